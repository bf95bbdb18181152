"""Claims on consistency: what is small in all may be plain from run to run or over a state."""

from dataclasses import replace

import numpy as np
import pytest

from saddlering_ros.discrepancy import Channel, diagnose, Diagnosis, Effect, Model, Parameter, Run
from saddlering_ros.discrepancy.diagnosis import problem_of
from saddlering_ros.discrepancy.problem.fits import fit_base, tangent
from saddlering_ros.discrepancy.problem.metric import noise_metric
from saddlering_ros.discrepancy.search.lack_of_fit import consistency_tests, LackOfFitTests

TIME = np.linspace(0.0, 10.0, 400)
DRIVES = (np.sin(TIME) + 0.5 * np.sin(2.3 * TIME), np.cos(1.4 * TIME))
STD = 0.02


def simulate(parameters: dict[str, float], run: Run) -> dict[str, np.ndarray]:
    drive = np.asarray(run.inputs['drive'])
    return {'seen': parameters['gain'] * drive + parameters['step.size'] * np.sign(drive)}


MODEL = Model(
    simulate,
    {'gain': Parameter(0.5, 2.0)},
    {'step': Effect('A step', {'size': Parameter(-1, 1)})},
    {'seen': Channel()})


def recorded(gains: tuple[float, float], step: float = 0.0, bend: float = 0.0, seed: int = 1
             ) -> list[Run]:
    """Two runs of these gains, with a step or a soft step (`bend`) in both."""
    random = np.random.default_rng(seed)
    runs = []
    for number, (gain, drive) in enumerate(zip(gains, DRIVES, strict=True)):
        run = Run(f'run {number}', TIME, {'drive': drive}, {'seen': TIME})
        seen = simulate({'gain': gain, 'step.size': step}, run)['seen'] + bend * np.tanh(6 * drive)
        runs.append(replace(run, outputs={'seen': seen + STD * random.normal(size=TIME.size)}))
    return runs


def found(gains: tuple[float, float], step: float = 0.0, bend: float = 0.0, seed: int = 1
          ) -> Diagnosis:
    return diagnose(MODEL, recorded(gains, step, bend, seed))


def test_a_fit_that_errors_of_a_solver_keep_from_its_minimum_shows_no_rest() -> None:
    metric = noise_metric(problem_of(MODEL, recorded((1.0, 1.0)))).with_offsets()
    fit = fit_base(metric)
    slopes, tests = tangent(metric, fit), LackOfFitTests(metric, 100)
    move = 3.0 / np.linalg.norm(slopes.white, axis=0)  # standard deviations
    away = replace(fit, whitened=fit.whitened + slopes.white @ move,
                   prediction=fit.prediction + slopes.plain @ move)
    at_minimum, beside = ([one.statistic for one in consistency_tests(
        metric, place, slopes, tests.slow(fit), 100)] for place in (fit, away))
    assert beside == pytest.approx(at_minimum, rel=1e-6)


def test_parameters_that_differ_from_run_to_run_are_a_misfit() -> None:
    answer = found((0.995, 1.005))
    assert answer.residual_after.slow.p_value > 0.01  # among all slow shapes it does not show
    assert answer.verdict == 'unknown'
    first = min(answer.residual_after.consistency, key=lambda item: item.p_value)
    assert first.coordinate == 'the runs, as the parameters act'
    assert 'seen along the runs' in answer.summary()


def test_a_law_a_little_unlike_the_true_one_is_part_of_the_cause_only() -> None:
    answer = found((1.0, 1.0), bend=0.3)
    assert answer.verdict == 'unknown'
    assert [(cause.effect, cause.partial) for cause in answer.causes] == [('step', True)]


@pytest.mark.parametrize('seed', range(4))
def test_sound_runs_and_true_laws_are_left_in_peace(seed: int) -> None:
    assert found((1.0, 1.0), seed=seed).verdict == 'none'
    assert found((1.0, 1.0), step=0.1, seed=seed).verdict == 'named'
