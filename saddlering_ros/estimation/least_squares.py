"""Bounded least squares of whitened residuals, and the covariance at its bottom."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

Array = NDArray[np.float64]
Residuals = Callable[[Array], Array]
"""From points (B, F) to whitened residuals (B, R)."""

Slopes = Callable[[Array], Array]
"""From a point (F,) to the Jacobian (R, F) of the whitened residuals."""

DIFFERENCE = 5e-4
"""Step of the central differences, in coordinates (relative for logarithmic ones)."""

AT_BOUND = 1e-4
"""A point this close to a bound, as a share of the box, lies on it."""


@dataclass(frozen=True)
class Minimum:
    """The bottom: point (F,), chi square, Jacobian (R, F), which coordinates lie on a bound."""

    point: Array
    chi_square: float
    jacobian: Array
    at_bound: NDArray[np.bool_]


def central_differences(residuals: Residuals, point: Array, low: Array, high: Array) -> Array:
    """Jacobian (R, F) at a point inside the box; all of it in one batch."""
    steps = DIFFERENCE * np.eye(len(point))
    above, below = np.minimum(point + steps, high), np.maximum(point - steps, low)
    forward, backward = np.split(residuals(np.concatenate([above, below])), 2)
    return np.asarray((forward - backward).T / np.diag(above - below))


def minimise(residuals: Residuals, start: Array, low: Array, high: Array,
             slopes: Slopes | None = None) -> Minimum:
    """Least squares inside the box from `start` (F,); central differences without `slopes`."""
    margin = 1e-9 * (high - low)
    if slopes is None:
        def slopes(point: Array) -> Array:
            return central_differences(residuals, point, low, high)
    solution = least_squares(
        lambda point: np.asarray(residuals(point[None, :])[0]),
        np.clip(start, low + margin, high - margin),
        jac=slopes,
        bounds=(low, high), x_scale='jac', ftol=1e-10, xtol=1e-9, gtol=1e-10, max_nfev=60,
    )
    point = np.asarray(solution.x)
    return Minimum(point, 2.0 * float(solution.cost), slopes(point), on_bound(point, low, high))


def on_bound(point: Array, low: Array, high: Array) -> NDArray[np.bool_]:
    """Which coordinates (F,) of a point lie on a bound of the box."""
    near = AT_BOUND * (high - low)
    return np.asarray((point - low < near) | (high - point < near))


def covariance(jacobian: Array) -> Array:
    """(J^T J)^-1 by columns of unit length; directions without effect get a huge variance."""
    length = np.linalg.norm(jacobian, axis=0)
    length = np.where(length > 0.0, length, 1e-12)
    _, singular, rows = np.linalg.svd(jacobian / length, full_matrices=False)
    singular = np.maximum(singular, 1e-9 * singular[0])
    inner = (rows.T / singular**2) @ rows
    return np.asarray(inner / np.outer(length, length))
