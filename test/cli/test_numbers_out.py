"""Claims about numbers that leave the suite: tables, recordings, parameter files."""

from dataclasses import replace
import errno
import json
from pathlib import Path
import re
import threading

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
from pyarrow import parquet
import pytest
import rclpy
from rosbags.highlevel import AnyReader

from saddlering_ros import rig
from saddlering_ros.bags.reader import read_run
from saddlering_ros.cli.main import main
from saddlering_ros.files import share_directory
from saddlering_ros.rig import CHANNELS, ParameterSet, TRUE_TO_SCALE, write_parameters
from saddlering_ros.ring.simulator import simulate_in_blocks

BAG = share_directory() / 'bags' / 'dynamic_50_fast'


@pytest.fixture(scope='module')
def parameters(tmp_path_factory):
    path = tmp_path_factory.mktemp('numbers') / 'parameters.yaml'
    source = rig.ParameterSource(method='given', bags=('a', 'b'), covariance=np.eye(6))
    write_parameters(path, ParameterSet(TRUE_TO_SCALE, {'radial_friction': {'force': 5e3}},
                                        source))
    return path


@pytest.mark.ros
def test_a_recorded_replay_holds_every_live_result_and_explains_itself(
        ros_domain, campaign, parameters, tmp_path, capsys):
    bag = str(campaign('radial_friction', 8000.0, 'force', ('dynamic_50_fast',))[0])
    recorded, table = tmp_path / 'recorded', tmp_path / 'residual.parquet'
    assert main(['replay', bag, '--rate', '0', '--params', str(parameters), '--record',
                 str(recorded), '--json', '-']) == 0
    told = json.loads(capsys.readouterr().out)
    assert main(['residual', bag, '--params', str(parameters), '--out', str(table)]) == 0
    offline = parquet.read_table(table)

    with AnyReader([recorded]) as reader:  # with nothing but what stands in the file
        kinds = {item.topic: item.msgtype for item in reader.connections}
        live = {}
        residual = [item for item in reader.connections if item.topic == '/ring/residual']
        for item, _, data in reader.messages(residual):
            said = reader.deserialize(data, item.msgtype)
            stamp = said.header.stamp.sec * 10**9 + said.header.stamp.nanosec
            live[stamp] = [getattr(said, name) for name in CHANNELS]
    assert kinds['/ring/parameters'] == 'saddlering_interfaces/msg/RingParameters'
    assert kinds['/diagnostics'] == 'diagnostic_msgs/msg/DiagnosticArray'
    assert sorted(live) == offline['stamp_ns'].to_pylist()
    assert np.array_equal(np.array([live[stamp] for stamp in sorted(live)]).T,
                          np.array([offline[name].to_numpy() for name in CHANNELS]))
    assert told['messages']['/ring/residual'] == len(live)
    again, first = read_run(recorded), read_run(bag)
    assert np.array_equal(again.load, first.load)
    assert (again.test, again.elevation) == (first.test, first.elevation)
    assert again.rig_hash == first.rig_hash != ''


def test_a_parameter_file_is_one_of_ros_2(ros_domain, parameters):
    context = rclpy.Context()
    rclpy.init(context=context, args=['--ros-args', '--params-file', str(parameters)])
    node = rclpy.create_node('any', context=context,
                             automatically_declare_parameters_from_overrides=True)
    try:
        found = {name: node.get_parameter(name).value for name in (
            'contact.K1', 'contact.n2', 'effects.radial_friction.force', 'source.bags')}
        assert found == {'contact.K1': TRUE_TO_SCALE.K1, 'contact.n2': TRUE_TO_SCALE.n2,
                         'effects.radial_friction.force': 5e3, 'source.bags': ['a', 'b']}
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)


def test_a_recording_with_half_the_facts_is_refused(capsys):
    assert main(['record', 'nowhere', '--test', 'static']) == 2
    assert 'give both, or neither' in capsys.readouterr().err


@pytest.mark.ros
def test_a_recording_is_not_put_over_something_else(ros_domain, tmp_path, capsys):
    (tmp_path / 'file').write_text('precious')
    assert main(['record', str(tmp_path), '--duration', '1', '--overwrite']) == 2
    assert Path(tmp_path / 'file').read_text() == 'precious'
    assert 'is not a bag' in capsys.readouterr().err


@pytest.mark.ros
def test_a_recording_of_nothing_says_so(ros_domain, tmp_path, capsys):
    out = tmp_path / 'nothing'
    assert main(['record', str(out), '--duration', '0.5', '--json', '-', '--namespace', 'r']) == 0
    said = capsys.readouterr()
    assert set(json.loads(said.out)['messages'].values()) == {0}
    assert 'no message was received' in said.err
    assert 'namespace /r' in said.err
    assert sorted(file.name for file in out.iterdir()) == ['metadata.yaml', 'nothing_0.mcap']


@pytest.mark.ros
def test_a_recording_that_cannot_be_written_any_more_ends_in_one_line(
        ros_domain, tmp_path, capsys, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, 'No space left on device')

    monkeypatch.setattr('saddlering_ros.bags.write.McapWriter.add_message', full)
    ended = threading.Event()
    speaking = threading.Thread(target=speak, args=(ros_domain, ended))
    speaking.start()
    try:
        assert main(['record', str(tmp_path / 'out'), '--duration', '30']) == 2
    finally:
        ended.set()
        speaking.join()
    said = capsys.readouterr().err
    assert said.count('\n') == 1
    assert 'cannot be written (No space left on device)' in said
    assert not (tmp_path / 'out').exists()


def speak(domain, ended):
    """Publish on /diagnostics until told to end."""
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain)
    node = rclpy.create_node('speaker', context=context)
    publisher = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
    while not ended.wait(0.05):
        publisher.publish(DiagnosticArray())
    node.destroy_node()
    rclpy.shutdown(context=context)


def test_a_step_that_does_not_converge_is_left_out_of_the_residual_and_told(
        parameters, tmp_path, monkeypatch, capsys):
    out = tmp_path / 'residual.csv'

    def stumbling(*given):
        for found in simulate_in_blocks(*given):
            found.displacement.gamma[5] = np.nan
            yield replace(found, failed_steps=1)

    monkeypatch.setattr('saddlering_ros.record.residual.simulate_in_blocks', stumbling)
    assert main(['residual', str(BAG), '--params', str(parameters), '--out', str(out)]) == 0
    assert 'did not converge in 1 step,' in capsys.readouterr().out
    assert 'nan' not in out.read_text()


@pytest.mark.parametrize('command', ['simulate', 'residual'])
def test_a_run_in_stretches_gives_the_same_table_to_the_last_bit(
        command, parameters, tmp_path, monkeypatch):
    whole, parts = tmp_path / 'whole.csv', tmp_path / 'parts.csv'
    words = [command, str(BAG), '--params', str(parameters), '--out']
    assert main([*words, str(whole)]) == 0
    monkeypatch.setattr('saddlering_ros.record.residual.BLOCK', 257)
    assert main([*words, str(parts)]) == 0
    assert parts.read_bytes() == whole.read_bytes()


def test_a_ring_without_an_equilibrium_is_an_error_not_an_empty_table(tmp_path, capsys):
    soft, out = tmp_path / 'soft.yaml', tmp_path / 'simulated.csv'
    write_parameters(soft, ParameterSet(replace(TRUE_TO_SCALE, K1=1000.0)))
    assert main(['simulate', str(BAG), '--params', str(soft), '--out', str(out)]) == 2
    told = capsys.readouterr().err
    assert 'no sample could be simulated' in told
    assert told.count('\n') == 1
    assert not out.exists()


@pytest.mark.parametrize('exponent', [1e-300, 0.4, 6.0])
def test_an_exponent_that_no_contact_has_is_refused_at_once(exponent, parameters, tmp_path,
                                                            capsys):
    strange = tmp_path / 'strange.yaml'
    strange.write_text(re.sub(r'n1: [^,}\n]*', f'n1: {exponent:.1e}', parameters.read_text()))
    assert main(['simulate', str(BAG), '--params', str(strange)]) == 2
    assert 'contact.n1' in capsys.readouterr().err
