"""Alignment of the probes on the load's stamps: one rule, for whole records and for streams.

The rule. A probe's reading at a load stamp t is

- the sample itself, where the probe has one stamped exactly t;
- otherwise the straight line between the last sample before t and the first one after it;
- nothing, where t lies outside the probe's own span, or where these two samples are further
  apart than a gap: `GAP_PERIODS` times the median of the (up to) `GAP_HISTORY` intervals before
  them and not less than `GAP_FLOOR_NS`. The first `GAP_LEAST_HISTORY` intervals are never gaps.
  After an interval longer than `LEAP_NS` another test begins, and earlier intervals no longer
  count: the next test may be sampled at another rate.

The rule looks back only. `align` (whole records) and `StreamAligner` (live samples) therefore
evaluate the same floating-point expressions on the same numbers. Their results are equal bit for
bit for streams that arrive in stamp order. Stamps are int64 nanoseconds; `seconds` converts them.
"""

from __future__ import annotations

from math import nan

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.record.scratch import blocks, scratch_array

GAP_PERIODS = 5
GAP_HISTORY = 15
GAP_LEAST_HISTORY = 3
GAP_FLOOR_NS = 5_000_000
LEAP_NS = 10_000_000_000
JITTER_NS = 250_000_000
"""Smallest step back [ns] of a stamp behind the newest of its topic that shows a clock set
back."""

DEAD_AFTER_NS = 2_000_000_000
"""Time [ns] without a sample of a live probe, while the load continues, after which the probe does
not read and rows are published without it. It is longer than any step of a replay in lockstep."""


def seconds(stamp: int, epoch: int) -> float:
    """Seconds from `epoch` to `stamp` (both ns); the scalar twin of `seconds_array`."""
    return float(stamp - epoch) / 1e9


def seconds_array(stamps: NDArray[np.int64], epoch: int) -> NDArray[np.float64]:
    """Seconds from `epoch` to each of `stamps` (both ns); equal bit for bit to `seconds`."""
    elapsed: NDArray[np.float64] = scratch_array(stamps.shape, np.float64)
    for part in blocks(len(stamps), stamps, elapsed):
        elapsed[part] = (stamps[part] - np.int64(epoch)).astype(np.float64) / 1e9
    return elapsed


def gap_limit(history: list[int]) -> int:
    """Longest interval [ns] that is still interpolated, from the intervals [ns] before it.

    The lower median counts for an even number of intervals. A short history sets no limit.
    """
    leaps = [place for place, interval in enumerate(history) if interval > LEAP_NS]
    if leaps:
        history = history[leaps[-1] + 1:]
    if len(history) < GAP_LEAST_HISTORY:
        return np.iinfo(np.int64).max
    median = sorted(history)[(len(history) - 1) // 2]
    return max(GAP_PERIODS * median, GAP_FLOOR_NS)


def gap_mask(stamps: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Mask (N - 1,) of the intervals between consecutive `stamps` (N,) that are gaps."""
    mask = np.zeros(max(len(stamps) - 1, 0), dtype=bool)
    intervals = np.diff(stamps[:GAP_HISTORY + 1])
    for early in np.flatnonzero(intervals > GAP_FLOOR_NS).tolist():
        mask[early] = intervals[early] > gap_limit(intervals[:early].tolist())
    for part in blocks(len(mask) - GAP_HISTORY, stamps, size=65536):
        _mask_block(np.diff(stamps[part.start:part.stop + GAP_HISTORY + 1]),
                    mask[part.start + GAP_HISTORY:])
    return mask


def _mask_block(intervals: NDArray[np.int64], mask: NDArray[np.bool_]) -> None:
    """Mark gaps in `mask` among the `intervals` after the first GAP_HISTORY."""
    long = np.flatnonzero(intervals[GAP_HISTORY:] > GAP_FLOOR_NS)
    if not len(long):
        return
    before = intervals[long[:, None] + np.arange(GAP_HISTORY)]
    sorted_before = np.sort(before, axis=1)
    limit = np.maximum(GAP_PERIODS * sorted_before[:, (GAP_HISTORY - 1) // 2], GAP_FLOOR_NS)
    for place in np.flatnonzero(sorted_before[:, -1] > LEAP_NS).tolist():
        limit[place] = gap_limit(before[place].tolist())
    mask[long] = intervals[long + GAP_HISTORY] > limit


def align(
    load_stamps: NDArray[np.int64],
    stamps: NDArray[np.int64],
    values: NDArray[np.float64],
    *, aligned: NDArray[np.float64] | None = None, is_gap: NDArray[np.bool_] | None = None,
) -> NDArray[np.float64]:
    """Values of a probe on the load's stamps (see the rule above); NaN where it has none.

    `load_stamps` (N,) and `stamps` (M,) [ns] strictly increasing, `values` (M,); returns (N,):
    `aligned`, if given, filled. is_gap (M - 1,): the gaps in `stamps`, if they are known.
    """
    if aligned is None:
        aligned = scratch_array(load_stamps.shape, np.float64)
    is_gap = gap_mask(stamps) if is_gap is None else is_gap
    for rows in blocks(len(load_stamps), load_stamps, stamps, values, aligned):
        aligned[rows] = nan
        of_load = load_stamps[rows]
        # Only the readings near this block, so that the search stays within a few pages of memory.
        low, high = np.searchsorted(stamps, [of_load[0], of_load[-1]], side='right').tolist()
        near = slice(max(low - 1, 0), high + 1)
        if high:
            _align_block(of_load, stamps[near], values[near], is_gap[near], aligned[rows])
    return aligned


def _align_block(
    load_stamps: NDArray[np.int64], stamps: NDArray[np.int64], values: NDArray[np.float64],
    is_gap: NDArray[np.bool_], aligned: NDArray[np.float64],
) -> None:
    """Write the values on some of the load's stamps into `aligned`."""
    before = np.searchsorted(stamps, load_stamps, side='right') - 1
    inside = before >= 0
    exact = inside & (stamps[before] == load_stamps)
    aligned[exact] = values[before[exact]]
    between = np.flatnonzero(inside & ~exact & (before < len(stamps) - 1))
    low = before[between]
    usable = ~is_gap[low]
    between, low = between[usable], low[usable]
    elapsed = (load_stamps[between] - stamps[low]).astype(np.float64)
    interval = (stamps[low + 1] - stamps[low]).astype(np.float64)
    aligned[between] = values[low] + (values[low + 1] - values[low]) * (elapsed / interval)
