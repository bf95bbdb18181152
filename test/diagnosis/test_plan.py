"""Claims about plans: what tests could find before they are made."""

import numpy as np
import pytest

from saddlering_ros.cli.main import main
from saddlering_ros.diagnosis import plan
from saddlering_ros.diagnosis.plan import KeptSystem, PlanError, planned_test, PlannedTest, Planner
from saddlering_ros.diagnosis.ring_system import RingSystem
from saddlering_ros.discrepancy import Point
from saddlering_ros.rig import default_rig, PARAMETER_NAMES, TRUE_TO_SCALE

STATIC, FAST = PlannedTest('static', 50.0), PlannedTest('fast', 50.0)


@pytest.fixture(scope='module')
def planner():
    return Planner(default_rig())


def test_a_further_test_makes_no_cause_harder_to_find(planner):
    alone, both = planner.plan([STATIC]), planner.plan([STATIC, FAST])
    limits = {cause.effect: cause.limit for cause in alone.causes if cause.is_testable}
    after = {cause.effect: cause.limit for cause in both.causes}
    # Another shape of a cause may become visible, with a limit of its own.
    harder = [name for name, limit in limits.items() if after[name] > 1.5 * limit]
    assert harder == []
    assert both.score < alone.score
    assert all(both.accuracy[name] <= 1.001 * alone.accuracy[name] for name in PARAMETER_NAMES)


def test_a_plan_promises_no_parameter_that_identify_would_leave_open(planner):
    """n1 of one elevation was 1.11111 ± 0.00091, and D1 of a static test (3.00 ± 0.40) × 10⁶."""
    alone, both = planner.plan([STATIC]), planner.plan([STATIC, PlannedTest('fast', 0.0)])
    assert set(alone.undetermined) == {'n1', 'n2', 'D1', 'D2'}
    assert 'add a run at another elevation' in alone.to_json()['parameters']['n1']['reason']
    assert alone.to_json()['parameters']['K1']['reason'] is None
    assert both.undetermined == {}


def test_a_ramp_shows_smaller_damping_than_a_static_test(planner):
    static, ramp = ({cause.effect: cause.limit for cause in planner.plan([test]).causes}
                    for test in (STATIC, FAST))
    assert ramp['damping_law'] < 0.5 * static['damping_law']


def test_kept_readings_are_those_of_the_ring_when_a_point_is_asked_twice():
    rig = default_rig()
    ring = RingSystem(rig)
    run = FAST.run(rig)
    plain = Point(TRUE_TO_SCALE.to_array())
    gain = Point(plain.base, {'load_gain': {'gain': 0.01}})
    kept = KeptSystem(ring).predict_many(run, [plain, plain, gain])
    assert np.array_equal(kept, ring.predict_many(run, [plain, plain, gain]))


@pytest.mark.parametrize(('tests', 'is_told'), [([], True), (['--test', 'static:50'], False)])
def test_a_plan_without_a_test_states_what_takes_long(tests, is_told, monkeypatch, capsys):
    def refuse(*_, **__):
        raise PlanError('stop')

    monkeypatch.setattr(plan, 'plan_tests', refuse)
    assert main(['plan', *tests]) == 2
    assert ('without --test, four of 20 tests are chosen' in capsys.readouterr().err) == is_told


@pytest.mark.parametrize(('typed', 'said'), [
    ('statik:50', 'there is no kind'), ('static', 'elevation is missing'),
    ('static:180', '-10 to 90'), ('static:-15', '-10 to 90')])
def test_a_test_that_cannot_be_planned_is_refused_in_one_line(typed, said):
    with pytest.raises(PlanError, match=said) as refusal:
        planned_test(typed)
    assert '\n' not in str(refusal.value)
