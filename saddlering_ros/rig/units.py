"""Units that engineers at the rig read (inside, all code is in SI), and limits of loads.

Every share of a limit counts from `rig.full_scale_load` of the rig file, so that a rig of 1 t and
a rig of 400 t are judged by the same shares.
"""

from collections.abc import Mapping
import math

TONNE = 1000.0 * 9.80665
"""One tonne-force [N], the step of the static test: 1000 kg at standard gravity."""

FULL_SCALE_LOAD = 25.0 * TONNE
"""Full scale of the hydraulic cylinder [N] where a rig file gives none: 25 t."""

FULL_SCALE_TIME = 0.1
"""Least time [s] in which the hydraulics change the load by full scale, where a rig file gives
none."""

FORCE_UNITS = {'t': TONNE, 'kN': 1e3}
"""Units a rig file can choose for loads on screens (`rig.force_unit`), in newtons."""

MICRO_UNITS = {'delta_x': 'µm', 'delta_y': 'µm', 'gamma': 'µrad', 'parity': 'µm'}
"""Unit in which each channel is shown: a millionth of its SI unit."""


def force_decimals(largest: float, unit: str, decimals: int = 1) -> int:
    """Decimals for loads up to `largest` [N]: `decimals` for 25 units, more for smaller loads."""
    smaller = 25.0 * FORCE_UNITS[unit] / largest if largest > 0.0 else 1.0
    return decimals + max(0, round(math.log10(smaller)))


def force_words(force: float, unit: str = 't', decimals: int = 1) -> str:
    """A force [N] in one of FORCE_UNITS: '4.9 t'."""
    return f'{force / FORCE_UNITS[unit]:.{decimals}f} {unit}'


def stiffnesses_per_millimetre(law: Mapping[str, float]) -> dict[str, float]:
    """K1 and K2 [N/mm^n] (what ADAMS users know) of a contact law by name, those that it has."""
    return {name: float(law[name] * 1e-3**law[exponent])
            for name, exponent in (('K1', 'n1'), ('K2', 'n2')) if {name, exponent} <= law.keys()}


def line_contact_stiffness(length: float = 20.0) -> float:
    """Palmgren's stiffness of one roller between two raceways [N/mm^(10/9)].

    Source: Palmgren's line contact, delta = 3.84e-5 Q^0.9 / l^0.8 per contact (mm, N); a roller
    has two contacts in series. `length` is the roller's effective length [mm].
    """
    return float((2.0 * 3.84e-5 / length**0.8) ** (-1.0 / 0.9))


IDENTIFICATION_SHARE = 0.2
"""Smallest peak of a run, as a share of full scale, that separates K and n."""

THRESHOLD_SHARE = 0.5
"""A run with a smaller peak cannot show causes that begin at higher loads."""

REST_SHARE = 0.004
"""A load is at rest while its mean stays within this share."""

REVERSAL_SHARE = 0.01
"""The load has changed direction after it has come back by this share."""

HOLD_SHARE = 0.002
"""Smaller held loads are not used: the ring may lie anywhere within its clearance."""

LEVEL_SHARE = 0.02
"""Readings whose loads differ by less than this share belong to one load level."""

SLOPE_SHARE = 1e-4
"""Step of the load over which the slope of the static response is taken."""

UNIT_MIN_SHARE, UNIT_MAX_SHARE = 0.004, 20.0
"""A record whose largest load is outside of these shares is not in newtons."""

NEGATIVE_SHARE = 0.01
"""A load that falls further below zero than this share has the wrong sign."""


class LoadLimits:
    """Limits [N] of a rig whose cylinder's full scale is `full_scale` [N], by the shares above."""

    def __init__(self, full_scale: float) -> None:
        self.full_scale = full_scale
        self.identification_min = IDENTIFICATION_SHARE * full_scale
        self.threshold_min = THRESHOLD_SHARE * full_scale
        self.rest_band = REST_SHARE * full_scale
        self.reversal_band = REVERSAL_SHARE * full_scale
        self.hold_min = HOLD_SHARE * full_scale
        self.level_step = LEVEL_SHARE * full_scale
        self.slope_step = SLOPE_SHARE * full_scale
        self.unit_min, self.unit_max = UNIT_MIN_SHARE * full_scale, UNIT_MAX_SHARE * full_scale
        self.negative_max = NEGATIVE_SHARE * full_scale
