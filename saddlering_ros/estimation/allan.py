"""Allan variances, and the mixture of white noise and relaxations that fits them best.

The Allan variance (half the mean square difference of neighbouring means over m samples) needs no
mean, and its growth with m shows slow noise of any kind. Allan, Proc. IEEE 54 (1966) 221.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from saddlering_ros.estimation.process import mean_correlation, mean_variance

Array = NDArray[np.float64]

MIN_PAIRS = 4
"""Smallest number of differences in an Allan variance that is used."""


def allan_of_relaxation(ratio: Array) -> Array:
    """Allan variance of unit OU noise at `ratio` time constants."""
    exact = mean_variance(ratio) - mean_correlation(ratio) ** 2
    return np.asarray(np.maximum(exact, ratio / 3.0 * np.exp(-ratio) * 1e-6))


def mixture(columns: Array, seen: Array, pairs: Array) -> Array:
    """Non-negative parts whose statistics fit the observed ones best, in relative terms."""
    if not seen.any():
        return np.zeros(columns.shape[1])
    floor = max(float(seen.max()) * 1e-9, np.finfo(float).tiny)
    target = np.maximum(seen, floor)
    unit = np.maximum(columns.max(axis=0), np.finfo(float).tiny)
    weight = np.sqrt(pairs) / target
    for _ in range(4):
        solution, _ = nnls(columns / unit * weight[:, None], target * weight)
        fitted = np.maximum(columns @ (solution / unit), floor)
        weight = np.sqrt(pairs) / np.maximum(fitted, 0.2 * target)
    return np.asarray(solution / unit)


def allan_columns(scales: Array, time_constants: Array) -> Array:
    """Allan variances (S, 1 + T) of unit white density and of each unit relaxation."""
    slow = [allan_of_relaxation(scales / tau) for tau in time_constants]
    return np.column_stack([1.0 / scales, *slow])


def allan_variances(rows: Sequence[tuple[Array, float]]) -> tuple[Array, Array, Array]:
    """Averaging times [s], Allan variances, and the number of differences in each.

    Each of `rows` is (values (N,), step [s]).
    """
    sums: dict[float, list[float]] = {}
    for row, step in rows:
        total = running_total(row)
        for count in averaged_counts(row.size):
            differences = row.size // count - 1
            entry = sums.setdefault(float(f'{count * step:.3g}'), [0.0, 0.0])
            entry[0] += differences * allan_variance(total, count)
            entry[1] += differences
    scales = np.array(sorted(scale for scale, entry in sums.items() if entry[1] >= MIN_PAIRS))
    allan = np.array([sums[scale][0] / sums[scale][1] for scale in scales])
    return scales, allan, np.array([sums[scale][1] for scale in scales])


def averaged_counts(size: int) -> list[int]:
    """Numbers of averaged values out of `size`: two per octave, up to half of them."""
    octaves = np.arange(0.0, 2.0 * np.log2(max(2.0, 0.5 * size)) + 1e-9)
    return [int(count) for count in np.unique(np.round(2.0 ** (0.5 * octaves)))
            if size // count >= 2]


def running_total(values: Array) -> Array:
    """Sums (N + 1,) of the first values of (N,)."""
    return np.concatenate([[0.0], np.cumsum(values)])


def allan_variance(total: Array, count: int) -> float:
    """Allan variance of means over `count` values, from every start, of a running total."""
    return float(allan_variances_of(total[None], count)[0])


def allan_variances_of(totals: Array, count: int) -> Array:
    """The same (rows,) of running totals (rows, N)."""
    means = (totals[:, count:] - totals[:, :-count]) / count
    return np.asarray(0.5 * np.mean((means[:, count:] - means[:, :-count]) ** 2, axis=1))
