"""Nodes start from what a launch file hands them, and end well whenever they are told to stop."""

from pathlib import Path
import signal
import subprocess
import sys

import pytest
from rosnet import Client, wait_until

from saddlering_ros.ros.launcher import NodeGroup
from saddlering_ros.ros.names import CLOCK, names, REPLAY

RIG = Path(__file__).parents[2] / 'config' / 'rig.yaml'
CODE = """
import os, signal, sys
sys.argv[0] = sys.argv[1]

class FirstImport:
    def find_spec(self, name, *_):
        if name == 'saddlering_ros.ros.launcher':
            os.kill(os.getpid(), getattr(signal, sys.argv[2]))

sys.meta_path.insert(0, FirstImport())
import saddlering_ros.nodes
os.kill(os.getpid(), getattr(signal, sys.argv[2]))
print('goes on')
"""
MADE = """
import os, signal, sys
sys.argv[0], number = sys.argv[1:]
from saddlering_ros.nodes.ring_alarm import RingAlarmNode
from saddlering_ros.ros.streaming_node import leave, run

class Dropped:  # what is raised in __del__ is printed and goes no further
    def __del__(self):
        os.kill(os.getpid(), getattr(signal, number))

def make():
    node = RingAlarmNode()
    Dropped()
    return node

leave(run(make, lambda node: print('spins'), []))
"""
DESTROYED = """
import ctypes, sys
from saddlering_ros.errors import SaddleringError
from saddlering_ros.ros import streaming_node
streaming_node.LONGEST_END = 0.5

class Node:
    context = None

    def destroy_node(self):
        ctypes.PyDLL(None).sleep(3600)  # a call into C that keeps the interpreter

def spin(node):
    if sys.argv[2] == 'refuses':
        raise SaddleringError('no use')

streaming_node.parameters.refuse_undeclared = lambda node: None
streaming_node.leave(streaming_node.run(Node, spin, []))
"""
HELD = """
import ctypes, gc, signal, sys
from saddlering_ros.ros.streaming_node import leave
for number in (signal.SIGINT, signal.SIGTERM):
    signal.signal(number, signal.SIG_IGN)

class Participant:
    def __del__(self):
        if sys.argv[1] == 'hung':
            ctypes.PyDLL(None).sleep(3600)  # a call into C that keeps the interpreter
        ctypes.PyDLL(None).strlen(None)

participant = Participant()
participant.itself = participant
del participant
leave(0, longest=0.5)
"""


def told_to_stop(program: str, number: str, code: str = CODE) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, '-c', code, program, number], capture_output=True,
                          text=True, timeout=60, check=False)


@pytest.mark.parametrize('number', ['SIGINT', 'SIGTERM'])
def test_a_node_that_is_told_to_stop_while_it_imports_ends_with_status_0(number: str) -> None:
    node = told_to_stop('/opt/lib/saddlering_ros/ring_simulator', number)
    assert (node.returncode, node.stdout, node.stderr) == (0, '', '')
    other = told_to_stop('/usr/bin/pytest', number)
    assert other.returncode == -getattr(signal, number)


@pytest.mark.ros
@pytest.mark.parametrize('number', ['SIGINT', 'SIGTERM'])
def test_a_node_that_is_told_to_stop_while_it_is_made_ends_with_status_0(number: str) -> None:
    node = told_to_stop('/opt/lib/saddlering_ros/ring_alarm', number, MADE)
    assert (node.returncode, node.stdout) == (0, '')
    assert 'Traceback' not in node.stderr


@pytest.mark.parametrize('fault', ['hung', 'crashed'])
def test_a_middleware_that_does_not_leave_the_network_is_abandoned(fault: str) -> None:
    node = subprocess.run([sys.executable, '-c', HELD, fault], capture_output=True, text=True,
                          timeout=60, check=False)  # an hour, were it not abandoned
    assert (node.returncode, node.stderr) == (0, '')


@pytest.mark.ros
@pytest.mark.parametrize(('ending', 'status'), [('ends', 0), ('refuses', 2)])
def test_a_node_that_hangs_while_it_is_destroyed_is_abandoned(ending: str, status: int) -> None:
    """Fast DDS kept the interpreter in destroy_node, and SIGTERM was ignored by then."""
    node = told_to_stop('ring_alarm', ending, DESTROYED)
    assert node.returncode == status, node.stderr
    assert node.stderr.splitlines() == ['no use'] * (ending == 'refuses')


class Told(BaseException):
    """What a signal's handler raises."""


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_in_the_middle_of_a_nodes_start_leaves_no_process(number, tmp_path, monkeypatch):
    started: list[subprocess.Popen[bytes]] = []

    def started_and_told(*_: object, **__: object) -> subprocess.Popen[bytes]:
        started.append(subprocess.Popen(['sleep', '60'], start_new_session=True))
        signal.raise_signal(number)
        return started[0]

    def tell(*_: object) -> None:
        raise Told

    monkeypatch.setattr('saddlering_ros.ros.launcher.Popen', started_and_told)
    before = signal.signal(number, tell)
    try:
        with pytest.raises(Told), NodeGroup(domain_id=1, log_folder=tmp_path) as group:
            group.start('ring_displacement')
        assert started[0].poll() is not None
        assert signal.getsignal(number) is tell
    finally:
        signal.signal(number, before)
        started[0].kill()
        started[0].wait()


@pytest.mark.ros
def test_two_rigs_of_nodes_that_replay_take_the_rig_file_and_end_with_status_0(
        heard: Client, ros_domain: int, tmp_path: Path) -> None:
    spaces = ('/rig1', '/rig2')
    groups = [NodeGroup(domain_id=ros_domain, log_folder=tmp_path / space[1:], namespace=space)
              for space in spaces]
    with groups[0] as one, groups[1] as two:
        for group in (one, two):
            for name in names(CLOCK, REPLAY)[::2]:
                group.start(name, {'autostart': False}, files=[RIG])
        started = [(group, name) for group in (one, two) for name in group.processes]
        wait_until(lambda: all(f'{group.namespace}/{name}: state' in heard.diagnostics
                               for group, name in started), 120.0, 'every node reports')
        for group, name in started:
            group.processes[name].process.send_signal(signal.SIGINT)
        assert [group.processes[name].process.wait(60.0) for group, name in started] == [
            0] * len(started)
