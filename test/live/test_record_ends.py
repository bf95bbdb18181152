"""A recording that is ended as launch and systemd end it is whole, and its status is 0."""

from __future__ import annotations

from pathlib import Path
import signal
import subprocess
import sys
import time

import pytest
from rosnet import wait_until

from saddlering_ros.ros.launcher import NodeGroup

pytestmark = pytest.mark.ros


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_recording_with_status_0(
        ros_domain: int, tmp_path: Path, number: signal.Signals) -> None:
    log = tmp_path / 'log'
    with log.open('w') as stream, subprocess.Popen(
            [sys.executable, '-m', 'saddlering_ros.cli.main', 'record', str(tmp_path / 'bag')],
            env=NodeGroup(ros_domain).environment, stdout=stream,
            stderr=subprocess.STDOUT) as process:
        wait_until(lambda: 'recording' in log.read_text() or process.poll() is not None)
        deadline = time.monotonic() + 30.0
        while process.poll() is None and time.monotonic() < deadline:
            process.send_signal(number)  # a launch and its terminal repeat it
            time.sleep(0.02)
        assert process.poll() == 0, log.read_text()
    assert (tmp_path / 'bag' / 'metadata.yaml').is_file()
