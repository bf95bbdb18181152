"""Effects of the catalogue, their parameters, and the tests on the rig that separate causes.

The `outcomes` of an effect hold the result of these tests, by their id, if that effect is the
cause: a noun with its clause. A test without an entry has the outcome of most effects.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

from saddlering_ros.effects.extension import OwnParameter, RingExtension, with_probe
from saddlering_ros.errors import SaddleringError
from saddlering_ros.quantities import compact
from saddlering_ros.rig import Rig
from saddlering_ros.rig.geometry import size_factor

UNCLEAR = ''
"""The outcome of a test that does not separate an effect from the others."""


@dataclass(frozen=True)
class RigTest:
    """One test: its id, its instruction, and the outcome of effects without an entry."""

    id: str
    instruction: str
    otherwise: str = UNCLEAR


RIG_TESTS = (
    RigTest('second_rate', 'Record a dynamic test at a second loading rate, four times slower.',
            'a misfit that does not depend on the rate'),
    RigTest('repeat_cycle', 'Record two cycles with holds of 30 s at preload and at full load.',
            'the same misfit in both cycles'),
    RigTest('zero_load', 'Record ten minutes at constant preload, at the highest sampling rate.',
            'no misfit at constant preload'),
    RigTest('swapped_probes', 'Swap probes 1 and 3, and probes 2 and 4, and repeat the static '
            'test.', 'a misfit that does not move'),
    RigTest('slewed_ring', 'Slew the ring by 90 deg and repeat the static test.',
            'a misfit that does not change'),
    RigTest('other_elevation', 'Repeat the static test at another elevation.'),
    RigTest('reference_load', 'Put a calibrated load cell in line with the cylinder and repeat '
            'the static test.', 'a load that agrees with the reference'),
    RigTest('inclinometer', 'Put an inclinometer on the loading axis and repeat the static test.',
            'an angle as recorded'),
    RigTest('pull_push', 'Pull and push the ring slowly through zero load.',
            'no unexpected jump at zero load'),
    RigTest('heights', 'Measure the heights of the loading axis and of probes 1 and 3 over the '
            'mid-plane of the ring.', 'heights as in the rig file'),
    RigTest('other_gap', 'Set the gap of the probe wider at zero load and repeat the static test.',
            'the same misfit'),
)
"""Order of preference among tests that separate as much."""


class EffectError(SaddleringError):
    """An effect or one of its parameters does not exist or is out of its bounds."""


@dataclass(frozen=True)
class EffectParameter:
    """One parameter: SI unit, bounds, `scale` (a typical size on a real rig), start value.

    one_sided: physics fixes the sign. amplitude: the effect vanishes if this parameter is
    `neutral`; the other parameters only shape it. The first parameter of an effect is an
    amplitude. logarithmic: searched on a log scale (low > 0), for instance time constants.
    limiting_case: values of a shape at which the effect is another one or none: a cause whose
    interval includes such a value is not established. whole: the bound of a size that nature sets,
    such as a share of 1: a cause of this size can be established. adds_to: the extension parameter
    to which it is added, if that is all that it does; the name of one that effects share, or one
    of its own.
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
    neutral: float = 0.0
    logarithmic: bool = False
    limiting_case: tuple[float, ...] = ()
    whole: float | None = None
    adds_to: str | OwnParameter = ''

    def sized_for(self, rig: Rig) -> 'EffectParameter':
        """The same with bounds, typical size and start of a rig."""
        factor = size_factor(self.unit, rig)
        if factor == 1.0:
            return self
        return replace(
            self, low=factor * self.low, high=factor * self.high, scale=factor * self.scale,
            start=factor * self.start, neutral=factor * self.neutral,
            limiting_case=tuple(factor * value for value in self.limiting_case))


@dataclass(frozen=True)
class Variant:
    """A discrete choice inside one effect (which probe, which row): fixed values and a label.

    channels: where this choice shows, if not in all channels of the effect. frees: parameters
    with a meaning in this choice alone, for instance one size for each coordinate. contains:
    effects that this choice can imitate completely, so that it is no alternative to them.
    """

    label: str
    values: Mapping[str, float]
    channels: tuple[str, ...] = ()
    frees: tuple[str, ...] = ()
    contains: tuple[str, ...] = ()


@dataclass(frozen=True)
class Choice:
    """A parameter that is chosen and not fitted: its values in order of the variants, in words."""

    name: str
    values: tuple[float, ...]
    words: str


class RingEffect:
    """One cause of a difference between measurement and simulation; one subclass, one file.

    A subclass states the class attributes; a walk of the folder finds it. Its id is the name of
    its file. What it does is stated by its parameters (`adds_to`), or by its own `extend`.
    starts: first guesses for effects that need several (searched places, times); a missing name
    takes the start of its parameter. The first variant is the default. channels: in which the
    cause shows, by default in every coordinate of the motion.
    """

    id: ClassVar[str]
    title: ClassVar[str]
    words: ClassVar[str]
    settled_by: ClassVar[str]
    outcomes: ClassVar[Mapping[str, str]] = {}
    stage: ClassVar[str]                      # one of STAGES
    channels: ClassVar[tuple[str, ...]] = ('delta_x', 'delta_y', 'gamma')  # and parity
    parameters: ClassVar[tuple[EffectParameter, ...]]
    variants: ClassVar[tuple[Variant, ...]] = (Variant('', {}),)
    choices: ClassVar[tuple[Choice, ...]] = ()
    starts: ClassVar[tuple[Mapping[str, float], ...]] = ()
    dynamic_only: ClassVar[bool] = False
    line: ClassVar[bool] = False              # a steady line, at rest too
    form: ClassVar[float] = 0.0               # share of the size that its idealised law may err

    def __init_subclass__(cls) -> None:
        cls.id = cls.__module__.rpartition('.')[2]

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        """The extension with this effect added; `values` holds every parameter and choice.

        What belongs to one of the four probes is added at the probe chosen. Parameters that only
        another variant frees are not added.
        """
        idle = {name for one in self.variants for name in one.frees
                if any(values[key] != value for key, value in one.values.items())}
        changed: dict[str, Any] = {}
        for item in self.parameters:
            if item.name not in values or item.name in idle:
                continue
            if isinstance(item.adds_to, OwnParameter):
                extension = item.adds_to.add(extension, values[item.name])
            elif item.adds_to:
                before, value = getattr(extension, item.adds_to), values[item.name]
                changed[item.adds_to] = (with_probe(before, round(values['probe']), value)
                                         if isinstance(before, tuple) else before + value)
        return replace(extension, **changed)

    def slewed(self, values: Mapping[str, float]) -> dict[str, float]:
        """Values after the ring is turned by a quarter; the same where nothing turns with it."""
        return dict(values)

    def parameters_on(self, rig: Rig | None) -> tuple[EffectParameter, ...]:
        """All parameters with the bounds of a rig; None: the rig of the catalogue."""
        if rig is None:
            return self.parameters
        return tuple(item.sized_for(rig) for item in self.parameters)

    def parameters_of(
        self, variant: Variant, rig: Rig | None = None,
    ) -> tuple[EffectParameter, ...]:
        """Parameters with a meaning in one of the variants."""
        others = {name for item in self.variants for name in item.frees} - set(variant.frees)
        return tuple(item for item in self.parameters_on(rig) if item.name not in others)

    def complete(self, values: Mapping[str, float], rig: Rig | None = None) -> dict[str, float]:
        """`values` with start values for missing ones.

        EffectError for a name that does not exist, a number out of bounds or a choice not offered.
        """
        parameters = self.parameters_on(rig)
        known = {parameter.name: parameter.start for parameter in parameters}
        known.update(self.variants[0].values)
        for name in values:
            if name not in known:
                raise EffectError(f'effects.{self.id}.{name} does not exist: '
                                  f'choose from {", ".join(known)}')
        complete = {**known, **values}
        for parameter in parameters:
            value = complete[parameter.name]
            slack = 1e-9 * (parameter.high - parameter.low)
            if not parameter.low - slack <= value <= parameter.high + slack:
                unit = '' if parameter.unit == '1' else f' {parameter.unit}'
                raise EffectError(
                    f'effects.{self.id}.{parameter.name} is {compact(value)}: give a number from '
                    f'{compact(parameter.low)} to {compact(parameter.high)}{unit}')
        for choice in self.choices:
            if complete[choice.name] not in choice.values:
                offered = ', '.join(f'{value:g}' for value in choice.values)
                raise EffectError(f'effects.{self.id}.{choice.name} is {complete[choice.name]:g}: '
                                  f'choose from {offered} ({choice.words})')
        return complete
