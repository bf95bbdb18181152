"""Claims on a base fit that ends in a wrong valley: it is left, and no effect is named for it."""

from dataclasses import replace

import numpy as np
import pytest

from saddlering_ros.discrepancy import DiscrepancyError, Effect, Model, Noise, Parameter, Run
from saddlering_ros.discrepancy.diagnosis import problem_of
from saddlering_ros.discrepancy.engine import diagnose_system
from saddlering_ros.discrepancy.problem.fits import Candidate, refit, run_refits
from saddlering_ros.discrepancy.problem.model import Channel
from saddlering_ros.discrepancy.search.evidence import SearchLog
from saddlering_ros.discrepancy.search.selection import better_base, select
from saddlering_ros.discrepancy.search.space import ModelSpace, prepare, refitted

TIME = np.linspace(0.0, 12.0, 400)
TRUE, WRONG = 1.3, 2.6


def simulate(p: dict[str, float], run: Run) -> dict[str, np.ndarray]:
    turn = p['rate'] * TIME
    return {'seen': np.cos(turn) + p['fade.size'] * TIME * np.cos(turn)}


MODEL = Model(
    simulate,
    base={'rate': Parameter(0.5, 4.0)},
    effects={'fade': Effect('Swing that fades', {'size': Parameter(-0.1, 0.1)})},
    channels={'seen': Channel(noise=Noise.white(0.01))})


@pytest.fixture
def run() -> Run:
    noise = 0.01 * np.random.default_rng(1).normal(size=TIME.size)
    return Run('swing', TIME, {}, {'seen': np.cos(TRUE * TIME) + noise})


def test_the_base_is_fitted_from_where_an_effect_has_led_it(run: Run) -> None:
    item = MODEL.base['rate']
    space = prepare(problem_of(MODEL, [run], start={'rate': WRONG}))
    fade = Candidate(((space.problem.system.effects[0], 0),))
    start = np.array([item.to_unit(TRUE), 0.5])
    fit = run_refits(space.metric, [refit(space.metric, fade, start)])[0]
    deeper = better_base(space, fit)
    assert space.base.misfit > 1e5
    assert deeper is not None
    assert item.from_unit(float(deeper.theta_unit[0])) == pytest.approx(TRUE, abs=1e-2)
    assert better_base(space, space.base) is None


def test_a_wrong_start_of_the_base_brings_no_cause(run: Run) -> None:
    found = diagnose_system(problem_of(MODEL, [run], start={'rate': WRONG}))
    assert found.verdict in ('none', 'unknown')


def test_an_effect_that_a_wrong_valley_of_the_base_conceals_is_selected() -> None:
    noise = 0.01 * np.random.default_rng(1).normal(size=TIME.size)
    faded = (1.0 + 0.08 * TIME) * np.cos(TRUE * TIME) + noise
    item = MODEL.base['rate']
    run = Run('swing', TIME, {}, {'seen': faded})
    space = prepare(problem_of(MODEL, [run], start={'rate': WRONG}))
    assert abs(item.from_unit(float(space.base.theta_unit[0])) - TRUE) > 0.5
    fit = select(space, SearchLog())
    assert fit.candidate.ids == ('fade',)
    assert item.from_unit(float(fit.theta_unit[0])) == pytest.approx(TRUE, abs=1e-2)


def test_the_model_without_an_effect_leaves_the_wrong_valley_of_its_own_fit() -> None:
    """A hum of a wrong phase ended at size 0, and all of it was told to be the drift."""
    def humming(p: dict[str, float], run: Run) -> dict[str, np.ndarray]:
        hum = p['hum.size'] * np.sin(20.0 * TIME - p['hum.phase'])
        return {'seen': p['slope'] * TIME + p['drift.size'] * TIME**2 + hum}

    model = Model(humming, base={'slope': Parameter(0.0, 1.0)}, channels=MODEL.channels, effects={
        'hum': Effect('Hum', {'size': Parameter(0.0, 1.0), 'phase': Parameter.angle()}),
        'drift': Effect('Drift', {'size': Parameter(-0.1, 0.1)})})
    noise = 0.01 * np.random.default_rng(1).normal(size=TIME.size)
    seen = 0.5 * TIME + 0.2 * np.sin(20.0 * TIME - 0.5) + noise
    space = prepare(problem_of(model, [Run('axis', TIME, {}, {'seen': seen})]))
    hum = Candidate(((space.problem.system.effects[0], 0),))
    both = hum.plus(space.problem.system.effects[1], 0)
    wrong, right = run_refits(space.metric, [
        refit(space.metric, hum, np.array([0.5, 0.0, 0.6]), rounds=0),
        refit(space.metric, both, np.array([0.5, 0.2, 0.08, 0.5]))])
    assert space.keep(wrong).misfit > 10.0 * right.misfit
    assert space.without(right, 'drift').misfit < 1.1 * right.misfit


@pytest.mark.parametrize('beyond', [1e-12, 1e-3])
def test_only_rounding_may_put_a_start_outside_its_bounds(run: Run, beyond: float) -> None:
    high = MODEL.base['rate'].high
    problem = problem_of(MODEL, [run], start={'rate': high * (1.0 + beyond)})
    if beyond < 1e-9:
        assert problem.first_guess() == pytest.approx([1.0])
        return
    with pytest.raises(DiscrepancyError, match='is outside'):
        problem.first_guess()


def roll(p: dict[str, float], run: Run) -> dict[str, np.ndarray]:
    """Angle of a wheel with unequal teeth: late in a run no slope leads to the right path."""
    angle, speed, seen = 0.0, 0.0, np.empty(TIME.size)
    for number, pull in enumerate(np.asarray(run.inputs['pull'])):
        seen[number] = angle
        speed += TIME[1] * (pull - p['loss'] * speed - p['teeth.size'] * np.sin(6.0 * angle))
        angle += TIME[1] * speed
    return {'angle': seen + p['drift.size'] * TIME}


WHEEL = Model(
    roll,
    base={'loss': Parameter(0.1, 3.0)},
    effects={'teeth': Effect('Unequal teeth', {'size': Parameter(-8.0, 8.0)}),
             'drift': Effect('Drift', {'size': Parameter(-1.0, 1.0)})},
    channels={'angle': Channel(noise=Noise.white(0.01))})


@pytest.fixture(scope='module')
def wheel() -> ModelSpace:
    pull = 2.0 * np.sin(0.9 * TIME) + 2.0 * np.sin(2.3 * TIME + 1.0)
    run = Run('wheel', TIME, {'pull': pull}, {'angle': TIME})
    seen = roll({'loss': 0.8, 'teeth.size': 3.0, 'drift.size': 0.0}, run)['angle']
    noise = 0.01 * np.random.default_rng(1).normal(size=TIME.size)
    return prepare(problem_of(WHEEL, [replace(run, outputs={'angle': seen + noise})]))


def test_an_effect_is_found_whose_path_only_the_start_of_a_run_leads_to(wheel: ModelSpace) -> None:
    fit = select(wheel, SearchLog())
    assert fit.candidate.ids == ('teeth',)
    assert fit.point.effects['teeth']['size'] == pytest.approx(3.0, rel=0.02)


def test_a_model_that_was_fitted_before_is_tried_again(wheel: ModelSpace) -> None:
    teeth = Candidate(((wheel.problem.system.effects[0], 0),))
    item = wheel.problem.system.effects[0].size
    start = np.array([WHEEL.base['loss'].to_unit(0.8), item.to_unit(3.0)])
    [right] = run_refits(wheel.metric, [refit(wheel.metric, teeth, start)])
    space = replace(wheel)
    space.keep(right)
    assert refitted(space, space.base)[0] is right
