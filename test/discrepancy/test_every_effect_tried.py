"""Claims on causes of a small first-order gain at the base fit, which are tried all the same."""

from __future__ import annotations

from bench import LOAD, recorded, System
import numpy as np
import pytest

from saddlering_ros.discrepancy import diagnose_system, Effect, Parameter, Point, Settings

NOISE = 1e-3


def kink(place: float) -> np.ndarray:
    return np.maximum(0.0, LOAD - place)


class Stop(System):
    """One channel straight in the load, with a kink somewhere, or one at a half."""

    effects = (
        Effect('somewhere', {'size': Parameter(-0.5, 0.5), 'place': Parameter(0.0, 1.0)},
               starts=({'size': 0.1, 'place': 0.15},)),
        Effect('at a half', {'size': Parameter(-0.5, 0.5)}),
    )

    def predict(self, name: str, point: Point) -> np.ndarray:
        bent = [values['size'] * kink(values.get('place', 0.5))
                for values in point.effects.values()]
        return (point.base[0] * LOAD + sum(bent))[None, :]


def test_an_effect_of_a_small_first_order_gain_is_refitted_before_another_is_named() -> None:
    chance = np.random.default_rng(3)
    true = {'somewhere': {'size': 0.2, 'place': 0.6}}
    seen = Stop().predict('slow', Point(np.ones(1), true))
    seen = seen + NOISE * chance.normal(size=seen.shape)
    found = diagnose_system(Stop(), [recorded('slow', seen)], Settings(refits=1))
    tried = {item.effects for item in found.search.candidates if item.step == 1}
    (cause,) = found.causes
    assert tried == {('somewhere',), ('at a half',)}
    assert cause.group == ('somewhere',)
    assert cause.parameters['place'].value == pytest.approx(0.6, abs=0.02)
