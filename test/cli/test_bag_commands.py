"""What `saddlering info`, `displacement` and `simulate` promise at the command line."""

from dataclasses import replace
import json
from pathlib import Path

import numpy as np
from pushed import pushed
from pyarrow import parquet
import pytest

from saddlering_ros.bags.reader import read_run
from saddlering_ros.bags.write import write_bag
from saddlering_ros.cli.main import main
from saddlering_ros.record.displacement import displacement_of_run
from saddlering_ros.record.record import TestMetadata
from saddlering_ros.record.topics import LOAD_TOPIC, PROBE_TOPICS
from saddlering_ros.rig import (
    default_rig,
    ParameterSet,
    ParameterSource,
    probes_to_displacement,
    read_parameters,
    TONNE,
    TRUE_TO_SCALE,
    write_parameters,
)
from saddlering_ros.rig.units import stiffnesses_per_millimetre
from saddlering_ros.ring.simulator import RingSimulator, simulate

EPOCH = 1_700_000_000_000_000_000
HEADER = 'stamp_ns,time,load,delta_x,delta_y,gamma,parity,validity'


@pytest.fixture
def bag(tmp_path) -> Path:
    """A dynamic test of two seconds at 500 Hz."""
    random = np.random.default_rng(0)
    time = np.arange(1000) * 2_000_000
    shape = np.clip(1.2 - np.abs(np.linspace(-1.8, 1.8, 1000)), 0.0, 1.0)
    load = (0.5 + 24.5 * shape) * TONNE + 50.0 * random.normal(size=1000)
    stamps = [EPOCH + time - 700_000 + 300_000 * number for number in range(4)]
    gaps = [1e-3 + sign * 4e-10 * load + 3e-7 * random.normal(size=1000)
            for sign in (1, 1, -1, -1)]
    metadata = TestMetadata('dynamic', 50.0, 'a rig', 'a run')
    return write_bag(tmp_path / 'bag', metadata, EPOCH + time, load, stamps, gaps,
                     default_rig().probes)


@pytest.fixture
def parameters(tmp_path) -> Path:
    path = tmp_path / 'parameters.yaml'
    write_parameters(path, ParameterSet(
        TRUE_TO_SCALE, {}, ParameterSource('assumed', (), None, None, '')))
    return path


def test_a_folder_of_bags_and_a_second_bag_are_refused_with_what_to_type(bag, tmp_path, capsys):
    """The advice `bags/*` named a script of the folder, and was "unknown" to `replay`."""
    assert main(['displacement', str(tmp_path)]) == 2
    assert capsys.readouterr().err == (f'saddlering displacement: {tmp_path}: is not a bag, but a '
                                       f'folder of 1: give {bag}\n')
    with pytest.raises(SystemExit):
        main(['displacement', str(bag), 'other', 'third'])
    assert 'takes one bag, not other third too: run it for each;' in capsys.readouterr().err


def table(path: Path) -> dict[str, np.ndarray]:
    """The columns of a CSV file, stamps as integers."""
    header, *lines = path.read_text().splitlines()
    rows = [line.split(',') for line in lines]
    names = header.split(',')
    return {name: np.array([int(row[place]) if name == 'stamp_ns' else float(row[place])
                            for row in rows]) for place, name in enumerate(names)}


@pytest.mark.parametrize('command', ['simulate', 'residual'])
def test_a_simulation_states_parameters_that_their_data_leave_open(bag, tmp_path, command, capsys):
    path = tmp_path / 'static.yaml'
    write_parameters(path, ParameterSet(TRUE_TO_SCALE, {}, ParameterSource(
        'paper', ('s',), None, None, '', undetermined={'D1': 'why', 'D2': 'why'})))
    assert main([command, str(bag), '--params', str(path)]) == 0
    out = ' '.join(capsys.readouterr().out.split())
    assert 'note: the data of the parameters do not determine D1, D2: where' in out
    assert 'outside of the bounds' not in out


def test_parameters_in_units_of_adams_are_noted(bag, tmp_path, capsys):
    """Stiffnesses in N/mm^n gave millimetres of motion without a word."""
    path, law = tmp_path / 'p.yaml', TRUE_TO_SCALE
    write_parameters(path, ParameterSet(replace(
        law, K1=stiffnesses_per_millimetre(vars(law))['K1'], D2=1e-3 * law.D2)))
    assert main(['simulate', str(bag), '--params', str(path)]) == 0
    out = ' '.join(capsys.readouterr().out.split())
    assert 'contact.K1 is 6.00 × 10⁴ N/m^n, and looks like N/mm^n; contact.D2 is 3000 N s/m, ' \
        'and looks like N s/mm: outside of the bounds of the rig file' in out


def test_displacement_writes_what_the_probes_measured_to_the_last_bit(bag, tmp_path, capsys):
    assert main(['displacement', str(bag), '--out', str(tmp_path / 'd.csv')]) == 0
    assert (tmp_path / 'd.csv').read_text().startswith(HEADER + '\n')
    run = read_run(bag)
    measured = displacement_of_run(default_rig(), run)
    kept = measured.complete
    columns = table(tmp_path / 'd.csv')
    np.testing.assert_array_equal(columns['stamp_ns'], run.stamps[kept])
    for name in ('delta_x', 'delta_y', 'gamma', 'parity'):
        np.testing.assert_array_equal(columns[name], getattr(measured.displacement, name)[kept])
    assert 'delta_x' in capsys.readouterr().out


def test_simulate_writes_what_the_model_gives_to_the_last_bit(bag, parameters, tmp_path):
    out = tmp_path / 's.csv'
    assert main(['simulate', str(bag), '--params', str(parameters), '--out', str(out)]) == 0
    run, rig = read_run(bag), default_rig()
    given = read_parameters(parameters)
    simulated = simulate(rig, given, run.elevation, run.time, run.load)
    columns = table(out)
    for name in ('delta_x', 'delta_y', 'gamma', 'parity'):
        np.testing.assert_array_equal(columns[name], getattr(simulated.displacement, name))
    simulator = RingSimulator(rig, given, run.elevation)
    times, probes = pushed(simulator, run.time, run.load)
    live = probes_to_displacement(rig.probes, probes)
    np.testing.assert_array_equal(columns['gamma'], live.gamma)
    np.testing.assert_array_equal(columns['time'], times)
    assert set(columns['stamp_ns']) <= set(run.stamps)


def test_parquet_holds_the_same_as_csv(bag, tmp_path):
    for name in ('d.csv', 'd.parquet'):
        assert main(['displacement', str(bag), '--out', str(tmp_path / name)]) == 0
    columns = table(tmp_path / 'd.csv')
    read = parquet.read_table(tmp_path / 'd.parquet')
    assert ','.join(read.column_names) == HEADER
    for name, values in columns.items():
        np.testing.assert_array_equal(read[name].to_numpy(), values)


def test_csv_goes_to_stdout_alone_on_request(bag, capsys):
    assert main(['displacement', str(bag), '--out', '-']) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == HEADER
    assert all(line.count(',') == 7 for line in lines)


@pytest.mark.parametrize('command', ['displacement', 'simulate', 'info'])
def test_json_goes_to_stdout_alone(bag, parameters, capsys, command):
    options = ['--params', str(parameters)] if command == 'simulate' else []
    assert main([command, str(bag), *options, '--json', '-']) == 0
    document = json.loads(capsys.readouterr().out)
    assert (document[0] if command == 'info' else document)


def test_elevation_given_wins(bag, parameters, capsys):
    common = ['simulate', str(bag), '--params', str(parameters), '--json', '-']
    found = []
    for options in ([], ['--elevation', '70']):
        assert main([*common, *options]) == 0
        found.append(json.loads(capsys.readouterr().out))
    assert [document['elevation_deg'] for document in found] == pytest.approx([50.0, 70.0])
    assert found[0]['channels'] != found[1]['channels']


@pytest.mark.parametrize('arguments', [
    ['displacement', 'BAG', '--out', 'table.xlsx'],
    ['displacement', 'BAG', '--out', '-', '--json', '-'],
    ['displacement', 'BAG', '--rig', 'nowhere.yaml'],
    ['displacement', 'BAG', '--elevation', '200'],
    ['simulate', 'BAG', '--params', 'nowhere.yaml'],
    ['displacement', 'nowhere'],
    ['simulate', 'nowhere', '--params', 'PARAMETERS'],
    ['info', 'nowhere']])
def test_unusable_arguments_get_one_line_and_status_2(bag, parameters, capsys, arguments):
    names = {'BAG': str(bag), 'PARAMETERS': str(parameters)}
    assert main([names.get(argument, argument) for argument in arguments]) == 2
    said = capsys.readouterr()
    assert said.out == ''
    assert len(said.err.splitlines()) == 1
    assert said.err.startswith(f'saddlering {arguments[0]}: ')


def test_a_damaged_bag_leaves_no_output(bag, parameters, tmp_path, capsys):
    file = bag / 'bag_0.mcap'
    file.write_bytes(file.read_bytes()[:20_000])
    before = set(tmp_path.iterdir())
    for command in (['displacement'], ['simulate', '--params', str(parameters)]):
        assert main([*command, str(bag), '--out', str(tmp_path / 'out.csv')]) == 2
    assert set(tmp_path.iterdir()) == before
    assert 'cut off' in capsys.readouterr().err


def test_info_shows_every_bag_and_ends_with_status_2_if_one_is_bad(bag, tmp_path, capsys):
    broken = tmp_path / 'broken.mcap'
    broken.write_bytes((bag / 'bag_0.mcap').read_bytes()[:30_000])
    assert main(['info', str(broken), str(bag)]) == 2
    said = capsys.readouterr()
    assert 'cut off' in said.out
    assert 'usable' in said.out
    assert all(topic in said.out for topic in (LOAD_TOPIC, *PROBE_TOPICS))
    assert len(said.err.splitlines()) == 1
    assert main(['info', str(bag)]) == 0


def test_info_as_json_has_no_nan(bag, tmp_path, capsys):
    (tmp_path / 'broken.mcap').write_bytes(b'junk')
    assert main(['info', str(bag), str(tmp_path / 'broken.mcap'), '--json', '-']) == 2

    def refuse(name):
        raise AssertionError(name)

    good, bad = json.loads(capsys.readouterr().out, parse_constant=refuse)
    assert good['usable']
    assert good['facts']['elevation_deg'] == 50.0
    assert not bad['usable']
    assert bad['problems']


ESCAPES = '\x1b]0;renamed\x07\x1b[2J\u202e'


def test_a_text_of_a_bag_cannot_control_the_terminal(bag, capsys, tmp_path):
    made = TestMetadata('dynamic', 50.0, f'rig{ESCAPES}', ESCAPES, {'operator': ESCAPES})
    file = bag / 'metadata.yaml'
    file.write_text(file.read_text().replace('a run', '"\\e[2Ja run"'))
    assert main(['info', str(bag)]) == 2
    said = capsys.readouterr()
    shown = said.out + said.err + ''.join(made.as_text().values())
    assert not {'\x1b', '\x07', '\u202e'} & set(shown)
    assert '\\x1b[2J' in shown


@pytest.mark.parametrize('words', [
    ['live', '--domain', '900'], ['record', 'out', '--domain', '-1'],
    ['check-driver', '--domain', '233'], ['replay', 'BAG', '--domain', '300']])
def test_a_domain_that_cannot_be_is_one_line(bag, words, capsys):
    assert main([str(bag) if word == 'BAG' else word for word in words]) == 2
    assert 'give a ROS domain from 0 to 232' in capsys.readouterr().err
