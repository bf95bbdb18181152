"""Batches of samples, aligned rows and displacements; the reading of a topic at other stamps.

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
from dataclasses import dataclass
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.record.scratch import blocks, scratch_array
from saddlering_ros.rig import CHANNELS

Stamps = NDArray[np.int64]
Floats = NDArray[np.float64]
Bits = NDArray[np.uint8]
Mask = NDArray[np.bool_]
Rows = NDArray[np.intp] | NDArray[np.bool_] | slice
"""Rows of a batch: indices, a mask, or a slice."""

SECOND = 1_000_000_000  # of a stamp [ns]

NOT_KNOWN = dict(zip(CHANNELS, (1, 2, 4, 8), strict=True))
"""Bits of unknown channels in `validity`, as in RingDisplacement.msg."""

_BITS = np.array(list(NOT_KNOWN.values()), np.uint8)

BRIDGED = 16
"""Bit of a result that was interpolated across a reading that was refused."""

DOUBTFUL_LOAD = 32
"""Bit of a simulation by a load that came there in a step that the hydraulics cannot make."""

ANY_TIME = (0, 0)
"""In place of the first and last stamp of a recording: none is known."""

ZERO_ELSEWHERE = 'the record has no steady start near the preload; its zero is at another load'


def unknown(channels: Floats) -> Bits:
    """Bits (N,) for the channels (4, N) that are NaN."""
    return np.asarray((np.isnan(channels) * _BITS[:, None]).sum(axis=0, dtype=np.uint8))


def is_published(validity: Bits) -> NDArray[np.bool_]:
    """Mask (N,) of rows with any of delta_x, delta_y and gamma; the others are not published."""
    nothing = NOT_KNOWN['delta_x'] | NOT_KNOWN['delta_y'] | NOT_KNOWN['gamma']
    return np.asarray(validity & nothing != nothing)


def is_pause(recording: tuple[int, int], before: int, after: int) -> bool:
    """Whether two stamps [ns] lie in one `recording`: first and last stamp [ns], or ANY_TIME."""
    return recording[0] <= before and after <= recording[1]


@dataclass(frozen=True)
class Samples:
    """Readings of one topic: stamps (N,) [ns], values (N,), the ends of its range (or NaN)."""

    stamps: Stamps
    values: Floats
    low: float = float('nan')
    high: float = float('nan')

    def __len__(self) -> int:
        return len(self.stamps)

    def pick(self, rows: Rows) -> Samples:
        return Samples(self.stamps[rows], self.values[rows], self.low, self.high)


def no_samples() -> Samples:
    """An empty batch of samples."""
    return Samples(np.empty(0, np.int64), np.empty(0))


@dataclass(frozen=True)
class AlignedRows:
    """Load samples in order of their stamps, with the readings of the C probes there."""

    stamps: Stamps  # (N,) [ns]
    time: Floats  # (N,) [s] since the first load stamp (after the last restart)
    loads: Floats  # (N,) [N]
    gaps: Floats  # (C, N) [m], NaN where a probe has no reading
    given: NDArray[np.bool_]  # (N,): each probe reads, or does not work: the row serves a zero
    published: NDArray[np.bool_]  # (N,): also while a probe is silent, once there is a zero
    restart: int  # how often the load's stamps had jumped back before these rows

    def __len__(self) -> int:
        return len(self.stamps)

    def pick(self, rows: Rows) -> AlignedRows:
        return AlignedRows(self.stamps[rows], self.time[rows], self.loads[rows],
                           self.gaps[:, rows], self.given[rows], self.published[rows],
                           self.restart)

    @staticmethod
    def join(batches: Sequence[AlignedRows]) -> AlignedRows:
        """Several batches of one test as one."""
        return AlignedRows(**_joined(batches), restart=batches[-1].restart)


@dataclass(frozen=True)
class Displacements:
    """A batch of N ring displacements.

    validity: 0 where all is sound, else a sum of the constants of RingDisplacement.msg.
    """

    stamps: Stamps  # (N,) [ns]
    channels: Floats  # (4, N): delta_x, delta_y [m], gamma [rad], parity [m]; NaN: not known
    zero_stamps: Stamps  # (N,) [ns] of the zero that they count from
    zero_loads: Floats  # (N,) [N] of the same zero
    elevations: Floats  # (N,) [rad], NaN: not known
    validity: Bits
    zero_durations: Floats  # (N,) [s] of its samples

    @classmethod
    def from_zero(
        cls, stamps: Stamps, channels: Floats, zero: tuple[int, int], load: float,
        elevation: float = math.nan, validity: Bits | None = None,
    ) -> Displacements:
        """Displacements from one zero: first and last stamp of its samples [ns], its load [N]."""
        count, (first, last) = len(stamps), zero
        return cls(stamps, channels, np.full(count, first), np.full(count, load),
                   np.full(count, elevation),
                   np.zeros(count, np.uint8) if validity is None else validity,
                   np.full(count, (last - first) / SECOND))

    def __len__(self) -> int:
        return len(self.stamps)

    def pick(self, rows: Rows) -> Displacements:
        return Displacements(self.stamps[rows], self.channels[:, rows], self.zero_stamps[rows],
                             self.zero_loads[rows], self.elevations[rows], self.validity[rows],
                             self.zero_durations[rows])


def no_displacements() -> Displacements:
    """An empty batch of displacements."""
    return Displacements.from_zero(np.empty(0, np.int64), np.empty((4, 0)), (0, 0), 0.0)


def join(batches: Sequence[Displacements]) -> Displacements:
    """Several batches as one."""
    kept = [batch for batch in batches if len(batch)]
    if len(kept) == 1:
        return kept[0]
    return Displacements(**_joined(kept)) if kept else no_displacements()


def _joined(batches: Sequence[AlignedRows] | Sequence[Displacements]) -> dict[str, Any]:
    """The arrays (..., N) of batches of one kind by name, one behind the other."""
    arrays = [name for name, value in vars(batches[0]).items() if isinstance(value, np.ndarray)]
    return {name: np.concatenate([getattr(batch, name) for batch in batches], axis=-1)
            for name in arrays}


GAP_PERIODS, GAP_FLOOR_NS = 5, 5_000_000
"""Four samples lost in a row at 1 kHz are bridged; the ring moves little in 5 ms."""

GAP_HISTORY, GAP_LEAST_HISTORY = 15, 3
"""Seven odd intervals do not move the median of 15, and one does not move that of three."""

LEAP_NS = 10_000_000_000
"""As long as the jump ahead after which streams take a new zero."""

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
    for block in blocks(len(stamps), stamps, elapsed):
        elapsed[block] = (stamps[block] - np.int64(epoch)).astype(np.float64) / 1e9
    return elapsed


def longer_hold(hold: int, delay: int) -> int:
    """Time [ns] that samples are held back: twice the `delay` [ns] of one that came too late."""
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
    for block in blocks(len(mask), stamps, size=65536):
        steps = np.diff(stamps[block.start:block.stop + 1])
        long = block.start + np.flatnonzero(steps > GAP_FLOOR_NS)
        mask[long] = _are_gaps(stamps, long)
    return mask


def _are_gaps(stamps: Stamps, places: NDArray[np.intp]) -> Mask:
    """Mask (M,) of the intervals from the samples at `places` (M,) to the next that are gaps."""
    is_gap = np.zeros(len(places), dtype=bool)
    early = int(np.searchsorted(places, GAP_HISTORY))
    for index, place in enumerate(places[:early].tolist()):
        history = np.diff(stamps[:place + 1]).tolist()
        is_gap[index] = stamps[place + 1] - stamps[place] > gap_limit(history)
    places = places[early:]
    if not len(places):
        return is_gap
    before = np.sort(np.diff(stamps[places[:, None] + np.arange(-GAP_HISTORY, 1)]), axis=1)
    limit = np.maximum(GAP_PERIODS * before[:, (GAP_HISTORY - 1) // 2], GAP_FLOOR_NS)
    for index in np.flatnonzero(before[:, -1] > LEAP_NS).tolist():
        place = places[index]
        limit[index] = gap_limit(np.diff(stamps[place - GAP_HISTORY:place + 1]).tolist())
    is_gap[early:] = stamps[places + 1] - stamps[places] > limit
    return is_gap


def align(load_stamps: Stamps, stamps: Stamps, values: Floats) -> Floats:
    """`reading_at` for a whole record: all stamps [ns] strictly increasing."""
    aligned: Floats = scratch_array(load_stamps.shape, np.float64)
    for rows in blocks(len(load_stamps), load_stamps, stamps, values, aligned):
        of_load = load_stamps[rows]
        # Only the readings near this block, so that the search stays within a few pages of memory.
        low, high = np.searchsorted(stamps, [of_load[0], of_load[-1]], side='right').tolist()
        near = slice(max(low - GAP_HISTORY - 1, 0), high + 1)
        aligned[rows] = reading_at(of_load, stamps[near], values[near])
    return aligned


def reading_at(load_stamps: Stamps, stamps: Stamps, values: Floats) -> Floats:
    """Readings of a topic (M,) at load stamps (N,) in order; NaN where it has none."""
    last = len(stamps) - 1
    if last < 0:
        return np.full(len(load_stamps), math.nan)
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
    readings: Floats = low + (values[after] - low) * (elapsed / np.maximum(interval, 1))
    if between < len(readings):
        readings = np.where(elapsed != 0, readings, low)
    if outside is not None:
        readings[outside] = math.nan
    if interval.max() > GAP_FLOOR_NS:
        rows = np.flatnonzero((interval > GAP_FLOOR_NS) & (elapsed != 0))
        places, of_place = np.unique(before[rows], return_inverse=True)
        readings[rows[_are_gaps(stamps, places)[of_place]]] = math.nan
    return readings
