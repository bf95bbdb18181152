"""Claims on readings in another unit than the simulator's, and on a simulator that never moves."""

from collections.abc import Callable
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
    Parameter,
    Run,
)

TIME = np.linspace(0.0, 8.0, 500)


def axis(parameters: dict[str, float], run: Run) -> dict[str, np.ndarray]:
    """The force that moves an axis, and its heat, which no friction changes."""
    speed, acceleration = (np.asarray(run.inputs[name]) for name in ('speed', 'acceleration'))
    force = parameters['mass'] * acceleration + parameters['viscous'] * speed
    return {'force': force + parameters['coulomb.force'] * np.tanh(speed / 0.002),
            'heat': parameters['loss'] * speed**2}


def still(channel: str) -> Callable[..., dict[str, np.ndarray]]:
    return lambda parameters, run: {**axis(parameters, run), channel: np.zeros(run.time.size)}


def model(simulate: Callable[..., dict[str, np.ndarray]] = axis) -> Model:
    return Model(
        simulate,
        {'mass': Parameter(80, 110), 'viscous': Parameter(0, 600), 'loss': Parameter(1, 9)},
        {'coulomb': Effect('Coulomb friction', {'force': Parameter(0, 60)})},
        {'force': Channel(unit='N'), 'heat': Channel(unit='W', offset='free')}, time_unit='s')


def record(turns: float, friction: float = 0.0, **factors: float) -> Run:
    """A run whose channels are `factors` times what the axis does."""
    speed = np.sin(turns * TIME)
    inputs = {'speed': speed, 'acceleration': np.gradient(speed, TIME)}
    run = Run(f'at {turns:g}', TIME, inputs, {'force': TIME, 'heat': TIME})
    true = axis({'mass': 95, 'viscous': 200, 'coulomb.force': friction, 'loss': 4}, run)
    random = np.random.default_rng(int(10 * turns))
    noise = {'force': 1.0, 'heat': 0.05}
    return replace(run, outputs={
        name: factors.get(name, 1.0) * (values + random.normal(0.0, noise[name], TIME.size))
        for name, values in true.items()})


def found(simulate: Callable[..., dict[str, np.ndarray]] = axis,
          friction: float = 0.0, **factors: float) -> Diagnosis:
    return diagnose(model(simulate), [record(turns, friction, **factors) for turns in (1.0, 2.5)])


def notes(answer: Diagnosis) -> list[str]:
    return [sentence for sentence in answer.warnings if 'check' in sentence]


@pytest.mark.parametrize('factor', [1000.0, 57.2958, 9.81, 0.1, 1e-3, -1.0])
def test_readings_in_another_unit_get_one_note_on_the_unit_and_no_name(factor: float) -> None:
    answer = found(force=factor)
    assert answer.verdict == 'unknown'
    [note] = notes(answer)
    assert note.startswith('force: the readings are about ')
    assert 'the unit' in note
    # The bounds of mass leave a factor open from 80 / 95 to 110 / 95.
    assert float(note.split()[5]) / factor == pytest.approx(1.0, rel=0.2)


@pytest.mark.parametrize('factor', [1e3, 1e-3])
def test_friction_beside_another_unit_changes_no_note(factor: float) -> None:
    answer = found(friction=20.0, heat=factor)
    assert answer.verdict == 'unknown'
    [note] = notes(answer)
    assert note.startswith('heat: the readings are')


def test_a_simulator_that_never_moves_is_told() -> None:
    answer = found(still('force'))
    assert answer.verdict == 'unknown'
    [note] = notes(answer)
    assert note.startswith('force: the simulator gives one value throughout each run, whatever')


def test_a_channel_that_never_moves_hides_no_other_unit() -> None:
    answer = found(still('heat'), force=1000.0)
    assert [note.split(':')[0] for note in notes(answer)] == ['heat', 'force']


def test_a_check_tells_the_unit_before_a_diagnosis() -> None:
    lines = check(model(), [record(turns, force=1000.0) for turns in (1.0, 2.5)])
    assert any('force: the readings are about ' in line for line in lines)


@pytest.mark.parametrize('friction', [0.0, 20.0, 60.0])
def test_readings_in_the_right_unit_get_no_note(friction: float) -> None:
    answer = found(friction=friction)
    assert answer.verdict == ('named' if friction else 'none')
    assert not notes(answer)
    assert not any('the readings are' in line for line in check(
        model(), [record(turns, friction) for turns in (1.0, 2.5)]))


def held(force: np.ndarray) -> np.ndarray:
    return force[np.arange(force.size) // 7 * 7]


def limited(force: np.ndarray) -> np.ndarray:
    return np.clip(force, -150.0, 150.0)


def frozen(force: np.ndarray) -> np.ndarray:
    return np.where(abs(np.arange(force.size) - 200) < 30, force[170], force)


def begun_again(force: np.ndarray) -> np.ndarray:
    return np.mod(force + 200.0, 360.0)


def rounded(force: np.ndarray) -> np.ndarray:
    return 25.0 * np.round(force / 25.0)


def bent(force: np.ndarray) -> np.ndarray:
    return rounded(force + 0.01 * force**2)


@pytest.mark.parametrize(('spoil', 'words'), [
    (held, 'each reading is repeated: if the channel is slower'),
    (limited, 'give NaN where the sensor stood still or was at its limit'),
    (frozen, 'give NaN where the sensor stood still or was at its limit'),
    (begun_again, 'unwrap an angle'), (rounded, None), (bent, None)])
def test_readings_that_stand_still_or_begin_again_are_said_to(
        spoil: Callable[[np.ndarray], np.ndarray], words: str | None) -> None:
    """An angle that began again was said to be noise that wanders by 130 degrees."""
    runs = [record(turns) for turns in (1.0, 2.5)]
    answer = diagnose(model(), [
        replace(run, outputs={**run.outputs, 'force': spoil(run.outputs['force'])})
        for run in runs])
    said = [item for item in answer.warnings
            if 'is repeated' in item or 'repeat the' in item or 'unwrap' in item]
    assert [words in item for item in said] == [True] if words else not said
