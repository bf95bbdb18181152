"""Claims on effects that do much less than usual and then look quite different."""

from __future__ import annotations

from bench import LOAD, recorded, System
import numpy as np
import pytest

from saddlering_ros.discrepancy import Cause, diagnose_system, Effect, Parameter, Point, Problem

NOISE = 1e-4


class Stopped(System):
    """One channel straight in the load, less a part that ends at a stop."""

    effects = (
        Effect('stop', {'height': Parameter(0.0, 4.0)}),
        Effect('square', {'size': Parameter(-0.2, 0.2)}),
        Effect(
            'clip',
            {'limit': Parameter(0.1, 3.0, neutral=3.0)},
            starts=tuple({'limit': limit} for limit in (0.3, 0.6, 1.2)),
        ),
    )

    def predict(self, name: str, point: Point) -> np.ndarray:
        height = point.effects.get('stop', {'height': 0.0})['height']
        size = point.effects.get('square', {'size': 0.0})['size']
        seen = point.base[0] * LOAD - 0.3 * np.minimum(LOAD, height) + size * LOAD**2
        limit = point.effects.get('clip', {'limit': 3.0})['limit']
        return np.minimum(seen, limit)[None, :]


def cause_of(effect: str, parameter: str, value: float) -> Cause:
    """The one cause found where that effect is hidden."""
    chance = np.random.default_rng(1)
    seen = Stopped().predict('slow', Point(np.ones(1), {effect: {parameter: value}}))
    seen = seen + NOISE * chance.normal(size=seen.shape)
    (cause,) = diagnose_system(Problem(Stopped(), [recorded('slow', seen)])).causes
    return cause


def test_a_stop_at_a_sixth_of_the_smallest_start_is_found() -> None:
    cause = cause_of('stop', 'height', 0.02)
    assert cause.group == ('stop',)
    assert cause.parameters['height'].value == pytest.approx(0.02, rel=0.1)


def test_a_limit_that_cuts_a_little_is_found() -> None:
    cause = cause_of('clip', 'limit', 0.96)
    assert cause.group == ('clip',)
    assert cause.parameters['limit'].value == pytest.approx(0.96, abs=0.002)


def test_the_limit_of_a_clip_is_told_as_the_clip_and_not_as_its_distance_from_none() -> None:
    chance = np.random.default_rng(1)
    seen = Stopped().predict('slow', Point(np.ones(1), {}))
    run = recorded('slow', seen + NOISE * chance.normal(size=seen.shape))
    found = diagnose_system(Problem(Stopped(), [run]))
    limits = next(item for item in found.observability.limits if item.effect == 'clip')
    assert 0.8 < limits.limit <= limits.best_limit < 1.0  # of a reading that goes to 1
