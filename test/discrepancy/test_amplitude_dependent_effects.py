"""Claims on effects whose shape depends on their size."""

from dataclasses import replace

import numpy as np

from saddlering_ros.discrepancy import Effect, Parameter
from saddlering_ros.discrepancy.problem.fits import Candidate, Fit
from saddlering_ros.discrepancy.problem.system import Point
from saddlering_ros.discrepancy.search.ranking import best_pairs, rank
from saddlering_ros.discrepancy.search.signatures import Signature, with_amplitude_dependence

TIME = np.linspace(0.0, 1.0, 200)
SWING = Effect('swing', {'period': Parameter(0.0, 1.0)})
GAIN = Effect('gain', {'share': Parameter(0.0, 1.0)})


def swing(period: float) -> np.ndarray:
    return 30.0 * np.sin(2.0 * np.pi * TIME / period)


def signature(effect: Effect, size: float, white: np.ndarray) -> Signature:
    length = float(np.linalg.norm(white))
    return Signature(effect, 0, np.array([size]), size, white, white, 1.0, length, 1.0)


SEEN = with_amplitude_dependence(
    [signature(SWING, period, swing(period)) for period in (0.1, 0.12, 0.2)]
    + [signature(GAIN, share, 100.0 * share * TIME) for share in (0.1, 0.2, 0.4)])


def fit(misfit: np.ndarray) -> Fit:
    empty = np.zeros((TIME.size, 0))
    return Fit(Candidate(), np.zeros(0), float(misfit @ misfit), -misfit, empty, misfit,
               Point(np.zeros(0)))


def best(misfit: np.ndarray) -> tuple[str, float]:
    scores = rank(fit(misfit), np.ones((TIME.size, 1)) / np.sqrt(TIME.size), SEEN)
    return scores[0].effect.id, float(scores[0].start[0])


def test_a_frequency_is_amplitude_dependent_and_a_gain_is_not() -> None:
    assert {item.effect.id for item in SEEN if item.amplitude_dependent} == {'swing'}


def test_an_amplitude_dependent_effect_starts_where_it_was_seen_and_not_at_a_size_scaled() -> None:
    assert best(0.7 * swing(0.12)) == ('swing', 0.12)


def test_a_straight_effect_starts_at_the_size_that_fits() -> None:
    name, start = best(31.0 * (TIME - TIME.mean()))
    assert name == 'gain'
    assert abs(start - 0.31) < 1e-6


def test_no_law_is_tried_beside_one_that_it_contains() -> None:
    """Friction in all rows had a radial force of 40 kN beside that of the radial row, which took
    its place; without the latter it acted, and friction of 435 N seemed to move most (ring 433).
    """
    wide = Effect('gain', GAIN.parameters, ({}, {}), first_variant=1, contains=('swing',))
    seen = [*SEEN, Signature(wide, 1, np.array([0.2]), 0.2, TIME, TIME, 1.0, 8.0, 1.0)]
    misfit = swing(0.12) + 31.0 * (TIME - TIME.mean())

    def beside(effect: Effect, variant: int) -> set[tuple[str, int]]:
        model = replace(fit(misfit), candidate=Candidate(((effect, variant),)))
        return {(score.effect.id, score.variant) for score in rank(
            model, np.ones((TIME.size, 1)) / np.sqrt(TIME.size), seen, [effect.id])}

    assert beside(SWING, 0) == {('gain', 0)}
    assert beside(GAIN, 0) == {('swing', 0)}
    assert beside(wide, 1) == set()
    pairs = best_pairs(fit(misfit), seen, 1.0)
    assert [[(effect.id, variant) for effect, variant in candidate.effects]
            for candidate, _ in pairs] == [[('gain', 0), ('swing', 0)]]
