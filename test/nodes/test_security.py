"""Promises of SECURITY.md on nodes: roots, limits, plain data, discovery, no code from data."""

import ast
from collections.abc import Callable
import math
import os
from pathlib import Path
import shutil
import signal
from types import SimpleNamespace
from typing import Any

import pytest
import rclpy
from sources import imported

from saddlering_interfaces.action import IdentifyRing
from saddlering_ros.cli.main import main as saddlering
from saddlering_ros.files import share_directory
from saddlering_ros.jobs.action_server import ActionNode, serve
from saddlering_ros.nodes.ring_diagnosis import RingDiagnosisNode
from saddlering_ros.nodes.ring_displacement import RingDisplacementNode
from saddlering_ros.nodes.ring_identification import settings_of
from saddlering_ros.record.topics import LOAD_TOPIC
from saddlering_ros.ros.diagnostics import OK, sources_status, WARN
from saddlering_ros.ros.launcher import prepare_middleware
from saddlering_ros.ros.names import NodeError
from saddlering_ros.ros.parameters import bag_below, NodeParameter
from saddlering_ros.ros.streaming_node import run_streaming

SOURCE = Path(__file__).resolve().parents[2] / 'saddlering_ros'


# --- no code from data ---

FORBIDDEN_MODULES = {'pickle', 'marshal', 'shelve', 'dill', 'cloudpickle', 'joblib', 'code'}
FORBIDDEN_CALLS = {'eval', 'exec', 'os.system', 'os.popen', 'yaml.load_all', 'yaml.unsafe_load',
                   'yaml.full_load', 'pandas.read_pickle'}

SHELLS = {'sh', 'bash', 'dash', 'zsh', 'csh', 'ksh', 'fish', 'cmd', 'powershell'}


def called(node: ast.Call) -> str:
    """`name` or `module.name` of what is called; empty if it has no such name."""
    match node.func:
        case ast.Name(name):
            return name
        case ast.Attribute(ast.Name(module), name):
            return f'{module}.{name}'
    return ''


def test_nothing_turns_data_into_code_or_goes_through_a_shell() -> None:
    paths = sorted(SOURCE.rglob('*.py'))
    assert len(paths) > 100
    for path in paths:
        for module, name in imported(path):
            root = module.partition('.')[0]
            assert root not in FORBIDDEN_MODULES
            # The worker's pipe to its own child pickles, and so does numba's keeping of code.
            assert root != 'multiprocessing' or path.name == 'worker.py'
            assert name != 'caching' or path.name == 'compiled.py'
        refuse_code_from_data(path)


def refuse_code_from_data(path: Path) -> None:
    for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
        if isinstance(node, ast.Call):
            name = called(node)
            assert name not in FORBIDDEN_CALLS
            assert name not in ('np.load', 'numpy.load') or len(node.args) < 3  # allow_pickle
            assert name != 'yaml.load' or path.name == 'plain_yaml.py'
            for words in (one for one in node.args if isinstance(one, (ast.List, ast.Tuple))):
                first = getattr(words.elts[0], 'value', None) if words.elts else None
                assert not (isinstance(first, str) and Path(first).name in SHELLS)
            for keyword in node.keywords:
                value = getattr(keyword.value, 'value', None)
                assert (keyword.arg, value) not in (
                    ('shell', True), ('allow_pickle', True), ('cache', True))


# --- goals ---

def test_a_bag_in_the_root_cannot_lead_out_of_it_by_its_files(tmp_path: Path) -> None:
    root = (tmp_path / 'root').resolve()
    bag = shutil.copytree(share_directory() / 'bags' / 'static_50', root / 'bag')
    assert bag_below(root, 'bag') == bag
    outside = shutil.move(bag / 'static_50_0.mcap', tmp_path / 'secret.mcap')
    (bag / 'static_50_0.mcap').symlink_to(outside)
    with pytest.raises(NodeError, match='a link to outside'):
        bag_below(root, 'bag')
    (root / 'file.mcap').symlink_to(outside)
    with pytest.raises(NodeError, match='is not below'):
        bag_below(root, 'file.mcap')


@pytest.mark.parametrize('field', [{'particles': 4_000_000_000}, {'iterations': 2 ** 32 - 1},
                                   {'c1': math.nan}, {'inertia_end': math.inf}])
def test_a_goal_cannot_ask_for_memory_or_time_without_end(field) -> None:
    with pytest.raises(NodeError, match='give a number above 0'):
        settings_of(IdentifyRing.Goal(**field))


def test_a_goal_cannot_name_more_than_a_hundred_bags(tmp_path: Path) -> None:
    node = SimpleNamespace(bag_root=tmp_path)
    with pytest.raises(NodeError, match='names 101 bags: give at most 100'):
        ActionNode.bags(node, ['run'] * 101)


# --- parameters, publishers and discovery ---

@pytest.mark.parametrize('value', [math.nan, math.inf, -1.0, 1e9])
def test_a_parameter_out_of_range_is_refused_also_while_running(value: float) -> None:
    parameter = NodeParameter('rate', 1.0, 'a rate', low=0.0, high=100.0, changeable=True)
    assert parameter.refusal(value)
    assert not parameter.refusal(2.0)


@pytest.mark.parametrize(('publishers', 'unmixed', 'level'), [
    (0, (), OK), (1, (), OK), (2, (), WARN), (2, (LOAD_TOPIC,), OK)])
def test_two_sources_of_one_topic_are_reported(publishers: int, unmixed, level: int) -> None:
    finding = sources_status({LOAD_TOPIC: publishers}, unmixed=unmixed)
    assert finding.level == level


def test_discovery_stays_on_this_machine_unless_the_user_says_otherwise(monkeypatch) -> None:
    for given, used in (({}, 'LOCALHOST'), ({'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET'}, 'SUBNET'),
                        ({'ROS_LOCALHOST_ONLY': '1'}, None)):
        monkeypatch.setattr(os, 'environ', dict(given))
        prepare_middleware()
        assert os.environ.get('ROS_AUTOMATIC_DISCOVERY_RANGE') == used


PROGRAMS = pytest.mark.parametrize('start', [
    lambda _: run_streaming(RingDisplacementNode, []), lambda _: serve(RingDiagnosisNode, []),
    lambda folder: saddlering(['record', str(folder / 'bag'), '--duration', '1']),
    lambda _: saddlering(['check-driver']), lambda _: saddlering(['live', '--port', '0'])],
    ids=['node', 'server', 'record', 'check-driver', 'live'])


@PROGRAMS
def test_a_profile_of_the_middleware_that_is_not_there_is_refused(
        start: Callable[[Path], Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str]) -> None:
    """Nodes took the settings of Fast DDS, with which a replay lasted 80 s in place of 6."""
    monkeypatch.setenv('FASTRTPS_DEFAULT_PROFILES_FILE', str(tmp_path / 'none.xml'))
    monkeypatch.setattr(signal, 'signal', lambda *_: None)
    assert start(tmp_path) == 2
    assert f'FASTRTPS_DEFAULT_PROFILES_FILE is {str(tmp_path / "none.xml")!r}, and there is no ' \
        'such file: correct it, or unset it' in capsys.readouterr().err


@PROGRAMS
def test_a_log_folder_that_cannot_be_written_is_refused_before_anything_is(
        start: Callable[[Path], Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv('ROS_LOG_DIR', '/proc/logs')
    monkeypatch.setattr(signal, 'signal', lambda *_: None)
    assert start(tmp_path) == 2
    assert 'log folder /proc/logs (ROS_LOG_DIR): /proc cannot be written to' in (
        capsys.readouterr().err)
    assert not list(tmp_path.iterdir())


@PROGRAMS
def test_every_program_limits_its_discovery_before_it_joins_a_domain(
        start: Callable[[Path], Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ranges = []

    def joined(*_: Any, **__: Any) -> None:
        ranges.append(os.environ.get('ROS_AUTOMATIC_DISCOVERY_RANGE'))
        raise KeyboardInterrupt

    for name in ('ROS_AUTOMATIC_DISCOVERY_RANGE', 'ROS_LOCALHOST_ONLY'):
        monkeypatch.setenv(name, '')
    monkeypatch.setattr(rclpy, 'init', joined)
    monkeypatch.setattr(signal, 'signal', lambda *_: None)
    start(tmp_path)
    assert ranges == ['LOCALHOST']
