"""A short record of a test, as arrays and as a bag, and nodes that run on it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from rosnet import Client, client

from saddlering_ros.bags.write import write_bag
from saddlering_ros.record.record import TestMetadata
from saddlering_ros.rig import default_rig, ParameterSet, TRUE_TO_SCALE
from saddlering_ros.ring.simulator import simulate
from saddlering_ros.ros.launcher import NodeGroup

START = 1_700_000_000_000_000_000
RATE = 500.0


@dataclass(frozen=True)
class Record:
    """Five topics as arrays: stamps [ns], load [N], gaps [m]."""

    stamps: np.ndarray
    load: np.ndarray
    probe_stamps: list[np.ndarray]
    gaps: list[np.ndarray]

    def paused(self, row: int, seconds: float) -> Record:
        """The same record with a pause of its recording before a row."""
        pause = (np.arange(len(self.stamps)) >= row) * round(seconds * 1e9)
        return Record(self.stamps + pause, self.load,
                      [stamps + pause for stamps in self.probe_stamps], self.gaps)

    def later(self, seconds: float) -> Record:
        """The same record at another time."""
        shift = round(seconds * 1e9)
        return Record(self.stamps + shift, self.load,
                      [stamps + shift for stamps in self.probe_stamps], self.gaps)


def make_record(seconds: float = 4.0, seed: int = 1) -> Record:
    """0.8 s at preload, up to about 24 t and back; probes 0.1 to 0.4 ms after the load."""
    rig, rng = default_rig(), np.random.default_rng(seed)
    count = round(seconds * RATE)
    time = np.arange(count) / RATE
    ramp = seconds / 2 - 0.9
    share = np.clip(np.minimum((time - 0.8) / ramp, (seconds - 0.4 - time) / ramp), 0.0, 1.0)
    load = rig.preload + 230e3 * share
    found = simulate(rig, ParameterSet(TRUE_TO_SCALE), np.radians(50.0), time, load)
    stamps = START + np.round(time * 1e9).astype(np.int64)
    probe_stamps = [stamps + 100_000 * number for number in (1, 2, 3, 4)]
    gaps = [np.float64(np.float32(
        1e-3 + np.interp(time + 1e-4 * (number + 1), time, found.probes[number])
        + rng.normal(0.0, 3e-7, count))) for number in range(4)]
    return Record(stamps, load + rng.normal(0.0, 20.0, count), probe_stamps, gaps)


@pytest.fixture(scope='session')
def record() -> Record:
    return make_record()


@pytest.fixture(scope='session')
def bag_root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp('bags')


@pytest.fixture(scope='session')
def bag(bag_root: Path, record: Record) -> Path:
    """The record as a bag."""
    return write_bag(bag_root / 'run', TestMetadata('dynamic', 50.0, 'a rig', 'a run'),
                     record.stamps, record.load, record.probe_stamps, record.gaps,
                     default_rig().probes)


@pytest.fixture
def group(ros_domain: int, tmp_path: Path) -> Iterator[NodeGroup]:
    """Node processes of this test, ended with it."""
    with NodeGroup(domain_id=ros_domain, log_folder=tmp_path / 'log') as nodes:
        yield nodes


@pytest.fixture
def heard(ros_domain: int) -> Iterator[Client]:
    """The test's own node, which hears all others."""
    with client(ros_domain) as one:
        yield one
