"""Claims about how nodes are started: what nobody knows, or reads twice, ends the node."""

from __future__ import annotations

import os
from pathlib import Path

from forked_nodes import endings
import pytest

BAG = Path(__file__).parents[2] / 'bags' / 'static_50'
pytestmark = pytest.mark.ros


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
    misspelt, otherwise, waiting = refusals(
        ['-p', 'elevation:=70.0'], ['--params-file', str(file)], ['--params-file', str(pipe)])
    assert misspelt == (
        'ring_simulator: parameter elevation is unknown: did you mean elevation_deg?')
    assert 'line 3: the number 0110 is not' in otherwise
    assert 'a pipe or device' in waiting
