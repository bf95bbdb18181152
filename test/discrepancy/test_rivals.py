"""Claims on rivals: a look-alike leaves the group only by what is known of the noise."""

from __future__ import annotations

from collections.abc import Sequence
from types import MappingProxyType

import numpy as np

from saddlering_ros.discrepancy import (
    Cause,
    diagnose,
    Effect,
    Parameter,
    Point,
    RestSegment,
    Run,
    Settings,
)

STEP = 0.05
TIME = np.arange(0.0, 20.0, STEP)
LOAD = np.interp(TIME, [0, 4, 12, 20], [0.0, 0.0, 1.0, 0.0])
NOISE = 1e-3
SIZE = 0.042
"""At which the look-alike fits worse, but not by more than a noise of unsure level might make."""


class Bow:
    """One channel straight in the load, and two ways in which it may be bent."""

    channel_names = ('one',)
    views = MappingProxyType({'one': np.array([1.0])})
    base_parameters = (Parameter('slope', 0.5, 2.0),)
    effects = (
        Effect('square', (Parameter('size', -0.2, 0.2),)),
        Effect('cube', (Parameter('size', -0.2, 0.2),)),
    )

    def disturbances(self, runs: Sequence[Run], point: Point) -> list[np.ndarray]:
        return [np.zeros((1, run.time.size, 0)) for run in runs]

    def predict_many(self, run: Run, points: Sequence[Point]) -> np.ndarray:
        return np.array([self.predict(point) for point in points])

    def predict(self, point: Point) -> np.ndarray:
        size = {name: values['size'] for name, values in point.effects.items()}
        bent = size.get('square', 0.0) * LOAD**2 + size.get('cube', 0.0) * LOAD**3
        return (point.base[0] * LOAD + bent)[None, :]


def found(stretches: int) -> Cause:
    """What is found of a hidden square, the noise known from so many stretches at rest."""
    chance = np.random.default_rng(3)
    seen = Bow().predict(Point(np.ones(1), {'square': {'size': SIZE}}))
    seen = seen + NOISE * chance.normal(size=seen.shape)
    rest = [RestSegment(NOISE * chance.normal(size=(1, 80)), STEP) for _ in range(stretches)]
    inputs = {'load': LOAD, 'direction': np.sign(np.gradient(LOAD))}
    run = Run('slow', 'bench', TIME, np.full(TIME.size, STEP), seen, inputs, tuple(rest))
    exact = Settings(form_error=0.0)
    (cause,) = diagnose(Bow(), [run], exact).causes
    return cause


def test_a_look_alike_leaves_the_group_only_where_the_noise_is_well_known() -> None:
    assert set(found(6).group) == {'square', 'cube'}
    assert found(100).group == ('square',)
