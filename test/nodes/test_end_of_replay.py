"""A replay ends when every sample of every topic came; anything else is an error."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
import signal
import threading
import time
from typing import Any

from node_server import NodeServer
import pytest

from saddlering_interfaces.msg import ReplayProgress
from saddlering_ros.bags import read_raw
from saddlering_ros.cli.main import main
from saddlering_ros.errors import BagError
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
    ('replay_clock', signal.SIGKILL, 'replay_clock ended with status -9'),
    ('eddy_current', signal.SIGTERM, 'ended before the bag was at its end')])
def test_a_replay_whose_node_is_ended_fails_and_replaces_nothing(
        name: str, number: signal.Signals, words: str, bag: Path, ros_domain: int,
        tmp_path: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch, node_server: NodeServer,
        ) -> None:
    monkeypatch.setattr('saddlering_ros.ros.launcher.RING_NODES', ('ring_displacement',))
    recorded = tmp_path / 'recorded'
    recorded.mkdir()
    (recorded / 'metadata.yaml').write_text('a good recording')
    thread = soon(node_server, name, number, recorded)
    assert main(['replay', str(bag), '--domain', str(ros_domain), '--record', str(recorded),
                 '--overwrite', '--rate', '0.5']) == 2
    thread.join()
    said = capsys.readouterr()
    assert words in said.err
    assert 'at its end\n' not in said.out
    assert (recorded / 'metadata.yaml').read_text() == 'a good recording'
    with contextlib.suppress(BagError):
        assert len(read_raw(tmp_path / 'recorded.incomplete')['/rig/hydraulic_load']) > 100


def test_progress_that_does_not_belong_together_or_is_of_nobody_waited_for_is_not_kept() -> None:
    group = LockstepGroup(['reader'])
    group.hear(ReplayProgress(node='reader', inputs=['/t'], publishers=[]), 0.0)
    for number in range(1000):
        group.hear(ReplayProgress(node=f'invented_{number}'), 0.0)
    assert group.malformed == 1
    assert group.said == {}
    assert group.heard == {}
    assert group.absent() == ['reader: nothing received']
