"""Claims on two causes that mask each other: neither alone explains what both explain together."""

from __future__ import annotations

from bench import LOAD, recorded, System
import numpy as np
import pytest

from saddlering_ros.discrepancy import (
    diagnose_system,
    Diagnosis,
    Effect,
    Parameter,
    Point,
    Problem,
)
from saddlering_ros.discrepancy.search import selection
from saddlering_ros.discrepancy.search.ranking import _pair_gains

NOISE = 3e-3
PUSH, PULL = LOAD**2, LOAD**2.5
SIZES = {'push': 0.24, 'pull': -0.196}
"""In these sizes, each change covers almost all of the other."""


class Spring(System):
    """A channel straight in the load, and two bows of nearly the same shape."""

    effects = tuple(Effect(name, {'size': Parameter(-0.5, 0.5)}) for name in SIZES)

    def predict(self, name: str, point: Point) -> np.ndarray:
        size = {name: values['size'] for name, values in point.effects.items()}
        seen = point.base[0] * LOAD + size.get('push', 0.0) * PUSH + size.get('pull', 0.0) * PULL
        return seen[None, :]


def diagnosed(**sizes: float) -> Diagnosis:
    """The diagnosis of a run with effects of these sizes."""
    truth = Point(np.ones(1), {name: {'size': size} for name, size in sizes.items()})
    noise = np.random.default_rng(2).normal(0.0, NOISE, (1, LOAD.size))
    seen = Spring().predict('slow', truth) + noise
    return diagnose_system(Problem(Spring(), [recorded('slow', seen)]))


def test_two_causes_that_mask_each_other_are_both_named(monkeypatch: pytest.MonkeyPatch) -> None:
    found = diagnosed(**SIZES)
    assert {cause.effect for cause in found.causes} == set(SIZES)
    assert 0.0 <= found.explained <= 1.0
    monkeypatch.setattr(selection, 'masked_pair', lambda space, fit, log: fit)
    assert not diagnosed(**SIZES).causes


@pytest.mark.parametrize('sizes', [{}, {'push': 0.24}])
def test_one_cause_or_none_gets_no_partner(sizes: dict[str, float]) -> None:
    assert {cause.effect for cause in diagnosed(**sizes).causes} == set(sizes)


def test_factors_of_a_pair_stay_within_their_reach() -> None:
    chance = np.random.default_rng(5)
    stack = chance.normal(size=(30, 3))
    products = stack.T @ chance.normal(size=30)
    reach = np.array([[0.0, 0.1], [-0.05, 0.05], [-1.0, 1.0]])
    gains, first, second = _pair_gains(stack, products, reach)
    grid = [np.linspace(low, high, 201) for low, high in reach]
    for row, column in ((0, 1), (1, 2), (2, 0)):
        one, other = np.meshgrid(grid[row], grid[column], indexing='ij')
        pair = stack[:, [row, column]]
        falls = 2.0 * (one * products[row] + other * products[column]) - (
            (pair @ np.stack([one.ravel(), other.ravel()])) ** 2).sum(axis=0).reshape(one.shape)
        assert gains[row, column] == pytest.approx(falls.max(), rel=1e-3)
        assert reach[row, 0] <= first[row, column] <= reach[row, 1]
        assert reach[column, 0] <= second[row, column] <= reach[column, 1]
