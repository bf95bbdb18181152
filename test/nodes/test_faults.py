"""The fault campaign of benchmarks/faults.py in short: nodes killed, stopped, fed with rubbish."""

from __future__ import annotations

import importlib.util
from pathlib import Path
import random
import sys
from types import ModuleType

import pytest

pytestmark = [pytest.mark.ros, pytest.mark.slow]


@pytest.fixture(scope='module')
def faults() -> ModuleType:
    path = Path(__file__).resolve().parents[2] / 'benchmarks' / 'faults.py'
    spec = importlib.util.spec_from_file_location('faults', path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules['faults'] = module  # its dataclasses look themselves up there
    spec.loader.exec_module(module)
    return module


def test_beside_a_driver_faults_end_in_right_numbers_or_in_words(
        faults: ModuleType, ros_domain: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(faults.MARK, 'test')
    with faults.stage(random.Random(5), domain=ros_domain) as one:
        faults.kill_and_restart(one, 'ring_displacement')
        faults.send_rubbish(one)
        faults.kill_and_restart(one, 'ring_simulator')
    assert one.faults == []
    assert faults.clean() == []


def test_on_a_full_disk_commands_keep_the_old_file_and_say_so(
        faults: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(faults, 'killed_on_a_slow_disk', lambda *_: [])
    assert faults.full_disk(random.Random(5)).faults == []
