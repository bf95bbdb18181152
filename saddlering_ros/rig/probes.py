"""Probe geometry both ways: four gap increments to the motion of C, and back."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from saddlering_ros.rig.description import Probes


@dataclass(frozen=True)
class Displacement:
    """Motion of C: delta_x, delta_y [m], gamma [rad], the probes' parity [m]; arrays or floats."""

    delta_x: Any
    delta_y: Any
    gamma: Any
    parity: Any


CHANNELS: tuple[str, ...] = ('delta_x', 'delta_y', 'gamma', 'parity')
"""Names of the fields of `Displacement`, in the order used everywhere."""


def gap_increment(probes: Probes, gaps: ArrayLike, zero_gaps: ArrayLike) -> NDArray[np.float64]:
    """d_i = polarity_i (gap_i - gap_i at zero); `gaps` (4, ...) and `zero_gaps` (4,) in metres."""
    readings = np.asarray(gaps, dtype=np.float64)
    shape = (4,) + (1,) * (readings.ndim - 1)
    polarity = np.asarray(probes.polarity).reshape(shape)
    zero = np.asarray(zero_gaps, dtype=np.float64).reshape(shape)
    return np.asarray(polarity * (readings - zero))


def probes_to_displacement(probes: Probes, increments: ArrayLike) -> Displacement:
    """Displacement from probe increments d, shape (4, ...) [m].

    delta_x = (d1 - d3)/2 - gamma h_s, delta_y = (d2 + d4)/2, gamma = atan((d2 - d4)/L),
    parity = (d1 + d3)/2. With h_s = 0, the default rig, the first is (d1 - d3)/2.
    """
    first, second, third, fourth = np.asarray(increments, dtype=np.float64)
    gamma = np.arctan((second - fourth) / probes.axial_span)
    # Without a height, delta_x is known even where an axial probe, and so gamma, is not.
    lean = gamma * probes.radial_height if probes.radial_height else 0.0
    return Displacement(
        delta_x=(first - third) / 2.0 - lean,
        delta_y=(second + fourth) / 2.0, gamma=gamma, parity=(first + third) / 2.0,
    )


def mirrored_gap(probes: Probes, gaps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Gaps [m] that the absent radial probe would read at a rigid ring, from those of the other.

    There d3 = -d1. The gap is put within the range of the probes, and is counted from zero anyway.
    """
    here, there = (probes.polarity[number - 1] for number in (probes.absent, probes.partner))
    if here != there:
        return gaps
    return np.asarray(probes.min_range + probes.max_range - gaps)


def with_absent(probes: Probes, increments: NDArray[np.float64]) -> NDArray[np.float64]:
    """Increments (4, N) of all probes from those (C, N) of the probes that the rig has."""
    if not probes.absent:
        return increments
    return np.insert(increments, probes.absent - 1, -increments[probes.partner_row], axis=0)


def measured_displacement(probes: Probes, increments: ArrayLike) -> Displacement:
    """Displacement from measured increments d, shape (4, ...) [m].

    The parity is NaN if a radial probe is absent, as its increment comes from the other.
    """
    found = probes_to_displacement(probes, increments)
    if not probes.absent:
        return found
    return replace(found, parity=np.full_like(np.asarray(found.parity), np.nan))


def displacement_to_probes(probes: Probes, displacement: Displacement) -> NDArray[np.float64]:
    """Probe increments d, shape (4, ...) [m], that a displacement causes (the exact inverse)."""
    radial = np.asarray(displacement.delta_x) + displacement.gamma * probes.radial_height
    tilt = np.tan(displacement.gamma) * probes.axial_span / 2.0
    parity = np.asarray(displacement.parity)
    return np.stack([
        parity + radial, displacement.delta_y + tilt, parity - radial, displacement.delta_y - tilt,
    ])
