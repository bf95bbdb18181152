"""The displacement that a run's probes measured, zeroed and computed as the live node does."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.record.errors import BagError
from saddlering_ros.record.record import Record
from saddlering_ros.record.scratch import blocks, count_where
from saddlering_ros.record.validity import BRIDGED, is_published, unknown
from saddlering_ros.rig import (
    CHANNELS,
    Displacement,
    gap_increment,
    measured_displacement,
    Rig,
    ZeroReading,
)
from saddlering_ros.rig.zeroing import BLOCK as ZERO_BLOCK
from saddlering_ros.rig.zeroing import Samples, zero_of_blocks


@dataclass(frozen=True)
class MeasuredRun:
    """Displacement by the probes of a run, at each of its N load stamps.

    time (N,) [s], stamps (N,) int64 [ns], load (N,) [N]: the run's own; d (4, N) [m]: increments
    of the probes since zero; displacement: of (N,) arrays, NaN where not known; zero: the reading
    taken as zero, its start and end counted in load samples; complete (N,): where all four probes
    have a reading and a zero; given (N,): where the live node publishes a displacement, which may
    be without the channels of a probe that does not read; validity (N,): what it publishes with
    it, 0 or a sum of the constants of RingDisplacement.msg.
    """

    time: NDArray[np.float64]
    stamps: NDArray[np.int64]
    load: NDArray[np.float64]
    d: NDArray[np.float64]
    displacement: Displacement
    zero: ZeroReading
    complete: NDArray[np.bool_]
    given: NDArray[np.bool_]
    validity: NDArray[np.uint8]


def zero_of_run(rig: Rig, run: Record) -> ZeroReading:
    """The zero of a run; its start and end count the rows that the live node gives."""
    if run.node_rows is None:
        count = count_where(lambda part: np.isfinite(part).all(axis=0), run.gaps)
    else:
        count = int(run.node_rows.given.sum())
    if not count:
        raise BagError(f'{run.path}: the four probes never read together: record them together')
    return zero_of_blocks(rig, lambda: _given_blocks(run))


def _given_blocks(run: Record) -> Iterator[Samples]:
    for part in blocks(len(run.time), run.time, run.load, run.gaps, size=ZERO_BLOCK):
        rows = given_of(run, part)
        yield run.time[part][rows], run.load[part][rows], run.gaps[:, part][:, rows]


def given_of(run: Record, part: slice) -> NDArray[np.bool_]:
    """Which rows of a stretch of a run the live node gives."""
    if run.node_rows is not None:
        return run.node_rows.given[part]
    return np.asarray(np.isfinite(run.gaps[:, part]).all(axis=0))


def validity_of(
    run: Record, displacement: Displacement, part: slice = slice(None),
) -> NDArray[np.uint8]:
    """Bits of validity of a stretch of a run with its displacement."""
    found = unknown(np.stack([getattr(displacement, name) for name in CHANNELS]))
    if run.node_rows is not None:
        found[run.node_rows.bridged[part]] |= BRIDGED
    return found


def displacement_of_run(rig: Rig, run: Record) -> MeasuredRun:
    """Zero the probes of `run` and compute the ring's displacement from them."""
    zero = zero_of_run(rig, run)
    given = run.given
    rows = np.flatnonzero(given)
    zero = replace(zero, start=int(rows[zero.start]), end=int(rows[zero.end - 1]) + 1)
    increments = gap_increment(rig.probes, run.gaps, np.array(zero.gaps))
    found = measured_displacement(rig.probes, increments)
    validity = validity_of(run, found)
    complete = np.asarray(np.isfinite(increments).all(axis=0))
    return MeasuredRun(
        time=run.time, stamps=run.stamps, load=run.load, d=increments, displacement=found,
        zero=zero, complete=complete, given=given & is_published(validity), validity=validity)
