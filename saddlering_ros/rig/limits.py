"""Limits of loads that follow from a rig's full scale: one place for all of them.

Every share below counts from `rig.full_scale_load` of the rig file, so that a rig of 1 t and a rig
of 400 t are judged by the same shares.
"""

from __future__ import annotations

from dataclasses import dataclass

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


@dataclass(frozen=True)
class LoadLimits:
    """Limits [N] of a rig whose cylinder's full scale is `full_scale` [N]."""

    full_scale: float

    @property
    def identification_min(self) -> float:
        """Load that a run must exceed to be identified from."""
        return IDENTIFICATION_SHARE * self.full_scale

    @property
    def threshold_min(self) -> float:
        """Peak load below which a diagnosis notes that thresholds cannot show."""
        return THRESHOLD_SHARE * self.full_scale

    @property
    def rest_band(self) -> float:
        """Largest deviation of a mean load at rest."""
        return REST_SHARE * self.full_scale

    @property
    def reversal_band(self) -> float:
        """Smallest way back that counts as a change of direction."""
        return REVERSAL_SHARE * self.full_scale

    @property
    def hold_min(self) -> float:
        """Smallest held load that a diagnosis uses."""
        return HOLD_SHARE * self.full_scale

    @property
    def level_step(self) -> float:
        """Smallest difference of two load levels."""
        return LEVEL_SHARE * self.full_scale

    @property
    def slope_step(self) -> float:
        """Step of the load for numerical slopes."""
        return SLOPE_SHARE * self.full_scale

    @property
    def unit_min(self) -> float:
        """A record that never exceeds this load was not published in newtons."""
        return UNIT_MIN_SHARE * self.full_scale

    @property
    def unit_max(self) -> float:
        """A record with a load above this was not published in newtons."""
        return UNIT_MAX_SHARE * self.full_scale

    @property
    def negative_max(self) -> float:
        """Largest negative load that noise and zero of the cell account for."""
        return NEGATIVE_SHARE * self.full_scale
