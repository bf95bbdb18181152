"""The full disk of the fault campaign of benchmarks/faults/."""

from __future__ import annotations

import random

import pytest

from benchmarks.faults import disks

pytestmark = [pytest.mark.ros, pytest.mark.slow]


def test_on_a_full_disk_commands_keep_the_old_file_and_say_so(
        monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(disks, 'killed_on_a_slow_disk', lambda *_: [])
    assert disks.full_disk(random.Random(5)).faults == []
