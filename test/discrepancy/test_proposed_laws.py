"""Claims on laws proposed for a misfit that nothing in the catalogue explains."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from saddlering_ros.diagnosis.proposed_law import proposal_document
from saddlering_ros.discrepancy.law import families
from saddlering_ros.discrepancy.law.families import MEMORY, Misfit, ObservedRun, PLAY, Products
from saddlering_ros.discrepancy.law.proposal import LawProposal, propose_law
from saddlering_ros.memory_operators import direction_of
from saddlering_ros.report import figures

NOISE = 0.02
TIME = np.arange(300) * 0.05


def run(name: str, added, seed: int, peak: float = 1.0, speed: float = 1.0) -> ObservedRun:
    """Two channels, the law in the first alone; a base parameter scales the load in both."""
    time = TIME / speed
    load = peak * np.interp(time, np.array([0.0, 1.0, 7.0, 14.0]) / speed, [0.0, 0.0, 1.0, 0.0])
    coordinates = {
        'load': load,
        'time': time,
        'direction': direction_of(load, 0.01),
        'rate': np.gradient(load, time)}
    noise = np.random.default_rng(seed).normal(size=(2, time.size)) * NOISE
    residual = noise + 0.3 * load
    residual[0] += added(coordinates)
    slopes = np.repeat(load[None, :, None], 2, axis=0)
    targets = {
        'one': np.repeat([[1.0], [0.0]], time.size, axis=1),
        'two': np.repeat([[0.0], [1.0]], time.size, axis=1)}
    return ObservedRun(name, coordinates, targets, residual, slopes)


def proposed(added, **held):
    others = [run('held', added, 9, **held)] if held else []
    return law_of([run(f'run {k}', added, k, speed=(1.0, 3.0)[k % 2]) for k in range(3)], others)


def law_of(fitted: list[ObservedRun], held_out: Sequence[ObservedRun] = ()):
    def mean_square(_: ObservedRun, residual: np.ndarray) -> float:
        return float(np.mean((residual - residual.mean(axis=1, keepdims=True)) ** 2))

    def products_with(white: np.ndarray) -> Products:
        return lambda plain: (plain.T @ plain / NOISE**2, plain.T @ white / NOISE)

    misfit = Misfit(tuple(fitted), lambda columns: columns / NOISE, products_with, 1000)
    return propose_law(misfit, mean_square, held_out)


LAWS = {
    'step': (lambda c: 0.2 * (0.5 + 0.5 * np.tanh((c['load'] - 0.6) / 0.03)), 'load'),
    'sine': (lambda c: 0.2 * np.sin(2.0 * np.pi * c['load'] / 0.3), 'load'),
    'dead zone': (lambda c: 0.8 * np.maximum(c['load'] - 0.55, 0.0), 'load'),
    'power': (lambda c: 0.3 * np.sqrt(c['load']), 'load'),
    'constant': (lambda c: 0.1 * c['direction'], 'direction'),
    'play': (
        lambda c: 0.12 * families.remembered(PLAY, c, np.array([0.12]))[:, 0], 'hysteresis'),
    'exponential memory': (
        lambda c: families.remembered(MEMORY, c, np.array([1.0]))[:, 0], 'rate')}


@pytest.mark.parametrize('law', LAWS)
def test_a_simple_law_is_found_by_its_coordinate_and_name(law: str) -> None:
    added, coordinate = LAWS[law]
    found = proposed(added)
    assert found is not None
    assert (found.terms[0].target, found.terms[0].coordinate) == ('one', coordinate)
    assert found.terms[0].law == law
    assert found.fit > 0.8


@pytest.mark.parametrize(('law', 'over', 'at_unit', 'unit'), [
    ('play', 'reach', 'N', 'm'), ('exponential memory', 'lag', 's', 'm/N')])
def test_a_law_that_remembers_the_load_is_told_and_drawn_by_its_weight(law, over, at_unit, unit):
    found = proposed(LAWS[law][0])
    assert found is not None
    size, reach = found.terms[0].parameters.values()
    [term] = proposal_document(found, ())['terms']
    curve = term['curve']
    assert (curve['over'], curve['at_unit'], curve['unit']) == (over, at_unit, unit)
    assert (curve['at'], curve['values'], curve['std']) == (
        [reach.value], [size.value], [size.std])
    assert [one['unit'] for one in term['parameters'].values()] == [unit, at_unit]
    weight, spread = figures.proposed_law(term, 't').panels[0].series
    assert weight.marker == 'o'
    assert np.isfinite(spread.y).sum() == 2


def test_the_parameters_of_a_step_lie_in_their_intervals() -> None:
    found = proposed(LAWS['step'][0])
    for name, true in {'size': 0.2, 'at': 0.6, 'width': 0.03}.items():
        item = found.terms[0].parameters[name]
        assert abs(item.value - true) < 4.0 * item.std
        assert item.std < 0.2 * true


def test_a_curve_that_is_no_simple_law_comes_with_its_band() -> None:
    def added(c):
        return 0.3 * np.sin(7.0 * c['load']) * np.exp(-2.0 * c['load']) + 0.2 * c['load'] ** 3

    term = proposed(added).terms[0]
    truth = added({'load': term.at})
    left = (term.values - truth) - np.polyval(np.polyfit(term.at, term.values - truth, 1), term.at)
    assert term.law == 'curve'
    assert np.abs(left).max() < 0.03
    assert 0.0 < np.median(term.band) < 0.02


def test_noise_alone_gets_no_proposal() -> None:
    assert proposed(lambda c: 0.0 * c['load']) is None


def test_what_it_is_worth_is_measured_on_a_run_held_out() -> None:
    found = proposed(LAWS['step'][0], speed=2.0)
    assert found.held_out > 0.8


def test_a_held_out_load_outside_the_range_seen_is_a_doubt() -> None:
    found = proposed(LAWS['step'][0], peak=1.3)
    assert any('outside the fitted range' in doubt for doubt in found.doubts)


def test_coordinates_that_go_together_are_a_doubt() -> None:
    def ramp(name: str, seed: int) -> ObservedRun:
        one = run(name, lambda c: 0.0 * c['load'], seed)
        load = TIME / TIME[-1]
        coordinates = {**one.coordinates, 'load': load, 'rate': np.zeros(TIME.size),
                       'direction': np.ones(TIME.size)}
        residual = one.residual * [[0.0], [1.0]] + np.array([[1.0], [0.0]]) * (
            np.random.default_rng(seed).normal(size=TIME.size) * NOISE + 0.3 * load**4)
        return ObservedRun(name, coordinates, one.targets, residual, one.slopes)

    found = law_of([ramp('a', 1), ramp('b', 2)])
    assert any('within 10 %' in doubt for doubt in found.doubts)
    assert any('all runs have one rate' in doubt for doubt in found.doubts)


def test_targets_that_go_together_are_a_doubt() -> None:
    def beside(name: str, seed: int) -> ObservedRun:
        one = run(name, LAWS['step'][0], seed)
        nearly = one.targets['one'] + 0.02 * one.targets['two']
        return replace(one, targets={**one.targets, 'nearly one': nearly})

    found = law_of([beside('a', 1), beside('b', 2)])
    told = {found.terms[0].target, *(name for name in ('one', 'nearly one', 'two') if any(
        f'an addition to {name} explains nearly as much' in doubt for doubt in found.doubts))}
    assert told == {'one', 'nearly one'}


def test_a_held_out_run_that_gets_worse_is_a_doubt() -> None:
    step = LAWS['step'][0]
    other = run('held', lambda coordinates: -step(coordinates), 9)
    found = law_of([run(f'run {k}', step, k) for k in range(3)], [other])
    assert 'the law makes held (held out) worse' in found.doubts
    assert found.held_out < 0.0


def test_a_gain_is_that_of_the_rms_and_a_run_that_gets_worse_is_stated() -> None:
    law = LawProposal((), share=0.0, p_value=0.0, reasons=()).judged_by(
        {'a': (4.0, 1.0)}, {'b': (1.0, 2.25)})
    assert (law.fit, law.held_out, law.worse) == (0.5, -0.5, ('b (held out)',))
