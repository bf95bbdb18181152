"""A replay that waits for a node says for which, and gives up in time."""

import re
import shutil
from types import SimpleNamespace

import pytest

from saddlering_ros.cli import replay
from saddlering_ros.cli.main import main
from saddlering_ros.errors import BagError
from saddlering_ros.files import share_directory
from saddlering_ros.ros.names import NodeError


class _Stopped:
    """The clock of a group in which one node stopped before it was first heard."""

    running = True

    def __init__(self, words='still waits for ring_simulator: nothing received'):
        self.words = words

    def said(self):
        return f'[WARN] [replay_clock]: {self.words}\n'


def test_a_node_that_stops_before_it_is_heard_is_named_and_ends_the_replay(monkeypatch, capsys):
    monkeypatch.setattr(replay, 'START_PATIENCE', 0.0)
    group = SimpleNamespace(
        processes={'replay_clock': _Stopped()}, check=lambda: None, wait=lambda *_: 0)
    with pytest.raises(NodeError, match=r'does not start: .*ring_simulator: nothing received'):
        replay._wait(group, float('inf'), None, print)
    err = capsys.readouterr().err
    assert err == 'note: the replay still waits for ring_simulator: nothing received\n'


def test_a_reader_that_a_replay_did_not_wait_for_is_told(monkeypatch, capsys):
    group = SimpleNamespace(processes={'replay_clock': _Stopped(
        'starts without the live page: nothing received')}, check=lambda: None)
    monkeypatch.setattr(replay, 'START_PATIENCE', 0.0)
    with pytest.raises(NodeError):
        replay._wait(group, float('inf'), None, print)
    assert capsys.readouterr().err == (
        'note: the replay starts without the live page: nothing received\n')


def test_a_replay_whose_nodes_are_slow_to_come_up_does_not_accuse_its_clock(monkeypatch):
    monkeypatch.setattr(replay, 'START_PATIENCE', 0.0)
    clock = SimpleNamespace(running=True, said=lambda: '[INFO] [replay_clock]: rig d499bde85c27')
    group = SimpleNamespace(processes={'replay_clock': clock}, check=lambda: None)
    with pytest.raises(NodeError, match=r'start: its nodes are not up within 0 s: if the machine'):
        replay._wait(group, float('inf'), None, print)


def test_a_recording_that_has_ended_with_a_fault_ends_the_replay_before_its_bag():
    clock = SimpleNamespace(running=True, said=lambda: 'replay is playing')
    group = SimpleNamespace(processes={'replay_clock': clock}, check=lambda: None)
    with pytest.raises(BagError, match='a full disk'):
        replay._wait(group, float('inf'), None, print, lambda: BagError('a full disk'))


def test_an_alarm_is_told_when_it_comes_and_is_the_result():
    """The console was silent, and the alarm stood in the log of the node."""
    states = ['waiting for samples', 'no alarm', 'no alarm', 'ALARM 1 s after the onset']
    begun = iter(range(1, len(states) + 1))
    log = [f'[INFO] [ring_alarm]: state of the alarm: {state}\n' for state in states]
    clock = SimpleNamespace(said=lambda: 'replay is playing\nreplay is at its end', running=True)

    def alarm_said():
        shown = next(begun, len(states))
        clock.running = shown < len(states)
        return ''.join(log[:shown])

    group = SimpleNamespace(
        processes={'replay_clock': clock,
                   'ring_alarm': SimpleNamespace(said=alarm_said, running=True)},
        check=lambda: None, wait=lambda *_: 0)
    told: list[str] = []
    assert replay._wait(group, float('inf'), None, told.append) == states[-1]
    assert told == [states[1], states[3]]


def test_a_bag_that_is_cut_off_is_told_before_it_is_replayed(tmp_path, monkeypatch, capsys):
    bag = shutil.copytree(share_directory() / 'bags' / 'dynamic_50', tmp_path / 'cut')
    file, = bag.glob('*.mcap')
    file.write_bytes(file.read_bytes()[:file.stat().st_size // 2])

    def refuse(*_, **__):
        raise NodeError('no node is started')

    monkeypatch.setattr('saddlering_ros.ros.launcher.start_nodes', refuse)
    assert main(['replay', str(bag)]) == 2
    note, refused = capsys.readouterr().err.splitlines()
    assert note.startswith(f'note: {file}: the file is cut off at byte')
    assert 'no node is started' in refused


def test_a_bag_with_two_elevations_is_refused_before_any_node_starts(
        tmp_path, monkeypatch, capsys):
    bag = shutil.copytree(share_directory() / 'bags' / 'dynamic_50', tmp_path / 'two')
    metadata = bag / 'metadata.yaml'
    metadata.write_text(re.sub(r'(elevation_deg: ).*', r"\1'70'", metadata.read_text()))

    def refuse(*_, **__):
        raise NodeError('no node is started')

    monkeypatch.setattr('saddlering_ros.ros.launcher.start_nodes', refuse)
    assert main(['replay', str(bag)]) == 2
    assert "elevation_deg is '70' in metadata.yaml and '50'" in capsys.readouterr().err
    assert main(['replay', str(bag), '--elevation', '50']) == 2
    assert 'no node is started' in capsys.readouterr().err
