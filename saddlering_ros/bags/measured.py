"""The displacement that a run's probes measured, zeroed and computed as the live node does."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.bags.errors import BagError
from saddlering_ros.bags.reader import TestRun
from saddlering_ros.bags.scratch import blocks, count_where
from saddlering_ros.rig import (
    Displacement,
    gap_increment,
    probes_to_displacement,
    Rig,
    ZeroReading,
)
from saddlering_ros.rig.zeroing import BLOCK as ZERO_BLOCK
from saddlering_ros.rig.zeroing import Samples, zero_of_blocks


@dataclass(frozen=True)
class MeasuredRun:
    """What the probes of a run say, at each of its N load stamps.

    time (N,) [s], stamps (N,) int64 [ns], load (N,) [N]: the run's own; d (4, N) [m]: increments
    of the probes since zero; displacement: of (N,) arrays; zero: the reading taken as
    zero, its start and end counted in load samples; complete (N,): where all four probes have a
    reading; the others are NaN (the live node publishes nothing there).
    """

    time: NDArray[np.float64]
    stamps: NDArray[np.int64]
    load: NDArray[np.float64]
    d: NDArray[np.float64]
    displacement: Displacement
    zero: ZeroReading
    complete: NDArray[np.bool_]


def zero_of_run(rig: Rig, run: TestRun) -> ZeroReading:
    """The zero of a run; its start and end count the samples that all four probes have."""
    if not count_where(lambda part: np.isfinite(part).all(axis=0), run.gaps):
        raise BagError(f'{run.path}: the four probes never read together: record them together')
    return zero_of_blocks(rig, lambda: _complete_blocks(run))


def _complete_blocks(run: TestRun) -> Iterator[Samples]:
    for part in blocks(len(run.time), run.time, run.load, run.gaps, size=ZERO_BLOCK):
        rows = np.isfinite(run.gaps[:, part]).all(axis=0)
        yield run.time[part][rows], run.load[part][rows], run.gaps[:, part][:, rows]


def displacement_of_run(rig: Rig, run: TestRun) -> MeasuredRun:
    """Zero the probes of `run` and compute the ring's displacement from them."""
    complete = run.complete
    zero = zero_of_run(rig, run)
    rows = np.flatnonzero(complete)
    zero = replace(zero, start=int(rows[zero.start]), end=int(rows[zero.end - 1]) + 1)
    increments = gap_increment(rig.probes, run.gaps, np.array(zero.gaps))
    displacement = probes_to_displacement(rig.probes, increments)
    return MeasuredRun(run.time, run.stamps, run.load, increments, displacement, zero, complete)
