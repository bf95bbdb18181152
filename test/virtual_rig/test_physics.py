"""The virtual rig's own physics against closed forms, smaller steps and the readable reference."""

from dataclasses import replace

import numpy as np
import pytest
import readable_ring as reference

from saddlering_ros.rig import default_rig, TONNE, TRUE_TO_SCALE
from saddlering_ros.virtual_rig import integrator as at
from saddlering_ros.virtual_rig.effects import request
from saddlering_ros.virtual_rig.experiment import PhysicalRig, run_test
from saddlering_ros.virtual_rig.integrator import make_rollers, Scatter

EQUAL = Scatter(gap=0.0, stiffness=0.0)
ELEVATION = np.radians(50.0)


def ramp(steps, step, period=2.0):
    """A smooth rise from 1 t to 20 t and half the way back, at thirds of the steps."""
    time = step / 3.0 * np.arange(3 * steps + 1)
    return 0.5 * TONNE + 15.0 * TONNE * np.sin(np.pi * np.minimum(time / period, 0.75)) ** 2


def rig_without_clearance():
    rig = default_rig()
    return replace(rig, axial_rows=replace(rig.axial_rows, clearance=0.0),
                   radial_row=replace(rig.radial_row, clearance=0.0))


def rest(rig, force, effects=()):
    physical = PhysicalRig(rig, TRUE_TO_SCALE, ELEVATION, effects, EQUAL)
    rollers = make_rollers(rig, TRUE_TO_SCALE, EQUAL, 1)
    for item in physical.effects:
        item.effect.act(rollers, item.values, item.form)
    none = np.zeros((0, at.FRICTION_COLUMNS))
    mass = np.array([rig.carriage.mass, rig.carriage.mass, rig.carriage.inertia])
    start = np.array([0.5 * rig.radial_row.clearance, 0.0, 0.0])
    q, failed_steps = at.settle(rollers.table, none, np.zeros(0), mass, np.array(force), start)
    assert failed_steps == 0
    return q, rollers


def test_a_pure_axial_load_is_shared_equally_by_one_row():
    rig = rig_without_clearance()
    q, _ = rest(rig, [0.0, -200e3, 0.0])
    each = 200e3 / rig.axial_rows.rollers
    pressed = (each / TRUE_TO_SCALE.K1) ** (1.0 / TRUE_TO_SCALE.n1)
    assert q[1] == pytest.approx(-pressed, rel=1e-9)


def test_a_pure_radial_load_gives_the_highest_roller_four_times_the_mean():
    rig = rig_without_clearance()
    q, _ = rest(rig, [150e3, -40e3, 0.0])
    highest = TRUE_TO_SCALE.K2 * q[0] ** TRUE_TO_SCALE.n2
    assert highest == pytest.approx(4.08 * 150e3 / rig.radial_row.rollers, rel=2e-3)


def test_at_rest_it_agrees_with_the_readable_reference():
    rig = default_rig()
    for load in (0.5 * TONNE, 8.0 * TONNE, 25.0 * TONNE):
        force = reference.external_force(rig, load, ELEVATION)
        found, _ = rest(rig, force)
        expected = reference.static_equilibrium(rig, TRUE_TO_SCALE, load, ELEVATION)
        assert np.max(np.abs(found - expected)) < 1e-10


def test_in_motion_it_agrees_with_the_readable_reference_within_ten_nanometres():
    rig = default_rig()
    step = 1.25e-4
    load = ramp(3400, step)
    run = run_test(PhysicalRig(rig, TRUE_TO_SCALE, ELEVATION, (), EQUAL), load, step)
    expected = reference.simulate_dynamic(rig, TRUE_TO_SCALE, ELEVATION, run.time, load[::3])
    found = np.stack([run.motion.x, run.motion.y, run.motion.tilt])
    assert np.max(np.abs(found - expected)) < 1e-8


def errors_of_steps(effects, coordinate):
    """Largest error of one coordinate with steps of 1 ms and of 0.25 ms."""
    rig = default_rig()
    runs = {}
    for finer in (1, 4, 8):
        step = 1e-3 / finer
        physical = PhysicalRig(rig, TRUE_TO_SCALE, ELEVATION, effects, EQUAL)
        motion = run_test(physical, ramp(1300 * finer, step), step).motion
        runs[finer] = getattr(motion, coordinate)[::finer]
    return [float(np.max(np.abs(runs[finer] - runs[8]))) for finer in (1, 4)]


@pytest.mark.parametrize('coordinate', ['x', 'y', 'tilt'])
def test_a_fourth_of_the_step_divides_the_error_by_sixteen_or_more(coordinate):
    coarse, fine = errors_of_steps((), coordinate)
    assert fine < coarse / 16.0
    assert fine < 1e-9


@pytest.mark.parametrize('form', ['jenkins', 'dahl', 'lugre', 'bouc_wen'])
def test_friction_converges_with_the_step(form):
    coarse, fine = errors_of_steps((request('radial_friction', form=form),), 'x')
    assert fine < coarse / 3.0
    assert fine < 1e-8


def test_the_same_number_is_the_same_rig_and_another_number_another():
    def gaps(number):
        return make_rollers(default_rig(), TRUE_TO_SCALE, Scatter(), number).table[:, at.GAP]

    assert np.array_equal(gaps(3), gaps(3))
    assert not np.array_equal(gaps(3), gaps(4))
    assert np.std(gaps(3)) == pytest.approx(0.7e-6, rel=0.15)


def test_radial_friction_holds_back_exactly_its_force_while_sliding():
    rig = default_rig()
    step = 2e-3
    load = np.linspace(0.5 * TONNE, 20.0 * TONNE, 30_001)
    friction = request('radial_friction', {'force': 6000.0, 'presliding': 1e-6}, 'jenkins')
    with_it = run_test(PhysicalRig(rig, TRUE_TO_SCALE, ELEVATION, (friction,), EQUAL), load, step)
    without = run_test(PhysicalRig(rig, TRUE_TO_SCALE, ELEVATION, (), EQUAL), load, step)
    late = len(with_it.load) // 2
    fewer = without.motion.load * np.cos(ELEVATION) - 6000.0
    expected = np.interp(fewer[late:], without.motion.load * np.cos(ELEVATION), without.motion.x)
    assert np.max(np.abs(with_it.motion.x[late:] - expected)) < 2e-8
