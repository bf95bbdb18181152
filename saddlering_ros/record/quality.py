"""Properties of the logger by its readings: repeats, resolution, bandwidth, spikes, stalls, drift.

Every check looks at the readings of one topic as recorded, at no model of the ring. A check that
cannot tell stays silent: a quiet sensor behind a coarse converter shows no bandwidth.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
import math

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.record.batches import Floats, Stamps
from saddlering_ros.record.scratch import blocks, count_where, extremes, spread, spread_changes

HELD_SHARE = 0.5
"""Share of readings equal to the one before above which readings may be held."""

MIN_NEW = 10
"""Smallest number of changes by which held readings are judged: their distances have a median."""

EVEN_SHARE = 0.6
"""Share of changes at an even distance, to a sample, above which a slower clock made them. Repeats
by chance, eight in ten and more, reach 0.31; with fewer of them HELD_STEPS decides."""

HELD_RATE = 0.75
"""Share of the rate below which readings are taken: half of it or less where a clock is slower."""

HELD_STEPS = 2.0
"""Smallest change (rms) of held readings, in steps of the converter."""

STALL_SAMPLES, STALL_SIZE = 20, 8.0
"""Number of equal readings that may be a stall, and change at its end in usual changes ..."""

STALL_STEPS = 3.0
"""... and in steps of the converter."""

STALL_CHANCE = 1e-6
"""Chance above which a run of equal readings is no stall."""

SPIKE_SIZE = 10.0
"""Distance of a spike from its four neighbours, in standard deviations."""

NOISE_SHARE = 0.7
"""Smallest standard deviation for it, as a share of that of the white noise. The median of five
follows noise, and seven deviations occur once in 1e11 readings without a spike."""

RETURN_SHARE = 0.5
"""Distance, as a share of the spike, within which the readings after a spike return."""

EQUAL_AT_LIMIT = 20
"""Number of readings in a row, equal to the largest or smallest one, that show a limit."""

QUIET_SECONDS = 0.8
"""Length [s] of the beginning of a record in which the bandwidth of the noise is looked for."""

MIN_QUIET_SAMPLES = 100
"""With so many readings (at 125 Hz) noise below 5 Hz shows (CHANCE_ERRORS), little above
MIN_BANDWIDTH; fewer would show nothing."""

MAINS = (50.0, 60.0)
"""Frequencies [Hz] of mains pickup, which belongs to no noise: its changes grow with the lag, as
those of a low-pass do."""

MIN_BANDWIDTH = 3.0
"""Frequency [Hz] below which noise at the beginning of a record is a movement."""

CHANCE_ERRORS = 4.5
"""Mean square changes over one sample and over many that differ by fewer standard errors are of
white noise."""

BAND_LIMIT = 0.2
"""Bandwidth, as a share of the sampling rate, below which noise is band-limited."""

ALONE_LIMIT = 0.05
"""The same of one probe. Interpolation half way between two samples leaves 0.11, and no lag."""

BAND_RATIO = 2.0
"""Ratio of the bandwidths of load and probes, each over its own rate, above which their filters
differ."""

STRETCH, MIN_APART = 64, 2.0
"""Readings of a stretch of which every second one may differ, and least difference in standard
deviations of the noise and in steps: white noise has 0.2, and 2 in none of a million stretches."""

COARSE_SHARE = 1.5
"""Step of a converter, in standard deviations of the noise, above which it is coarse."""

MAX_GROWTH = 4.0
"""Ratio of the mean square changes over 40 and over 10 readings above which there is a
movement."""

LOOKED_AT = 1_000_000
"""Largest number of readings that give the step of the converter."""

DRIFT_MIN, DRIFT_MAX = 5e-5, 1e-2
"""Shares between which different rates of load and probes were meant to be equal."""

DRIFT_SECONDS, DRIFT_PERIODS = 1e-3, 0.15
"""A drift between clocks that is larger than this at the end of the record [s], and than this
share of the slower period (stamps jitter by a few percent of it), gets a note."""

MAX_BINS, MAX_IN_BIN, MIN_IN_BIN = 400, 100, 20
"""Bins whose noise is compared, and readings of each: a bin has its noise to within a third or
better, and at most 40 000 readings show a drift of 5e-5 as two beats."""

MIN_BEATS = 1.5
"""Fewer beats are no rhythm: a change during one load cycle is as long."""

MIN_DEPTH, LOUD_ALIKE, QUIET_ALIKE = 0.5, (-0.75, -0.55), -0.5
"""Depth of the beat of interpolated noise, which is 0.76 by theory and below 0.25 by chance; and
how a change of a change follows the one before: by -0.64 in the loud third, as white noise does,
and by -0.33 in the quiet one. Noise that swells by itself has -0.67 in both, a line near half of
the rate -1."""

EVEN_STAMPS, EARLIEST = 200, 0.02
"""Stamps of a stretch in which a clock is even, and share of them that count as the earliest."""

NEAR_WHOLE, MIN_WHOLE = 0.25, 0.95
"""Distance of a step from whole periods, in periods, and share of steps up to this distance from
which on longer steps are of missing samples: stamps of arrival lie anywhere."""

BETWEEN_BLOCKS = 10.0
"""Smallest step between blocks of readings, in usual steps: jitter makes none so long."""


@dataclass(frozen=True)
class TopicQuality:
    """Properties of one topic by its readings; the defaults are those of no numbers."""

    rate: float = math.nan  # [Hz] by the median period
    mean_rate: float = math.nan  # [Hz] over the record, NaN if stamps have gaps
    repeated: float = math.nan  # share of readings equal to the one before
    update_rate: float = math.nan  # [Hz] of readings that are new, below `rate` if held
    resolution: float = math.nan  # greatest common step, 0 if none shows
    noise: float = math.nan  # rms white noise of a reading
    bandwidth: float = math.nan  # [Hz] of the noise, NaN if unknown
    rate_before: float = 0.0  # share by which the rate before an interpolation differs, 0: none
    spikes: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    stall: tuple[int, int] = (0, 0)  # start, count of equal readings, not by chance or rest
    limit: tuple[float, int] = (math.nan, 0)  # value, count, where a limit repeats an extreme
    alternates: float = 0.0  # difference of every second reading, 0 if it can be noise
    lateness: float = 0.0  # [s] of the mean stamp behind the earliest ones of an even clock
    pause: float = 0.0  # [s] between blocks of readings, in which most of the time lies; 0: none
    has_equal_blocks: bool = False

    @property
    def is_held(self) -> bool:
        """Whether readings are published more often than they are taken."""
        return self.update_rate < HELD_RATE * self.rate

    @property
    def is_coarse(self) -> bool:
        """Whether the converter's step, and not the sensor's noise, limits the readings."""
        return self.resolution > COARSE_SHARE * self.noise


def topic_quality(stamps: Stamps, values: Floats) -> TopicQuality:
    """Look at readings (N,) at stamps (N,) [ns]."""
    steps = spread_changes(stamps)
    period = float(np.median(steps))
    rate = 1e9 / max(period, 1.0)
    longest = max(int(np.diff(stamps[block.start:block.stop + 1]).max())
                  for block in blocks(len(stamps) - 1, stamps))
    mean_rate = 1e9 * (stamps.size - 1) / float(stamps[-1] - stamps[0])
    changes = spread_changes(values)
    repeats = count_where(lambda block: block[1:] == block[:-1], values, ahead=1)
    repeated = repeats / max(len(values) - 1, 1)
    resolution = common_step(values)
    new = changes[changes != 0.0]
    held = (repeated > HELD_SHARE and new.size > MIN_NEW
            and float(np.sqrt(np.mean(new**2))) > HELD_STEPS * max(resolution, 1e-300))
    if held:  # New readings of a slower clock come at even distances.
        apart = np.diff(np.flatnonzero(changes != 0.0))
        usual = float(np.median(apart))
        held = usual >= 2.0 and float(np.mean(np.abs(apart - usual) <= 1.0)) > EVEN_SHARE
    update_rate = rate * (1.0 - repeated) if held else rate
    seen = spread(values)
    fresh = seen[np.append(True, np.diff(seen) != 0.0)] if held else seen
    noise = white_noise(fresh)
    runs = _runs(values)
    # A coarse converter repeats its largest reading, too.
    is_fine = resolution <= COARSE_SHARE * noise
    pause, is_equal = between_blocks(steps, period)
    return TopicQuality(
        rate=rate, mean_rate=math.nan if longest > 1.9 * period else mean_rate,
        repeated=repeated, update_rate=update_rate, resolution=resolution, noise=noise,
        bandwidth=_bandwidth(fresh, update_rate, resolution),
        rate_before=0.0 if held else _rate_before(values),
        spikes=np.zeros(0, dtype=np.intp) if held else spikes_of(values, resolution, noise),
        stall=(0, 0) if held else _stall(values, new, runs, resolution),
        limit=_limit(values, runs, repeated) if is_fine else (math.nan, 0),
        alternates=0.0 if held else _alternates(seen, resolution),
        lateness=1e-9 * _lateness(steps, period), pause=1e-9 * pause, has_equal_blocks=is_equal)


def _lateness(steps: Stamps, period: float) -> float:
    """Mean delay of stamps behind the earliest ones of an even clock, in the unit of the steps.

    Stamps of arrival are late by what a bus or a queue takes, which differs from one to the next.
    Steps of whole periods are of missing samples.
    """
    beats = steps / max(period, 1.0)
    missing = np.maximum(np.rint(beats) - 1.0, 0.0)
    if np.mean(np.abs(beats - 1.0 - missing) < NEAR_WHOLE) > MIN_WHOLE:
        beats = beats - missing
    even = beats[:beats.size // EVEN_STAMPS * EVEN_STAMPS].reshape(-1, EVEN_STAMPS)
    even = even[even.max(axis=1, initial=0.0) < EVEN_STAMPS]
    if not even.size:
        return 0.0
    number = np.arange(EVEN_STAMPS) - 0.5 * (EVEN_STAMPS - 1)
    behind = np.cumsum(even, axis=1)
    behind -= behind.mean(axis=1, keepdims=True)
    behind -= np.outer(behind @ number / (number @ number), number)
    return -period * float(np.median(np.quantile(behind, EARLIEST, axis=1)))


def between_blocks(steps: Stamps | Floats, period: float, least: int = MIN_NEW,
                   ) -> tuple[float, bool]:
    """Pause between blocks of readings that are stamped together, and whether blocks are equal.

    The pause has the unit of the steps and of their usual one, the period. It is 0 if less than
    half of the time lies between blocks, and of one long pause. least: pauses that show equality.
    """
    ends = np.flatnonzero(steps > BETWEEN_BLOCKS * period)
    if ends.size < 2 or steps[ends].sum() < 0.5 * steps.sum():
        return 0.0, False
    readings = np.diff(ends)
    is_equal = ends.size >= least and bool(
        np.mean(np.abs(readings - np.median(readings)) <= 1.0) > EVEN_SHARE)
    return float(np.median(steps[ends])), is_equal


def _runs(values: Floats) -> NDArray[np.int64]:
    """Runs of at least STALL_SAMPLES equal readings as rows (start, count)."""
    runs = []
    open_at = 0
    for block in blocks(len(values), values):
        changed = np.flatnonzero(np.diff(values[block.start:block.stop + 1]) != 0.0)
        edges = np.concatenate([[open_at], block.start + changed + 1])
        if block.stop == len(values):
            edges = np.append(edges, len(values))
        open_at = int(edges[-1])
        long = np.flatnonzero(np.diff(edges) >= STALL_SAMPLES)
        runs.append(np.stack([edges[long], np.diff(edges)[long]], axis=1))
    return np.concatenate(runs)


def common_step(values: Floats, share: float = 0.9) -> float:
    """Greatest common step of readings (N,), 0 if none shows in fewer levels than a `share`."""
    levels = np.unique(values[:LOOKED_AT])
    if levels.size < 3:
        return float(np.ptp(levels)) if levels.size > 1 else 0.0
    steps = np.diff(levels)
    steps = steps[steps > 1e-9 * float(np.abs(levels).max())]
    if not steps.size or levels.size >= share * min(values.size, LOOKED_AT):
        return 0.0
    smallest = float(steps.min())
    multiples = steps / smallest
    is_regular = float(np.mean(np.abs(multiples - np.round(multiples)) < 0.05)) > 0.95
    return smallest if is_regular else 0.0


def white_noise(values: Floats, lag: int = 1) -> float:
    """Standard deviation of the noise on samples (N,) of something smooth; NaN ones do not count.

    Second differences over `lag` samples remove a straight line and have six times the variance of
    the samples. Their median does not follow steps. Slower noise does not count.
    """
    seen = values[np.isfinite(values)]
    if seen.size < 2 * lag + 1:
        return math.nan
    changes = seen[lag:] - seen[:-lag]
    second = changes[lag:] - changes[:-lag]
    robust = 1.4826 * float(np.median(np.abs(second - np.median(second)))) / math.sqrt(6.0)
    if robust > 0.0:
        return robust
    kept = np.abs(second) <= np.quantile(np.abs(second), 0.99)
    return float(np.sqrt(np.mean(second[kept] ** 2) / 6.0))


def spikes_of(values: Floats, step: float, noise: float) -> NDArray[np.intp]:
    """Indices of single readings (or pairs) far from the readings on both sides.

    A reading is compared with the median of five about it, which keeps a step of the signal. step:
    of the converter; noise: standard deviation of the readings' white noise.
    """
    if values.size < 10:
        return np.zeros(0, dtype=np.intp)
    usual = 1.4826 * float(np.median(_away_from_neighbours(spread(values))))
    scale = max(usual, NOISE_SHARE * noise, 0.5 * step)
    spikes = []
    last = len(values) - 1
    for block in blocks(len(values), values):
        start, stop = max(block.start - 2, 0), block.stop + 2
        away = _away_from_neighbours(values[start:stop])[block.start - start:]
        far = np.flatnonzero(away[:block.stop - block.start] > SPIKE_SIZE * scale)
        places = block.start + far
        # Where the median of nine changes is large too, a fast movement is no spike.
        about = np.clip(places[:, None] + np.arange(-4, 5), 0, last)
        around = np.median(np.abs(values[np.minimum(about + 1, last)] - values[about]), axis=1)
        # A ring that jumps through its clearance overshoots its new position by a single reading.
        # After a spike the readings return.
        before = values[np.clip(places - 2, 0, last)] + values[np.clip(places - 3, 0, last)]
        behind = values[np.clip(places + 2, 0, last)] + values[np.clip(places + 3, 0, last)]
        moved = 0.5 * np.abs(behind - before)
        spikes.append(places[(away[far] > SPIKE_SIZE * 0.5 * around)
                             & (moved < RETURN_SHARE * away[far])])
    return np.concatenate(spikes)


def _away_from_neighbours(values: Floats) -> Floats:
    """Distance of each reading (N,) from the median of the five around it; ends are repeated."""
    padded = np.pad(values, 2, mode='edge')
    first, second, third, fourth, fifth = (padded[place:place + len(values)] for place in range(5))
    # The median of three: the fifth, and two that bound the median of the other four.
    low = np.maximum(np.minimum(first, second), np.minimum(fourth, fifth))
    high = np.minimum(np.maximum(first, second), np.maximum(fourth, fifth))
    median = np.maximum(np.minimum(low, high), np.minimum(np.maximum(low, high), third))
    return np.abs(values - median)


def _limit(values: Floats, runs: NDArray[np.int64], repeated: float) -> tuple[float, int]:
    """The largest or smallest reading where it is repeated as only a limit does, and how often."""
    lowest, highest = extremes(values)
    for extreme in (float(highest), float(lowest)):
        longest = max(runs[values[runs[:, 0]] == extreme, 1].tolist(), default=0)
        if longest >= EQUAL_AT_LIMIT and _chance(longest, repeated, values.size) < STALL_CHANCE:
            return extreme, count_where(lambda block, at=extreme: block == at, values)
    return math.nan, 0


def _chance(count: int, repeated: float, samples: int) -> float:
    """Expected number of runs of `count` equal readings if a share `repeated` repeats."""
    return samples * float(min(max(repeated, 1e-3), 1.0 - 1e-9)) ** (count - 1)


def _stall(
    values: Floats, new: Floats, runs: NDArray[np.int64], resolution: float
) -> tuple[int, int]:
    """The longest run of equal readings that ends in a jump or is no chance; new: changes."""
    if new.size < 20 or not len(runs):
        return 0, 0
    usual = float(np.median(np.abs(new)))
    limits = extremes(values)
    for start, count in runs[np.argsort(runs[:, 1])[::-1][:5]].tolist():
        end = start + count
        if values[start] in limits or end >= values.size:
            continue
        about = np.concatenate([np.diff(values[max(0, start - 3 * count):start + 1]),
                                np.diff(values[end:end + 3 * count + 1])])
        local = float(np.mean(about == 0.0)) if about.size else 1.0
        jump = abs(float(values[end] - values[start]))
        if jump > max(STALL_SIZE * usual, STALL_STEPS * resolution) or (
                2.0 * resolution < usual and _chance(count, local, values.size) < STALL_CHANCE):
            return int(start), int(count)
    return 0, 0


def _bandwidth(values: Floats, rate: float, resolution: float) -> float:
    """Bandwidth [Hz] of the noise at the beginning of a record, where the load is at rest.

    By the mean square change over one sample and over many: equal for white noise; of a
    first-order low-pass at f the first is 1 - exp(-2 pi f / rate) of the second.
    """
    quiet = values[:int(QUIET_SECONDS * rate)]
    if quiet.size < MIN_QUIET_SAMPLES:
        return math.nan
    time = np.arange(quiet.size) / rate
    turns = 2.0 * math.pi * np.outer(time, MAINS)
    known = np.column_stack([np.ones_like(time), time, np.cos(turns), np.sin(turns)])
    quiet = quiet - known @ np.linalg.lstsq(known, quiet, rcond=None)[0]
    lags = [lag for lag in (1, 2, 5, 10, 20, 40) if lag < quiet.size // 4]
    seen = [float(np.mean((quiet[lag:] - quiet[:-lag]) ** 2)) for lag in lags]
    if lags[-1] == 40 and seen[-1] > MAX_GROWTH * seen[lags.index(10)]:
        return math.nan
    rounding = resolution**2 / 6.0
    largest = max(seen) - rounding
    if largest < 4.0 * rounding or largest <= 0.0:
        return math.nan
    share = min(max((seen[0] - rounding) / largest, 1e-4), 0.999)
    if share > 1.0 - CHANCE_ERRORS * math.sqrt(3.0 / quiet.size):
        share = 0.999
    bandwidth = -math.log1p(-share) * rate / (2.0 * math.pi)
    return bandwidth if bandwidth > MIN_BANDWIDTH else math.nan


def _alternates(values: Floats, resolution: float) -> float:
    """Difference of every second reading (N,) from its neighbours: the median over stretches."""
    middle = values[1:-1] - 0.5 * (values[:-2] + values[2:])  # without a straight line
    count = middle.size // STRETCH
    if not count:
        return 0.0
    signs = np.where(np.arange(STRETCH) % 2, -1.0, 1.0)
    apart = float(np.median(np.abs(middle[:count * STRETCH].reshape(count, STRETCH) @ signs)))
    noise = min(white_noise(values[::2]), white_noise(values[1::2]))
    return apart / STRETCH if apart > MIN_APART * STRETCH * max(noise, resolution) else 0.0


def _rate_before(values: Floats) -> float:
    """Share by which the rate of readings before they were interpolated differs; 0 if none shows.

    A reading at the share f between two with equal noise has (1 - f)^2 + f^2 of its variance, and
    its second difference has 6 - 20 f (1 - f) in place of 6. Of two rates f rises steadily, so
    that the noise swells once for each period by which the clocks drift apart.
    """
    second = np.diff(values[:MAX_BINS * MAX_IN_BIN], 2)
    size = max(MIN_IN_BIN, second.size // MAX_BINS)
    bins = second[:second.size // size * size].reshape(-1, size)
    power = np.median(np.abs(bins), axis=1) ** 2
    if len(bins) < 2 * MIN_IN_BIN or not power.min() > 0.0:
        return 0.0
    # In tenths of a beat, up to eight bins each.
    depth = 2.0 * np.abs(np.fft.rfft(power / power.mean() - 1.0, 10 * len(bins))) / len(bins)
    depth = depth[:10 * len(bins) // 8]
    found = 0.1 * float(depth.argmax())
    if found < MIN_BEATS or depth.max() < MIN_DEPTH:
        return 0.0
    limit = 6.0 * np.sqrt(power)[:, None]  # of steps and spikes, which are no noise
    bins = np.clip(bins, -limit, limit)[np.argsort(power)]
    quiet, loud = (float(np.sum(part[:, 1:] * part[:, :-1]) / np.sum(part**2))
                   for part in (bins[:len(bins) // 3], bins[-len(bins) // 3:]))
    is_interpolated = LOUD_ALIKE[0] < loud < LOUD_ALIKE[1] and quiet > QUIET_ALIKE
    return found / bins.size if is_interpolated else 0.0


def doubtful_lag(load: TopicQuality, probes: Sequence[TopicQuality], seconds: float) -> float:
    """Largest possible delay [s] between readings of load and probes."""
    ages = [one.lateness + (0.5 / one.update_rate if one.is_held else 0.0)
            for one in (load, *probes)]
    age = ages[0] - median_of_known(ages[1:])
    drift = abs(rate_share(load, probes, seconds)) * seconds
    return abs(age + filter_lag(load, probes)) + drift


def filter_lag(load: TopicQuality, probes: Sequence[TopicQuality]) -> float:
    """Delay [s] of the load by a filter minus that of the probes; 0 if none shows."""
    if rate_before(load, probes) or load.is_held or any(one.is_held for one in probes):
        return 0.0
    bandwidths = np.array([load.bandwidth, median_of_known([one.bandwidth for one in probes])])
    rates = np.array([load.rate, median_of_known([one.rate for one in probes])])
    shares = bandwidths / rates
    if not (np.isfinite(shares).all() and shares.max() > BAND_RATIO * shares.min()):
        return 0.0
    lags = np.where(shares < BAND_LIMIT, 1.0 / (2.0 * math.pi * bandwidths), 0.0)
    return float(lags[0] - lags[1])


def rate_before(load: TopicQuality, probes: Sequence[TopicQuality]) -> float:
    """Share by which the rate before an interpolation of load or probes differs, 0: none."""
    return max(load.rate_before, float(np.median([one.rate_before for one in probes])))


def rate_share(load: TopicQuality, probes: Sequence[TopicQuality], seconds: float) -> float:
    """Share by which the probes' rate exceeds the load's, if that may be a drift; else 0."""
    share = rate_before(load, probes) or (
        median_of_known([one.mean_rate for one in probes]) / load.mean_rate - 1.0)
    period = 1.0 / min(load.rate, median_of_known([one.rate for one in probes]))
    least = max(DRIFT_SECONDS, DRIFT_PERIODS * period)
    is_drift = DRIFT_MIN < abs(share) < DRIFT_MAX and abs(share) * seconds > least
    return share if is_drift else 0.0


def median_of_known(values: Sequence[float]) -> float:
    """The median of the finite values; NaN if there is none."""
    finite = [value for value in values if math.isfinite(value)]
    return float(np.median(finite)) if finite else math.nan
