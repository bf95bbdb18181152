"""Units that engineers at the rig read, and their factors to SI (inside, all code is in SI)."""

from __future__ import annotations

import math

STANDARD_GRAVITY = 9.80665
"""Standard acceleration of gravity [m/s2]."""

TONNE = 1000.0 * STANDARD_GRAVITY
"""One tonne-force [N], the step of the static test."""

FULL_SCALE_LOAD = 25.0 * TONNE
"""Full scale of the hydraulic cylinder [N] where a rig file gives none: 25 t."""

FULL_SCALE_TIME = 0.1
"""Least time [s] in which the hydraulics change the load by full scale, where a rig file gives
none."""

FORCE_UNITS = {'t': TONNE, 'kN': 1e3}
"""Units a rig file can choose for loads on screens (`rig.force_unit`), in newtons."""

MICRO_UNITS = {'delta_x': 'µm', 'delta_y': 'µm', 'gamma': 'µrad', 'parity': 'µm'}
"""Unit in which each channel is shown: a millionth of its SI unit."""

MILLIMETRE = 1e-3
"""One millimetre [m]."""


def force_decimals(largest: float, unit: str, decimals: int = 1) -> int:
    """Decimals for loads up to `largest` [N]: `decimals` for 25 units, more for smaller loads."""
    smaller = 25.0 * FORCE_UNITS[unit] / largest if largest > 0.0 else 1.0
    return decimals + max(0, round(math.log10(smaller)))


def force_words(force: float, unit: str = 't', decimals: int = 1) -> str:
    """A force [N] in one of FORCE_UNITS: '4.9 t'."""
    return f'{force / FORCE_UNITS[unit]:.{decimals}f} {unit}'


def force_range(low: float, high: float, unit: str = 't', decimals: int = 1) -> str:
    """Two forces [N] in one of FORCE_UNITS: '0.5 to 25.0 t'."""
    return f'{low / FORCE_UNITS[unit]:.{decimals}f} to {force_words(high, unit, decimals)}'


def stiffness_per_millimetre(stiffness: float, exponent: float) -> float:
    """Contact stiffness in N/mm^n (what ADAMS users know) from N/m^n."""
    return float(stiffness * MILLIMETRE**exponent)


def stiffness_per_metre(stiffness: float, exponent: float) -> float:
    """Contact stiffness in N/m^n from N/mm^n."""
    return float(stiffness / MILLIMETRE**exponent)


def line_contact_stiffness(length: float = 20.0) -> float:
    """Palmgren's stiffness of one roller between two raceways [N/mm^(10/9)].

    Source: Palmgren's line contact, delta = 3.84e-5 Q^0.9 / l^0.8 per contact (mm, N); a roller
    has two contacts in series. `length` is the roller's effective length [mm].
    """
    return float((2.0 * 3.84e-5 / length**0.8) ** (-1.0 / 0.9))
