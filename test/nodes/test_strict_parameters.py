"""Claims about how nodes are started: what nobody knows, or reads twice, ends the node."""

from collections.abc import Iterator
import contextlib
from importlib import util
import json
import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from forked_nodes import endings
import pytest
import rclpy
from rclpy.node import Node
from rclpy.parameter import Parameter
import yaml

from saddlering_ros.files import share_directory
from saddlering_ros.nodes.ring_residual import RingResidualNode
from saddlering_ros.rig import load_rig, RigError
from saddlering_ros.ros import parameters
from saddlering_ros.ros.launcher import ros_arguments
from saddlering_ros.ros.names import NodeError
from saddlering_ros.ros.parameters import declare, declare_rig, NodeParameter, strict_arguments
from saddlering_ros.ros.streaming_node import run_streaming

BAG = Path(__file__).parents[2] / 'bags' / 'static_50'
pytestmark = pytest.mark.ros


@contextlib.contextmanager
def node_with(*arguments: str) -> Iterator[Node]:
    context = rclpy.Context()
    rclpy.init(context=context, args=['program', *arguments])
    node = rclpy.create_node('listener', context=context)
    try:
        yield node
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)


def refusals(*cases: list[str]) -> list[str]:
    ended = endings([('ring_simulator', ['--ros-args', *words]) for words in cases])
    assert [status for status, _ in ended] == [2] * len(cases), ended
    return [said.strip().splitlines()[-1] for _, said in ended]


def test_as_fast_as_the_nodes_follow_needs_lockstep() -> None:
    [(status, said)] = endings([('replay_clock', [
        '--ros-args', '-p', f'bag:={BAG}', '-p', 'rate:=0.0'])])
    assert (status, said.count('Traceback')) == (2, 0)
    assert 'needs lockstep: give lockstep:=true too' in said


def test_a_node_that_was_given_what_nobody_knows_or_reads_otherwise_ends(tmp_path: Path) -> None:
    file, pipe = tmp_path / 'rig.yaml', tmp_path / 'pipe'
    file.write_text('/**:\n  ros__parameters:\n    rig.radial_row.rollers: 0110\n')
    os.mkfifo(pipe)
    misspelt, ignored, otherwise, waiting = refusals(
        ['-p', 'elevation:=70.0'],
        ['-p', 'qos_overrides./nothing.publisher.depth:=3'],
        ['--params-file', str(file)], ['--params-file', str(pipe)])
    assert misspelt == (
        'ring_simulator: parameter elevation is unknown: did you mean elevation_deg?')
    assert 'has no effect: the parameter input_reliability' in ignored
    assert 'line 3: the number 0110 is not' in otherwise
    assert 'a pipe or device' in waiting


ROS_ARGS = '--ros-args'


def test_a_node_says_which_rig_it_has_and_which_parameter_file_is_of_another_node(tmp_path):
    file, ended = tmp_path / 'mine.yaml', []
    node: Any = SimpleNamespace(get_fully_qualified_name=lambda: '/ring_simulator')
    for name in ('ring_simulater', '/**/ring_simulator', 'rig1/ring_simulator', '/*'):
        file.write_text(f'{name}: {{ros__parameters: {{rig: {{}}}}}}\n')
        ended.append(parameters.unaddressed([ROS_ARGS, '--params-file', str(file)], node))
    assert [len(warnings) for warnings in ended] == [1, 0, 1, 0]
    assert ended[0][0].endswith('it has sections for /ring_simulater and none for '
                                '/ring_simulator: name this node or /**')
    file.write_text(yaml.safe_dump({'nobody': {'ros__parameters': {'rate': 2.0}}}))
    [(_, said)] = endings([('replay_clock', [
        ROS_ARGS, '--params-file', str(file), '-p', f'bag:={BAG}', '-p', 'rate:=0.0'])])
    assert 'the shipped one, because no parameter rig.* is given' in said
    assert f'nothing of {file} is used' in said


NOT_READ: list[tuple[list[str], str]] = [
    (['max_gap:=3.0'], 'max_gap:=3.0 is not read: give --ros-args -p NAME:=VALUE'),
    ([ROS_ARGS, '-r', 'rig/load'], "remap rule '-r rig/load' is of no use: give -r OLD:=NEW"),
    ([ROS_ARGS, '-r', '__ns:=rig1'], "-r __ns:=rig1' is of no use: give -r __ns:=/NAME with let"),
    ([ROS_ARGS, '-p', "frame_id:=''"], "frame_id is '': give the name of a frame, without"),
    ([ROS_ARGS, '-p', 'frame_id:=/map'], "frame_id is '/map': give the name of a frame"),
    ([ROS_ARGS, '-p', 'max_gap'], "rule '-p max_gap' is of no use: give -p NAME:=VALUE"),
    ([ROS_ARGS, '--log-level', 'loud'], "'--log-level loud' is of no use: give --log-level debug"),
    ([ROS_ARGS, '--params-file', 'flat.yaml'],
     'of no use (Cannot have a value before ros__parameters at line 1): give --params-file FILE'),
    ([ROS_ARGS, '--params-file', 'lists.yaml', '-p', 'frame:=a'], 'did you mean frame_id?'),
    ([ROS_ARGS, '-p', 'needed_nodes:=[]', '-p', 'frame:=a'], 'did you mean frame_id?')]


def test_a_command_line_that_is_not_understood_is_refused_with_what_to_type(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path('flat.yaml').write_text('max_gap: 3.0\n')
    Path('lists.yaml').write_text('/**: {ros__parameters: {bounds: {n1: [1, 1.5]}}}\n')
    ended = endings([('ring_residual', words) for words, _ in NOT_READ])
    for (words, wanted), (status, said) in zip(NOT_READ, ended, strict=True):
        line = said.strip().splitlines()[-1]
        assert (status, line.count('/src/')) == (2, 0), (words, said)
        assert wanted in line


@pytest.mark.parametrize('domain', ['300', '-1', 'abc', '1.5'])
def test_a_node_refuses_a_domain_that_ros_does_not_have(monkeypatch, capsys, domain) -> None:
    monkeypatch.setenv('ROS_DOMAIN_ID', domain)
    assert run_streaming(RingResidualNode, []) == 2
    assert f"ROS_DOMAIN_ID is '{domain}': give a ROS domain from 0" in capsys.readouterr().err


def test_a_transform_without_its_message_package_is_refused_in_a_line() -> None:
    if util.find_spec('tf2_msgs'):
        pytest.skip('tf2_msgs is there')
    [(status, said)] = endings([('ring_displacement', [
        '--ros-args', '-p', 'displaced_frame_id:=ring_displaced'])])
    assert (status, said.count('Traceback')) == (2, 0)
    assert 'needs the package tf2_msgs: sudo apt install ros-jazzy-tf2-msgs' in said


# As launch_ros 0.26 evaluates parameters: keys of nested dictionaries joined by dots, and lists
# made tuples. Its node action writes one file per dictionary.
LAUNCHED = {
    'participants': ('ring_displacement', 'ring_simulator'), 'numbers': (1.0, 1e-5, 2e300),
    'polarity': (1, -1, 1, -1), 'flags': (True, False), 'rig.middle_row.height': 0.12,
    'bag': '/prüfstand/läufe/Übung 1' + 'x' * 90, 'digits': '0110', 'empty': '', 'time': '1:30',
    'quoted': "it's: no # comment", 'elevation_deg': float('nan')}


def launched(path: Path, name: str) -> list[str]:
    document = {name: {'ros__parameters': LAUNCHED}}
    path.write_text(yaml.dump(document, default_flow_style=False))
    return [ROS_ARGS, '--params-file', str(path)]


@pytest.mark.parametrize('name', ['/**', '/rig1/ring_alarm', '/ring_alarm'])
def test_a_file_that_a_launch_file_wrote_is_accepted(tmp_path: Path, name: str) -> None:
    words = launched(tmp_path / 'launch_params_x', name)
    assert '!!python/tuple' in Path(words[-1]).read_text()
    strict_arguments(words)


@pytest.mark.parametrize('text', [
    '!!python/object/apply:os.system [true]', '!!python/name:os.system', '!!python/dict {a: 1}'])
def test_no_other_tag_of_python_is_accepted(tmp_path: Path, text: str) -> None:
    file = tmp_path / 'params.yaml'
    file.write_text(f'/**:\n  ros__parameters:\n    a: {text}\n')
    with pytest.raises(NodeError, match='is not YAML'):
        strict_arguments([ROS_ARGS, '--params-file', str(file)])


def test_a_node_starts_with_a_list_from_a_launch_file(tmp_path: Path) -> None:
    """The clock takes the list; what ends it is the bag that is not there."""
    file = tmp_path / 'launch_params_y'
    file.write_text(yaml.dump({'/replay_clock': {'ros__parameters': {
        'participants': ('ring_displacement',), 'bag': str(tmp_path / 'keine-ä')}}},
        default_flow_style=False))
    [(status, said)] = endings([('replay_clock', ['--ros-args', '--params-file', str(file)])])
    assert status == 2
    assert 'keine-ä' in said
    assert 'tuple' not in said


@pytest.mark.parametrize('is_project', [False, True])
def test_a_rig_file_reaches_a_node_with_its_certificates_and_limits_of_wear(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_project: bool) -> None:
    document = yaml.safe_load((share_directory() / 'config' / 'rig.yaml').read_text())
    document['/**']['ros__parameters']['rig'] |= {
        'instruments': {'load_gain': 1e-3, 'probe_gain': [2e-3, 1e-3, 1e-3, 1e-3]},
        'wear_limits': {'tilting_clearance': 5e-4}}
    file = tmp_path / 'rig.yaml'
    file.write_text(yaml.dump(document))
    if is_project:
        monkeypatch.setenv('SADDLERING_RIG', str(file))
    with node_with(*ros_arguments(files=[] if is_project else [file])) as node:
        assert declare_rig(node) == load_rig(file)
        parameters.refuse_undeclared(node)


CERTIFICATE = """<digitalCalibrationCertificate><quantity id="sensitivity"><real>
<value>1.0</value><unit>\\one</unit><expandedMU><valueExpandedMU>0.002</valueExpandedMU>
<coverageFactor>2</coverageFactor></expandedMU></real></quantity></digitalCalibrationCertificate>
"""


def test_a_node_finds_certificates_beside_its_rig_file_as_a_command_does(tmp_path, monkeypatch):
    tmp_path.joinpath('cell.xml').write_text(CERTIFICATE)
    certified = {'certificate': 'cell.xml', 'quantity': 'sensitivity'}
    document = yaml.safe_load((share_directory() / 'config' / 'rig.yaml').read_text())
    document['/**']['ros__parameters']['rig']['instruments'] = {
        'load_gain': certified, 'probe_gain': [dict(certified), 0.002, 0.003, dict(certified)]}
    file = tmp_path / 'rig.yaml'
    file.write_text(yaml.dump(document))
    monkeypatch.chdir('/')
    with node_with(*strict_arguments(ros_arguments(files=[file]))) as node:
        assert declare_rig(node) == load_rig(file)
        assert load_rig(file).instruments.probe_gain == (0.001, 0.002, 0.003, 0.001)
        parameters.refuse_undeclared(node)


def test_a_certificate_that_is_not_there_is_refused_with_its_place(tmp_path: Path) -> None:
    file = tmp_path / 'rig.yaml'
    file.write_text('/**: {ros__parameters: {rig.instruments.load_gain: '
                    '{certificate: cell.xml, quantity: gain}}}')
    with pytest.raises(RigError, match=f'{file}: rig.instruments.load_gain: {tmp_path}/cell.xml'):
        strict_arguments(ros_arguments(files=[file]))


@pytest.mark.parametrize('value', [1e-7, 1.5e-7, 5e-5, 3.0, -1e16])
def test_a_number_reaches_a_node_as_it_was_given(value: float) -> None:
    context = rclpy.Context()
    rclpy.init(args=['program', *ros_arguments({'given': value})], context=context)
    node = rclpy.create_node('listener', context=context,
                             automatically_declare_parameters_from_overrides=True)
    try:
        assert node.get_parameter('given').value == value
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)


CHANGEABLE = (
    NodeParameter('window', 2.0, 'a number', low=1e-6, high=100.0, changeable=True),
    NodeParameter('elevation_deg', 3.0, 'a number', low=-10.0, high=90.0, changeable=True,
                  nan_allowed=True),
    NodeParameter('name', 'a', 'a text', changeable=True),
    NodeParameter('fixed', 1.0, 'a number'))


@pytest.mark.parametrize(('name', 'given', 'kept'), [
    ('window', 50, 50.0), ('window', '1e-6', 1e-6), ('window', '5E1', 50.0),
    ('elevation_deg', 'nan', float('nan'))])
def test_a_number_is_taken_as_ros2_param_set_sends_it(name, given, kept) -> None:
    """It sends 50 as a whole number, and 1e-6 as the text that YAML 1.1 makes of it."""
    with node_with() as node:
        settings = declare(node, CHANGEABLE)
        answer = node.set_parameters_atomically([Parameter(name, value=given)])
        assert (answer.successful, answer.reason) == (True, '')
        assert repr(settings[name]) == repr(node.get_parameter(name).value) == repr(kept)


@pytest.mark.parametrize(('name', 'given', 'words'), [
    ('window', 101, 'out of range'), ('window', '1e-7', 'out of range'),
    ('window', 'inf', 'out of range'), ('elevation_deg', '91', 'from -10 to 90'),
    ('window', 'wide', "window is 'wide': give a number"),
    ('window', '1_0', "window is '1_0': give a number"),
    ('window', True, 'window is True: give a number'),
    ('window', None, 'window is None: give a number'),
    ('window', [1.0], 'window is [1.0]: give a number'),
    ('name', 50, 'name is 50: give a text'), ('fixed', 2, 'read-only parameter: fixed')])
def test_any_other_value_is_refused_in_a_line_that_says_what_to_give(name, given, words) -> None:
    with node_with() as node:
        before = dict(declare(node, CHANGEABLE))
        answer = node.set_parameters_atomically([Parameter(name, value=given)])
        assert not answer.successful
        assert words in answer.reason
        assert '\n' not in answer.reason
        assert {one.name: node.get_parameter(one.name).value for one in CHANGEABLE} == before
        assert node.describe_parameter(name).type == node.get_parameter(name).type_.value


def test_numbers_that_a_launch_file_wrote_as_texts_are_numbers(tmp_path: Path) -> None:
    """YAML 1.1 reads 1e-6 as text, and some writers of YAML quote it then."""
    document = yaml.safe_load((share_directory() / 'config' / 'rig.yaml').read_text())
    given = document['/**']['ros__parameters']
    given['rig']['preload'] = '1e4'
    given |= {'window': '1e-6', 'contact': {'K1': '1e8'}, 'source': {'bags': ['20250101']}}
    file = tmp_path / 'launch_params_z'
    file.write_text(json.dumps(document))
    with node_with('--ros-args', '--params-file', str(file)) as node:
        assert declare(node, CHANGEABLE)['window'] == 1e-6
        assert declare_rig(node).preload == 1e4
        assert parameters.given_sections(node, ('contact', 'source')) == {
            'contact': {'K1': 1e8}, 'source': {'bags': ['20250101']}}


def test_a_text_at_the_start_that_is_no_number_ends_the_node() -> None:
    with node_with('--ros-args', '-p', 'window:=wide') as node, pytest.raises(
            NodeError, match="listener: parameter window is 'wide': give a number"):
        declare(node, CHANGEABLE)
