"""Turning the correlated errors of a run's readings into uncorrelated ones, in linear time.

The errors of one channel are an autoregressive process (or independent readings) plus one error
common to all, that of the zero: covariance R + s^2 1 1^T. With W R W^T = I and u = W 1 the
common part is removed by I - b u u^T / |u|^2, b = 1 - 1 / sqrt(1 + s^2 |u|^2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular, toeplitz
from scipy.signal import lfilter

from saddlering_ros.identification.noise import ChannelNoise

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Whitening:
    """The whitening of one channel of one run.

    coefficients (p,) of the process; head (p, p) whitens its first p readings, scale (N,) the
    innovations of the rest; direction (N,) unit vector and share b take out the common error.
    """

    coefficients: Array
    head: Array
    scale: Array
    direction: Array
    share: float

    @classmethod
    def of_process(cls, noise: ChannelNoise, samples: int, common: float) -> Whitening:
        """For `samples` successive values of a process, with a common error of that variance."""
        order = min(len(noise.coefficients), samples)
        head = np.zeros((order, order))
        if order:
            lower = cholesky(toeplitz(noise.autocovariance(order)), lower=True)
            head = solve_triangular(lower, np.eye(order), lower=True)
        scale = np.full(samples, 1.0 / np.sqrt(noise.innovation_variance))
        return cls._with_common(noise.coefficients, head, scale, common)

    @classmethod
    def of_independent(cls, variance: Array, common: float) -> Whitening:
        """For independent readings with variances (N,), with a common error of that variance."""
        nothing = np.zeros(0)
        return cls._with_common(nothing, np.zeros((0, 0)), 1.0 / np.sqrt(variance), common)

    @classmethod
    def _with_common(
        cls, coefficients: Array, head: Array, scale: Array, common: float
    ) -> Whitening:
        plain = cls(coefficients, head, scale, np.zeros(len(scale)), 0.0)
        ones = plain.apply(np.ones((1, len(scale))))[0]
        size = float(np.linalg.norm(ones))
        return cls(
            coefficients, head, scale, ones / size, 1.0 - 1.0 / np.sqrt(1.0 + common * size**2)
        )

    def apply(self, values: Array) -> Array:
        """Whitened rows (B, N) of values (B, N)."""
        order = len(self.head)
        if order:
            white = lfilter(np.concatenate([[1.0], -self.coefficients]), [1.0], values, axis=-1)
            white = white * self.scale
            white[:, :order] = values[:, :order] @ self.head.T
        else:
            white = values * self.scale
        if self.share:
            white -= self.share * (white @ self.direction)[:, None] * self.direction
        return np.asarray(white)
