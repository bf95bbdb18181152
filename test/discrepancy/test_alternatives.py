"""Claims on alternatives: a look-alike leaves the group only by what is known of the noise."""

from __future__ import annotations

from bench import LOAD, recorded, STEP, System
import numpy as np

from saddlering_ros.discrepancy import (
    Cause,
    diagnose_system,
    Effect,
    Parameter,
    Point,
    Problem,
    RestSegment,
    Settings,
)

NOISE = 1e-3
SIZE = 0.042
"""At which the look-alike fits worse, but not by more than a noise of unsure level might make."""


class Bow(System):
    """One channel straight in the load, and two ways in which it may be bent."""

    effects = (
        Effect('square', {'size': Parameter(-0.2, 0.2)}),
        Effect('cube', {'size': Parameter(-0.2, 0.2)}),
    )

    def predict(self, name: str, point: Point) -> np.ndarray:
        size = {name: values['size'] for name, values in point.effects.items()}
        bent = size.get('square', 0.0) * LOAD**2 + size.get('cube', 0.0) * LOAD**3
        return (point.base[0] * LOAD + bent)[None, :]


def found(stretches: int) -> Cause:
    """What is found of a hidden square, the noise known from so many stretches at rest."""
    chance = np.random.default_rng(3)
    seen = Bow().predict('slow', Point(np.ones(1), {'square': {'size': SIZE}}))
    seen = seen + NOISE * chance.normal(size=seen.shape)
    rest = [RestSegment(NOISE * chance.normal(size=(1, 80)), STEP) for _ in range(stretches)]
    exact = Settings(form_error=0.0)
    (cause,) = diagnose_system(Problem(Bow(), [recorded('slow', seen, rest)], exact)).causes
    return cause


def test_a_look_alike_leaves_the_group_only_where_the_noise_is_well_known() -> None:
    assert set(found(6).group) == {'square', 'cube'}
    assert found(100).group == ('square',)
