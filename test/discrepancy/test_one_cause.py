"""Claims on one cause that two others, found one after the other, could share between them."""

from __future__ import annotations

from bench import LOAD, recorded, System
import numpy as np
import pytest

from saddlering_ros.discrepancy import diagnose_system, Effect, Parameter, Point, Problem
from saddlering_ros.discrepancy.problem.fits import Fit
from saddlering_ros.discrepancy.search import selection
from saddlering_ros.discrepancy.search.evidence import SearchLog
from saddlering_ros.discrepancy.search.space import fit_each, ModelSpace

NOISE = 1e-3
SHAPES = {'square': LOAD**2, 'cube': LOAD**3, 'both': LOAD**2 - 2.0 * LOAD**3}


class Bow(System):
    """One channel straight in the load, bent by a square, a cube, or by one thing that is both."""

    effects = tuple(Effect(name, {'size': Parameter(-0.5, 0.5)}) for name in SHAPES)

    def predict(self, name: str, point: Point) -> np.ndarray:
        bent = [values['size'] * SHAPES[name] for name, values in point.effects.items()]
        return (point.base[0] * LOAD + sum(bent))[None, :]


def test_one_effect_takes_the_place_of_two_that_fit_no_better(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    search = selection.forward

    def misled(space: ModelSpace, fit: Fit, log: SearchLog) -> Fit:
        """A search that never tries what is both, from the base."""
        if fit.candidate.effects:
            return search(space, fit, log)
        for name in ('square', 'cube'):
            scores = [score for score in space.scores(fit) if score.effect.id == name]
            fit = fit_each(space, fit, scores)[0]
        return fit

    monkeypatch.setattr(selection, 'forward', misled)
    chance = np.random.default_rng(3)
    seen = Bow().predict('slow', Point(np.ones(1), {'both': {'size': 0.2}}))
    seen = seen + NOISE * chance.normal(size=seen.shape)
    (cause,) = diagnose_system(Problem(Bow(), [recorded('slow', seen)])).causes
    assert cause.effect == 'both'
    assert cause.parameters['size'].value == pytest.approx(0.2, rel=0.1)
