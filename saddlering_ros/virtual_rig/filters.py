"""Recursive filters over evenly spaced values, exact for inputs straight between instants."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.virtual_rig.compilation import compiled

Floats = NDArray[np.float64]


@compiled()
def recursion(values: Floats, b: Floats, a: Floats) -> Floats:
    """Filter y_n = b_0 x_n + b_1 x_(n-1) + b_2 x_(n-2) + a_1 y_(n-1) + a_2 y_(n-2).

    values (N,); b (3,) and a (2,): the coefficients, a of the outputs one and two instants back.
    """
    output = np.empty(values.shape[0])
    x1, x2, y1, y2 = 0.0, 0.0, 0.0, 0.0
    for n in range(values.shape[0]):
        x0 = values[n]
        y0 = b[0] * x0 + b[1] * x1 + b[2] * x2 + a[0] * y1 + a[1] * y2
        output[n] = y0
        x2, x1, y2, y1 = x1, x0, y1, y0
    return output


def low_pass(values: Floats, spacing: float, time_constant: float) -> Floats:
    """First-order low-pass of values (N,) `spacing` [s] apart; starts at rest."""
    if time_constant <= 0.0:
        return values
    ratio = spacing / time_constant
    keep = np.exp(-ratio)
    mean = -np.expm1(-ratio) / ratio
    moved = recursion(values - values[0], np.array([1.0 - mean, mean - keep, 0.0]),
                      np.array([keep, 0.0]))
    return np.asarray(moved + values[0])


def second_mode(values: Floats, spacing: float, frequency: float, damping: float) -> Floats:
    """Solve y'' + 2 z w y' + w^2 y = w^2 u from rest; frequency w [rad/s]."""
    from scipy.linalg import expm

    block = np.zeros((4, 4))
    block[0, 1], block[1, 0], block[1, 1] = 1.0, -frequency**2, -2.0 * damping * frequency
    block[1, 2], block[2, 3] = frequency**2, 1.0
    flow = expm(block * spacing)
    state, held, second = flow[:2, :2], flow[:2, 2], flow[:2, 3] / spacing
    first = held - second
    cross = np.array([-state[1, 1], state[0, 1]])
    numerator = np.array([second[0], first[0] + float(cross @ second), float(cross @ first)])
    trace, determinant = float(np.trace(state)), float(np.linalg.det(state))
    moved = recursion(values - values[0], numerator, np.array([trace, -determinant]))
    return np.asarray(moved + values[0])


def slow_noise(kicks: Floats, spacing: float, rms: float, time_constant: float) -> Floats:
    """Ornstein-Uhlenbeck noise (N,) from independent normal numbers (N,) of unit variance."""
    keep = float(np.exp(-spacing / time_constant))
    driven = kicks * rms * np.sqrt(1.0 - keep * keep)
    driven[0] = kicks[0] * rms
    output: Floats = recursion(driven, np.array([1.0, 0.0, 0.0]), np.array([keep, 0.0]))
    return output
