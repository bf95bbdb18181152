"""Claims on effects that do much less than usual and then look quite different."""

from __future__ import annotations

from collections.abc import Sequence
from types import MappingProxyType

import numpy as np
import pytest

from saddlering_ros.discrepancy import (
    Cause,
    diagnose,
    Effect,
    Parameter,
    Point,
    RestSegment,
    Run,
)

STEP = 0.05
TIME = np.arange(0.0, 20.0, STEP)
LOAD = np.interp(TIME, [0, 4, 12, 20], [0.0, 0.0, 1.0, 0.0])
NOISE = 1e-4


class Stopped:
    """One channel straight in the load, less a part that ends at a stop."""

    channel_names = ('one',)
    views = MappingProxyType({'one': np.array([1.0])})
    base_parameters = (Parameter('slope', 0.5, 2.0),)
    effects = (
        Effect('stop', (Parameter('height', 0.0, 4.0),)),
        Effect('square', (Parameter('size', -0.2, 0.2),)),
        Effect(
            'clip',
            (Parameter('limit', 0.1, 3.0),),
            starts=tuple({'limit': limit} for limit in (0.3, 0.6, 1.2)),
            neutral=3.0,
        ),
    )

    def disturbances(self, runs: Sequence[Run], point: Point) -> list[np.ndarray]:
        return [np.zeros((1, run.time.size, 0)) for run in runs]

    def predict_many(self, run: Run, points: Sequence[Point]) -> np.ndarray:
        return np.array([self.predict(point) for point in points])

    def predict(self, point: Point) -> np.ndarray:
        height = point.effects.get('stop', {'height': 0.0})['height']
        size = point.effects.get('square', {'size': 0.0})['size']
        seen = point.base[0] * LOAD - 0.3 * np.minimum(LOAD, height) + size * LOAD**2
        limit = point.effects.get('clip', {'limit': 3.0})['limit']
        return np.minimum(seen, limit)[None, :]


def cause_of(effect: str, parameter: str, value: float) -> Cause:
    """The one cause found where that effect is hidden."""
    chance = np.random.default_rng(1)
    seen = Stopped().predict(Point(np.ones(1), {effect: {parameter: value}}))
    seen = seen + NOISE * chance.normal(size=seen.shape)
    inputs = {'load': LOAD, 'direction': np.sign(np.gradient(LOAD))}
    rest = (RestSegment(seen[:, TIME < 4.0], STEP),)
    run = Run('slow', 'bench', TIME, np.full(TIME.size, STEP), seen, inputs, rest)
    (cause,) = diagnose(Stopped(), [run]).causes
    return cause


def test_a_stop_at_a_sixth_of_the_smallest_start_is_found() -> None:
    cause = cause_of('stop', 'height', 0.02)
    assert cause.group == ('stop',)
    assert cause.estimates['height'].value == pytest.approx(0.02, rel=0.1)


def test_a_limit_that_cuts_a_little_is_found() -> None:
    cause = cause_of('clip', 'limit', 0.96)
    assert cause.group == ('clip',)
    assert cause.estimates['limit'].value == pytest.approx(0.96, abs=0.002)
