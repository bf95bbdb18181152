"""Claims on many short runs: what noise alone does to few samples is no sign of anything."""

from dataclasses import replace

import numpy as np
import pytest

from saddlering_ros.discrepancy import (
    Channel,
    check,
    diagnose,
    Diagnosis,
    Effect,
    Model,
    Noise,
    Parameter,
    Run,
)
from saddlering_ros.discrepancy.diagnosis import problem_of
from saddlering_ros.discrepancy.search.lack_of_fit import LackOfFitTests
from saddlering_ros.discrepancy.search.space import prepare

STD, SAMPLES = 0.03, 12


def simulate(parameters: dict[str, float], run: Run) -> dict[str, np.ndarray]:
    """A polynomial of the drive."""
    drive = np.asarray(run.inputs['drive'])
    terms = sum(parameters[f'c{power}'] * drive**power for power in range(4))
    return {'seen': terms + parameters['step.size'] * (drive > 0.0)}


MODEL = Model(
    simulate, {f'c{power}': Parameter(-2, 2) for power in range(4)},
    {'step': Effect('A step', {'size': Parameter(-1, 1)})},
    {'seen': Channel(noise=Noise.white(STD))})


def short_runs(seed: int, names: str = 'abcdefgh') -> list[Run]:
    """Each with the same drives in another order, with declared white noise."""
    random, runs = np.random.default_rng(seed), []
    for name in names:
        drive = random.permutation(np.linspace(-1.0, 1.0, SAMPLES))
        run = Run(name, np.arange(SAMPLES) * 1.0, {'drive': drive}, {'seen': drive})
        true = simulate({'c0': 0.1, 'c1': 1.0, 'c2': 0.3, 'c3': 0.2, 'step.size': 0.0}, run)
        runs.append(Run(name, run.time, run.inputs, {
            'seen': true['seen'] + STD * random.normal(size=SAMPLES)}))
    return runs


def sound(seed: int) -> Diagnosis:
    return diagnose(MODEL, short_runs(seed))


@pytest.mark.parametrize('seed', [6, 28, 29])
def test_a_run_need_not_take_up_all_parameters(seed: int) -> None:
    """Noise was called underestimated, with 7 of 12 samples as what noise alone would leave."""
    assert sound(seed).verdict == 'none'


@pytest.mark.parametrize('seed', [1, 3])
def test_one_of_twelve_samples_may_hold_half_of_the_power_of_noise(seed: int) -> None:
    assert sound(seed).warnings == ()


@pytest.mark.parametrize('seed', [30, 33, 37])
def test_a_small_slow_residual_takes_nothing_from_a_declared_level(seed: int) -> None:
    """A family of shapes had p = 5e-8 by a level of 0.2, and 0.9 by that of the declared noise."""
    assert sound(seed).verdict == 'none'


def test_many_runs_cost_as_much_as_each_and_not_their_cube(monkeypatch) -> None:
    """The shapes of 200 short runs, which share no samples, were one matrix: 5 s of silence."""
    metric = prepare(problem_of(MODEL, short_runs(1, 'abcdefghijklmnopqrst'))).metric
    widths, eigh = [], np.linalg.eigh
    monkeypatch.setattr(np.linalg, 'eigh', lambda gram: widths.append(len(gram)) or eigh(gram))
    LackOfFitTests(metric, 12)
    assert (len(widths), max(widths)) == (20, 4)


def test_a_check_of_many_runs_tells_the_largest_residuals() -> None:
    """Of 200 runs of two channels it had 400 lines, which hid those on units."""
    runs = short_runs(1, 'abcdefghijklmnopqrstuvwxyz')
    runs[7] = replace(runs[7], outputs={'seen': runs[7].outputs['seen'] + 1.0})
    said = check(MODEL, runs)
    lines = [line for line in said if 'times the noise' in line]
    assert (len(lines), any(line.startswith('seen in h: ') for line in lines)) == (20, True)
    assert '6 further residuals are smaller beside the noise' in said
