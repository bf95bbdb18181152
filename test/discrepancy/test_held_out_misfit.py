"""Claims on held-out runs that the fitted ones do not predict: no `none` hides them."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from saddlering_ros.diagnosis.verdict import ChannelMisfit, unpredicted
from saddlering_ros.discrepancy import Channel, diagnose, Effect, Model, Noise, Parameter, Run


def simulate(values: dict[str, float], run: Run) -> dict[str, np.ndarray]:
    speed = np.asarray(run.inputs['speed'])
    return {'force': values['viscous'] * speed + values['cubic'] * speed**3
            + values['friction.force'] * np.tanh(speed / 0.02)}


MODEL = Model(
    simulate, {'viscous': Parameter(0, 50), 'cubic': Parameter(0, 50)},
    {'friction': Effect('Friction', {'force': Parameter(0, 5)})}, {'force': Channel('N')})


def record(name: str, rate: float, friction: float = 0.0, size: float = 1.0) -> Run:
    time = np.linspace(0.0, 20.0, 400)
    run = Run(name, time, {'speed': size * np.sin(rate * time)}, {'force': time})
    noise = np.random.default_rng(int(100 * rate)).normal(0.0, 0.05, time.size)
    true = simulate({'viscous': 10.0, 'cubic': 5.0, 'friction.force': friction}, run)
    return Run(name, time, run.inputs, {'force': true['force'] + noise})


def test_a_held_out_run_with_a_cause_of_its_own_is_told():
    answer = diagnose(MODEL, [record('a', 0.7), record('b', 1.1)], hold_out=[
        record('same', 0.9), record('other', 1.3, friction=2.0)])
    assert (answer.verdict, answer.complete) == ('unknown', False)
    assert [rest.run for rest in answer.remainder] == ['other']
    assert answer.remainder[0].size == pytest.approx(1.0, abs=0.6)
    assert any('do not predict held-out other' in warning for warning in answer.warnings)
    assert answer.probabilities['none'] == 0.0


def test_a_name_states_what_a_held_out_run_keeps():
    """A cause explains the fitted runs; a held-out run has four times of it."""
    runs = [record('a', 0.7, friction=0.5), record('b', 1.1, friction=0.5)]
    answer = diagnose(MODEL, runs, hold_out=[
        record('same', 0.9, friction=0.5), record('other', 1.3, friction=2.0)])
    assert (answer.verdict, answer.complete) == ('named', False)
    assert [(rest.run, rest.along) for rest in answer.remainder] == [('other', '')]
    assert ' of range in force of held-out other fits no cause.' in answer.headline
    assert any('the causes do not predict held-out other' in one for one in answer.warnings)
    assert any('Friction does not keep its size: in held-out other it has 39' in one
               for one in answer.warnings)
    assert 'next test: Fit other too, which the model does not predict.' in answer.summary()
    assert diagnose(MODEL, runs, hold_out=[record('same', 0.9, friction=0.5)]).complete


def test_a_step_that_grows_in_a_held_out_run_is_no_name_for_a_drift():
    """A step took all that a slow drift changes in three runs, and was named with 87 %."""
    def level(values: dict[str, float], run: Run) -> dict[str, np.ndarray]:
        time = np.asarray(run.time)
        return {'level': values['mean'] + values['tide'] * np.sin(0.5 * time)
                + values['datum.step'] * (time > values['datum.at'])}

    model = Model(
        level, {'mean': Parameter(-5, 5), 'tide': Parameter(0, 5)},
        {'datum': Effect('A step', {'step': Parameter(-1, 1), 'at': Parameter(10, 380)})},
        {'level': Channel('m')})

    def run(number: int, step: float, drift: float) -> Run:
        time = 100.0 * number + np.linspace(0.0, 96.0, 480)
        bare = Run(f'run {number}', time, {'hour': time}, {'level': time})
        seen = level({'mean': 0.3, 'tide': 1.6, 'datum.step': step, 'datum.at': 150.0}, bare)
        noise = np.random.default_rng([3, number]).normal(0.0, 0.03, time.size)
        return replace(bare, outputs={
            'level': seen['level'] + drift * (time / 400.0)**2 + noise})

    runs = [run(number, 0.0, 0.05) for number in range(4)]
    answer = diagnose(model, runs[:3], hold_out=runs[3:])
    assert answer.verdict == 'unknown'
    assert any('A step does not keep its size: in held-out run 3' in one
               for one in answer.warnings)
    assert answer.probabilities.get('datum', 0.0) < 0.5
    runs = [run(number, 0.04, 0.0) for number in range(4)]
    assert diagnose(model, runs[:3], hold_out=runs[3:]).verdict == 'named'


def test_a_held_out_run_in_another_unit_is_told_where_no_cause_is_established():
    """The headline stated a rest of 0.1 %, and no sentence the run of which all is left."""
    runs = [record('a', 0.7, friction=0.5), record('b', 1.1, friction=0.5)]
    other = record('other', 0.9, friction=0.5)
    answer = diagnose(MODEL, runs, hold_out=[
        replace(other, outputs={'force': -1000.0 * other.outputs['force']})])
    assert answer.verdict == 'unknown'
    assert ' of range in force of held-out other fits no cause.' in answer.headline
    assert any('the causes do not predict held-out other' in one for one in answer.warnings)


def test_what_the_fitted_runs_do_not_determine_is_no_misfit():
    small = [record('a', 0.7, size=0.03), record('b', 1.1, size=0.03)]
    answer = diagnose(MODEL, small, hold_out=[record('wide', 0.9)])
    predicted = answer.runs[-1]
    assert np.std(predicted.before - predicted.run.channels) > 0.2
    assert (answer.verdict, answer.complete) == ('none', True)


def test_a_ring_is_judged_by_what_validate_allows():
    def run(held_out: bool, misfit: float) -> SimpleNamespace:
        channels = {'delta_x': ChannelMisfit(0.4, misfit, 0.002, 0.004),
                    'parity': ChannelMisfit(0.5, 0.5, 0.1, 0.0)}
        return SimpleNamespace(
            channels=channels, measured=np.array([[0.0, 1e-4]]),
            record=SimpleNamespace(run=SimpleNamespace(name='run', held_out=held_out)))

    units = {'delta_x': 'm'}
    assert not unpredicted([run(True, 0.008), run(False, 0.3)], units)
    [rest] = unpredicted([run(True, 0.3)], units)
    assert (rest.channel, rest.unit) == ('delta_x', 'm')
    assert rest.size == pytest.approx(3e-5)
    assert rest.times_noise == pytest.approx(150)


def test_what_the_other_run_leaves_open_of_the_base_is_no_argument_against_a_cause() -> None:
    """Without the run that moves the damping is open, and a guess of it drowned the bend."""
    chance, time = np.random.default_rng(2), np.linspace(0.0, 10.0, 400)
    load, rate = 5.0 - np.abs(time - 5.0), np.where(time < 5.0, 1.0, -1.0)

    def simulate(p: dict[str, float], run: Run) -> dict[str, np.ndarray]:
        bend = p['bend.size'] * run.inputs['load'] ** 2
        return {'seen': p['gain'] * run.inputs['load'] + p['damping'] * run.inputs['rate'] + bend}

    runs = [Run(name, time, {'load': load, 'rate': moves},
                {'seen': 1.2 * load + 2.5 * moves + 0.01 * load ** 2
                 + chance.normal(0.0, 0.01, time.size)})
            for name, moves in (('static', 0.0 * rate), ('dynamic', rate))]
    model = Model(simulate, base={'gain': Parameter(0.5, 2.0), 'damping': Parameter(0.0, 3.0)},
                  effects={'bend': Effect('Bend', {'size': Parameter(-0.1, 0.1)})},
                  channels={'seen': Channel(noise=Noise.white(0.01))})
    gain = diagnose(model, runs).causes[0].gain
    assert gain.held_out == pytest.approx(gain.fit, abs=0.1)
