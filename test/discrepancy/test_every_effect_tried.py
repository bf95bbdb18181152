"""Claims on causes of a small first-order gain at the base fit, which are tried all the same."""

from __future__ import annotations

from bench import LOAD, recorded, System
import numpy as np
import pytest

from saddlering_ros.discrepancy import diagnose_system, Effect, Parameter, Point, Problem, Settings

NOISE = 1e-3


class Bow(System):
    """One channel straight in the load, bent by some power of it, or by its third."""

    effects = (
        Effect('some power', {'size': Parameter(-0.5, 0.5), 'power': Parameter(1.1, 8.0)},
               starts=({'size': 0.1, 'power': 1.3},)),
        Effect('third power', {'size': Parameter(-0.5, 0.5)}),
    )

    def predict(self, name: str, point: Point) -> np.ndarray:
        bent = [values['size'] * LOAD ** values.get('power', 3.0)
                for values in point.effects.values()]
        return (point.base[0] * LOAD + sum(bent))[None, :]


def test_an_effect_of_a_small_first_order_gain_is_refitted_before_another_is_named() -> None:
    chance = np.random.default_rng(3)
    true = {'some power': {'size': 0.2, 'power': 4.5}}
    seen = Bow().predict('slow', Point(np.ones(1), true))
    seen = seen + NOISE * chance.normal(size=seen.shape)
    found = diagnose_system(Problem(Bow(), [recorded('slow', seen)], Settings(refits=1)))
    tried = {item.effects for item in found.search.candidates if item.step == 1}
    (cause,) = found.causes
    assert tried == {('some power',), ('third power',)}
    assert cause.effect == 'some power'
    assert cause.parameters['power'].value == pytest.approx(4.5, abs=0.3)
