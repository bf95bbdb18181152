"""Promises of SECURITY.md on nodes: roots, limits, plain data, discovery, no code from data."""

from __future__ import annotations

import ast
from dataclasses import dataclass
import math
from pathlib import Path
import shutil
import socket
from types import SimpleNamespace

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from saddlering_interfaces.action import IdentifyRing
from saddlering_ros.files import share_directory
from saddlering_ros.jobs import diagnosis as diagnosis_job
from saddlering_ros.jobs import identification as identification_job
from saddlering_ros.jobs.action_server import ActionNode
from saddlering_ros.jobs.identification import IdentificationAnswer, IdentificationRequest
from saddlering_ros.jobs.plain_data import PlainDataError, ValueSocket
from saddlering_ros.nodes.ring_identification import settings_of
from saddlering_ros.rig import default_rig, ParameterSet, ParameterSource, TRUE_TO_SCALE
from saddlering_ros.ros.diagnostics import OK, SourcesTask, WARN
from saddlering_ros.ros.launcher import local_discovery
from saddlering_ros.ros.names import NodeError
from saddlering_ros.ros.parameters import bag_below, NodeParameter

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


@pytest.mark.parametrize('path', sorted(SOURCE.rglob('*.py')),
                         ids=lambda path: str(path.relative_to(SOURCE)))
def test_nothing_turns_data_into_code_or_goes_through_a_shell(path: Path) -> None:
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else [
                node.module or '']
            assert not {name.partition('.')[0] for name in names} & FORBIDDEN_MODULES
            assert not any(name.startswith('multiprocessing') for name in names)  # it pickles
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
        if isinstance(node, ast.ImportFrom) and path.name != 'compiled.py':
            assert 'caching' not in [alias.name for alias in node.names]  # numba's pickles it


# --- what goes between a node and its worker ---

def pair(types=()) -> tuple[ValueSocket, ValueSocket]:
    one, other = socket.socketpair()
    return ValueSocket(one, types), ValueSocket(other, types)


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.lists(inner, max_size=4).map(tuple)
    | st.dictionaries(st.text(max_size=5).filter(lambda key: not key.startswith('(')), inner,
                      max_size=4), max_leaves=20)


@settings(max_examples=60, deadline=None, derandomize=True, database=None)
@given(value=VALUES)
def test_plain_values_arrive_as_they_were_sent(value) -> None:
    one, other = pair()
    one.send(value)
    assert other.receive() == value


def test_requests_and_answers_arrive_bit_for_bit() -> None:
    request = IdentificationRequest(
        ('a', 'b'), (), default_rig(),
        settings_of(IdentifyRing.Goal(lower_bounds=[1.0] * 6, upper_bounds=[2.0] * 6)))
    covariance = np.random.default_rng(0).normal(size=(6, 6))
    covariance[0, 0] = math.nan
    source = ParameterSource('swarm', ('a',), 0.1 + 0.2, covariance, 'n', ('f' * 64,))
    answer = IdentificationAnswer(ParameterSet(TRUE_TO_SCALE, {'e': {'p': 1e-300}}, source),
                                  math.inf, 'w', '[]', '{}')
    one, other = pair(identification_job.TYPES)
    one.send(('done', request))
    assert other.receive() == ('done', request)
    one.send(answer)
    found = other.receive()
    np.testing.assert_array_equal(found.parameters.source.covariance, covariance)
    assert found.parameters.contact == TRUE_TO_SCALE
    assert found.objective == math.inf
    assert set(diagnosis_job.TYPES) >= {type(default_rig()), ParameterSet}


@dataclass
class Stranger:
    """A class that nobody agreed on."""

    value: int = 1


@pytest.mark.parametrize('value', [Stranger(), {1: 2}, {'(type)': 'Rig'}, object(), b'bytes'])
def test_what_is_no_plain_data_is_not_sent(value) -> None:
    with pytest.raises(PlainDataError):
        pair()[0].send(value)


def test_a_class_that_was_not_agreed_on_is_not_made() -> None:
    one, other = socket.socketpair()
    ValueSocket(one, [Stranger]).send(Stranger())
    with pytest.raises(PlainDataError, match='not among the types'):
        ValueSocket(other, []).receive()


def test_a_length_beyond_all_measure_is_refused_and_an_end_is_an_end() -> None:
    one, other = socket.socketpair()
    one.sendall(b'\xff\xff\xff\xff')
    with pytest.raises(PlainDataError, match='too large'):
        ValueSocket(other, []).receive()
    one, other = socket.socketpair()
    one.close()
    with pytest.raises(EOFError):
        ValueSocket(other, []).receive()


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


@pytest.mark.parametrize(('publishers', 'level'), [(0, OK), (1, OK), (2, WARN)])
def test_two_sources_of_one_topic_are_reported(publishers: int, level: int) -> None:
    finding = SourcesTask(lambda: {'/rig/hydraulic_load': publishers}).report(1.0)
    assert finding.level == level


def test_discovery_stays_on_this_machine_unless_the_user_says_otherwise(
        monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv('ROS_AUTOMATIC_DISCOVERY_RANGE', raising=False)
    monkeypatch.delenv('ROS_LOCALHOST_ONLY', raising=False)
    assert local_discovery() == {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'SUBNET')
    assert local_discovery() == {}
