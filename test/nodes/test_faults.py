"""The fault campaign of benchmarks/faults/ in short: nodes killed, stopped, fed with rubbish."""

from __future__ import annotations

import random

import pytest

from benchmarks.faults import beside_driver, disks, processes, stage

pytestmark = [pytest.mark.ros, pytest.mark.slow]


def test_beside_a_driver_faults_end_in_right_numbers_or_in_words(
        ros_domain: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(processes.MARK, 'test')
    with stage.stage(random.Random(5), domain=ros_domain) as one:
        beside_driver.kill_and_restart(one, 'ring_displacement')
        beside_driver.send_rubbish(one)
    assert one.faults == []
    assert processes.clean() == []


def test_on_a_full_disk_commands_keep_the_old_file_and_say_so(
        monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(disks, 'killed_on_a_slow_disk', lambda *_: [])
    assert disks.full_disk(random.Random(5)).faults == []
