"""What an effect of the catalogue is, and how its parameters look."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from saddlering_ros.errors import SaddleringError
from saddlering_ros.effects.extension import RingExtension


class EffectError(SaddleringError):
    """An effect or a parameter of an effect that does not exist or is out of its bounds."""


@dataclass(frozen=True)
class EffectParameter:
    """One parameter: SI unit, bounds, `scale` (a size that a rig may well show), start value.

    one_sided: the sign is fixed by physics (force, clearance widening may be two-sided). `amplitude`
    marks the parameter that makes the effect vanish at 0; the others only shape it.
    """

    name: str
    unit: str
    low: float
    high: float
    scale: float
    start: float
    words: str
    amplitude: bool = False
    one_sided: bool = False


@dataclass(frozen=True)
class Variant:
    """A discrete choice inside one effect (which probe, which row): fixed values and a label."""

    label: str
    values: Mapping[str, float]


class Effect(ABC):
    """One cause by which a measurement can part from the simulation; one subclass, one file.

    A subclass states the class attributes and `extend`; discovery finds it by walking the folder.
    """

    id: ClassVar[str]
    title: ClassVar[str]
    words: ClassVar[str]
    settled_by: ClassVar[str]
    stage: ClassVar[str]                      # 'load path', 'ring' or 'measurement'
    channels: ClassVar[tuple[str, ...]]       # of delta_x, delta_y, gamma, parity
    parameters: ClassVar[tuple[EffectParameter, ...]]
    variants: ClassVar[tuple[Variant, ...]] = (Variant('', {}),)
    dynamic_only: ClassVar[bool] = False

    @abstractmethod
    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        """The extension with this effect added; `values` holds every parameter and variant value."""

    def complete(self, values: Mapping[str, float]) -> dict[str, float]:
        """`values` with start values for what is missing; EffectError for unknown names."""
        known = {parameter.name: parameter.start for parameter in self.parameters}
        for name, value in self.variants[0].values.items():
            known[name] = value
        unknown = sorted(set(values) - set(known))
        if unknown:
            raise EffectError(f'effects.{self.id}.{unknown[0]} does not exist: '
                              f'choose from {", ".join(known)}')
        return {**known, **values}
