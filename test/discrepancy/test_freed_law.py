"""A law of the right kind that is too narrow is told from the true one by its freed shape."""

import numpy as np
import pytest

from saddlering_ros.discrepancy import Channel, diagnose, Effect, Model, Parameter, Run
from saddlering_ros.discrepancy.law import families
from saddlering_ros.discrepancy.verdict import wrong_law

STEP, COUNT = 0.02, 300
TIME = STEP * np.arange(COUNT)


def speed_of(torque: np.ndarray, viscous: float, dry: float, falling: float, tired: float = 0.0):
    """Speed (N,) of a load of 0.1 kg m^2 whose friction falls with it, in half steps."""
    seen, speed = np.empty(COUNT), 0.0
    for number, given in enumerate(torque):
        seen[number] = speed
        for _ in range(2):
            friction = dry + falling * np.exp(-(speed**2))
            lost = (viscous + tired * number) * speed + friction * np.tanh(speed / 0.1)
            speed += STEP / 2 * (given - lost) / 0.1
    return seen


def record(number: int, dry: float, falling: float) -> Run:
    random = np.random.default_rng(number)
    phases = random.uniform(0.0, 2.0 * np.pi, 3)
    torque = np.sin(TIME[:, None] * [1.1, 2.7, 5.3] + phases).sum(axis=1)
    speed = speed_of(torque, 0.3, dry, falling, tired=5e-5) + 0.01 * random.normal(size=COUNT)
    return Run(f'run {number}', TIME, {'torque': torque}, {'speed': speed})


MODEL = Model(
    lambda values, run: {'speed': speed_of(
        run.inputs['torque'], values['viscous'], values['coulomb.torque'], 0.0)},
    base={'viscous': Parameter(0.1, 1.0)},
    effects={'coulomb': Effect('Dry friction', {'torque': Parameter(0.0, 1.0)})},
    channels={'speed': Channel()})


@pytest.mark.parametrize(('dry', 'falling', 'verdict', 'is_told'), [
    (0.2, 0.0, 'named', False), (0.2, 0.12, 'named', True), (0.1, 0.25, 'unknown', False)])
def test_a_law_of_the_right_kind_that_is_too_narrow_is_not_established(
    dry: float, falling: float, verdict: str, is_told: bool,
) -> None:
    answer = diagnose(MODEL, [record(number, dry, falling) for number in range(3)],
                      hold_out=[record(3, dry, falling)])
    assert answer.verdict == verdict
    assert answer.causes[0].effect == 'coulomb'
    doubts = [words for words in answer.warnings if 'of another shape over speed' in words]
    assert bool(doubts) is (verdict == 'unknown')
    told = [words for words in answer.warnings if 'a curve over speed predicts' in words]
    assert bool(told) is is_told
    assert (answer.probabilities['coulomb'] < 0.2) is (verdict == 'unknown')
    words = 'Something acts over speed as Dry friction does, by a law of another shape'
    assert answer.headline.startswith(words) is (verdict == 'unknown')
    assert ('another_law' in answer.causes[0].entry()) is (verdict == 'unknown')


def test_a_cause_that_changes_nothing_is_no_law_of_another_shape() -> None:
    """A fitted size of 0 had a curve of length 0, by which the freed one was divided."""
    states = {'speed': [np.sin(TIME), np.cos(TIME)]}
    assert families.forced([np.zeros((1, COUNT))] * 2, states)[0] < wrong_law.MIN_REPEATED
