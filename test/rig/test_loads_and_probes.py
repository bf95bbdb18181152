"""Claims about loads, probes and units: what is resolved, how signs run, that geometry inverts."""

from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from saddlering_ros import rig
from saddlering_ros.rig import Displacement, probes_to_displacement, TONNE, TRUE_TO_SCALE
from saddlering_ros.rig.geometry import displacement_to_probes, gap_increment, resolve_load
from saddlering_ros.rig.units import line_contact_stiffness, stiffnesses_per_millimetre

RIG = rig.default_rig()
RAISED = replace(RIG.probes, radial_height=0.12)


def test_a_level_barrel_pushes_rearward_only_and_tilts_by_the_trunnions_height() -> None:
    resolved = resolve_load(RIG, 10.0 * TONNE, 0.0)
    assert resolved.force_x == pytest.approx(10.0 * TONNE)
    assert resolved.force_y == pytest.approx(0.0, abs=1e-9)
    assert resolved.moment == pytest.approx(10.0 * TONNE * 1.00)


def test_an_upright_barrel_pushes_down_only_and_tilts_the_rear_down_by_the_trunnions_x() -> None:
    resolved = resolve_load(RIG, 10.0 * TONNE, np.pi / 2)
    assert resolved.force_x == pytest.approx(0.0, abs=1e-9)
    assert resolved.force_y == pytest.approx(-10.0 * TONNE)
    assert resolved.moment == pytest.approx(10.0 * TONNE * 0.15)


def test_the_moment_is_that_of_the_force_about_the_reference_point() -> None:
    for degrees in (0.0, 33.0, 50.0, 70.0, 90.0):
        resolved = resolve_load(RIG, rig.FULL_SCALE_LOAD, np.deg2rad(degrees))
        # Positive with the rear going down, so it is minus the right-handed moment x F_y - y F_x.
        arm = RIG.trunnion.y * resolved.force_x - RIG.trunnion.x * resolved.force_y
        assert resolved.moment == pytest.approx(arm, rel=1e-12)


def test_loads_of_a_whole_record_are_resolved_at_once() -> None:
    load = np.linspace(0.0, rig.FULL_SCALE_LOAD, 7)
    whole = resolve_load(RIG, load, 0.9)
    assert whole.moment == pytest.approx([resolve_load(RIG, p, 0.9).moment for p in load])


@given(st.floats(-1e-3, 1e-3), st.floats(-1e-3, 1e-3), st.floats(-1e-2, 1e-2),
       st.floats(-1e-4, 1e-4), st.floats(-0.5, 0.5))
def test_probe_geometry_and_its_inverse_undo_each_other(delta_x, delta_y, gamma, parity, height):
    probes = replace(RIG.probes, radial_height=height)
    seen = displacement_to_probes(probes, Displacement(delta_x, delta_y, gamma, parity))
    back = probes_to_displacement(probes, seen)
    found = [back.delta_x, back.delta_y, back.gamma, back.parity]
    assert found == pytest.approx([delta_x, delta_y, gamma, parity], abs=1e-16, rel=1e-12)


def test_radial_motion_opens_the_rear_probe_and_closes_the_front_one() -> None:
    seen = displacement_to_probes(RIG.probes, Displacement(1e-4, 0.0, 0.0, 0.0))
    assert seen == pytest.approx([1e-4, 0.0, -1e-4, 0.0])


def test_tilt_moves_the_axial_pair_apart_by_the_span() -> None:
    seen = displacement_to_probes(RIG.probes, Displacement(0.0, 0.0, 2e-4, 0.0))
    assert (seen[1] - seen[3]) / 1.30 == pytest.approx(np.tan(2e-4))
    assert seen[0] == seen[2] == 0.0


def test_a_raised_radial_pair_sees_tilt_and_the_way_back_takes_it_out() -> None:
    seen = displacement_to_probes(RAISED, Displacement(0.0, 0.0, 2e-4, 0.0))
    assert seen[0] == pytest.approx(2e-4 * 0.12)
    assert probes_to_displacement(RAISED, seen).delta_x == pytest.approx(0.0, abs=1e-18)


def test_parity_is_zero_for_a_rigid_ring_and_half_of_what_one_probe_alone_adds() -> None:
    seen = displacement_to_probes(RIG.probes, Displacement(8e-5, -3e-5, 2e-4, 0.0))
    assert probes_to_displacement(RIG.probes, seen).parity == pytest.approx(0.0, abs=1e-18)
    seen[0] += 4e-6
    assert probes_to_displacement(RIG.probes, seen).parity == pytest.approx(2e-6)


def test_a_gap_counts_from_zero_in_the_sense_of_its_polarity() -> None:
    probes = replace(RIG.probes, polarity=(1.0, -1.0, 1.0, 1.0))
    zero = np.array([1.0e-3, 1.1e-3, 0.9e-3, 1.0e-3])
    gaps = (zero + 1e-5)[:, None] * np.ones(3)
    assert gap_increment(probes, gaps, zero) == pytest.approx(
        np.array([1e-5, -1e-5, 1e-5, 1e-5])[:, None] * np.ones(3))


def test_6e4_newton_per_millimetre_to_the_10_9_is_1_29e8_per_metre() -> None:
    assert round(TRUE_TO_SCALE.K1 / 1e8, 2) == 1.29
    assert stiffnesses_per_millimetre({'K1': TRUE_TO_SCALE.K1, 'n1': 10 / 9, 'n2': 1.1}) == {
        'K1': pytest.approx(6e4, rel=1e-12)}


def test_palmgrens_law_gives_the_deflection_of_two_contacts_in_series() -> None:
    assert line_contact_stiffness(20.0) == pytest.approx(5.35e5, rel=2e-3)
    load = 5000.0
    deflection = (load / line_contact_stiffness(20.0)) ** 0.9
    assert deflection == pytest.approx(2 * 3.84e-5 * load**0.9 / 20.0**0.8, rel=1e-12)
