"""Claims on a declared model error: too small is reported, right is none, too large hides."""

from dataclasses import replace

import numpy as np
import pytest
from test_any_simulator import example

from saddlering_ros import discrepancy
from saddlering_ros.discrepancy import (
    Channel,
    check,
    diagnose,
    Effect,
    Model,
    Noise,
    Parameter,
    Run,
)

Sound = tuple[Model, list[Run]]
"""A model and runs that it can only miss by something of which no effect is listed."""


def rippled() -> Sound:
    """A stage with a ripple over its place, too fast for any band of time."""
    def record(name: str, rate: float, seed: int) -> Run:
        time = np.linspace(0.0, 20.0, 600)
        command = 5.0 * np.sin(rate * time) + 2.0 * np.sin(2.3 * rate * time + 1.0)
        position = command + 0.05 * np.sin(9.0 * command)
        position += np.random.default_rng(seed).normal(0.0, 0.01, time.size)
        return Run(name, time, {'command': command}, {'position': position})

    model = Model(
        lambda values, run: {'position': values['gain'] * np.asarray(run.inputs['command'])},
        {'gain': Parameter(0.2, 3.0)}, channels={'position': Channel()})
    return model, [record('a', 0.6, 1), record('b', 1.1, 2)]


def oval_rotor() -> Sound:
    """Two probes at a rotor that runs up, whose shaft is a little oval."""
    def simulate(values: dict[str, float], run: Run) -> dict[str, np.ndarray]:
        speed, angle = (np.asarray(run.inputs[name]) for name in ('speed', 'angle'))
        turned = values['unbalance'] * speed**2 * np.exp(1j * angle) / (
            values['critical']**2 - speed**2 + 20j * speed)
        return {'x': turned.real, 'y': turned.imag}

    def record(name: str, first: float, last: float, seed: int) -> Run:
        time = 0.004 * np.arange(1000)
        speed = np.linspace(first, last, time.size)
        angle = np.cumsum(speed) * 0.004
        run = Run(name, time, {'speed': speed, 'angle': angle}, {'x': time},
                  {'speed': speed, 'turn': angle % (2.0 * np.pi)})
        seen = simulate({'unbalance': 25.0, 'critical': 100.0}, run)
        random = np.random.default_rng(seed)
        return replace(run, outputs={
            name: values + 0.8 * np.cos(2.0 * angle + phase) + 0.3 * random.normal(size=time.size)
            for (name, values), phase in zip(seen.items(), (0.3, 1.1), strict=True)})

    model = Model(simulate, {'unbalance': Parameter(5, 60), 'critical': Parameter(60, 140)},
                  channels={'x': Channel('um'), 'y': Channel('um')})
    return model, [record('up', 40, 130, 1), record('down', 150, 50, 2)]


def wandering() -> Sound:
    """A gain whose error is a bend over the drive and a slow wander over time."""
    def record(number: int) -> Run:
        time = np.linspace(0.0, 20.0, 500)
        drive = np.sin((0.9 + 0.2 * number) * time) + 0.4 * np.sin(2.7 * time + number)
        error = np.sin(0.31 * time * (1 + number)) + np.sin(2.0 * drive + 1.0)
        noise = np.random.default_rng(number).normal(0.0, 0.004, time.size)
        return Run(f'run {number}', time, {'drive': drive},
                   {'seen': 1.2 * drive + 0.05 * error + noise})

    model = Model(lambda values, run: {'seen': values['gain'] * np.asarray(run.inputs['drive'])},
                  {'gain': Parameter(0.5, 2.0)}, channels={'seen': Channel()})
    return model, [record(number) for number in range(3)]


def cogging() -> Sound:
    """The shaft of examples/any_simulator/no_rest.py, whose cogging no catalogue has."""
    module = example('no_rest')
    runs = [module.record(f'run {seed}', seed, module.HIDDEN) for seed in (1, 2)]
    neutral = {'cogging.size': 0.0, 'cogging.phase': 0.0, 'cogging.teeth': 3.0}
    model: Model = replace(
        module.model, effects={'drag': module.model.effects['drag']},
        simulate=lambda values, run: module.simulate({**neutral, **values}, run))
    return model, runs


def declared(model: Model, share: float) -> Model:
    """The model with this error in every channel."""
    return replace(model, channels={
        name: replace(channel, model_error=share) for name, channel in model.channels.items()})


def rms_left(model: Model, runs: list[Run]) -> float:
    """Largest rms residual of the best fit over range, as the manual says how to declare it."""
    fitted = diagnose(declared(model, 0.02), runs).runs
    span = np.max([np.ptp(one.run.channels, axis=1) for one in fitted], axis=0)
    return float(max((np.std(one.before - one.run.channels, axis=1) / span).max()
                     for one in fitted))


@pytest.mark.parametrize('sound', [rippled, oval_rotor, wandering, cogging])
def test_a_model_error_declared_too_small_is_reported_and_no_other_is(sound) -> None:
    model, runs = sound()
    right = rms_left(model, runs)
    for share in (1e-6, 0.6 * right):
        answer = diagnose(declared(model, share), runs)
        assert answer.verdict == 'unknown'
        assert answer.remainder[0].share_of_range > share
        assert any('more than the declared model error of' in one for one in answer.warnings)
    for share in (right, 0.5):
        answer = diagnose(declared(model, share), runs)
        assert (answer.verdict, answer.complete) == ('none', True)
        assert answer.warnings == ()


def test_a_rest_over_all_bands_together_is_not_below_the_declared_model_error() -> None:
    """Two waves of 1 % of range, one slow and one fast, are 1.4 %; noise takes a part of them."""
    def record(number: int) -> Run:
        time = np.linspace(0.0, 20.0, 1000)
        drive = np.sin((0.9 + 0.2 * number) * time)
        error = np.sin((2.0 + 0.3 * number) * time) + np.sin((9.0 + number) * time)
        noise = np.random.default_rng(number).normal(0.0, 0.004, time.size)
        return Run(f'run {number}', time, {'drive': drive}, {'seen': drive + 0.03 * error + noise})

    model = replace(wandering()[0], channels={'seen': Channel(model_error=0.0105)})
    answer = diagnose(model, [record(number) for number in range(3)])
    assert answer.verdict == 'unknown'
    assert answer.remainder[0].share_of_range > 0.0115


@pytest.mark.parametrize('share', [0.0, 0.002, 0.05])
@pytest.mark.parametrize('std', [0.0005, 0.004, 0.02, None])
def test_the_check_compares_the_misfit_with_the_declared_noise_alone(std, share) -> None:
    """A misfit of 5 % of range is not about the noise, whatever model error is declared."""
    model, runs = wandering()
    noise = Noise.unknown() if std is None else Noise.white(std)
    bent = [replace(run, outputs={'seen': run.outputs['seen'] + 0.15 * np.sin(
        0.7 * run.time) ** 3}) for run in runs]
    model = replace(model, channels={'seen': Channel(noise=noise, model_error=share)})
    for line, run in zip([line for line in check(model, bent) if ' times the noise, ' in line],
                         bent, strict=True):
        times, size = (float(part.split()[-1]) for part in (
            line.split(' times ')[0], line.split(' % of range')[0]))
        span = max(float(np.ptp(one.outputs['seen'])) for one in bent)
        assert size > 2.5, run.name
        # Noise that is learnt holds what is fast of the misfit.
        noise = std or 0.01 * size * span / max(times, 10.0)
        assert times == pytest.approx(0.01 * size * span / noise, rel=0.05)


def test_what_remains_is_compared_with_the_noise_without_declared_model_error() -> None:
    model, runs = wandering()
    plain, answer = (diagnose(declared(model, share), runs) for share in (0.0, 0.008))
    times = plain.remainder[0].times_noise
    assert times > 3.0
    assert answer.remainder[0].times_noise == pytest.approx(times, rel=0.2)


def test_a_cause_that_the_declared_error_hides_makes_none_no_less_sure() -> None:
    model, runs = wandering()
    listed = discrepancy.Effect('Step', {'size': Parameter(0.0, 1.0)})

    def simulate(values: dict[str, float], run: Run) -> dict[str, np.ndarray]:
        drive = np.asarray(run.inputs['drive'])
        return {'seen': values['gain'] * drive + values['step.size'] * np.tanh(50.0 * drive)}

    model = replace(declared(model, 0.05), simulate=simulate, effects={'step': listed})
    steps = [0.08 * np.tanh(50.0 * np.asarray(run.inputs['drive'])) for run in runs]
    answer = diagnose(model, [replace(run, outputs={'seen': run.outputs['seen'] + step})
                              for run, step in zip(runs, steps, strict=True)])
    assert answer.verdict == 'none'
    assert answer.probabilities['none'] > 0.8
    assert not [reason for reason in answer.near_limit if 'the evidence' in reason]


@pytest.mark.parametrize(('share', 'verdict'), [(1.0, 'named'), (0.4, 'unknown')])
def test_what_acts_on_the_channels_in_other_shares_is_no_cause_beside_a_declared_error(
    share: float, verdict: str,
) -> None:
    """What was left was under the declared error, and a displaced sensor was a slow heater."""
    def bench(values: dict[str, float], run: Run) -> dict[str, np.ndarray]:
        force = np.asarray(run.inputs['force'])
        bent = values['bend.size'] * force**3
        return {'near': values['near'] * force + bent, 'far': values['far'] * force + bent}

    def recording(number: int) -> Run:
        time, random = np.linspace(0.0, 20.0, 400), np.random.default_rng(number)
        force = np.sin((0.7 + 0.3 * number) * time) + 0.4 * np.sin(2.3 * time + number)
        seen = {name: base * force + own * force**3 + random.normal(0.0, 0.02, time.size)
                for name, base, own in (('near', 2.0, 0.2), ('far', 1.5, 0.2 * share))}
        return Run(f'run {number}', time, {'force': force}, seen)

    channel = Channel('mm', offset='free', model_error=0.01)
    model = Model(
        bench, {'near': Parameter(0, 5), 'far': Parameter(0, 5)},
        {'bend': Effect('Bending', {'size': Parameter(-2, 2)})},
        {'near': channel, 'far': channel})
    answer = diagnose(model, [recording(0), recording(1)], hold_out=[recording(2)])
    assert answer.verdict == verdict
    assert any('is fitted for each channel' in one for one in answer.warnings) == (share < 1.0)
