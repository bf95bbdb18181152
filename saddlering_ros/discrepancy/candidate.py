"""A candidate model and its fit: the base parameters and some effects, each in one variant."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from saddlering_ros.discrepancy.system import Array, Effect, Parameter, Point

Key = tuple[tuple[str, int], ...]
"""Key of the fit of a candidate: its effects and variants, in any order."""


@dataclass(frozen=True)
class Candidate:
    """A model: the base and some effects, each in one variant."""

    effects: tuple[tuple[Effect, int], ...] = ()

    @property
    def key(self) -> Key:
        return tuple(sorted((effect.id, variant) for effect, variant in self.effects))

    @property
    def ids(self) -> tuple[str, ...]:
        return tuple(effect.id for effect, _ in self.effects)

    def parameters(self, base: Sequence[Parameter]) -> tuple[Parameter, ...]:
        own = [parameter for effect, _ in self.effects for parameter in effect.ordered]
        return (*base, *own)

    def plus(self, effect: Effect, variant: int) -> Candidate:
        return Candidate((*self.effects, (effect, variant)))

    def without(self, effect_id: str) -> Candidate:
        return Candidate(tuple(item for item in self.effects if item[0].id != effect_id))

    def slices(self, fixed: int) -> Iterator[tuple[Effect, int, slice]]:
        """Each effect, its variant, and its parameters' indices after `fixed` base parameters."""
        start = fixed
        for effect, variant in self.effects:
            stop = start + len(effect.ordered)
            yield effect, variant, slice(start, stop)
            start = stop

    def point(self, base: Sequence[Parameter], theta_unit: Array) -> Point:
        """Point at bound-scaled coordinates `theta_unit`."""
        values = np.array(
            [
                item.from_unit(float(u))
                for item, u in zip(base, theta_unit[: len(base)], strict=True)
            ]
        )
        effects: dict[str, Mapping[str, float]] = {}
        for effect, variant, part in self.slices(len(base)):
            own = {
                item.name: item.from_unit(float(u))
                for item, u in zip(effect.ordered, theta_unit[part], strict=True)
            }
            effects[effect.id] = {**own, **effect.variants[variant]}
        return Point(values, effects)


@dataclass(frozen=True)
class Fit:
    """A candidate at its optimum.

    theta_unit (p,): bound-scaled parameters; misfit: the whitened sum of squares.
    """

    candidate: Candidate
    theta_unit: Array
    misfit: float
    whitened: Array
    jacobian: Array
    prediction: Array
    point: Point
    history: tuple[float, ...] = field(default=())
    converged: bool = True
