"""A ring whose motion is known: one cycle of load that repeats for ever, and a bag of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from saddlering_ros.bags import write_bag
from saddlering_ros.record import TestMetadata
from saddlering_ros.rig import CHANNELS, default_rig, ParameterSet, TRUE_TO_SCALE
from saddlering_ros.ring import simulate

RIG = default_rig()
ELEVATION = 50.0
RATE = 1000.0
CYCLE = 6.0


@dataclass(frozen=True)
class Truth:
    """One cycle of load that repeats for ever: load [N] (N,), gaps [m] (4, N), motion (4, N)."""

    load: np.ndarray
    gaps: np.ndarray
    motion: np.ndarray

    @classmethod
    def make(cls, rate: float = RATE, cycle: float = CYCLE) -> Truth:
        """1.2 s at preload, up to about 24 t and back; the second of two cycles, in full swing."""
        count = round(cycle * rate)
        time = np.arange(2 * count) / rate
        ramp = (cycle - 1.6) / 2.0
        within = time % cycle
        share = np.clip(np.minimum((within - 1.2) / ramp, (cycle - 0.4 - within) / ramp), 0.0, 1.0)
        load = RIG.preload + 230e3 * share
        run = simulate(RIG, ParameterSet(TRUE_TO_SCALE), np.radians(ELEVATION), time, load)
        motion = np.stack([np.asarray(getattr(run.displacement, name)) for name in CHANNELS])
        gaps = 1e-3 + np.asarray(RIG.probes.polarity)[:, None] * run.probes
        return cls(load[-count:], np.float64(np.float32(gaps[:, -count:])), motion[:, -count:])

    def at(self, seconds: np.ndarray, rate: float = RATE) -> np.ndarray:
        """Motion (4, N) at times since a cycle began."""
        place = (seconds * rate) % self.load.size
        whole = np.arange(self.load.size + 1)
        return np.stack([np.interp(place, whole, np.append(row, row[0])) for row in self.motion])


def cycle_bag(folder: Path, truth: Truth, cycles: int, rate: float = RATE) -> tuple[Path, int]:
    """A bag of `cycles` cycles; its path, and its first stamp."""
    start = 1_700_000_000_000_000_000
    count = truth.load.size * cycles
    stamps = start + np.round(np.arange(count) / rate * 1e9).astype(np.int64)
    bag = write_bag(folder / 'bag', TestMetadata('dynamic', ELEVATION), stamps,
                    np.tile(truth.load, cycles), [stamps] * 4,
                    list(np.tile(truth.gaps, (1, cycles))), RIG.probes)
    return bag, start
