"""Claims on a misfit that is as random as noise slower than what noise is learnt from."""

from dataclasses import replace

import numpy as np
import pytest

from saddlering_ros.discrepancy import (
    Channel,
    diagnose,
    Diagnosis,
    DiscrepancyError,
    Effect,
    Model,
    Noise,
    Parameter,
    Run,
)
from saddlering_ros.estimation.record_noise import ChannelRecord, relaxation_of

TIME = np.linspace(0.0, 20.0, 1000)
STEP = float(TIME[1])
TAU = 20 * STEP
STD = 0.1


def beam(parameters: dict[str, float], run: Run) -> dict[str, np.ndarray]:
    """The bending of a beam that stiffens, under a force that moves along it."""
    force, place = (np.asarray(run.inputs[name]) for name in ('force', 'place'))
    bending = force * place**2 * (3.0 - place) / parameters['stiffness']
    return {'tip': bending * (1.0 + parameters['stiffening.size'] * force**2)}


MODEL = Model(
    beam, {'stiffness': Parameter(0.5, 2.0)},
    {'stiffening': Effect('Stiffening', {'size': Parameter(-0.01, 0.01)})},
    {'tip': Channel(unit='mm', offset='free')}, time_unit='s')


def relaxing(random: np.random.Generator, tau: float) -> np.ndarray:
    keep = np.exp(-STEP / tau)
    steps = random.normal(0.0, STD * np.sqrt(1.0 - keep**2), TIME.size)
    values = np.zeros(TIME.size)
    values[0] = random.normal(0.0, STD)
    for number in range(1, TIME.size):
        values[number] = keep * values[number - 1] + steps[number]
    return values


def record(number: int, seed: int, size: float = 0.0, tau: float = TAU) -> Run:
    inputs = {'force': 8 * np.sin((0.8 + 0.37 * number) * TIME) + 2 * np.sin(2.9 * TIME),
              'place': 0.5 + 0.4 * np.sin(0.31 * TIME + number)}
    run = Run(f'run {number}', TIME, inputs, {'tip': TIME})
    true = beam({'stiffness': 1.0, 'stiffening.size': size}, run)['tip']
    noise = relaxing(np.random.default_rng([seed, number]), tau)
    return replace(run, outputs={'tip': true + noise})


def found(seed: int, model: Model = MODEL, size: float = 0.0, tau: float = TAU) -> Diagnosis:
    return diagnose(model, [record(number, seed, size, tau) for number in (0, 1)])


def notes(answer: Diagnosis) -> list[str]:
    return [sentence for sentence in answer.warnings if 'random' in sentence]


def test_the_relaxation_of_a_residual_has_its_time_and_level() -> None:
    values = relaxing(np.random.default_rng(1), TAU)
    noise = relaxation_of(ChannelRecord('a', TIME, values))
    assert noise.time_constants[0] == pytest.approx(TAU, rel=0.4)
    assert noise.variances(np.array([1.0]))[0] ** 0.5 == pytest.approx(STD, rel=0.4)


@pytest.mark.parametrize('seed', [1, 2, 4])
def test_a_misfit_as_random_as_slow_noise_is_unknown_with_a_note_and_open_chances(seed) -> None:
    answer = found(seed)
    assert answer.verdict == 'unknown'
    [note] = notes(answer)
    assert 'tip' in note
    assert 'Noise.spectrum' in note
    assert float(note.split('correlation time of about ')[1].split(' ms')[0]) == pytest.approx(
        1000 * TAU, rel=0.5)
    assert answer.probabilities == {'none': 0.5, 'unknown': 0.5}


def test_slow_noise_that_is_declared_as_the_note_says_is_no_misfit() -> None:
    frequency = np.geomspace(0.01, 20.0, 60)
    density = 4.0 * STD**2 * TAU / (1.0 + (2.0 * np.pi * frequency * TAU) ** 2)
    declared = Channel(unit='mm', offset='free', noise=Noise.spectrum(frequency, density))
    answer = found(1, replace(MODEL, channels={'tip': declared}))
    assert answer.verdict == 'none'


@pytest.mark.parametrize(('size', 'words', 'verdict'), [
    (0.0, 'the misfit is as random as', 'none'), (0.002, 'what Stiffening leaves is', 'named')])
def test_noise_that_wanders_is_noted_with_a_declaration_that_makes_it_no_misfit(
    size: float, words: str, verdict: str,
) -> None:
    """A sound machine was unknown, and so was a cause, and no sentence said why."""
    def wandering(number: int) -> Run:
        run, random = record(number, 1, size, tau=1e-9), np.random.default_rng([8, number])
        walk = 0.1 * np.cumsum(random.normal(0.0, STEP**0.5, TIME.size))
        return replace(run, outputs={'tip': run.outputs['tip'] + walk})

    runs = [wandering(number) for number in (0, 1, 2)]
    answer = diagnose(MODEL, runs)
    assert answer.verdict == 'unknown'
    [note] = notes(answer)
    assert note.startswith(words)
    walk = float(note.split('tip: Noise.unknown(walk=')[1].split(')')[0])
    assert walk == pytest.approx(0.1, rel=0.4)
    declared = Channel(unit='mm', offset='free', noise=Noise.unknown(walk=walk))
    assert diagnose(replace(MODEL, channels={'tip': declared}), runs).verdict == verdict


def test_a_walk_that_is_no_number_is_refused() -> None:
    with pytest.raises(DiscrepancyError, match='walk is -1'):
        Noise.unknown(walk=-1.0)


def test_a_misfit_that_follows_an_input_has_no_such_note() -> None:
    def bare(parameters: dict[str, float], run: Run) -> dict[str, np.ndarray]:
        return beam({**parameters, 'stiffening.size': 0.0}, run)
    answer = found(1, replace(MODEL, simulate=bare, effects={}), size=0.002)
    assert answer.verdict == 'unknown'
    assert not notes(answer)


def test_what_changes_sign_with_the_direction_of_an_input_is_no_slow_noise() -> None:
    """Dry friction that is in no catalogue looked as random as noise that lasts."""
    def rubbed(number: int) -> Run:
        run = record(number, seed=4, tau=1e-9)
        sign = np.sign(np.gradient(np.asarray(run.inputs['force'])))
        return replace(run, outputs={'tip': run.outputs['tip'] + 0.15 * sign})

    answer = diagnose(MODEL, [rubbed(number) for number in (0, 1)])
    assert answer.verdict == 'unknown'
    assert {rest.along for rest in answer.remainder} == {'the direction of force'}
    assert not any('as random as noise' in words for words in answer.warnings)
