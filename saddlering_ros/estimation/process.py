"""The noise of one channel as a process, its means over blocks, and tails of distributions.

White noise, Ornstein-Uhlenbeck (OU) noise and a random walk have a closed covariance between
block means (D. T. Gillespie, Phys. Rev. E 54 (1996) 2084). A non-negative mixture of them
therefore describes noise at any spacing of samples.

The Allan variance (half the mean square difference of neighbouring means over m samples) needs no
mean, and its growth with m shows slow noise of any kind. Allan, Proc. IEEE 54 (1966) 221.

The tails have the formulas of `scipy.stats`, which takes a second of processor time to import.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import fdtr, fdtrc, fdtri

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


def block_means(values: Array, size: int) -> Array:
    """Means (..., M) of successive blocks of `size` samples along the last axis."""
    count = values.shape[-1] // size
    kept = values[..., : count * size]
    return np.asarray(kept.reshape(*values.shape[:-1], count, size).mean(axis=-1))


def span_means(values: Array, first: ArrayLike, last: ArrayLike) -> Array:
    """Means (..., B) of values (..., N) over the B spans [first, last)."""
    total = np.concatenate(
        [np.zeros((*values.shape[:-1], 1)), np.cumsum(values, axis=-1)], axis=-1)
    start, stop = np.asarray(first), np.asarray(last)
    return np.asarray((total[..., stop] - total[..., start]) / (stop - start))


def filled(values: Array) -> Array:
    """Rows (C, N) with missing values (a probe's short gap) replaced by a straight line."""
    grid = np.arange(values.shape[1])
    good = np.isfinite(values)
    return np.stack(
        [np.interp(grid, grid[seen], row[seen]) for row, seen in zip(values, good, strict=True)])


def fisher_chance(ratio: Any, between: Any, within: Any) -> Any:
    """Chance that an F-distributed ratio is larger; between, within: degrees of freedom."""
    return fdtrc(between, within, np.maximum(ratio, 0.0))


def fisher_share_below(ratio: Any, between: Any, within: Any) -> Any:
    """Chance that an F-distributed ratio is smaller than `ratio`."""
    return fdtr(between, within, np.maximum(ratio, 0.0))


def fisher_limit(chance: float, between: float, within: float) -> float:
    """Return the ratio that an F-distributed one exceeds with probability `chance`."""
    return float(fdtri(between, within, 1.0 - chance))


MIN_PAIRS = 4
"""Smallest number of differences in an Allan variance that is used."""


def allan_columns(scales: Array, time_constants: Array) -> Array:
    """Allan variances (S, 1 + T) of unit white density and of each unit relaxation."""
    ratio = scales[:, None] / time_constants
    exact = mean_variance(ratio) - mean_correlation(ratio) ** 2
    return np.column_stack([1.0 / scales, np.maximum(exact, ratio / 3.0 * np.exp(-ratio) * 1e-6)])


def allan_variances(rows: Sequence[tuple[Array, float]]) -> tuple[Array, Array, Array]:
    """Averaging times [s], Allan variances, numbers of differences of rows (values, step [s])."""
    by_step: dict[float, list[Array]] = {}
    for row, step in rows:
        by_step.setdefault(step, []).append(row)
    sums: dict[float, list[float]] = {}
    for step, alike in by_step.items():
        totals = RowTotals(alike)
        for count in averaged_counts(int(totals.sizes.max())):
            among = np.array([count in averaged_counts(size) for size in totals.sizes.tolist()])
            weighted, differences = totals.weighted_variance(count, among)
            entry = sums.setdefault(float(f'{count * step:.3g}'), [0.0, 0.0])
            entry[0] += weighted
            entry[1] += differences
    scales = np.array(sorted(scale for scale, entry in sums.items() if entry[1] >= MIN_PAIRS))
    allan = np.array([sums[scale][0] / sums[scale][1] for scale in scales])
    return scales, allan, np.array([sums[scale][1] for scale in scales])


@lru_cache(maxsize=4096)
def averaged_counts(size: int) -> tuple[int, ...]:
    """Numbers of averaged values out of `size`: two per octave, up to half of them."""
    octaves = np.arange(0.0, 2.0 * np.log2(max(2.0, 0.5 * size)) + 1e-9)
    return tuple(int(count) for count in np.unique(np.round(2.0 ** (0.5 * octaves)))
                 if size // count >= 2)


class RowTotals:
    """Running totals of rows (n_i,), all in one array, for Allan variances over all of them."""

    def __init__(self, rows: Sequence[Array]) -> None:
        self.sizes = np.array([row.size for row in rows], dtype=np.intp)
        self._ends = np.cumsum(self.sizes)
        self._total = np.concatenate([[0.0], np.cumsum(np.concatenate(rows))])

    def variances(self, count: int,
                  among: NDArray[np.bool_] | None = None) -> tuple[NDArray[np.bool_], Array]:
        """Mask (R,) of the rows used, and their Allan variances at means over `count` values.

        among (R,): mask of those that may be used; a row shorter than two means is never used.
        """
        used = self.sizes // count >= 2
        if among is not None:
            used &= among
        if not used.any():
            return used, np.zeros(0)
        means = (self._total[count:] - self._total[:-count]) / count
        squares = np.append((means[count:] - means[:-count]) ** 2, 0.0)
        starts = self._ends[used] - self.sizes[used]
        stops = self._ends[used] - 2 * count + 1
        sums = np.add.reduceat(squares, np.column_stack([starts, stops]).ravel())[::2]
        return used, 0.5 * sums / (stops - starts)

    def weighted_variance(self, count: int,
                          among: NDArray[np.bool_] | None = None) -> tuple[float, int]:
        """Sum of `variances` weighted by the numbers of differences of the rows, and their sum."""
        used, variances = self.variances(count, among)
        differences = self.sizes[used] // count - 1
        return float(differences @ variances), int(differences.sum())

    def pooled_variance(self, count: int) -> tuple[float, int]:
        """Allan variance of all rows at means over `count` values, and its differences."""
        weighted, pairs = self.weighted_variance(count)
        return (weighted / pairs if pairs else np.nan), pairs
