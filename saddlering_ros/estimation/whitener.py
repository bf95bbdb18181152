"""Residuals whitened by a noise process in O(N): even and uneven samples, block means, gaps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.estimation import whitening_kernels as kernels
from saddlering_ros.estimation.errors import EstimationError
from saddlering_ros.estimation.process import (
    ChannelNoise,
    mean_correlation,
    mean_variance,
)

Array = NDArray[np.float64]

OVERLAP = 0.1
"""Largest overlap of neighbouring blocks, as a share of a block, by jitter of stamps."""


@dataclass(frozen=True)
class Whitener:
    """Cholesky factor L of a noise covariance, as its N x (4 T + 1) numbers.

    `whiten` applies L^-1 and `colour` applies L. The result equals that of the dense factor to
    rounding.
    """

    ahead: Array
    gaps: Array
    inside: Array
    pivots: Array
    gains: Array

    @property
    def present(self) -> Array:
        """Mask (N,) of the samples that are present."""
        return np.asarray(np.isfinite(self.pivots))

    def whiten(self, columns: Array) -> Array:
        """L^-1 times columns (N, B) or (N,); 0 where a sample is missing."""
        return self._applied(kernels.whiten, columns)

    def whiten_in_place(self, columns: Array) -> None:
        """`whiten` of a contiguous array (N, B), which is overwritten."""
        kernels.whiten(self.ahead, self.gaps, self.inside, self.pivots, self.gains, columns)

    def colour(self, columns: Array) -> Array:
        """L times columns (N, B) or (N,); 0 where a sample is missing."""
        return self._applied(kernels.colour, columns)

    def _applied(self, kernel, columns: Array) -> Array:  # type: ignore[no-untyped-def]
        matrix = np.array(columns, dtype=np.float64, order='C', ndmin=2)
        if columns.ndim == 1:
            matrix = np.ascontiguousarray(matrix.T)
        kernel(self.ahead, self.gaps, self.inside, self.pivots, self.gains, matrix)
        return matrix if columns.ndim == 2 else matrix[:, 0]


def build_whitener(
    noise: ChannelNoise,
    time: Array,
    width: Array,
    hold: Array | None = None,
    present: Array | None = None,
    jitter: float = 0.0,
) -> Whitener:
    """Whitener of means over `width` (N,) about `time` (N,) [s], in order of time.

    hold (N,) numbers the levels at which a coarse converter keeps its part of the noise; a level
    that returns later counts as another one. present (N,) is 0 where a sample is missing. jitter
    [unit^2] is added to every variance.
    """
    if np.any(np.diff(time) < 0.0):
        raise EstimationError('noise: the samples of a run must be in order of time')
    parts = noise.parts()
    variance = np.array([item[0] for item in parts])
    tau = np.array([item[1] for item in parts])
    ratio = width[:, None] / tau
    edge = mean_correlation(ratio)
    own = noise.white / width + noise.floor + jitter
    own = own + mean_variance(ratio) @ variance
    gap = np.diff(time, prepend=time[0]) - 0.5 * (width + np.append(width[0], width[:-1]))
    # Blocks may overlap by the jitter of their stamps; distances along the run stay exact.
    gap = np.maximum(gap, -OVERLAP * np.minimum(width, np.append(width[0], width[:-1])))
    gaps = np.exp(-gap[:, None] / tau)
    inside = np.exp(-ratio)
    ahead, behind = variance * edge, edge
    if noise.held > 0.0:
        own = own + noise.held
        stays = _same_level(hold, time.size)
        ones = np.ones((time.size, 1))
        ahead, behind = np.hstack([ahead, noise.held * ones]), np.hstack([behind, ones])
        gaps, inside = np.hstack([gaps, stays[:, None]]), np.hstack([inside, ones])
    there = np.ones(time.size) if present is None else present.astype(np.float64)
    pivots, gains = np.empty(time.size), np.empty_like(ahead)
    ahead, gaps, inside = (np.ascontiguousarray(item) for item in (ahead, gaps, inside))
    bad = kernels.factorise(
        own, ahead, np.ascontiguousarray(behind), gaps, inside, there, pivots, gains
    )
    if bad:
        raise EstimationError(
            f'noise: the covariance is singular at sample {bad - 1}: give the channel some white '
            'noise'
        )
    return Whitener(ahead, gaps, inside, pivots, gains)


def _same_level(hold: Array | None, count: int) -> Array:
    """1 (N,) where a sample is at the level of the one before it."""
    if hold is None:
        return np.zeros(count)
    return np.append(0.0, (np.diff(hold) == 0.0).astype(np.float64))


def independent(variances: Array) -> Whitener:
    """Whitener of independent readings of given variances (N,)."""
    none = np.zeros((variances.size, 0))
    return Whitener(none, none, none, np.ascontiguousarray(variances), none)
