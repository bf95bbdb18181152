"""Stretches in which a record is at rest, from its load: one rule for all estimates of noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
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


def stretches_at_rest(time: Array, load: Array, band: float) -> Stretches:
    """Stretches [start, stop) of samples over which the mean load stays within `band` [N].

    A block belongs to a stretch while its mean is within the band of the mean of the blocks before
    it. The beginning of a stretch is left to settling, unless the record begins with it.
    """
    step = float(np.median(np.diff(time)))
    count = max(1, round(BLOCK_SECONDS / step))
    usable = time.size // count * count
    level = load[:usable].reshape(-1, count).mean(axis=1)
    found, start, total = [], 0, level[0] if level.size else 0.0
    for index in range(1, level.size + 1):
        inside = index < level.size and abs(level[index] - total / (index - start)) < band
        if inside:
            total += level[index]
            continue
        begin, end = start * count, index * count
        settling = 0 if start == 0 else min(round(SETTLING_SECONDS / step), (end - begin) // 2)
        long_enough = time[end - 1] - time[begin] > MIN_SECONDS
        if long_enough and end - begin - settling >= MIN_SAMPLES:
            guard = min(round(GUARD_SECONDS / step), (end - begin) // 5)
            found.append((begin + settling, end - guard))
        start = index
        total = level[index] if index < level.size else 0.0
    return found


def quiet_stretches(stretches: Stretches) -> Stretches:
    """Stretches for noise: only the one before the first movement, if there is one.

    After a movement the ring still creeps while the load rests, and creep is no noise.
    """
    return [one for one in stretches if one[0] == 0] or stretches
