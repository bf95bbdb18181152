"""The displacement that a run's probes measured, zeroed and computed as the live node does."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.bags.errors import BagError
from saddlering_ros.bags.reader import TestRun
from saddlering_ros.rig import (
    Displacement,
    gap_increment,
    probes_to_displacement,
    Rig,
    zero_of_record,
    ZeroReading,
)


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


def displacement_of_run(rig: Rig, run: TestRun) -> MeasuredRun:
    """Zero the probes of `run` and compute the ring's displacement from them."""
    complete = run.complete
    rows = np.flatnonzero(complete)
    if not len(rows):
        raise BagError(f'{run.path}: the four probes never read together: record them together')
    zero = zero_of_record(rig, run.time[rows], run.load[rows], run.gaps[:, rows])
    zero = replace(zero, start=int(rows[zero.start]), end=int(rows[zero.end - 1]) + 1)
    increments = gap_increment(rig.probes, run.gaps, np.array(zero.gaps))
    displacement = probes_to_displacement(rig.probes, increments)
    return MeasuredRun(run.time, run.stamps, run.load, increments, displacement, zero, complete)
