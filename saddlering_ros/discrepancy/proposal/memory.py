"""Operators with memory over whole records: plays, relaxations, direction of a drive."""

from __future__ import annotations

import numpy as np

from saddlering_ros.discrepancy.system import Array
from saddlering_ros.memory_operators import Direction, Plays, Relaxations


def stop_operators(drive: Array, reaches: Array) -> Array:
    """(N, R): the drive (N,) minus the output of plays with half widths `reaches` (R,)."""
    plays = Plays(np.asarray(reaches, dtype=np.float64), float(drive[0]))
    return np.array([plays.push(value) for value in drive.tolist()])


def relaxations(time: Array, drive: Array, constants: Array) -> Array:
    """(N, T): the drive (N,) minus first-order lags of it with time constants (T,) [s].

    Every lag rests at the first sample. The drive is linear between samples.
    """
    lags = Relaxations(np.asarray(constants, dtype=np.float64))
    pairs = zip(np.diff(time).tolist(), np.diff(drive).tolist(), strict=True)
    first = np.zeros(np.size(constants))
    return np.array([first, *(lags.push(step, change) for step, change in pairs)])


def direction_of(drive: Array, band: float) -> Array:
    """+1 (N,) while the drive rises and -1 while it falls; at rest the last direction."""
    direction = Direction(band, float(drive[0]))
    return np.array([direction.push(value) for value in drive.tolist()])
