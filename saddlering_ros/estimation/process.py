"""The noise of one channel as a process: white noise, relaxations, and a held part of a converter.

White noise, Ornstein-Uhlenbeck (OU) noise and a random walk have a closed covariance between
block means (D. T. Gillespie, Phys. Rev. E 54 (1996) 2084). A non-negative mixture of them
therefore describes noise at any spacing of samples.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.errors import SaddleringError

Array = NDArray[np.float64]

TIME_CONSTANTS = np.array([0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 40.0])
"""Time constants of the mixture [s]; the longest one represents a random walk."""


class EstimationError(SaddleringError):
    """Noise cannot be learnt from records, or records cannot be whitened."""


@dataclass(frozen=True)
class ChannelNoise:
    """Noise of one channel: white density, and variances of the slow parts."""

    white: float  # [unit^2 s]: variance of a mean over one second of white noise
    slow: Array  # (T,) [unit^2]: variances of the relaxations
    held: float  # [unit^2]: part that a coarse converter keeps at rest
    pairs: int  # independent differences behind the level: degrees of freedom of tests
    time_constants: Array = field(default_factory=lambda: TIME_CONSTANTS)  # (T,) [s]
    floor: float = 0.0  # [unit^2]: variance of every mean of its own, for any width

    def covariance(self, time: Array, width: Array, hold: Array | None = None) -> Array:
        """Covariance (N, N) of means over `width` about `time`; `hold` (N,) numbers levels.

        The covariance is exact, also for stretches that overlap.
        """
        apart = np.abs(time[:, None] - time) - 0.5 * (width[:, None] + width)
        matrix = np.zeros((time.size, time.size))
        overlap = np.nonzero(apart < -1e-9 * width)
        start, stop = time - 0.5 * width, time + 0.5 * width
        for variance, tau in self.parts():
            shrink = mean_correlation(width / tau)
            shared = np.outer(shrink, shrink) * np.exp(-np.maximum(apart, 0.0) / tau)
            # Covariance (P,) of means of unit OU noise over pairs of stretches that may overlap.
            one, other = overlap
            integral = (_twice_integrated(stop[one] - start[other], tau)
                        - _twice_integrated(stop[one] - stop[other], tau)
                        - _twice_integrated(start[one] - start[other], tau)
                        + _twice_integrated(start[one] - stop[other], tau))
            shared[overlap] = np.asarray(integral / ((stop - start)[one] * (stop - start)[other]))
            matrix += variance * shared
        if self.held > 0.0:
            same = np.eye(time.size) if hold is None else (hold[:, None] == hold[None, :])
            matrix += self.held * same
        np.fill_diagonal(matrix, self.variances(width))
        return matrix

    def parts(self) -> list[tuple[float, float]]:
        """(variance, time constant) of the relaxations with a variance."""
        pairs = zip(self.slow, self.time_constants, strict=True)
        return [(float(variance), float(tau)) for variance, tau in pairs if variance > 0.0]

    def variances(self, width: Array) -> Array:
        """Variances (N,) of means over `width` (N,) seconds."""
        total = self.white / width + self.floor + self.held
        for variance, tau in self.parts():
            total = total + variance * mean_variance(width / tau)
        return np.asarray(total)

    def since(self, time: Array, width: Array, reference: float, span: float) -> Array:
        """Standard deviation (N,) of block means minus the mean over `span` s at `reference`."""
        shared = np.zeros(time.size)
        gap = np.maximum(np.abs(time - reference) - 0.5 * (width + span), 0.0)
        for variance, tau in self.parts():
            near = mean_correlation(width / tau) * mean_correlation(np.array([span / tau]))
            shared = shared + variance * near * np.exp(-gap / tau)
        alone = self.variances(np.append(span, width))
        return np.asarray(np.sqrt(alone[1:] + alone[0] - 2.0 * shared))

    def deviation(self, width: float) -> float:
        """Standard deviation of one mean over `width` seconds."""
        return float(np.sqrt(self.variances(np.array([width]))[0]))

    def lasting(self, separation: float) -> float:
        """Covariance of two readings `separation` seconds apart [unit^2]."""
        return float(sum(variance * np.exp(-separation / tau) for variance, tau in self.parts()))

    def times(self, factor: float) -> 'ChannelNoise':
        """The same noise with `factor` times its variance."""
        return replace(self, white=factor * self.white, slow=factor * self.slow,
                       held=factor * self.held, floor=factor * self.floor)

    def of_samples(self, step: float) -> 'ChannelNoise':
        """The same noise of samples every `step` [s], which are no means of their width."""
        return replace(self, white=0.0, floor=self.floor + self.white / step)

    def with_relaxations(self, variances: Array, time_constants: Array) -> 'ChannelNoise':
        """The same noise plus relaxations of `variances` (T,) with `time_constants` (T,) [s]."""
        return replace(self, slow=np.append(self.slow, variances),
                       time_constants=np.append(self.time_constants, time_constants))

    def at_least(self, deviation: float, width: float) -> 'ChannelNoise':
        """The same noise with a scatter of `deviation` or more of means over `width` seconds."""
        least = deviation**2 * width
        return self if self.white >= least else replace(self, white=least)


def _twice_integrated(separation: Array, tau: float) -> Array:
    """Second antiderivative of exp(-|separation| / tau), of separations [s] of either sign."""
    apart = np.abs(separation)
    return np.asarray(tau**2 * np.exp(-apart / tau) + tau * apart)


def mean_correlation(ratio: Array) -> Array:
    """Covariance of the mean of unit OU noise over `ratio` time constants with its edge."""
    return np.asarray(-np.expm1(-ratio) / ratio)


def mean_variance(ratio: Array) -> Array:
    """Variance of the mean of unit OU noise over `ratio` time constants."""
    small = ratio < 1e-3
    safe = np.where(small, 1.0, ratio)
    exact = 2.0 * (safe - 1.0 + np.exp(-safe)) / safe**2
    return np.where(small, 1.0 - ratio / 3.0, exact)
