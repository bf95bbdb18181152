"""Rows of a whole record that the live nodes publish, with marks of those that are not sound.

The rule is that of `StreamAligner`: a probe without a sample for more than DEAD_AFTER_NS of the
load's stamps does not read, and rows are published without it. A shorter silence removes the rows
within it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.record.alignment import DEAD_AFTER_NS, GAP_HISTORY, gap_limit, gap_mask
from saddlering_ros.record.scratch import blocks, scratch_mask

Stamps = NDArray[np.int64]
Rows = NDArray[np.intp]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class NodeRows:
    """Masks (N,) over the load stamps of a record.

    given: ring_displacement publishes the row; bridged: the reading of a probe is interpolated
    across a refused one; load_bridged: a load was refused between this stamp and the one
    before; load_doubtful: the load came in a step that the hydraulics cannot make.
    """

    given: Mask
    bridged: Mask
    load_bridged: Mask
    load_doubtful: Mask


def complete_rows(gaps: NDArray[np.float64]) -> Mask:
    """Mask (N,) of the rows of aligned gaps (4, N) at which every probe reads."""
    found = scratch_mask(gaps.shape[1])
    for part in blocks(len(found), gaps, found):
        found[part] = np.isfinite(gaps[:, part]).all(axis=0)
    return found


def degraded_rows(
    load_stamps: Stamps, probe_stamps: list[Stamps], gaps: NDArray[np.float64],
) -> Rows:
    """Mask of rows that the nodes publish without a probe, from aligned gaps (4, N) with NaN.

    At each of these rows every probe reads or does not work, and a radial or an axial pair
    reads.
    """
    rows = np.flatnonzero(~complete_rows(gaps))
    reads = np.isfinite(gaps[:, rows])
    rows = rows[(reads[0] & reads[2]) | (reads[1] & reads[3])]
    run_start = _run_starts(load_stamps, rows)
    for gap, stamps in zip(gaps, probe_stamps, strict=True):
        answered = np.isfinite(gap[rows])
        silent = np.flatnonzero(~answered)
        answered[silent] = _is_absent(load_stamps, stamps, rows[silent], run_start[silent])
        rows, run_start = rows[answered], run_start[answered]
    return rows


def _is_absent(load_stamps: Stamps, stamps: Stamps, rows: Rows, run_start: Stamps) -> Mask:
    """Mask of rows without a reading at which a probe with `stamps` (M,) does not work."""
    asked = load_stamps[rows]
    place = np.searchsorted(stamps, asked, side='right') - 1
    before = np.maximum(stamps[np.maximum(place, 0)], run_start)
    absent = np.zeros(len(rows), dtype=bool)
    head, tail = place < 0, place == len(stamps) - 1
    absent[head] = stamps[0] - run_start[head] > DEAD_AFTER_NS
    limit = max(DEAD_AFTER_NS, gap_limit(np.diff(stamps[-GAP_HISTORY - 1:]).tolist()))
    absent[tail] = load_stamps[-1] - before[tail] > limit
    inside = np.flatnonzero(~head & ~tail)
    absent[inside] = stamps[place[inside] + 1] - before[inside] > DEAD_AFTER_NS
    if len(inside):
        absent[inside] &= gap_mask(stamps)[place[inside]]
    return absent


def _run_starts(load_stamps: Stamps, rows: Rows) -> Stamps:
    """For some rows, the load stamp since which the load has continued without a leap."""
    starts = [0]
    for part in blocks(len(load_stamps) - 1, load_stamps):
        steps = np.diff(load_stamps[part.start:part.stop + 1])
        starts += (part.start + 1 + np.flatnonzero(steps > DEAD_AFTER_NS)).tolist()
    first = np.array(starts)
    return np.asarray(load_stamps[first[np.searchsorted(first, rows, side='right') - 1]])
