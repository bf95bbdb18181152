"""A replay ends when every sample of every topic came; anything else is an error."""

import errno
import os
from pathlib import Path
import re
import signal
import subprocess
import sys
import threading
import time
from typing import Any

from node_server import NodeServer
import pytest
from rosnet import Client, ended, wait_until
from std_srvs.srv import Trigger

from saddlering_interfaces.msg import ReplayProgress
from saddlering_ros.bags.reader import read_raw
from saddlering_ros.bags.write import BagWriter
from saddlering_ros.cli.main import main
from saddlering_ros.errors import BagError
from saddlering_ros.ros.launcher import NodeGroup, ros_arguments
from saddlering_ros.ros.messages import LockstepGroup


def soon(server: NodeServer, name: str, number: signal.Signals, recorded: Path,
         ) -> threading.Thread:
    """Signal a node of the replay once something has been recorded."""
    def act() -> None:
        for _ in range(3000):
            time.sleep(0.02)
            files = list(recorded.parent.glob('.*.recording.*/*/*.mcap'))
            if files and files[0].stat().st_size > 100_000:
                break
        os.kill(server.newest[name], number)

    thread = threading.Thread(target=act, daemon=True)
    thread.start()
    return thread


@pytest.mark.ros
@pytest.mark.parametrize(('name', 'number', 'words'), [
    ('replay_clock', signal.SIGKILL, 'ended with status -9 (SIGKILL): start it again'),
    ('eddy_current', signal.SIGTERM, 'ended before the bag was at its end')])
def test_a_replay_whose_node_is_ended_fails_and_replaces_nothing(
        name: str, number: signal.Signals, words: str, bag: Path, ros_domain: int,
        tmp_path: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch, node_server: NodeServer,
        ) -> None:
    monkeypatch.setattr('saddlering_ros.ros.launcher.RING_NODES', ('ring_displacement',))
    recorded = tmp_path / 'recorded'
    recorded.mkdir()
    (recorded / 'metadata.yaml').write_text('a good recording')
    (tmp_path / 'recorded.incomplete').mkdir()
    thread = soon(node_server, name, number, recorded)
    assert main(['replay', str(bag), '--domain', str(ros_domain), '--record', str(recorded),
                 '--overwrite', '--rate', '0.5']) == 2
    thread.join()
    said = capsys.readouterr()
    assert words in said.err
    assert 'at its end\n' not in said.out
    assert (recorded / 'metadata.yaml').read_text() == 'a good recording'
    assert 'until then is in ' + str(tmp_path / 'recorded.incomplete.2\n') in said.err
    assert 'appeared' not in said.err
    assert len(read_raw(tmp_path / 'recorded.incomplete.2')['/rig/hydraulic_load']) > 100


@pytest.mark.ros
def test_a_replay_whose_recording_meets_a_full_disk_says_so(
        bag: Path, ros_domain: int, tmp_path: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch,
        ) -> None:
    """It blamed a recorder that "fell behind" and named a folder of no file."""
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, 'No space left on device')

    monkeypatch.setattr('saddlering_ros.ros.launcher.RING_NODES', ('ring_displacement',))
    monkeypatch.setattr('saddlering_ros.bags.write.McapWriter.add_message', full)
    assert main(['replay', str(bag), '--domain', str(ros_domain), '--rate', '0', '--record',
                 str(tmp_path / 'recorded')]) == 2
    said = capsys.readouterr().err.splitlines()
    assert 'recorded: cannot be written (No space left on device)' in said[-1]
    assert not [line for line in said if 'incomplete' in line or 'fell behind' in line]
    shown = Path(re.findall(r'readable in (\S+)', said[-1])[0])
    assert shown.is_dir()


def test_a_recording_that_cannot_begin_is_not_said_to_be_readable(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, 'No space left on device')

    monkeypatch.setattr('saddlering_ros.bags.write.McapWriter.add_metadata', full)
    with pytest.raises(BagError, match=r'on device\): choose another place$'), BagWriter(
            tmp_path / 'recorded', {}, {}, recorded=True):
        pass


def test_progress_that_does_not_belong_together_or_is_of_nobody_waited_for_is_not_kept() -> None:
    group = LockstepGroup(['reader'])
    group.hear(ReplayProgress(node='reader', inputs=['/t'], publishers=[]), 0.0)
    for number in range(1000):
        group.hear(ReplayProgress(node=f'invented_{number}'), 0.0)
    assert group.malformed == 1
    assert group.said == {}
    assert group.heard == {}
    assert group.absent() == ['reader: nothing received']


PATIENT_LOAD = """
import sys
from saddlering_ros.ros import streaming_node
streaming_node.LONGEST_HAND_OVER = 60.0  # how fast this machine lets the reader go on is no matter
from saddlering_ros.nodes.hydraulic_load import main
main(sys.argv[1:])
"""
READER = """
import os, sys, time
from saddlering_ros.ros.launcher import prepare_middleware
prepare_middleware()
from geometry_msgs.msg import WrenchStamped
import rclpy
from saddlering_ros.ros.raw_topics import RawSubscription
rclpy.init(args=[], domain_id=int(sys.argv[1]))
flow = RawSubscription(rclpy.create_node('reader'), 'rig/hydraulic_load', WrenchStamped)
while not flow.publishers():
    time.sleep(0.01)
print('matched', flush=True)
while flow.received < int(sys.argv[2]) and flow.publishers():
    flow.take()
    time.sleep(0.01)
flow.take()
print(flow.received, flush=True)
os._exit(0)
"""


@pytest.mark.ros
def test_a_reader_that_had_no_processor_still_gets_the_end_of_a_test(
        group: NodeGroup, heard: Client, bag: Path, ros_domain: int) -> None:
    """The node ends while the reader is stopped; its queue of packets holds a part only."""
    def has_heard_of_the_reader() -> bool:
        said = heard.progress.get('hydraulic_load')
        return said is not None and min(said.subscriptions) > 0

    count = len(read_raw(bag)['/rig/hydraulic_load'])
    clock = group.start('replay_clock', {
        'bag': str(bag), 'lockstep': True, 'rate': 0.0, 'exit_at_end': True, 'start_paused': True,
        'participants': ['hydraulic_load'],
        'timeout': 1.0})  # for which it waits for a stopped reader that it has not found yet
    with subprocess.Popen(
            [sys.executable, '-c', PATIENT_LOAD, *ros_arguments({'bag': str(bag)})],
            env=group.environment) as load, ended(load), subprocess.Popen(
            [sys.executable, '-c', READER, str(ros_domain), str(count)],
            stdout=subprocess.PIPE, text=True) as reader, ended(reader):
        wait_until(lambda: 'paused' in clock.said(), 80.0, 'the clock is ready')
        assert reader.stdout is not None
        assert reader.stdout.readline() == 'matched\n'
        # The reader may know of the node before the node knows of it, which then sends it nothing.
        wait_until(has_heard_of_the_reader, what='the node is matched too')
        reader.send_signal(signal.SIGSTOP)
        assert heard.call(Trigger, '/replay_clock/play').success
        wait_until(lambda: 'at its end' in clock.said(), 80.0, 'the end of the bag')
        load.send_signal(signal.SIGINT)
        time.sleep(0.2)
        reader.send_signal(signal.SIGCONT)
        assert reader.stdout.readline() == f'{count}\n'
