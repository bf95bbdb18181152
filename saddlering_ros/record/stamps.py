"""Header stamps of one topic: put in order, or found to go back.

The rule. A recorder may store messages in another order than that of their creation, but a clock
must not go back. Stamps that count as reordered are sorted. They are in order to within jitter
(`JITTER_NS`), in the file or by their log times, and their late messages fill places without
other messages. Stamps go back in three cases: both orders break by more than jitter; most
late messages lie between or upon others, at most half a period away (two passes over the same
stretch of time); or later messages lie more than `MAX_HOLE_NS` before all earlier ones, because a
recorder that reorders leaves no hole.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.errors import BagError
from saddlering_ros.record.alignment import JITTER_NS
from saddlering_ros.record.scratch import count_where, extremes

MAX_DUPLICATES = 0.01
"""Share of stamps with two different readings above which the clock stands still at times."""

MAX_HOLE_NS = 1_000_000_000

MAX_BREAKS = 0.05
"""Share of messages stored before an earlier one above which the order of the file is random."""

REGULAR_SHARE = 0.8
"""Share of intervals near the typical one from which on stamps count as regular."""

_FAR = np.iinfo(np.int64).max

LONGEST_LEAP_NS = 3600 * 1_000_000_000
"""Jump ahead [ns] of stamps above which they were set and not measured."""


@dataclass(frozen=True)
class StampOrder:
    """Messages to keep in stamp order (indices, or a slice for all), and the changes made."""

    keep: NDArray[np.int64] | slice
    reordered: int
    duplicates: int


def put_in_order(
    where: str,
    stamps: NDArray[np.int64],
    log_times: Callable[[], NDArray[np.int64]],
    values: NDArray[np.float64],
) -> StampOrder:
    """Order of the messages (N,) of a topic by stamp, without repeated ones; BagError if none.

    Log times [ns] are asked for only if messages came late: a long record is spared them.
    """
    if len(stamps) > 1 and extremes(stamps) == (0, 0):
        raise BagError(f'{where}: all stamps are zero: let the driver fill header.stamp')
    if len(stamps) and not count_where(_goes_back, stamps, ahead=1):
        _check_leaps(where, stamps)
        return StampOrder(slice(None), 0, 0)
    lateness = _lateness(stamps)
    late = lateness > 0
    order = np.argsort(stamps, kind='stable')
    if late.any():
        _check_late(where, stamps, log_times(), lateness, order)
    ordered = stamps[order]
    _check_leaps(where, ordered)
    keep = _without_duplicates(where, ordered, values[order])
    return StampOrder(order[keep], int(late.sum()), len(stamps) - int(keep.sum()))


def _goes_back(stamps: NDArray[np.int64]) -> NDArray[np.bool_]:
    return np.asarray(stamps[1:] <= stamps[:-1])


def _lateness(stamps: NDArray[np.int64]) -> NDArray[np.int64]:
    """Distance of each stamp behind the newest before it [ns]; 0 for stamps in order."""
    return np.maximum.accumulate(stamps) - stamps if len(stamps) else stamps


def _check_late(
    where: str, stamps: NDArray[np.int64], log_times: NDArray[np.int64],
    lateness: NDArray[np.int64], order: NDArray[np.int64],
) -> None:
    by_log = np.argsort(log_times, kind='stable')
    log_lateness = _lateness(stamps[by_log])
    if lateness.max() > JITTER_NS and log_lateness.max() > JITTER_NS:
        index = int(by_log[np.argmax(log_lateness > JITTER_NS)])
        raise _going_back(where, stamps, index, int(log_lateness.max()))
    intervals = np.diff(stamps[order])
    period = _period(stamps, intervals)
    # Lateness [ns] too small to separate a clock set back from swapped neighbours.
    #
    # Little more than a period where stamps come at regular intervals, three where they do not.
    steps = np.diff(stamps)
    regular = np.mean(np.abs(steps - period) <= 0.45 * period) > REGULAR_SHARE
    if lateness.max() <= ((1.2 if regular else 3.0) * period):
        return
    nearest = np.minimum(np.append(intervals, _FAR), np.append(_FAR, intervals))
    late = lateness[order] > 0
    doubled = late & (nearest <= 0.55 * period)
    apart = (intervals > MAX_HOLE_NS) & (np.diff(order) < 0)
    if 2 * doubled.sum() > late.sum() or apart.any():
        index = int(np.argmax(lateness > 0))
        raise _going_back(where, stamps, index, int(lateness.max()))


def _period(stamps: NDArray[np.int64], intervals: NDArray[np.int64]) -> float:
    """Typical time between samples [ns], from the order that shows more of it.

    Sorted `intervals` show it if the order of the file is random. If the order breaks only now
    and then, the intervals of the file show it, because two passes over one stretch of time
    would halve the sorted ones.
    """
    steps = np.diff(stamps)
    shuffled = (steps < 0).sum() > MAX_BREAKS * len(steps)
    seen = intervals if shuffled else steps
    return float(np.median(seen[seen > 0])) if (seen > 0).any() else 0.0


def _going_back(where: str, stamps: NDArray[np.int64], index: int, furthest: int) -> BagError:
    after = (stamps[:index].max() - stamps[0]) / 1e9 if index else 0.0
    return BagError(
        f'{where}: stamps go back by {furthest / 1e9:.6g} s, first at message {index} '
        f'({after:.3f} s into the record): the clock was set back, or the file holds two '
        'recordings; record again with a steady clock')


def _check_leaps(where: str, ordered: NDArray[np.int64]) -> None:
    if not count_where(_leaps, ordered, ahead=1):
        return
    leaps = np.diff(ordered)
    index = int(np.argmax(leaps))
    raise BagError(
        f'{where}: stamps leap ahead by {leaps[index] / 1e9:.6g} s behind stamp '
        f'{ordered[index]} ns: the clock was set, or a header.stamp was not filled; record again')


def _leaps(stamps: NDArray[np.int64]) -> NDArray[np.bool_]:
    return np.asarray(np.diff(stamps) > LONGEST_LEAP_NS)


def _without_duplicates(
    where: str, ordered: NDArray[np.int64], values: NDArray[np.float64],
) -> NDArray[np.bool_]:
    """Mask of the first message of each stamp; BagError if too many others contradict it."""
    repeated = np.zeros(len(ordered), dtype=bool)
    repeated[1:] = np.diff(ordered) == 0
    contradicting = repeated.copy()
    contradicting[1:] &= values[1:] != values[:-1]
    if contradicting.sum() > max(1.0, MAX_DUPLICATES * len(ordered)):
        first = int(np.argmax(contradicting))
        raise BagError(
            f'{where}: {int(contradicting.sum())} of {len(ordered)} messages have the stamp of '
            f'another message with a different reading, first {ordered[first]} ns: the clock '
            'stops at times; record again with a stamp for each sample')
    return ~repeated
