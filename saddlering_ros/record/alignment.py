"""The rule by which a probe is aligned on the load's stamps.

The rule. A probe's reading at a load stamp t is

- the sample itself, where the probe has one stamped exactly t;
- otherwise the straight line between the last sample before t and the first one after it;
- nothing, where t lies outside the probe's own span, or where these two samples are further
  apart than a gap: `GAP_PERIODS` times the median of the (up to) `GAP_HISTORY` intervals before
  them and not less than `GAP_FLOOR_NS`. The first `GAP_LEAST_HISTORY` intervals are never gaps.
  After an interval longer than `LEAP_NS` another test begins, and earlier intervals no longer
  count: the next test may be sampled at another rate.

The rule looks back only, so that a stream gives the same bits as a whole record. Stamps are int64
nanoseconds; `seconds_array` converts them.
"""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.record.samples import Samples
from saddlering_ros.record.scratch import blocks, scratch_array

Stamps = NDArray[np.int64]
Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

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
not read. The zero is taken from rows without such a probe."""

SILENT_AFTER_NS = 250_000_000
"""Time [ns] without a sample of a probe, while the load and a pair of other probes continue, after
which rows are published without it, once there is a zero. It is longer than a step of a replay in
lockstep (0.2 s), and shorter than the silence that an interlock takes for a fault (0.3 s)."""

MAX_HOLD_NS = 50_000_000
"""Largest time [ns] that a load sample is held back for an earlier one to overtake it."""


def seconds_array(stamps: Stamps, epoch: int) -> Floats:
    """Seconds from `epoch` to each of `stamps` (both ns)."""
    elapsed: Floats = scratch_array(stamps.shape, np.float64)
    for part in blocks(len(stamps), stamps, elapsed):
        elapsed[part] = (stamps[part] - np.int64(epoch)).astype(np.float64) / 1e9
    return elapsed


def longer_hold(hold: int, delay: int) -> int:
    """Time [ns] that samples are held back after one that came `delay` [ns] too late.

    It is twice the delay, so that the next late samples are in time.
    """
    return min(max(hold, 2 * delay), MAX_HOLD_NS)


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


def gap_mask(stamps: Stamps) -> Mask:
    """Mask (N - 1,) of the intervals between consecutive `stamps` (N,) that are gaps."""
    mask = np.zeros(max(len(stamps) - 1, 0), dtype=bool)
    for part in blocks(len(mask), stamps, size=65536):
        long = part.start + np.flatnonzero(np.diff(stamps[part.start:part.stop + 1])
                                           > GAP_FLOOR_NS)
        mask[long] = _are_gaps(stamps, long)
    return mask


def _are_gaps(stamps: Stamps, places: NDArray[np.intp]) -> Mask:
    """Mask (M,) of the intervals from the samples at `places` (M,) to the next that are gaps."""
    found = np.zeros(len(places), dtype=bool)
    early = int(np.searchsorted(places, GAP_HISTORY))
    for index, place in enumerate(places[:early].tolist()):
        history = np.diff(stamps[:place + 1]).tolist()
        found[index] = stamps[place + 1] - stamps[place] > gap_limit(history)
    places = places[early:]
    if not len(places):
        return found
    before = np.sort(np.diff(stamps[places[:, None] + np.arange(-GAP_HISTORY, 1)]), axis=1)
    limit = np.maximum(GAP_PERIODS * before[:, (GAP_HISTORY - 1) // 2], GAP_FLOOR_NS)
    for index in np.flatnonzero(before[:, -1] > LEAP_NS).tolist():
        place = places[index]
        limit[index] = gap_limit(np.diff(stamps[place - GAP_HISTORY:place + 1]).tolist())
    found[early:] = stamps[places + 1] - stamps[places] > limit
    return found


def align(load_stamps: Stamps, stamps: Stamps, values: Floats) -> Floats:
    """Values of one topic on the load's stamps (see the rule above); NaN where it has none.

    `load_stamps` (N,) and `stamps` (M,) [ns] strictly increasing, `values` (M,); returns (N,).
    """
    aligned: Floats = scratch_array(load_stamps.shape, np.float64)
    for rows in blocks(len(load_stamps), load_stamps, stamps, values, aligned):
        of_load = load_stamps[rows]
        # Only the readings near this block, so that the search stays within a few pages of memory.
        low, high = np.searchsorted(stamps, [of_load[0], of_load[-1]], side='right').tolist()
        near = slice(max(low - GAP_HISTORY - 1, 0), high + 1)
        aligned[rows] = readings_at(of_load, [Samples(stamps[near], values[near])])[0]
    return aligned


class Readings(Protocol):
    """Readings of a topic: stamps (M,) [ns], strictly increasing, and values (M,)."""

    @property
    def stamps(self) -> Stamps:
        """Stamps (M,) [ns]."""

    @property
    def values(self) -> Floats:
        """Readings (M,)."""


def readings_at(load_stamps: Stamps, topics: Sequence[Readings]) -> Floats:
    """Readings (C, N) of C topics at load stamps (N,) in order; NaN where one has none."""
    found = np.empty((len(topics), len(load_stamps)))
    for row, topic in enumerate(topics):
        found[row] = _of_topic(load_stamps, topic.stamps, topic.values)
    return found


def _of_topic(load_stamps: Stamps, stamps: Stamps, values: Floats) -> Floats | float:
    """Readings of a topic at load stamps (N,) in order, from its own (M,)."""
    last = len(stamps) - 1
    if last < 0:
        return math.nan
    after = stamps.searchsorted(load_stamps, 'right')
    before = after - 1
    earlier, low = stamps[before], values[before]
    elapsed = load_stamps - earlier
    between = np.count_nonzero(elapsed)
    if not between:  # a reading of its own for each load stamp
        return low
    outside = None
    if before[0] < 0 or before[-1] == last:
        outside = np.flatnonzero(((before < 0) | (before == last)) & (elapsed != 0))
        after = np.minimum(after, last)
    interval = stamps[after] - earlier
    found = low + (values[after] - low) * (elapsed / np.maximum(interval, 1))
    if between < len(found):
        found = np.where(elapsed != 0, found, low)
    if outside is not None:
        found[outside] = math.nan
    if interval.max() > GAP_FLOOR_NS:
        rows = np.flatnonzero((interval > GAP_FLOOR_NS) & (elapsed != 0))
        places, of_place = np.unique(before[rows], return_inverse=True)
        found[rows[_are_gaps(stamps, places)[of_place]]] = math.nan
    return found
