"""A static run cut into plateaus by its load, and the reading of each plateau.

Cutting. The mean loads over windows of `WINDOWS` seconds before and after each sample are
compared. Where the two differ by little, the load is held. The step, the number of cycles and the
length of a plateau are free, but a plateau lasts several windows.

Reading. The first `SETTLING_SHARE` of a hold is for settling; the reading is the mean of the rest.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from saddlering_ros.errors import BagError, counted
from saddlering_ros.record.batches import Floats, Mask
from saddlering_ros.record.record import Record
from saddlering_ros.record.scratch import blocks, forget, scratch_array, spread, spread_changes

Span = tuple[int, int]
"""Samples [start, stop)."""

WINDOWS = (0.5, 0.25, 0.1)
"""Widths [s] of the comparison, widest first. The first one with enough plateaus is used."""

STEADY_SHARE = 0.0015
"""Means that differ by less than this share of the load's range belong to one hold."""

NOISE_FACTOR = 5.0
"""... or by less than this many standard errors of the difference."""

LONGEST_INTERRUPTION = 1.0
"""Largest interval [s] between two stretches at the same level that are one hold."""

EDGE = 0.1
"""Length [s] of the means that find the end of a hold."""

SETTLING_SHARE = 0.4
"""Share of a hold for settling."""

SHORTEST_HOLD = 0.5
"""Length [s] below which a steady stretch is a turning point and no plateau."""

MIN_SAMPLES = 5
"""Smallest number of readings of a mean: its error is then known within 35 %."""

MIN_PLATEAUS = 3
"""Smallest number of plateaus: one on the way up, the top, and one on the way down."""

SAME_LEVEL_SHARE = 0.35
"""Difference of loads, as a share of a step, below which plateaus are at the same level."""


@dataclass(frozen=True)
class Plateaus:
    """The M plateaus of a static run in order of time; indices count the run's load samples.

    The part averaged is [start, stop). level: equal on both branches, 0 the lowest. branch: +1
    reached from below and left upwards (or the end), -1 the other way, 0 at the first plateau and
    at turning points (the top; the bottom between two cycles).
    """

    load: Floats  # (M,) [N]
    gaps: Floats  # (4, M) [m], NaN for a probe that was not reading
    time: Floats  # (M,) [s], mean over the part averaged
    start: NDArray[np.int64]
    stop: NDArray[np.int64]
    hold_start: NDArray[np.int64]
    hold_stop: NDArray[np.int64]
    branch: NDArray[np.int64]
    level: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.load)

    @property
    def direction(self) -> Floats:
        """+1 (M,) while the load rises, -1 while it falls; at a turning point that before it."""
        direction = self.branch.astype(float)
        for index in np.flatnonzero(direction == 0.0):
            direction[index] = direction[index - 1] if index else 1.0
        return direction


def plateaus(run: Record) -> Plateaus:
    """Cut `run` into plateaus; BagError if its load is not held at a few levels."""
    holds = find_holds(run.time, run.load)
    if len(holds) < MIN_PLATEAUS:
        raise BagError(
            f'{run.path}: the load is held at {counted(len(holds), "level")}, too few for a '
            "static test: hold the load at more levels, or give test='dynamic'")
    hold_start, hold_stop = np.array(holds, dtype=np.int64).T
    # The first samples behind the settling part.
    begins = run.time[hold_start] + SETTLING_SHARE * (
        run.time[hold_stop - 1] - run.time[hold_start])
    start = np.minimum(np.searchsorted(run.time, begins), hold_stop - MIN_SAMPLES)
    load = plateau_means(start, hold_stop, run.load)
    # Number of each plateau's load level, 0 the lowest; the step is found from the loads.
    step = float(np.median(np.abs(np.diff(load))))
    order = np.argsort(load, kind='stable')
    level = np.zeros(len(load), dtype=np.int64)
    number, members = 0, [float(load[order[0]])]
    for place in order[1:].tolist():
        if load[place] - np.mean(members) > SAME_LEVEL_SHARE * step:
            number, members = number + 1, []
        members.append(float(load[place]))
        level[place] = number
    # Branch, from the levels in order of time.
    moves = np.sign(np.diff(level)).tolist()
    arrived, leaving = [0, *moves], [*moves, 0]
    for place in range(1, len(level)):
        arrived[place] = arrived[place] or arrived[place - 1]
        leaving[-1 - place] = leaving[-1 - place] or leaving[-place]
    turning = np.multiply(arrived, leaving) < 0
    branch = np.where(turning, 0, arrived).astype(np.int64)
    return Plateaus(
        load=load, gaps=plateau_means(start, hold_stop, run.gaps),
        time=plateau_means(start, hold_stop, run.time), start=start,
        stop=hold_stop, hold_start=hold_start, hold_stop=hold_stop, branch=branch, level=level)


def plateau_means(start: ArrayLike, stop: ArrayLike, values: ArrayLike) -> Floats:
    """Means (..., M) of `values` (..., N) over the samples [start, stop) of each of M plateaus.

    NaN samples do not count. The mean of fewer than MIN_SAMPLES readings is NaN.
    """
    values = np.asarray(values, dtype=np.float64)
    spans = list(zip(np.asarray(start).tolist(), np.asarray(stop).tolist(), strict=True))
    channels = values.reshape(-1, values.shape[-1])
    mean = np.full((len(channels), len(spans)), np.nan)
    for number, channel in enumerate(channels):
        for place, (first, last) in enumerate(spans):
            readings = channel[first:last]
            readings = readings[np.isfinite(readings)]
            if len(readings) >= MIN_SAMPLES:
                mean[number, place] = readings.mean()
        forget(channel)
    return mean.reshape(*values.shape[:-1], len(spans))


def find_holds(time: Floats, load: Floats) -> list[Span]:
    """Stretches [start, stop) of samples over which the load is held, in order."""
    low, high = np.percentile(spread(load), [0.5, 99.5])
    span = float(high - low)
    if len(load) < 2 * MIN_SAMPLES or span <= 0.0:
        return []
    best: list[Span] = []
    best_share = 0.0
    for window in WINDOWS:
        holds = _holds(time, load, window, span)
        share = sum(time[stop - 1] - time[start] for start, stop in holds)
        share /= time[-1] - time[0]
        if len(holds) >= MIN_PLATEAUS and share >= 0.5:
            return holds
        if len(holds) >= MIN_PLATEAUS and share > best_share + 0.1:
            best, best_share = holds, share
    return best if best_share >= 0.2 else []


def _holds(time: Floats, load: Floats, window: float, span: float) -> list[Span]:
    period = float(np.median(spread_changes(time)))
    window = max(window, 4.0 * period)
    changes = spread_changes(load)
    noise = float(np.median(np.abs(changes))) / 0.954
    # Of a ramp that a slow logger reads, every change is large, and the changes are equal.
    noise = min(noise, 2.0 * float(np.median(np.abs(np.diff(changes)))) / 1.652)
    samples = window / period
    tolerance = max(STEADY_SHARE * span, NOISE_FACTOR * noise * np.sqrt(2.0 / samples))
    steady = _steady(time, load, window, tolerance)
    shortest = max(SHORTEST_HOLD if window >= WINDOWS[0] else window, 3 * period)
    edges = np.flatnonzero(np.diff(steady, prepend=False, append=False)).reshape(-1, 2)
    stretches = [
        (start, stop) for start, stop in edges.tolist()
        if stop - start >= MIN_SAMPLES and time[stop - 1] - time[start] >= shortest / 2]
    merged = _merged(stretches, time, load, 0.004 * span, noise)
    holds = [(start, stop) for start, stop in merged if time[stop - 1] - time[start] >= shortest]
    # Number of samples whose mean shows the end of a hold, at most a window.
    wanted = max(EDGE / period, (NOISE_FACTOR * noise / (4.0 * STEADY_SHARE * span)) ** 2)
    # Extend each hold by the samples at its level that the window removed at its ends. A hold
    # ends where the mean of `edge` samples leaves its level. These samples and as many before
    # them do not belong to the hold.
    edge = max(1, round(min(wanted, window / period)))
    total = _running_sum(load)
    limit = max(tolerance, NOISE_FACTOR * noise / np.sqrt(edge))

    def is_away(first: int, last: int) -> Mask:
        means = (total[first + edge:last + edge] - total[first:last]) / edge
        return np.asarray(np.abs(means - level) > limit)

    extended: list[Span] = []
    for number, (start, stop) in enumerate(holds):
        level = np.median(load[start:stop])
        first = low = extended[-1][1] if extended else 0
        high = holds[number + 1][0] if number + 1 < len(holds) else len(load)
        # From the hold backwards to the last mean at another level, then forwards to the first.
        end = min(start - edge + 1, len(total) - edge)
        for block in blocks(end - low, total):
            away = is_away(end - block.stop, end - block.start)
            if away.any():
                first = end - block.stop + int(np.flatnonzero(away)[-1]) + edge
                break
        last, end = high, min(high, len(total) - edge)
        for block in blocks(end - stop, total):
            away = is_away(stop + block.start, stop + block.stop)
            if away.any():
                last = stop + block.start + int(np.argmax(away)) - edge
                break
        extended.append((min(first, start), max(last, stop)))
    return extended


def _steady(time: Floats, load: Floats, window: float, tolerance: float) -> Mask:
    """Mask of samples at which the means over the windows before and after differ by little."""
    total = _running_sum(load, float(load.mean()))
    steady = np.zeros(len(time), dtype=bool)
    for block in blocks(len(time), time, load, total):
        here = np.arange(block.start, block.stop)
        first = np.searchsorted(time, time[block] - window, side='left')
        last = np.searchsorted(time, time[block] + window, side='right')
        before = (total[here + 1] - total[first]) / (here + 1 - first)
        after = (total[last] - total[here]) / (last - here)
        steady[block] = np.abs(after - before) <= tolerance
    return steady


def _running_sum(values: Floats, less: float = 0.0) -> Floats:
    """Sums (N + 1,) of the first 0 to N values, each minus a constant."""
    total = scratch_array((len(values) + 1,), np.float64)
    for block in blocks(len(values), values, total):
        added = np.cumsum(np.append(total[block.start], values[block] - less))
        total[block.start + 1:block.stop + 1] = added[1:]
    return total


def _merged(
    stretches: list[Span], time: Floats, load: Floats, tolerance: float, noise: float,
) -> list[Span]:
    """Join neighbours at the same level, as after a short disturbance of the load."""
    joined: list[Span] = []
    for start, stop in stretches:
        if joined:
            first, last = joined[-1]
            close = time[start] - time[last - 1] <= LONGEST_INTERRUPTION
            step = abs(float(np.median(load[first:last]) - np.median(load[start:stop])))
            error = 1.25 * noise * np.sqrt(1.0 / (last - first) + 1.0 / (stop - start))
            if close and step <= tolerance + NOISE_FACTOR * error:
                joined[-1] = (first, stop)
                continue
        joined.append((start, stop))
    return joined
