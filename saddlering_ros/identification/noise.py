"""Noise of the three displacement channels from stretches at rest, as an autoregressive process.

Each channel at rest, less what the load's own movement explains, is an AR(p) process (p <= 6 by
BIC, Yule-Walker equations); the innovations of the channels share one correlation matrix. The
means taken from short stretches hide part of the slow noise: their variance is put back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter

Array = NDArray[np.float64]

LONGEST_MEMORY = 6
"""Highest order of the autoregression, in samples of the grid."""

SMALLEST_NOISE = 1e-9
"""Noise assumed where a record shows less [m, or rad at a metre]: one nanometre."""


@dataclass(frozen=True)
class ChannelNoise:
    """One channel's AR process: coefficients (p,) and innovation variance."""

    coefficients: Array
    innovation_variance: float

    def autocovariance(self, lags: int) -> Array:
        """Autocovariance at lags 0..lags-1, shape (lags,)."""
        order = len(self.coefficients)
        first = _starting_autocovariance(self.coefficients, self.innovation_variance)
        covariance = np.zeros(max(lags, order + 1))
        covariance[: order + 1] = first
        for lag in range(order + 1, len(covariance)):
            covariance[lag] = self.coefficients @ covariance[lag - order : lag][::-1]
        return covariance[:lags]

    def variance_of_mean(self, samples: int) -> float:
        """Variance of the mean of `samples` successive grid values."""
        return _variance_of_mean(self.autocovariance(max(1, samples)), max(1, samples))

    @property
    def standard_deviation(self) -> float:
        """Standard deviation of one grid value."""
        return float(np.sqrt(self.autocovariance(1)[0]))


@dataclass(frozen=True)
class NoiseModel:
    """Noise of delta_x, delta_y, gamma on a grid: one process each, correlation of innovations."""

    channels: tuple[ChannelNoise, ...]
    correlation: Array
    samples: int

    def pick(self, channels: Sequence[int]) -> NoiseModel:
        """The same noise for some of the channels."""
        index = list(channels)
        return NoiseModel(
            tuple(self.channels[channel] for channel in index),
            self.correlation[np.ix_(index, index)],
            self.samples,
        )


def _starting_autocovariance(coefficients: Array, innovation_variance: float) -> Array:
    """Autocovariance at lags 0..p of an AR process, from the Yule-Walker equations."""
    order = len(coefficients)
    if order == 0:
        return np.array([innovation_variance])
    system = np.eye(order + 1)
    for row in range(order + 1):
        for lag in range(1, order + 1):
            system[row, abs(row - lag)] -= coefficients[lag - 1]
    right = np.zeros(order + 1)
    right[0] = innovation_variance
    return np.asarray(np.linalg.solve(system, right))


def _variance_of_mean(autocovariance: Array, samples: int) -> float:
    weights = 1.0 - np.arange(samples) / samples
    covariance = autocovariance[:samples]
    return float((covariance[0] + 2.0 * np.sum(weights[1:] * covariance[1:])) / samples)


def _pooled_autocovariance(segments: Sequence[Array], lags: int) -> Array:
    """Autocovariance of mean-free segments, pooled, at lags 0..lags-1."""
    total = np.zeros(lags)
    count = np.zeros(lags)
    for segment in segments:
        values = segment - segment.mean()
        for lag in range(min(lags, len(values))):
            total[lag] += values[: len(values) - lag] @ values[lag:]
            count[lag] += len(values) - lag
    return np.asarray(total / np.maximum(count, 1.0))


def fit_channel(segments: Sequence[Array], smallest: float = SMALLEST_NOISE) -> ChannelNoise:
    """AR process of one channel from segments (n_i,) at rest; order by BIC."""
    samples = sum(len(segment) for segment in segments)
    longest = int(min(LONGEST_MEMORY, samples // 25, max(len(s) for s in segments) // 4))
    raw = _pooled_autocovariance(segments, longest + 1)
    noise = _best_order(raw, samples, smallest)
    for _ in range(3):  # the segments' means took this much of the slow noise with them
        lost = np.mean([noise.variance_of_mean(len(segment)) for segment in segments])
        noise = _best_order(raw + min(float(lost), 0.5 * raw[0]), samples, smallest)
    return noise


def _best_order(autocovariance: Array, samples: int, smallest: float) -> ChannelNoise:
    floor = smallest**2
    if autocovariance[0] <= floor:
        return ChannelNoise(np.zeros(0), floor)
    best = ChannelNoise(np.zeros(0), float(autocovariance[0]))
    best_score = samples * np.log(autocovariance[0])
    for order in range(1, len(autocovariance)):
        coefficients = solve_toeplitz(autocovariance[:order], autocovariance[1 : order + 1])
        variance = float(autocovariance[0] - coefficients @ autocovariance[1 : order + 1])
        if variance <= 1e-6 * autocovariance[0] or not _is_stable(coefficients):
            break
        score = samples * np.log(variance) + order * np.log(samples)
        if score < best_score:
            best, best_score = ChannelNoise(np.asarray(coefficients), variance), score
    return best


def _is_stable(coefficients: Array) -> bool:
    roots = np.roots(np.concatenate([[1.0], -coefficients]))
    return bool(np.all(np.abs(roots) < 0.999))


def fit_noise(segments: Sequence[Array], smallest: Sequence[float]) -> NoiseModel:
    """Noise model from segments (C, n_i) at rest; `smallest` (C,) is the least noise of each."""
    channels = tuple(
        fit_channel([segment[channel] for segment in segments], smallest[channel])
        for channel in range(len(smallest))
    )
    innovations = np.concatenate(
        [_innovations(segment, channels) for segment in segments], axis=1
    )
    scale = np.sqrt(np.mean(innovations**2, axis=1))
    standard = innovations / np.where(scale > 0.0, scale, 1.0)[:, None]
    correlation = standard @ standard.T / max(1, standard.shape[1])
    correlation[np.diag_indices_from(correlation)] = 1.0
    noticeable = np.abs(correlation) > 3.0 / np.sqrt(max(1, standard.shape[1]))
    correlation = np.where(noticeable, np.clip(correlation, -0.95, 0.95), 0.0)
    correlation[np.diag_indices_from(correlation)] = 1.0
    if np.linalg.eigvalsh(correlation)[0] < 1e-3:
        correlation = np.eye(len(correlation))
    return NoiseModel(channels, correlation, sum(segment.shape[1] for segment in segments))


def _innovations(segment: Array, channels: Sequence[ChannelNoise]) -> Array:
    values = segment - segment.mean(axis=1, keepdims=True)
    return np.stack(
        [
            lfilter(np.concatenate([[1.0], -noise.coefficients]), [1.0], row)
            for noise, row in zip(channels, values, strict=True)
        ]
    )
