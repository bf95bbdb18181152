"""Removal of errors that whitened residuals share, for instance of a zero or a clearance.

Residuals of covariance I + A A' (A: the effect of each error of unit variance) become uncorrelated
by I - U (1 - 1/sqrt(1 + s^2)) U', where U and s are the singular vectors and values of A.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MIN_STRENGTH = 1e-3
"""Smallest effect of an error that is removed, in units of the scatter of the residuals."""

MIN_STRENGTH_OF_MANY = 0.03
"""The same limit for hundreds of errors."""


@dataclass(frozen=True)
class SharedErrors:
    """Independent errors of unit variance that residuals (n,) share.

    directions (n, k) orthonormal, strength (k,) over the residuals' own scatter; mixture (M, k):
    the part that each of the M errors has in a direction.
    """

    directions: Array
    strength: Array
    mixture: Array

    @classmethod
    def none(cls, size: int) -> SharedErrors:
        """No shared error of residuals (size,)."""
        return cls(np.zeros((size, 0)), np.zeros(0), np.zeros((0, 0)))

    @classmethod
    def of(cls, answers: Array) -> SharedErrors:
        """Shared errors of residuals with the responses (n, M) to M errors of any size."""
        left, strength, right = np.linalg.svd(answers, full_matrices=False)
        kept = strength > MIN_STRENGTH
        return cls(np.ascontiguousarray(left[:, kept]), strength[kept], right[kept].T)

    @classmethod
    def of_many(cls, answers: Array) -> SharedErrors:
        """The same for hundreds of errors, none of which is thousands of times the noise."""
        variance, mixture = np.linalg.eigh(answers.T @ answers)
        kept = variance > MIN_STRENGTH_OF_MANY**2
        strength, mixture = np.sqrt(variance[kept]), mixture[:, kept]
        return cls(answers @ (mixture / strength), strength, mixture)

    @property
    def shrink(self) -> Array:
        """Parts (k,) of residuals along the directions that are removed."""
        return np.asarray(1.0 - 1.0 / np.sqrt(1.0 + self.strength**2))

    @property
    def dimensions(self) -> float:
        """Number of dimensions that the errors remove from the residuals."""
        return float((1.0 - (1.0 - self.shrink) ** 2).sum())

    def apply(self, columns: Array) -> Array:
        """Whitened columns (n, B) or (n,)."""
        inner = self.directions.T @ columns
        scale = self.shrink if columns.ndim == 1 else self.shrink[:, None]
        return np.asarray(columns - self.directions @ (scale * inner))

    def along(self, residual: Array) -> Array:
        """The errors along the directions (k,) that a residual (n,) makes most likely."""
        share = self.strength / (1.0 + self.strength**2)
        return np.asarray(share * (self.directions.T @ residual))

    def likely(self, residual: Array) -> Array:
        """The errors (M,) that a residual (n,) makes most likely."""
        return np.asarray(self.mixture @ self.along(residual))
