"""A cause that leaves much more of one run than of each other is not established."""

import numpy as np
import pytest

from saddlering_ros.discrepancy import Channel, diagnose, Effect, Model, Parameter, Run
from saddlering_ros.discrepancy.verdict import established

TIME = np.linspace(0.0, 40.0, 400)


def simulate(values: dict[str, float], run: Run) -> dict[str, np.ndarray]:
    use, night = np.asarray(run.inputs['use']), np.asarray(run.inputs['night'])
    return {'head': values['pump'] * use - values['leak.size'] * night}


def record(number: int, wander: float) -> Run:
    random = np.random.default_rng(number)
    one, two, three = random.uniform(0.0, 2.0 * np.pi, 3)
    inputs = {'use': np.sin(TIME + one), 'night': np.sin(0.37 * TIME + two) ** 2}
    rest = wander * np.sin(0.61 * TIME + three) + 0.01 * random.normal(size=400)
    return Run(f'run {number}', TIME, inputs, {
        'head': 1.1 * inputs['use'] - 0.4 * inputs['night'] + rest})


MODEL = Model(
    simulate, {'pump': Parameter(0.5, 2.0)},
    {'leak': Effect('Leak', {'size': Parameter(0.0, 2.0)})},
    {'head': Channel(offset='free')})


@pytest.mark.parametrize(('wander', 'verdict'), [
    (0.02, 'named'), (0.05, 'named'), (0.11, 'unknown')])
def test_a_cause_leaves_no_run_much_more_than_the_others(
    wander: float, verdict: str, monkeypatch: pytest.MonkeyPatch,
) -> None:
    runs = [record(0, 0.02), record(1, wander), record(2, 0.02), record(3, 0.02)]
    answer = diagnose(MODEL, runs[:3], hold_out=runs[3:])
    assert (answer.verdict, answer.causes[0].effect) == (verdict, 'leak')
    assert any('run 1 keeps' in words for words in answer.warnings) is (verdict == 'unknown')
    monkeypatch.setattr(established, 'uneven_rest', lambda _: [])
    assert diagnose(MODEL, runs[:3], hold_out=runs[3:]).verdict == 'named'
