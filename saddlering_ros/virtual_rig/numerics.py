"""Compiled numerics of the virtual rig: recursive filters and laws of dry friction.

The filters work on evenly spaced values and are exact for inputs straight between instants. The
laws of friction are exact updates over a short travel: a state z follows a coordinate, |z| <= 1,
and the force is the limit times z. Sources: Jenkins: A. Jenkins 1962 (elastic-plastic spring);
Dahl: P. Dahl 1968, dz/dx = (1 - sgn(dx) z) / travel; LuGre: C. Canudas de Wit et al. 1995, with a
Stribeck level and viscous part; Bouc-Wen: Y.-K. Wen 1976 with n = 2 and beta = gamma = 1/2.
"""

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.compiled import Compiler

compiled = Compiler(Path(__file__).with_name('integrator.py'), Path(__file__))
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


JENKINS, DAHL, LUGRE, BOUC_WEN = 0, 1, 2, 3

LAWS = {'jenkins': JENKINS, 'dahl': DAHL, 'lugre': LUGRE, 'bouc_wen': BOUC_WEN}
"""Number of each law by the name users give."""

STRIBECK_EXCESS = 0.25
"""LuGre: static friction over sliding friction, minus 1."""


@compiled()
def follow(law: int, z: float, travel: float, presliding: float, seconds: float,
           stribeck_speed: float) -> tuple[float, float]:
    """State z after moving by `travel` in `seconds`, and its derivative by travel.

    travel and presliding share one unit [m, rad or N]; stribeck_speed is that unit per second.
    """
    if law == JENKINS:
        moved = z + travel / presliding
        if moved > 1.0:
            return 1.0, 0.0
        if moved < -1.0:
            return -1.0, 0.0
        return moved, 1.0 / presliding
    if law == BOUC_WEN:
        return _bouc_wen(z, travel / presliding, presliding)
    level = 1.0
    if law == LUGRE and seconds > 0.0:
        speed = travel / seconds / stribeck_speed
        level = 1.0 + STRIBECK_EXCESS * math.exp(-speed * speed)
    goal = level if travel >= 0.0 else -level
    fade = math.exp(-abs(travel) / (presliding * level))
    after = goal + (z - goal) * fade
    return after, abs(goal - z) * fade / (presliding * level)


@compiled()
def _bouc_wen(z: float, steps: float, presliding: float) -> tuple[float, float]:
    """dz/ds = 1 while |z| falls, 1 - z^2 while it grows, in closed form."""
    sign = 1.0 if steps >= 0.0 else -1.0
    start, left = z * sign, abs(steps)
    if start < 0.0:
        if start + left <= 0.0:
            return sign * (start + left), 1.0 / presliding
        left += start
        start = 0.0
    start = min(start, 1.0 - 1e-12)
    after = math.tanh(math.atanh(start) + left)
    return sign * after, (1.0 - after * after) / presliding


@compiled()
def hysteresis(law: int, values: Floats, presliding: float, initial: float) -> Floats:
    """State z (N,) of a friction element that follows `values` (N,)."""
    state = np.empty(values.shape[0])
    state[0] = initial
    for n in range(1, values.shape[0]):
        travel = values[n] - values[n - 1]
        state[n] = follow(law, state[n - 1], travel, presliding, 0.0, 1.0)[0]
    return state
