"""Claims about the readable reference: closed forms, energy, reaction, order, another solver."""

from dataclasses import replace

import numpy as np
import pytest
import readable_ring as reference
from scipy.integrate import solve_ivp

from saddlering_ros.rig import default_rig, TONNE, TRUE_TO_SCALE

ELEVATION = np.deg2rad(50.0)
RIG = default_rig()


def test_pure_axial_load_is_shared_equally_by_the_lower_row() -> None:
    rig = replace(RIG, trunnion=replace(RIG.trunnion, x=0.0, y=0.0))
    load = 10.0 * TONNE
    q = reference.static_equilibrium(rig, TRUE_TO_SCALE, load, np.pi / 2)
    each = (load + rig.carriage.weight) / rig.axial_rows.rollers
    depth = (each / TRUE_TO_SCALE.K1) ** (1.0 / TRUE_TO_SCALE.n1)
    assert q[1] == pytest.approx(-(0.5 * rig.axial_rows.clearance + depth), rel=1e-9)
    upper, lower, _ = reference.roller_loads(rig, TRUE_TO_SCALE, q)
    assert np.all(upper == 0.0)
    assert lower == pytest.approx(np.full(97, each), rel=1e-7)


def test_largest_roller_load_under_pure_radial_load_is_4_08_times_the_mean() -> None:
    rig = replace(RIG, radial_row=replace(RIG.radial_row, clearance=0.0),
                  trunnion=replace(RIG.trunnion, x=0.0, y=0.0))
    load = 10.0 * TONNE
    q = reference.static_equilibrium(rig, TRUE_TO_SCALE, load, 0.0)
    _, _, middle = reference.roller_loads(rig, TRUE_TO_SCALE, q)
    # Literature: 4.08 F_r/Z for n = 10/9 (line contact, zero clearance), three figures.
    assert middle.max() * rig.radial_row.rollers / load == pytest.approx(4.08, abs=0.01)


def test_rollers_react_with_exactly_the_external_force_and_moment() -> None:
    q = reference.static_equilibrium(RIG, TRUE_TO_SCALE, 20.0 * TONNE, ELEVATION)
    upper, lower, middle = reference.roller_loads(RIG, TRUE_TO_SCALE, q)
    axial = np.cos(2 * np.pi * np.arange(97) / 97)
    radial = np.cos(2 * np.pi * np.arange(110) / 110)
    reaction = [np.sum(middle * radial), np.sum(upper) - np.sum(lower),
                -0.6 * np.sum(upper * axial) + 0.6 * np.sum(lower * axial)]
    assert reaction == pytest.approx(
        reference.external_force(RIG, 20.0 * TONNE, ELEVATION), rel=1e-8)


def test_contact_force_is_the_gradient_of_an_energy() -> None:
    rows = reference.contact_rows(RIG, TRUE_TO_SCALE)

    def energy(q: np.ndarray) -> float:
        return sum(float(np.sum(row.stiffness / (row.exponent + 1.0) * np.maximum(
            row.direction @ q - row.gap, 0.0) ** (row.exponent + 1.0))) for row in rows)

    q, step = np.array([1.1e-4, -5e-5, 1.8e-4]), 1e-8
    gradient = [(energy(q + step * e) - energy(q - step * e)) / (2 * step) for e in np.eye(3)]
    assert -reference.contact_force(rows, q, np.zeros(3)) == pytest.approx(gradient, rel=1e-6)


def test_work_done_by_a_slow_load_cycle_is_stored_and_given_back() -> None:
    time = np.linspace(0.0, 400.0, 801)
    load = TONNE * (1.0 + 12.0 * (1.0 - np.cos(2 * np.pi * time / 400.0)))
    q = reference.simulate_dynamic(RIG, TRUE_TO_SCALE, ELEVATION, time, load)
    external = np.array([reference.external_force(RIG, p, ELEVATION) for p in load])
    middle = 0.5 * (external[1:] + external[:-1])
    work = np.cumsum(np.sum(middle * np.diff(q.T, axis=0), axis=1))
    assert abs(work[-1]) < 0.01 * np.max(np.abs(work))
    assert abs(work[-1]) > 0.0


def test_jacobian_is_the_derivative_of_the_force_by_motion_and_rate() -> None:
    rows = reference.contact_rows(RIG, TRUE_TO_SCALE)
    q, v = np.array([1e-4, -4e-5, 2e-4]), np.array([3e-5, -1e-5, -4e-5])
    by_q, by_rate = reference.contact_jacobian(rows, q, v)
    for k in range(3):
        e = np.eye(3)[k]
        slope = (reference.contact_force(rows, q + 1e-10 * e, v)
                 - reference.contact_force(rows, q - 1e-10 * e, v)) / 2e-10
        assert by_q[:, k] == pytest.approx(slope, rel=1e-4, abs=1e3)
        slope = (reference.contact_force(rows, q, v + 1e-9 * e)
                 - reference.contact_force(rows, q, v - 1e-9 * e)) / 2e-9
        assert by_rate[:, k] == pytest.approx(slope, rel=1e-4, abs=1e1)


def test_a_roller_never_pulls_and_touches_down_without_a_jump() -> None:
    depth = np.linspace(-1e-6, 3e-6, 4001)
    for rate in (-1.0, -1e-3, 0.0, 1e-3):
        force = reference.unit_force(depth, np.full_like(depth, rate), 1.3e8, 10 / 9, 3e6)
        assert np.all(force >= 0.0)
        assert np.all(force[depth <= 0.0] == 0.0)
        assert force[depth > 0.0][0] < 1.0


def _smooth_load(t: np.ndarray | float) -> np.ndarray:
    return 4903.325 + 10 * TONNE * np.sin(np.pi * np.clip(np.asarray(t) / 0.4, 0, 1)) ** 4


@pytest.fixture(scope='module')
def radau() -> np.ndarray:
    """Motion (3, 5) at 5 moments of the rise of a load pulse, by scipy's Radau at 1e-9."""
    start = reference.static_equilibrium(RIG, TRUE_TO_SCALE, float(_smooth_load(0.0)), ELEVATION)
    rate = reference.rate_of_state(RIG, TRUE_TO_SCALE, ELEVATION, lambda t: float(_smooth_load(t)))
    solution = solve_ivp(rate, (0.0, 0.1), np.concatenate([start, np.zeros(3)]), method='Radau',
                         t_eval=np.linspace(0.0, 0.1, 5), rtol=1e-9, atol=1e-14)
    assert solution.success
    return np.asarray(solution.y[:3])


def test_the_implicit_steps_converge_to_scipys_radau_with_second_order(radau: np.ndarray) -> None:
    errors = []
    for steps in (400, 1600):
        time = np.linspace(0.0, 0.1, steps + 1)
        q = reference.simulate_dynamic(RIG, TRUE_TO_SCALE, ELEVATION, time, _smooth_load(time))
        errors.append(np.max(np.abs(q[:, ::steps // 4] - radau)))
    # Rollers that come and go are kinks; the order shows over two halvings, not in each one.
    assert 0.5 * np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.35)
