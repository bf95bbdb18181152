"""Means over blocks, tails of distributions, and Allan variances.

The Allan variance (half the mean square difference of neighbouring means over m samples) needs no
mean, and its growth with m shows slow noise of any kind. Allan, Proc. IEEE 54 (1966) 221.

The tails have the formulas of `scipy.stats`, which takes a second of processor time to import.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import fdtr, fdtrc, fdtri

from saddlering_ros.estimation.process import Array, mean_correlation, mean_variance


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
    columns = [1.0 / scales]
    for tau in time_constants:
        ratio = scales / tau
        exact = mean_variance(ratio) - mean_correlation(ratio) ** 2
        columns.append(np.maximum(exact, ratio / 3.0 * np.exp(-ratio) * 1e-6))
    return np.column_stack(columns)


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


def running_total(values: Array) -> Array:
    """Sums (N + 1,) of the first values of (N,)."""
    return np.concatenate([[0.0], np.cumsum(values)])


class RowTotals:
    """Running totals of rows (n_i,), all in one array, for Allan variances over all of them."""

    def __init__(self, rows: Sequence[Array]) -> None:
        self.sizes = np.array([row.size for row in rows], dtype=np.intp)
        self._ends = np.cumsum(self.sizes)
        self._total = running_total(np.concatenate(rows))

    def weighted_variance(
        self, count: int, among: NDArray[np.bool_] | None = None
    ) -> tuple[float, int]:
        """Sum of the Allan variances of the rows, weighted by their numbers of differences.

        The second result is the number of all differences. The means are over `count` values.
        among (R,): mask of the rows used; a row shorter than two means is never used.
        """
        used = self.sizes // count >= 2
        if among is not None:
            used &= among
        if not used.any():
            return 0.0, 0
        means = (self._total[count:] - self._total[:-count]) / count
        squares = np.append((means[count:] - means[:-count]) ** 2, 0.0)
        starts = self._ends[used] - self.sizes[used]
        stops = self._ends[used] - 2 * count + 1
        sums = np.add.reduceat(squares, np.column_stack([starts, stops]).ravel())[::2]
        differences = self.sizes[used] // count - 1
        variances = 0.5 * sums / (stops - starts)
        return float(differences @ variances), int(differences.sum())

    def pooled_variance(self, count: int) -> tuple[float, int]:
        """Allan variance of all rows at means over `count` values, and its differences."""
        weighted, pairs = self.weighted_variance(count)
        return (weighted / pairs if pairs else np.nan), pairs


def allan_variances_of(totals: Array, count: int) -> Array:
    """Allan variances (rows,) of means over `count` values, from running totals (rows, N)."""
    means = (totals[:, count:] - totals[:, :-count]) / count
    return np.asarray(0.5 * np.mean((means[:, count:] - means[:, :-count]) ** 2, axis=1))
