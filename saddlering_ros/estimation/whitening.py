"""Turning the correlated errors of a run's readings into uncorrelated ones, in linear time.

The errors of one channel are a stationary process (or readings of known covariance) plus one
error common to all, that of the zero: covariance R + s^2 1 1^T. With W R W^T = I and u = W 1 the
common part is removed by I - b u u^T / |u|^2, b = 1 - 1 / sqrt(1 + s^2 |u|^2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_toeplitz, solve_triangular, toeplitz
from scipy.signal import lfilter

from saddlering_ros.estimation.noise import ChannelNoise

Array = NDArray[np.float64]

LONGEST_MEMORY = 100
"""Values a process is predicted from; two seconds of the usual fit grid."""

LEAST_VARIANCE = 1e-3
"""Shared errors below this, in units of the residuals' own variance, are left in."""


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
        """For `samples` successive values of a process, with a common error of that variance.

        The process is predicted from its last LONGEST_MEMORY values (Yule-Walker equations).
        """
        order = min(LONGEST_MEMORY if noise.variances.any() else 0, samples - 1)
        covariance = noise.autocovariance(order + 1)
        coefficients = np.zeros(order)
        if order:
            coefficients = np.asarray(solve_toeplitz(covariance[:order], covariance[1:]))
        innovation = float(covariance[0] - coefficients @ covariance[1:])
        scale = np.full(samples, 1.0 / np.sqrt(innovation))
        head = _inverse_root(toeplitz(covariance[:order])) if order else np.zeros((0, 0))
        return cls._with_common(coefficients, head, scale, common)

    @classmethod
    def of_covariance(cls, covariance: Array, common: float = 0.0) -> Whitening:
        """For readings with a covariance (N, N), with a common error of that variance."""
        count = len(covariance)
        head = _inverse_root(covariance)
        return cls._with_common(np.zeros(0), head, np.ones(count), common)

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
        if order == values.shape[-1]:
            white = values @ self.head.T
        elif order:
            white = lfilter(np.concatenate([[1.0], -self.coefficients]), [1.0], values, axis=-1)
            white = white * self.scale
            white[:, :order] = values[:, :order] @ self.head.T
        else:
            white = values * self.scale
        if self.share:
            white -= self.share * (white @ self.direction)[:, None] * self.direction
        return np.asarray(white)


@dataclass(frozen=True)
class SharedErrors:
    """Errors that residuals share, uncorrelated but for them: covariance I + A^T A becomes I.

    directions (k, R) orthonormal; shares (k,) of the residuals along them that are taken out;
    mixture (M, k): the errors, in their own units, that a unit along each direction speaks for.
    """

    directions: Array
    shares: Array
    mixture: Array

    @classmethod
    def of(cls, answers: Array) -> SharedErrors:
        """For residuals (R,) that answer by A (M, R) to M independent errors of unit variance."""
        variance, mixture = np.linalg.eigh(answers @ answers.T)
        noticed = variance > LEAST_VARIANCE
        size = np.sqrt(variance[noticed])
        directions = (mixture[:, noticed] / size).T @ answers
        return cls(directions, 1.0 - 1.0 / np.sqrt(1.0 + size**2),
                   mixture[:, noticed] * (size / (1.0 + size**2)))

    def apply(self, values: Array) -> Array:
        """Whitened rows (B, R) of values (B, R)."""
        return np.asarray(values - (values @ self.directions.T * self.shares) @ self.directions)

    def estimate(self, residuals: Array) -> Array:
        """The errors (M,) that residuals (R,) make most likely."""
        return np.asarray(self.mixture @ (self.directions @ residuals))


def _inverse_root(covariance: Array) -> Array:
    lower = cholesky(covariance, lower=True)
    return np.asarray(solve_triangular(lower, np.eye(len(lower)), lower=True))
