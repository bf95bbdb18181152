"""Sizes that are stated for the nominal rig, and their factors on any other rig."""

from __future__ import annotations

from saddlering_ros.rig.description import Rig
from saddlering_ros.rig.units import FULL_SCALE_LOAD

NOMINAL_RADIUS = 0.6
"""Pitch radius [m] of the nominal rig; its full scale is 25 t."""


def size_factor(unit: str, rig: Rig) -> float:
    """Factor from a size on the nominal rig to that on a rig: forces follow its full scale."""
    load = rig.full_scale_load / FULL_SCALE_LOAD
    moment = load * (rig.axial_rows.pitch_radius / NOMINAL_RADIUS)
    factors = {'N': load, 'N m': moment, 'm/N': 1.0 / load, 'rad/(N m)': 1.0 / moment,
               'm/N^0.5': load**-0.5}
    return factors.get(unit, 1.0)
