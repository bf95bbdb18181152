"""Geometry of a rig: probes and motion of C both ways, loads at C, coordinate frames, sizes.

Frame ids are those of the messages. `ring` is the frame of all displacements: origin C, x to the
rear, y up the ring's axis, z to the left. `rig` has the same origin and the axes of REP 103:
x forward, y to the left, z up. A probe's x axis points along its line of sight, as REP 117 wants
it of sensor_msgs/Range.
"""

from dataclasses import dataclass, replace
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from saddlering_ros.rig.description import Probes, Rig
from saddlering_ros.rig.units import FULL_SCALE_LOAD


@dataclass(frozen=True)
class Displacement:
    """Motion of C: delta_x, delta_y [m], gamma [rad], the probes' parity [m]; arrays or floats."""

    delta_x: Any
    delta_y: Any
    gamma: Any
    parity: Any

    @property
    def channels(self) -> NDArray[np.float64]:
        """The same as one array (4, ...)."""
        return np.array([self.delta_x, self.delta_y, self.gamma, self.parity])


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
        delta_x=(first - third) / 2.0 - lean, delta_y=(second + fourth) / 2.0, gamma=gamma,
        parity=(first + third) / 2.0)


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


@dataclass(frozen=True)
class ResolvedLoad:
    """Force [N] and moment [N m] at C, load-positive; the dead weight is not in it."""

    force_x: NDArray[np.float64]
    force_y: NDArray[np.float64]
    moment: NDArray[np.float64]


def resolve_load(rig: Rig, load: ArrayLike, elevation: ArrayLike) -> ResolvedLoad:
    """Resolve load P [N] along the barrel axis at `elevation` [rad], applied at the trunnion.

    F_x = P cos(theta), F_y = -P sin(theta), M = P (y_t cos(theta) + x_t sin(theta)).
    """
    magnitude = np.asarray(load, dtype=np.float64)
    cosine, sine = np.cos(elevation), np.sin(elevation)
    arm = rig.trunnion.y * cosine + rig.trunnion.x * sine
    return ResolvedLoad(magnitude * cosine, -magnitude * sine, magnitude * arm)


RIG_FRAME, RING_FRAME, CYLINDER_FRAME = 'rig', 'ring', 'hydraulic_cylinder'


@dataclass(frozen=True)
class Frame:
    """A frame in its parent's axes: translation (x, y, z) [m], quaternion (x, y, z, w)."""

    name: str
    parent: str
    translation: tuple[float, float, float]
    rotation: tuple[float, float, float, float]


def frames_of(rig: Rig, elevation: float | None = None) -> tuple[Frame, ...]:
    """Every frame of `rig`; that of the cylinder only at a known `elevation` [rad].

    The rig file has no distance of the radial probes from C: they are drawn at the pitch radius
    of the radial row, and the axial ones at the height of C.
    """
    half = math.sqrt(0.5)
    # x to the rear, y up, z to the left, in forward, left, up: half a turn about (0, 1, 1).
    ring = Frame(RING_FRAME, RIG_FRAME, (0.0, 0.0, 0.0), (0.0, half, half, 0.0))
    radius, height = rig.radial_row.pitch_radius, rig.probes.radial_height
    lever = rig.probes.axial_span / 2.0
    places = ((radius, height, 0.0), (-lever, 0.0, math.pi / 2), (-radius, height, math.pi),
              (lever, 0.0, math.pi / 2))
    probes = [
        _in_load_plane(f'eddy_current_{number}', x, y, angle if sign > 0 else angle + math.pi)
        for number, (sign, (x, y, angle)) in enumerate(
            zip(rig.probes.polarity, places, strict=True), 1)]
    if elevation is None:
        return (ring, *probes)
    cylinder = _in_load_plane(CYLINDER_FRAME, rig.trunnion.x, rig.trunnion.y, -elevation)
    return (ring, *probes, cylinder)


def displaced_frame(delta_x: float, delta_y: float, gamma: float) -> Frame:
    """The frame of the ring as it stands displaced [m, m, rad]: gamma turns it from y to x."""
    return _in_load_plane('ring_displaced', delta_x, delta_y, -gamma)


def _in_load_plane(name: str, x: float, y: float, angle: float) -> Frame:
    """A frame at (x, y) of the ring, turned by `angle` [rad] from x to y."""
    return Frame(name, RING_FRAME, (x, y, 0.0),
                 (0.0, 0.0, math.sin(angle / 2.0), math.cos(angle / 2.0)))


NOMINAL_RADIUS = 0.6
"""Pitch radius [m] of the nominal rig; its full scale is 25 t."""


def size_factor(unit: str, rig: Rig) -> float:
    """Factor from a size on the nominal rig to that on a rig: forces follow its full scale."""
    load = rig.full_scale_load / FULL_SCALE_LOAD
    moment = load * (rig.axial_rows.pitch_radius / NOMINAL_RADIUS)
    factors = {'N': load, 'N m': moment, 'm/N': 1.0 / load, 'rad/(N m)': 1.0 / moment,
               'm/N^0.5': load**-0.5}
    return factors.get(unit, 1.0)
