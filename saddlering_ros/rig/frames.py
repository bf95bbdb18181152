"""Coordinate frames of a rig: the ring, the probes, the cylinder, as static transforms.

Frame ids are those of the messages. `ring` is the frame of all displacements: origin C, x to the
rear, y up the ring's axis, z to the left. `rig` has the same origin and the axes of REP 103:
x forward, y to the left, z up. A probe's x axis points along its line of sight, as REP 117 wants
it of sensor_msgs/Range.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.rig.description import Rig

RIG_FRAME, RING_FRAME, CYLINDER_FRAME = 'rig', 'ring', 'hydraulic_cylinder'


@dataclass(frozen=True)
class Frame:
    """A frame in its parent's axes: translation (x, y, z) [m], quaternion (x, y, z, w)."""

    name: str
    parent: str
    translation: tuple[float, float, float]
    rotation: tuple[float, float, float, float]

    def matrix(self) -> NDArray[np.float64]:
        """Rotation matrix (3, 3): its columns are the frame's axes in the parent's."""
        x, y, z, w = self.rotation
        return np.array([
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])


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


def _in_load_plane(name: str, x: float, y: float, angle: float) -> Frame:
    """A frame at (x, y) of the ring, turned by `angle` [rad] from x to y."""
    return Frame(name, RING_FRAME, (x, y, 0.0),
                 (0.0, 0.0, math.sin(angle / 2.0), math.cos(angle / 2.0)))
