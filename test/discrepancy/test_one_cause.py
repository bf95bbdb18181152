"""Claims on one cause that two others, found one after the other, could share between them."""

from __future__ import annotations

from collections.abc import Sequence
from types import MappingProxyType

import numpy as np
import pytest

from saddlering_ros.discrepancy import (
    diagnose,
    Effect,
    engine,
    Parameter,
    Point,
    RestSegment,
    Run,
)
from saddlering_ros.discrepancy.refit import Fit

STEP = 0.05
TIME = np.arange(0.0, 20.0, STEP)
LOAD = np.interp(TIME, [0, 4, 12, 20], [0.0, 0.0, 1.0, 0.0])
NOISE = 1e-3
SHAPES = {'square': LOAD**2, 'cube': LOAD**3, 'both': LOAD**2 - 2.0 * LOAD**3}


class Bow:
    """One channel straight in the load, bent by a square, a cube, or by one thing that is both."""

    channel_names = ('one',)
    views = MappingProxyType({'one': np.array([1.0])})
    base_parameters = (Parameter('slope', 0.5, 2.0),)
    effects = tuple(Effect(name, (Parameter('size', -0.5, 0.5),)) for name in SHAPES)

    def disturbances(self, runs: Sequence[Run], point: Point) -> list[np.ndarray]:
        return [np.zeros((1, run.time.size, 0)) for run in runs]

    def predict_many(self, run: Run, points: Sequence[Point]) -> np.ndarray:
        return np.array([self.predict(point) for point in points])

    def predict(self, point: Point) -> np.ndarray:
        bent = [values['size'] * SHAPES[name] for name, values in point.effects.items()]
        return (point.base[0] * LOAD + sum(bent))[None, :]


def test_one_effect_takes_the_place_of_two_that_fit_no_better(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    search = engine._Session.forward

    def misled(session: engine._Session, fit: Fit) -> Fit:
        """A search that never tries what is both, from the base."""
        if fit.candidate.effects:
            return search(session, fit)
        for name in ('square', 'cube'):
            scores = [score for score in session.scores(fit) if score.effect.id == name]
            fit = session.fit_with(fit, scores)[0]
        return fit

    monkeypatch.setattr(engine._Session, 'forward', misled)
    chance = np.random.default_rng(3)
    seen = Bow().predict(Point(np.ones(1), {'both': {'size': 0.2}}))
    seen = seen + NOISE * chance.normal(size=seen.shape)
    rest = (RestSegment(seen[:, TIME < 4.0], STEP),)
    inputs = {'load': LOAD, 'direction': np.sign(np.gradient(LOAD))}
    run = Run('slow', 'bench', TIME, np.full(TIME.size, STEP), seen, inputs, rest)
    (cause,) = diagnose(Bow(), [run]).causes
    assert cause.effect.id == 'both'
    assert cause.estimates['size'].value == pytest.approx(0.2, rel=0.1)
