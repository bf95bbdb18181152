"""Claims of the engine on a machine that is no ring."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
import sys

import numpy as np
import pytest

from saddlering_ros.discrepancy import diagnose_system, Diagnosis, Point, Problem, RunBlocks

sys.path.insert(0, str(Path(__file__).parents[2] / 'examples'))

import second_system


class Short(second_system.Axis):
    """The axis with some effects taken out of its catalogue."""

    def __init__(self, *missing: str) -> None:
        self.effects = tuple(item for item in second_system.Axis.effects if item.id not in missing)


@lru_cache(maxsize=8)
def diagnosed(hidden: str = '', size: float = 0.0, seed: int = 1, *missing: str) -> Diagnosis:
    effects = {hidden: {effect_size(hidden): size}} if hidden else {}
    runs = [
        second_system.measure(100 * seed + k, effects, period)
        for k, period in enumerate((3.0, 6.0))
    ]
    return diagnose_system(Problem(Short(*missing), runs))


def effect_size(name: str) -> str:
    return next(item for item in second_system.Axis.effects if item.id == name).size.name


@pytest.mark.parametrize(('effect', 'size'), [('friction', 2.0), ('encoder_gain', 0.02)])
def test_a_hidden_effect_is_named_and_measured(effect: str, size: float) -> None:
    found = diagnosed(effect, size)
    assert found.verdict == 'named'
    assert [cause.effect for cause in found.causes] == [effect]
    estimate = found.causes[0].parameters[effect_size(effect)]
    assert abs(estimate.value - size) < max(5.0 * estimate.std, 0.05 * size)


def test_the_gain_holds_on_runs_left_out() -> None:
    gain = diagnosed('friction', 2.0).causes[0].gain
    assert gain.held_out is not None
    assert gain.held_out > 0.5


def test_an_effect_that_is_in_no_catalogue_is_not_given_a_confident_name() -> None:
    found = diagnosed('friction', 4.0, 1, 'friction')
    assert found.verdict == 'unknown'


def test_a_simulator_of_the_wrong_shape_is_told_so() -> None:
    class Wrong(second_system.Axis):
        def predict_many(self, run: RunBlocks, points: Sequence[Point]) -> np.ndarray:
            return np.zeros((len(points), 1, run.time.size))

    with pytest.raises(ValueError, match='wrong shape'):
        diagnose_system(Problem(Wrong(), [second_system.measure(1, {}, 3.0)]))
