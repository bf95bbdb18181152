"""Claims about how nodes are started: what nobody knows, or reads twice, ends the node."""

from __future__ import annotations

import os
from pathlib import Path
import subprocess
import sys

import pytest

pytestmark = pytest.mark.ros


def refusal(*arguments: str) -> str:
    done = subprocess.run(
        [sys.executable, '-m', 'saddlering_ros.nodes.ring_simulator', '--ros-args', *arguments],
        capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2, done.stderr
    return done.stderr.strip().splitlines()[-1]


def test_a_misspelt_parameter_ends_a_node_with_a_suggestion() -> None:
    assert refusal('-p', 'elevation:=70.0') == (
        'ring_simulator: parameter elevation is unknown: did you mean elevation_deg?')


def test_a_file_that_rclpy_would_read_otherwise_or_wait_for_is_refused(tmp_path: Path) -> None:
    file = tmp_path / 'rig.yaml'
    file.write_text('/**:\n  ros__parameters:\n    rig.radial_row.rollers: 0110\n')
    assert 'line 3: the number 0110 is not' in refusal('--params-file', str(file))
    pipe = tmp_path / 'pipe'
    os.mkfifo(pipe)
    assert 'a pipe or device' in refusal('--params-file', str(pipe))
