"""Noise of the displacement channels, slow wander included, without asking the ring's model.

It is taken as a sum of processes with exponential autocorrelation, r(t) = sum a_j exp(-t / tau_j),
a_j >= 0, tau_j from nought (white) to seconds. The a_j are fitted to the Allan variance, half the
mean square difference of the means of neighbouring blocks, which does not care that the mean of a
stretch is unknown; long blocks average the white part away and show the slow part that makes the
error of a mean. Source: D. W. Allan, Statistics of atomic frequency standards, Proc. IEEE 54
(1966) 221.

The parity of the radial probes is nought for a rigid ring, whatever its contact does: where it is
noise alone, it shows the slow part over the whole record. The stretches at rest, less what the
load's own movement explains, give each channel's size, and everything where the parity moves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

Array = NDArray[np.float64]

FAST_TIMES = (0.01, 0.03, 0.1, 0.3)
SLOW_TIMES = (1.0, 2.0, 4.0, 8.0)
"""Time constants [s] a noise may have beside white."""

MODEL_ERROR = 0.02
SHORT_MODEL_ERROR = 0.2
"""Relative error of the model itself; readings interpolated between stamps share neighbours."""

LONGEST_BLOCK = 2.5 * SLOW_TIMES[-1]
"""Longest block [s] of a parity that is looked at."""

COMPARED_SIZES = np.array([4, 8])
"""Blocks [samples] over which a channel's noise is compared with the parity's: longer than what
interpolation between stamps smooths, shorter than any movement of a ring at rest."""

MOST_RATIO = 10.0
"""A channel that much quieter or noisier (variance) than the parity is read by another kind."""

MOST_GROWTH = 2.0
"""The parity is noise alone if its Allan variance over the record is at most that many times what
it is at rest, and grows at most that much faster than a random walk's."""

SMALLEST_NOISE = 1e-9
"""Noise assumed where a record shows less [m, or rad]: one nanometre."""


@dataclass(frozen=True)
class ChannelNoise:
    """One channel on a grid of `interval` [s]: white variance, and variances of times [s]."""

    interval: float
    white: float
    times: Array
    variances: Array

    def autocovariance(self, lags: int) -> Array:
        """Autocovariance at lags 0..lags-1 of the grid, shape (lags,)."""
        covariance = self.at(np.asarray(self.interval * np.arange(lags), dtype=np.float64))
        covariance[0] += self.white
        return covariance

    def at(self, separation: Array) -> Array:
        """Covariance of the coloured part at separations [s]."""
        decay = np.exp(-np.asarray(separation)[..., None] / self.times)
        return np.asarray(decay @ self.variances)

    def variance_of_mean(self, samples: int) -> float:
        """Variance of the mean of `samples` successive grid values."""
        count = max(1, samples)
        weights = 2.0 * (1.0 - np.arange(count) / count)
        weights[0] = 1.0
        return float(weights @ self.autocovariance(count) / count)

    def covariance_of_means(self, centres: Array, samples: Sequence[int]) -> Array:
        """Covariance (M, M) of means of `samples` grid values about the times `centres` [s]."""
        lasting = self.interval * np.asarray(samples, dtype=np.float64)
        start, stop = centres - 0.5 * lasting, centres + 0.5 * lasting
        integral = (self._twice_integrated(stop[:, None] - start)
                    - self._twice_integrated(stop[:, None] - stop)
                    - self._twice_integrated(start[:, None] - start)
                    + self._twice_integrated(start[:, None] - stop))
        covariance = integral / np.outer(lasting, lasting)
        np.fill_diagonal(covariance, [self.variance_of_mean(count) for count in samples])
        return np.asarray(covariance)

    def _twice_integrated(self, separation: Array) -> Array:
        """Second antiderivative of `at` at separations [s] of either sign."""
        apart = np.abs(separation)[..., None]
        return np.asarray(
            (self.times**2 * np.exp(-apart / self.times) + self.times * apart) @ self.variances)

    @property
    def standard_deviation(self) -> float:
        """Standard deviation of one grid value."""
        return float(np.sqrt(self.white + self.variances.sum()))


@dataclass(frozen=True)
class NoiseModel:
    """Noise of delta_x, delta_y, gamma on a grid: a process each, correlation of the channels."""

    channels: tuple[ChannelNoise, ...]
    correlation: Array


def fit_channel(segments: Sequence[Array], interval: float) -> ChannelNoise:
    """Noise of one channel from segments (n_i,) at rest, sampled every `interval` [s]."""
    return fit_noise([segment[None, :] for segment in segments], interval).channels[0]


@dataclass(frozen=True)
class ParityNoise:
    """Parities that are noise alone: their values (1, N_i) on the grid, over whole records.

    ratios (C,): variance of each channel's noise over that of the parity's.
    """

    values: Sequence[Array]
    ratios: Array


def fit_noise(
    segments: Sequence[Array], interval: float, slow: NoiseModel | None = None,
    parity: ParityNoise | None = None, samples: int = 1,
) -> NoiseModel:
    """Noise model from segments (C, n_i) at rest, sampled every `interval` [s].

    All channels share the time constants and their proportions, being read by probes of one kind;
    each has its own size. parity: where given, these are read from it. slow: noise of the same
    channels read from longer records; its slow part is taken over. samples: readings averaged in
    a value.
    """
    known = _known(slow, len(segments[0]))
    seen = (_from_rests(segments, interval, known) if parity is None
            else _from_parity(parity, interval, known))
    candidates = FAST_TIMES + (SLOW_TIMES if slow is None else ())
    free = np.array([t for t in candidates if interval < t <= 1.5 * interval * seen.longest])
    design = np.column_stack([1.0 / seen.sizes, _of_unit(seen.sizes, interval, free)])
    amounts = _fitted(design, seen.shape, seen.sizes * samples, seen.freedom)
    times = np.concatenate([free, SLOW_TIMES if slow is not None else ()])
    channels = tuple(
        ChannelNoise(
            interval, max(float(size * amounts[0]), SMALLEST_NOISE**2), times,
            np.concatenate([size * amounts[1:], taken]),
        )
        for size, taken in zip(seen.scale, known, strict=True)
    )
    return NoiseModel(channels, _correlation(segments, -(-int(COMPARED_SIZES[-1]) // samples)))


@dataclass(frozen=True)
class _Seen:
    """Allan variance `shape` (L,) at block `sizes` (L,) with its degrees of freedom (L,).

    It is what `scale` (C,) of each channel makes its own; longest: grid values in what was seen.
    """

    sizes: NDArray[np.int64]
    shape: Array
    freedom: Array
    scale: Array
    longest: int


def fit_common(
    first: Sequence[Array], second: Sequence[Array], weights: Sequence[float], interval: float
) -> ChannelNoise:
    """Noise that pairs of segments (n_i,) have in common, each pair weighing `weights`.

    From the Allan covariance: what is in one alone does not count. Segments of seconds hardly tell
    a slow time constant, so each of SLOW_TIMES counts by its likelihood.
    """
    sums = [a + b for a, b in zip(first, second, strict=True)]
    differences = [a - b for a, b in zip(first, second, strict=True)]
    longest = max(len(segment) for segment in first)
    sizes = np.unique(np.geomspace(1, max(1, longest // 2), 14).astype(np.int64))
    parts = [
        [_allan_variance([one[None, :]], sizes) for one in kind]
        for kind in (sums, differences, first, second)
    ]
    pairs = np.array([count for _, count in parts[0]])
    share = np.asarray(weights)[:, None] * pairs
    seen = share.sum(axis=0) > 0.0
    share = share[:, seen] / share[:, seen].sum(axis=0)
    of_sum, of_difference, own, other = (
        np.einsum('sl,sl->l', share, np.array([found[0, seen] for found, _ in kind]))
        for kind in parts
    )
    common, sizes = 0.25 * (of_sum - of_difference), sizes[seen]
    freedom = np.maximum(pairs.sum(axis=0)[seen] / sizes, 0.5)
    error = np.maximum(np.sqrt((own * other + common**2) / freedom), 1e-300)
    columns = _of_unit(sizes, interval, np.array(SLOW_TIMES))
    amounts, likelihood = np.zeros((len(SLOW_TIMES), 2)), np.zeros(len(SLOW_TIMES))
    for place, column in enumerate(columns.T):
        design = np.column_stack([1.0 / sizes, column]) / error[:, None]
        amounts[place], misfit = nnls(design, common / error)
        likelihood[place] = -0.5 * misfit**2
    likelihood = np.exp(likelihood - likelihood.max())
    likelihood /= likelihood.sum()
    return ChannelNoise(interval, float(likelihood @ amounts[:, 0]), np.array(SLOW_TIMES),
                        likelihood * amounts[:, 1])


def _known(slow: NoiseModel | None, channels: int) -> Array:
    """Slow variances (C, J) taken over; J is nought where there are none."""
    if slow is None:
        return np.zeros((channels, 0))
    return np.array([
        [one.variances[one.times == time].sum() for time in SLOW_TIMES] for one in slow.channels
    ])


def _from_rests(segments: Sequence[Array], interval: float, known: Array) -> _Seen:
    longest = max(segment.shape[1] for segment in segments)
    sizes, measured, pairs = _at_sizes(segments, longest // 2)
    taken = _of_unit(sizes, interval, np.array(SLOW_TIMES[: known.shape[1]]))
    measured = np.maximum(measured - known @ taken.T, 0.0)
    scale = np.maximum(_size_of(measured, sizes, pairs), SMALLEST_NOISE**2)
    shape = np.mean(measured / scale[:, None], axis=0)
    return _Seen(sizes, shape, len(scale) * pairs / sizes, scale, longest)


def _from_parity(parity: ParityNoise, interval: float, known: Array) -> _Seen:
    whole = max(values.shape[1] for values in parity.values)
    longest = min(int(2.0 * LONGEST_BLOCK / interval), whole // 4)
    sizes, measured, pairs = _at_sizes(parity.values, longest // 2)
    taken = _of_unit(sizes, interval, np.array(SLOW_TIMES[: known.shape[1]]))
    own = np.mean(known / parity.ratios[:, None], axis=0)
    shape = np.maximum(measured[0] - taken @ own, 0.0)
    return _Seen(sizes, shape, pairs / sizes, parity.ratios, longest)


def parity_ratios(
    parities: Sequence[Array], rests: Sequence[Array], segments: Sequence[Array]
) -> Array | None:
    """Variance of each channel's noise over the parity's, shape (C,); None if the parity moves.

    parities (1, N_i) of whole records sampled alike, rests (1, n_i): their stretches at rest;
    segments (C, n_i): all channels there.
    """
    if not segments:
        return None
    whole, _ = _allan_variance(parities, COMPARED_SIZES)
    channels, pairs = _allan_variance(segments, COMPARED_SIZES)
    if not np.all(pairs > 0) or not np.all(whole > 0.0):
        return None
    ratios = np.mean(channels / whole, axis=1)
    if np.any(ratios < 1.0 / MOST_RATIO) or np.any(ratios > MOST_RATIO):
        return None
    sizes, at_rest, pairs = _at_sizes(rests, max(rest.shape[1] for rest in rests) // 2)
    sure = pairs >= 10 * sizes
    sizes, at_rest = sizes[sure], at_rest[0, sure]
    if not len(sizes):
        return None
    whole, _ = _allan_variance(parities, sizes)
    wide, grown, _ = _at_sizes(parities, max(parity.shape[1] for parity in parities) // 8)
    walk = whole[0, -1] * np.maximum(wide / sizes[-1], 1.0)
    moved = np.any(whole[0] > MOST_GROWTH * at_rest) or np.any(
        grown[0, wide > sizes[-1]] > MOST_GROWTH * walk[wide > sizes[-1]])
    return None if moved else np.asarray(ratios)


def _at_sizes(segments: Sequence[Array], largest: int) -> tuple[NDArray[np.int64], Array, Array]:
    """Block sizes (L,) up to `largest` that have pairs, Allan variance (C, L), pairs (L,)."""
    sizes = np.unique(np.geomspace(1, max(1, largest), 14).astype(np.int64))
    measured, pairs = _allan_variance(segments, sizes)
    return sizes[pairs > 0], measured[:, pairs > 0], pairs[pairs > 0]


def _size_of(measured: Array, sizes: NDArray[np.int64], pairs: Array) -> Array:
    """Level of each channel's Allan variance (C,), from all block sizes by what they weigh."""
    weight = pairs / sizes
    return np.asarray((measured * sizes) @ weight / weight.sum())


def _fitted(
    design: Array, measured: Array, samples: NDArray[np.int64], freedom: Array
) -> Array:
    """Amounts >= 0 with design @ amounts = measured, each row weighted by its relative error.

    That is of the model, not of the measured value, which may be small by chance alone: hence the
    repeated fits, from white noise on.
    """
    own = np.where(samples < 4, SHORT_MODEL_ERROR, MODEL_ERROR)
    error = np.sqrt(1.0 / np.maximum(freedom, 0.5) + own**2)
    expected = measured[0] * design[:, 0]
    amounts = np.zeros(design.shape[1])
    for _ in range(6):
        weight = 1.0 / (error * np.maximum(expected, 1e-300))
        amounts, _ = nnls(design * weight[:, None], measured * weight)
        expected = np.maximum(design @ amounts, 0.1 * measured[0] * design[:, 0])
    return np.asarray(amounts)


def _allan_variance(
    segments: Sequence[Array], sizes: NDArray[np.int64]
) -> tuple[Array, Array]:
    """Overlapping Allan variance (C, L) at block sizes, and how many pairs it is from (L,)."""
    total, pairs = np.zeros((len(segments[0]), len(sizes))), np.zeros(len(sizes))
    for segment in segments:
        centred = segment - segment.mean(axis=1, keepdims=True)
        sums = np.concatenate([np.zeros((len(segment), 1)), np.cumsum(centred, axis=1)], axis=1)
        for place, size in enumerate(sizes):
            if 2 * size > segment.shape[1]:
                break
            means = (sums[:, size:] - sums[:, :-size]) / size
            difference = means[:, size:] - means[:, :-size]
            total[:, place] += 0.5 * np.sum(difference**2, axis=1)
            pairs[place] += difference.shape[1]
    return total / np.maximum(pairs, 1.0), pairs


def _means_of(values: Array, size: int) -> Array:
    """Means (C, n // size) of successive `size` values."""
    count = values.shape[1] // size
    return np.asarray(values[:, :count * size].reshape(len(values), count, size).mean(axis=2))


def _of_unit(sizes: NDArray[np.int64], interval: float, times: Array) -> Array:
    """Allan variance (L, J) at block sizes of unit variance with time constants [s].

    2 (v(m) - v(2 m)) with v(m) the variance of a mean of m.
    """
    table = np.empty((len(sizes), len(times)))
    for column, time in enumerate(times):
        one = ChannelNoise(interval, 0.0, np.array([time]), np.ones(1))
        for row, size in enumerate(sizes):
            table[row, column] = 2.0 * (
                one.variance_of_mean(int(size)) - one.variance_of_mean(2 * int(size))
            )
    return table


def _correlation(segments: Sequence[Array], size: int) -> Array:
    """Correlation of the channels' steps between means of `size` values; if significant.

    From value to value it would be that of interpolation between stamps: of two probes, the one
    whose stamps lie between those of the load seems the quieter.
    """
    steps = np.concatenate([np.diff(_means_of(segment, size), axis=1) for segment in segments],
                           axis=1)
    scale = np.sqrt(np.mean(steps**2, axis=1))
    standard = steps / np.where(scale > 0.0, scale, 1.0)[:, None]
    correlation = standard @ standard.T / max(1, standard.shape[1])
    noticeable = np.abs(correlation) > 4.0 / np.sqrt(max(1, standard.shape[1]))
    correlation = np.where(noticeable, np.clip(correlation, -0.95, 0.95), 0.0)
    np.fill_diagonal(correlation, 1.0)
    if np.linalg.eigvalsh(correlation)[0] < 1e-3:
        return np.eye(len(correlation))
    return np.asarray(correlation)
