"""Steady lines on stretches at rest, such as mains pickup, at the original sampling rate.

Block means remove a line, so that it cannot be fitted with the other effects. The statistic at a
frequency is the sum over stretches of windowed power over the level of the neighbouring
frequencies. Under noise of any smooth spectrum the statistic is an F ratio, with a Bonferroni
correction over frequencies and channels.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from saddlering_ros.discrepancy.problem.system import Array
from saddlering_ros.discrepancy.search.limits import POWER_QUANTILE
from saddlering_ros.estimation.rest import RestSegment
from saddlering_ros.estimation.statistics import fisher_chance, fisher_limit

MIN_FREQUENCY = 8.0
"""Frequency [Hz] below which the residual tests apply: slower swings may belong to the machine,
and a stretch at rest has too few of their periods."""

MIN_SAMPLES = 100
"""Smallest number of samples of a stretch whose spectrum is used: three times the frequencies
that give the level of the noise."""

NEIGHBOURS = 15
"""Independent frequencies on each side that give the level of the noise, to a fifth."""

WINDOW_WIDTH = 2.0
"""Independent frequencies that a Hann window combines into one."""

ROUNDING = 1e-12
"""Deviation from a straight line below which values are still, as a share of the largest one:
double precision."""


@dataclass(frozen=True)
class Line:
    """A steady line: frequency [Hz], amplitude (C,) in each channel, chance under noise.

    `own` (C,): channels in which the line alone is real; `deviation` (C,): of the amplitudes;
    `delta_bic`: evidence with its phases counted; `step` [s] of the record in which it was
    found.
    """

    frequency: float
    amplitude: Array
    deviation: Array
    own: NDArray[np.bool_]
    p_value: float
    delta_bic: float
    step: float


@dataclass(frozen=True)
class LineSearch:
    """Result of the search at rest: a line or None, and the amplitude that would be found."""

    line: Line | None
    limit: float


def find_line(
    segments: Sequence[RestSegment],
    error_rate: float,
    between: tuple[float, float] = (MIN_FREQUENCY, np.inf),
    min_samples: int = MIN_SAMPLES,
) -> LineSearch:
    """The strongest line that is real at `error_rate`, in the runs with the fastest sampling.

    between: lowest and highest frequency [Hz] of the search. A channel that is still in a stretch
    has no level of noise, and is not searched.
    """
    usable = [segment for segment in segments if segment.values.shape[1] >= min_samples]
    if not usable:
        return LineSearch(None, np.inf)
    fastest = min(segment.step for segment in usable)
    usable = [segment for segment in usable if segment.step < 1.05 * fastest]
    # Channels (C,) whose values (C, n) leave a straight line by more than rounding.
    moving = np.all([
        _detrended(segment.values).std(axis=1) > ROUNDING * np.abs(segment.values).max(axis=1)
        for segment in usable], axis=0)
    if not moving.any():
        return LineSearch(None, np.inf)
    step = float(np.median([segment.step for segment in usable]))
    size = 2 * 2 ** int(np.ceil(np.log2(max(segment.values.shape[1] for segment in usable))))
    frequency = np.fft.rfftfreq(size, step)
    power, ratio, freedom = _ratios(usable, size)
    ratio[~moving] = 0.0
    edge = 4.0 / (step * min(segment.values.shape[1] for segment in usable))
    inside = (frequency >= between[0]) & (frequency <= min(between[1], frequency[-1] - edge))
    if not inside.any():
        return LineSearch(None, np.inf)
    trials = int(moving.sum()) * int(inside.sum())
    count = len(usable)
    limit = _limit(usable, moving, fisher_limit(error_rate / trials, 2 * count, freedom))
    chance = fisher_chance(ratio, 2 * count, freedom) * trials
    chance[:, ~inside] = np.inf
    # The chance of a very strong line is 0 at several frequencies; the ratio separates them.
    shown = np.where(inside, ratio, -np.inf)
    channel, place = np.unravel_index(int(np.argmax(shown)), shown.shape)
    p_value = float(chance[channel, place])
    if p_value >= error_rate:
        return LineSearch(None, limit)
    around = np.log(power[channel, place - 1 : place + 2])
    bend = around[0] - 2.0 * around[1] + around[2]
    shift = 0.5 * (around[0] - around[2]) / bend if bend < 0.0 else 0.0
    at = float(frequency[place] + shift / (size * step))
    amplitude, deviation, worth = _measured(usable, at)
    own = chance[:, place - 1 : place + 2].min(axis=1) < error_rate
    line = Line(at, amplitude, deviation, own, min(1.0, p_value), worth, step)
    return LineSearch(line, limit)


def _limit(segments: Sequence[RestSegment], moving: NDArray[np.bool_], threshold: float) -> float:
    """Amplitude in the quietest of the moving channels that passes a threshold nine times in ten.

    Under a Hann window a line of amplitude a over n samples of noise s has a^2 n / (6 s^2)
    times the power of the noise at its frequency.
    """
    unit = np.mean([
        segment.values.shape[1] / (6.0 * _detrended(segment.values[moving]).var(axis=1))
        for segment in segments], axis=0).max()
    beyond = max(threshold - 1.0, 0.0)
    beyond += POWER_QUANTILE * np.sqrt((1.0 + 2.0 * beyond) / len(segments))
    return float(np.sqrt(beyond / unit))


def _ratios(segments: Sequence[RestSegment], size: int) -> tuple[Array, Array, float]:
    """Summed power (C, F), power over the local level (C, F), and its degrees of freedom."""
    powers, relative = [], []
    for segment in segments:
        count = segment.values.shape[1]
        power = np.abs(np.fft.rfft(_detrended(segment.values) * np.hanning(count), size)) ** 2
        width = 2 * int(np.ceil(NEIGHBOURS * WINDOW_WIDTH * size / count)) + 1
        level = median_filter(power, (1, width), mode='mirror') / np.log(2.0)
        level = np.maximum(level, 1e-300)
        powers.append(power / level.mean(axis=1, keepdims=True))
        relative.append(power / level)
    freedom = 2.0 * NEIGHBOURS * len(segments)
    return np.sum(powers, axis=0), np.mean(relative, axis=0), freedom


def _detrended(values: Array) -> Array:
    """Values (C, n) minus their straight line."""
    place = np.linspace(-1.0, 1.0, values.shape[1])
    level = values - values.mean(axis=1, keepdims=True)
    return np.asarray(level - np.outer(level @ place / (place @ place), place))


def turns(segment: RestSegment, frequency: float) -> Array:
    """Cosine and sine (n, 2) at a frequency."""
    phase = 2.0 * np.pi * frequency * segment.step * np.arange(segment.values.shape[1])
    return np.column_stack([np.cos(phase), np.sin(phase)])


def _measured(segments: Sequence[RestSegment], frequency: float) -> tuple[Array, Array, float]:
    """Amplitudes (C,) minus their bias by noise, their deviations (C,), and the delta BIC."""
    channels = segments[0].values.shape[0]
    total, noise, worth, weight = np.zeros(channels), np.zeros(channels), 0.0, 0
    for segment in segments:
        count = segment.values.shape[1]
        values = _detrended(segment.values)
        parts, left = _fitted(values, turns(segment, frequency))
        total += count * (parts**2).sum(axis=0) - 4.0 * left
        noise += count * left
        weight += count
        gain = np.log(np.maximum((values**2).mean(axis=1), 1e-300) / np.maximum(left, 1e-300))
        worth += float(count * gain.sum() - 2.0 * channels * np.log(count))
    amplitude = np.sqrt(np.maximum(total / weight, 0.0))
    return amplitude, np.sqrt(2.0 * noise) / weight, worth


def amplitudes(segment: RestSegment, frequency: float) -> tuple[Array, Array]:
    """Amplitude (C,) of a line in one stretch, and its standard deviation (C,)."""
    parts, left = _fitted(_detrended(segment.values), turns(segment, frequency))
    return np.hypot(*parts), np.sqrt(2.0 * left / segment.values.shape[1])


def _fitted(values: Array, swings: Array) -> tuple[Array, Array]:
    """Cosine and sine (2, C) of each channel of values (C, n), and the mean square left (C,)."""
    parts = np.linalg.lstsq(swings, values.T, rcond=None)[0]
    return parts, ((values.T - swings @ parts) ** 2).mean(axis=0)


def line_gain(segments: Sequence[RestSegment], frequency: float, amplitude: Array) -> float:
    """1 - rms without / rms with the line, its phase free, over the channels with the line."""
    before = after = 0.0
    having = amplitude > 0.0
    for segment in segments:
        values, swings = _detrended(segment.values[having]), turns(segment, frequency)
        parts = np.linalg.lstsq(swings, values.T, rcond=None)[0]
        size = np.maximum(np.hypot(*parts), 1e-300)
        left = values.T - swings @ (parts * (amplitude[having] / size))
        before += float((values**2).sum())
        after += float((left**2).sum())
    return max(0.0, 1.0 - float(np.sqrt(after / max(before, 1e-300))))
