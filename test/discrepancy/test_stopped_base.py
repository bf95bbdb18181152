"""Claims on base parameters that go to a bound because the cause is not in the model yet."""

from __future__ import annotations

from bench import LOAD, recorded, STEP, System
import numpy as np
import pytest

from saddlering_ros.discrepancy import diagnose_system, Effect, Parameter, Point, Problem

RATE = np.gradient(LOAD, STEP)
NOISE = 1e-4
POWERS = range(2, 11)
"""Of the load: more effects than are refitted in a step."""


class Dragged(System):
    """One channel straight in the load, and dragged in proportion to its rate."""

    base_parameters = (
        Parameter(0.5, 2.0, name='slope'),
        Parameter(1e-6, 1.0, start=0.5, name='drag'),
    )
    effects = (
        Effect('turning', {'share': Parameter(0.0, 1.0)}),
        *(Effect(f'power_{power}', {'size': Parameter(-0.2, 0.2)}) for power in POWERS),
    )

    def predict(self, name: str, point: Point) -> np.ndarray:
        share = point.effects.get('turning', {'share': 0.0})['share']
        seen = point.base[0] * LOAD + point.base[1] * (1.0 - 3.0 * share * LOAD) * RATE
        for power in POWERS:
            size = point.effects.get(f'power_{power}', {'size': 0.0})['size']
            seen = seen + size * LOAD**power
        return seen[None, :]


def test_an_effect_that_does_nothing_at_that_bound_is_found_all_the_same() -> None:
    """A drag that turns round with load sends one without it to nothing, where it has no share."""
    chance = np.random.default_rng(1)
    seen = Dragged().predict('slow', Point(np.array([1.0, 0.5]), {'turning': {'share': 0.9}}))
    run = recorded('slow', seen + NOISE * chance.normal(size=seen.shape))
    found = diagnose_system(Problem(Dragged(), [run]))
    (cause,) = found.causes
    assert cause.group == ('turning',)
    assert cause.parameters['share'].value == pytest.approx(0.9, rel=0.05)
    assert found.base_alone['drag'].value == pytest.approx(0.0, abs=1e-3)
