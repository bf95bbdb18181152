"""Means over successive blocks and over spans of samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


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
