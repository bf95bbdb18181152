"""Claims on shapes that act as switches: slopes tell of the next samples alone."""

from dataclasses import replace

import numpy as np
import pytest

from saddlering_ros.discrepancy import Channel, diagnose, Effect, Model, Parameter, Run

TIME, STD, JUMP = np.linspace(0.0, 10.0, 80), 0.1, 0.5


def simulate(parameters: dict[str, float], run: Run) -> dict[str, np.ndarray]:
    """A gain, a jump at a time of the run, and a drift."""
    seen = parameters['gain'] * np.asarray(run.inputs['drive'])
    seen = seen + parameters['jump.size'] * (run.time > parameters['jump.at'])
    return {'seen': seen + parameters['drift.rate'] * run.time / 10.0}


MODEL = Model(
    simulate, {'gain': Parameter(0.0, 2.0)},
    {'jump': Effect('A jump', {'size': Parameter(-2, 2), 'at': Parameter(0, 10)}),
     'drift': Effect('A drift', {'rate': Parameter(-1, 1)})},
    {'seen': Channel()})
TRUE = {'gain': 1.0, 'drift.rate': 0.0, 'jump.size': JUMP}


def with_jump(at: float, seed: int) -> list[Run]:
    random, runs = np.random.default_rng(seed), []
    for number in range(3):
        run = Run(f'run {number}', TIME, {'drive': np.sin((1.0 + number) * TIME)}, {'seen': TIME})
        true = simulate({**TRUE, 'jump.at': at}, run)['seen']
        runs.append(replace(run, outputs={'seen': true + STD * random.normal(size=TIME.size)}))
    return runs


@pytest.mark.parametrize('seed', range(3))
@pytest.mark.parametrize('at', [3.1, 7.3])
def test_a_jump_is_found_between_the_times_that_are_tried(at: float, seed: int) -> None:
    answer = diagnose(MODEL, with_jump(at, seed))
    assert (answer.verdict, answer.causes[0].effect) == ('named', 'jump')
    found = answer.causes[0].parameters
    # The time lies between two samples, and a mean has the error of its samples.
    assert abs(found['at'].value - at) < 3.0 * found['at'].std
    assert abs(found['size'].value - JUMP) < 3.0 * found['size'].std
    assert found['at'].std < 0.2
    after = np.count_nonzero(at < TIME)
    assert found['size'].std > 0.8 * STD / (3.0 * after) ** 0.5


@pytest.mark.parametrize('at', [3.1, 6.1])
def test_a_jump_is_found_where_what_another_time_leaves_is_within_the_declared_error(
        at: float) -> None:
    """It was named a drift, with a probability of 97 %."""
    model = replace(MODEL, channels={'seen': Channel(model_error=0.05)})
    answer = diagnose(model, with_jump(at, 0))
    assert (answer.verdict, answer.causes[0].effect) == ('named', 'jump')
    found = answer.causes[0].parameters['at']
    assert abs(found.value - at) < 3.0 * found.std
