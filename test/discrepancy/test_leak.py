"""Claims on a leak: its shares in two channels, and what it leaves of each run."""

from dataclasses import replace

import numpy as np
import pytest

from saddlering_ros.discrepancy import Channel, diagnose, Effect, Model, Parameter, Run
from saddlering_ros.discrepancy.verdict import established, wrong_law

pytestmark = pytest.mark.usefixtures('no_next_test')

TIME = np.linspace(0.0, 40.0, 400)


def simulate(values: dict[str, float], run: Run) -> dict[str, np.ndarray]:
    use, night = np.asarray(run.inputs['use']), np.asarray(run.inputs['night'])
    lost = values['leak.size'] * night
    return {'near': values['pump'] * use - lost, 'far': values['pipe'] * use - lost}


def record(number: int, far: float, wander: float = 0.02) -> Run:
    """A run with a leak that lowers the far end by a share of the near one, and a wander."""
    random = np.random.default_rng(number)
    one, two, three = random.uniform(0.0, 2.0 * np.pi, 3)
    inputs = {'use': np.sin(TIME + one), 'night': np.sin(0.37 * TIME + two) ** 2}
    night = 0.4 * inputs['night']
    seen = {'near': 1.1 * inputs['use'] - night, 'far': 0.9 * inputs['use'] - far * night}
    return Run(f'run {number}', TIME, inputs, {
        name: each + wander * np.sin(0.61 * TIME + three) + 0.01 * random.normal(size=400)
        for name, each in seen.items()})


MODEL = Model(
    simulate, {'pump': Parameter(0.5, 2.0), 'pipe': Parameter(0.5, 2.0)},
    {'leak': Effect('Leak', {'size': Parameter(0.0, 2.0)})},
    {'near': Channel(offset='free'), 'far': Channel(offset='free')})


@pytest.mark.parametrize(('far', 'verdict'), [(1.0, 'named'), (0.5, 'unknown')])
def test_a_law_with_another_share_in_each_channel_is_not_established(far, verdict, monkeypatch):
    runs = [record(number, far) for number in range(4)]
    answer = diagnose(MODEL, runs[:3], hold_out=runs[3:])
    assert (answer.verdict, answer.causes[0].effect) == (verdict, 'leak')
    refused = [words for words in answer.warnings if 'with a size for each channel' in words]
    assert bool(refused) is (verdict == 'unknown')
    if refused:
        monkeypatch.setattr(wrong_law, 'unlike_channels', lambda *_: [])
        assert diagnose(MODEL, runs[:3], hold_out=runs[3:]).verdict == 'named'


def simulate_with_gauge(values: dict[str, float], run: Run) -> dict[str, np.ndarray]:
    seen = simulate(values, run)
    return {**seen, 'far': seen['far'] + values['gauge.size'] * np.asarray(run.inputs['night'])}


@pytest.mark.parametrize('wander', [0.02, 0.0])
def test_a_cause_in_one_channel_does_not_patch_the_law_of_the_main_one(wander, monkeypatch):
    model = replace(MODEL, simulate=simulate_with_gauge, effects={
        **MODEL.effects, 'gauge': Effect('Gauge', {'size': Parameter(-1.0, 1.0)})})
    runs = [record(number, 0.5, wander) for number in range(4)]
    answer = diagnose(model, runs[:3], hold_out=runs[3:])
    assert answer.verdict == 'unknown'
    assert any('with a size for each channel' in words for words in answer.warnings)
    monkeypatch.setattr(wrong_law, 'unlike_channels_unpatched', lambda *_: [])
    answer = diagnose(model, runs[:3], hold_out=runs[3:])
    assert answer.verdict == 'named'
    assert [cause.effect for cause in answer.causes] == ['leak', 'gauge']


def test_a_cause_in_one_channel_that_its_main_cause_cannot_replace_is_no_patch() -> None:
    """A far end that follows a clock was refused, because a leak there can follow it in part."""
    def with_clock(values: dict[str, float], run: Run) -> dict[str, np.ndarray]:
        seen, night = simulate(values, run), np.asarray(run.inputs['night'])
        return {**seen, 'far': seen['far'] + values['clock.size'] * night**3}

    model = replace(MODEL, simulate=with_clock, effects={
        **MODEL.effects, 'clock': Effect('Clock', {'size': Parameter(-1.0, 1.0)})})
    runs = [replace(run, outputs={**run.outputs, 'far': run.outputs['far']
                                  + 0.3 * np.asarray(run.inputs['night']) ** 3})
            for run in (record(number, 1.0) for number in range(4))]
    answer = diagnose(model, runs[:3], hold_out=runs[3:])
    assert answer.verdict == 'named'
    assert [cause.effect for cause in answer.causes] == ['leak', 'clock']


@pytest.mark.parametrize(('wander', 'verdict'), [(0.05, 'named'), (0.11, 'unknown')])
def test_a_cause_leaves_no_run_much_more_than_the_others(wander, verdict, monkeypatch) -> None:
    runs = [record(0, 1.0), record(1, 1.0, wander), record(2, 1.0), record(3, 1.0)]
    answer = diagnose(MODEL, runs[:3], hold_out=runs[3:])
    assert (answer.verdict, answer.causes[0].effect) == (verdict, 'leak')
    assert any('run 1 keeps' in words for words in answer.warnings) is (verdict == 'unknown')
    if verdict == 'unknown':
        monkeypatch.setattr(established, 'uneven_rest', lambda _: [])
        assert diagnose(MODEL, runs[:3], hold_out=runs[3:]).verdict == 'named'
