"""The frames of a rig stand where its file says and turn as its signs say."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from saddlering_ros.record.topics import LOAD, PROBES
from saddlering_ros.rig import default_rig, geometry
from saddlering_ros.rig.geometry import Displacement, Frame, frames_of, resolve_load

RIG = replace(default_rig(), probes=replace(
    default_rig().probes, radial_height=0.05, polarity=(1.0, -1.0, -1.0, 1.0)))
ELEVATION = np.radians(50.0)
FRAMES = {frame.name: frame for frame in frames_of(RIG, ELEVATION)}


def axes_of(frame: Frame) -> np.ndarray:
    """Axes of a frame as the columns of a matrix (3, 3) in its parent's."""
    return Rotation.from_quat(frame.rotation).as_matrix()


def test_every_frame_id_of_the_rigs_messages_has_a_frame() -> None:
    assert {topic.frame_id for topic in (LOAD, *PROBES)} <= set(FRAMES)


def test_the_ring_points_to_the_rear_and_up_in_the_axes_of_rep_103() -> None:
    rear, up, left = axes_of(FRAMES['ring']).T
    np.testing.assert_allclose([rear, up, left], [[-1, 0, 0], [0, 0, 1], [0, 1, 0]], atol=1e-15)


@pytest.mark.parametrize('motion', [(1e-5, 0.0, 0.0), (0.0, 1e-5, 0.0), (0.0, 0.0, 1e-5)])
def test_a_probe_sees_its_gap_grow_by_the_motion_along_its_line_of_sight(motion) -> None:
    dx, dy, gamma = motion
    gaps = np.array(RIG.probes.polarity) * geometry.displacement_to_probes(
        RIG.probes, Displacement(dx, dy, gamma, 0.0))
    for number, gap in enumerate(gaps, 1):
        frame = FRAMES[f'eddy_current_{number}']
        x, y, _ = frame.translation
        moved = np.array([dx + gamma * y, dy - gamma * x, 0.0])
        assert axes_of(frame)[:, 0] @ moved == pytest.approx(gap, abs=1e-12)


def test_the_frame_of_the_displaced_ring_moves_with_its_points() -> None:
    dx, dy, gamma = 3e-4, -2e-4, 1e-4
    frame, point = geometry.displaced_frame(dx, dy, gamma), np.array([0.7, 0.4, 0.0])
    moved = np.array([dx + gamma * point[1], dy - gamma * point[0], 0.0])
    np.testing.assert_allclose(
        axes_of(frame) @ point + frame.translation, point + moved, atol=1e-8)  # gamma^2 / 2


def test_the_cylinder_pushes_along_its_x_axis() -> None:
    force = resolve_load(RIG, 1.0, ELEVATION)
    weightless = resolve_load(RIG, 0.0, ELEVATION)
    push = axes_of(FRAMES['hydraulic_cylinder'])[:, 0]
    np.testing.assert_allclose(
        push[:2], [force.force_x - weightless.force_x, force.force_y - weightless.force_y],
        atol=1e-9)


def test_without_an_elevation_the_cylinder_has_no_frame() -> None:
    assert 'hydraulic_cylinder' not in {frame.name for frame in frames_of(RIG)}
