"""Stretches in which a record is at rest, from its load: one rule for all estimates of noise.

The zero of a test has a rule of its own (`rig/zeroing.py`).
"""

from dataclasses import dataclass

import numpy as np

from saddlering_ros.estimation.process import Array

Stretches = list[tuple[int, int]]

BLOCK_SECONDS = 0.05
"""Length [s] of the means of the load that are compared."""

MIN_SECONDS = 0.3
"""Shortest rest [s]."""

SETTLING_SECONDS = 0.5
"""Time [s] of settling after a movement, at most half the stretch."""

GUARD_SECONDS = 0.1
"""Time [s] before the next movement that is left out, at most a fifth of the stretch."""

MIN_SAMPLES = 8


@dataclass(frozen=True)
class RestSegment:
    """A stretch of a record with the system at rest, at its original rate: a source of noise.

    `values` (C, n) of all channels, `step` seconds between samples. Segments of one `label`
    share a systematic course (for instance creep after a step), whose mean is subtracted
    before noise is measured.
    """

    values: Array
    step: float
    label: str = ''


@dataclass
class Rest:
    """A rest as it grows by blocks of samples: how many there are, and their mean load [N].

    Streams and records use this one rule. band [N]: see `takes`.
    """

    band: float
    samples: int = 0
    level: float = 0.0

    def takes(self, mean: float, count: int) -> bool:
        """Add a block of `count` samples, if its mean load is within the band of the rest's."""
        if self.samples and abs(mean - self.level) >= self.band:
            return False
        self.samples += count
        self.level += (mean - self.level) * count / self.samples
        return True

    def quiet(self, step: float, *, has_moved: bool, moves_on: bool) -> slice:
        """The samples without settling and without the start of the next movement.

        step [s]: between samples; has_moved, moves_on: whether the load moved before and after.
        """
        settling = min(round(SETTLING_SECONDS / step), self.samples // 2) if has_moved else 0
        guard = min(round(GUARD_SECONDS / step), self.samples // 5) if moves_on else 0
        return slice(settling, self.samples - guard)


def stretches_at_rest(time: Array, load: Array, band: float) -> Stretches:
    """Stretches [start, stop) of samples over which the mean load stays within `band` [N].

    The beginning of a stretch is left to settling, unless the record begins with it.
    """
    step = float(np.median(np.diff(time)))
    count = max(1, round(BLOCK_SECONDS / step))
    blocks = time.size // count
    level = load[:blocks * count].reshape(-1, count).mean(axis=1)
    found, begin = [], 0
    rest = Rest(band, count, float(level[0])) if blocks else Rest(band)
    for index in range(1, blocks + 1):
        if index < blocks and rest.takes(level[index], count):
            continue
        quiet = rest.quiet(step, has_moved=begin > 0, moves_on=True)
        seconds = time[index * count - 1] - time[begin]
        if seconds > MIN_SECONDS and rest.samples - quiet.start >= MIN_SAMPLES:
            found.append((begin + quiet.start, begin + quiet.stop))
        if index < blocks:
            begin, rest = index * count, Rest(band, count, float(level[index]))
    return found


def quiet_stretches(stretches: Stretches) -> Stretches:
    """Stretches for noise: only the one before the first movement, if there is one.

    After a movement the ring still creeps while the load rests, and creep is no noise.
    """
    return [one for one in stretches if one[0] == 0] or stretches
