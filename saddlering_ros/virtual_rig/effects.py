"""Effects of the virtual rig: their declaration, the requests for them, and their table.

The forms are our own reading of the catalogue's words, made apart from saddlering_ros.effects, so
that the diagnosis is never examined by the very formulas it uses.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
import math
from typing import Any

from saddlering_ros.errors import did_you_mean, plain_number, VirtualRigError
from saddlering_ros.rig import default_rig, Rig
from saddlering_ros.rig.geometry import size_factor

Act = Callable[[Any, Mapping[str, float], str], None]


@dataclass(frozen=True)
class TrueSize:
    """One number of an effect, in SI units, of the nominal rig (`default_rig`)."""

    name: str
    unit: str
    low: float  # of plausible sizes
    high: float  # of plausible sizes
    typical: float
    signed: bool = False  # drawn with either sign
    choices: tuple[float, ...] = ()  # the only values allowed
    positive: bool = False  # below or at zero makes no sense

    def sized_for(self, rig: Rig) -> 'TrueSize':
        factor = size_factor(self.unit, rig)
        return replace(self, low=factor * self.low, high=factor * self.high,
                       typical=factor * self.typical)


@dataclass(frozen=True)
class RigEffect:
    """An effect; act(target, values, form) changes the target of its stage in place."""

    id: str
    stage: str  # where it acts
    channels: tuple[str, ...]  # in which it shows
    parameters: tuple[TrueSize, ...]  # main one first
    act: Act
    forms: tuple[str, ...] = ('default',)  # default first
    dynamic_only: bool = False  # it does not show in a static test

    def parameters_on(self, rig: Rig) -> tuple[TrueSize, ...]:
        """The parameters with their sizes on a rig, the main one first."""
        return tuple(parameter.sized_for(rig) for parameter in self.parameters)

    @property
    def in_catalogue(self) -> bool:
        """Whether a diagnosis can be asked to name it."""
        return not self.id.startswith('out:')


@dataclass(frozen=True)
class EffectRequest:
    """One effect as asked for: its parameters, complete, and its form."""

    effect: RigEffect
    values: Mapping[str, float] = field(default_factory=dict)
    form: str = 'default'


EFFECTS: dict[str, RigEffect] = {}
"""Every effect by its id; ids that start with 'out:' are in no catalogue."""


def effect(name: str, stage: str, channels: Sequence[str], parameters: Iterable[TrueSize],
           forms: Sequence[str] = ('default',), *,
           dynamic_only: bool = False) -> Callable[[Act], Act]:
    """Enter the function below into the table of effects."""
    def enter(act: Act) -> Act:
        EFFECTS[name] = RigEffect(name, stage, tuple(channels), tuple(parameters), act,
                                  tuple(forms), dynamic_only)
        return act
    return enter


def find_effect(name: str) -> RigEffect:
    """The effect of this id; VirtualRigError lists the ids if there is none."""
    if name not in EFFECTS:
        raise VirtualRigError(f'effect {name!r} does not exist{did_you_mean(name, EFFECTS)} '
                              f'(there are {", ".join(sorted(EFFECTS))})')
    return EFFECTS[name]


def request(name: str, values: Mapping[str, float] | None = None,
            form: str | None = None, rig: Rig | None = None) -> EffectRequest:
    """A complete request; parameters not given take their typical size on `rig`.

    VirtualRigError lists the existing names for an unknown effect, parameter or form.
    """
    chosen = find_effect(name)
    form = chosen.forms[0] if form is None else form
    if form not in chosen.forms:
        raise VirtualRigError(f'form {form!r} of {name} does not exist: give one of '
                              f'{", ".join(chosen.forms)}')
    sizes = {parameter.name: parameter for parameter in chosen.parameters_on(rig or default_rig())}
    complete = {key: parameter.typical for key, parameter in sizes.items()}
    for key, value in (values or {}).items():
        parameter = sizes.get(key)
        if parameter is None:
            raise VirtualRigError(f'{name} has no parameter {key!r}: it has {", ".join(sizes)}')
        if not math.isfinite(value):
            raise VirtualRigError(f'{name}.{key} is {value}: give a finite number')
        if parameter.choices and value not in parameter.choices:
            allowed = ', '.join(f'{choice:g}' for choice in parameter.choices)
            raise VirtualRigError(f'{name}.{key} is {value:g}: give one of {allowed}')
        is_size = key == chosen.parameters[0].name and not parameter.signed
        if (parameter.positive and value <= 0.0) or (is_size and value < 0.0):
            raise VirtualRigError(f'{name}.{key} is {value:g} {parameter.unit}: give a number '
                                  + ('above zero' if parameter.positive else 'from zero up'))
        complete[key] = float(value)
    return EffectRequest(chosen, complete, form)


def parse_requests(texts: Iterable[str], forms: Iterable[str] = (),
                   rig: Rig | None = None) -> tuple[EffectRequest, ...]:
    """Requests from NAME, NAME=VALUE (main parameter) or NAME.PARAM=VALUE; forms: NAME=FORM.

    rig: its typical sizes replace values that are not given (default: the shipped rig).
    """
    values: dict[str, dict[str, float]] = {}
    for text in texts:
        left, equals, right = text.partition('=')
        name, _, key = left.strip().partition('.')
        parameters = values.setdefault(find_effect(name).id, {})
        if not equals and not key:
            continue
        try:
            parameters[key or EFFECTS[name].parameters[0].name] = plain_number(right)
        except ValueError as problem:
            raise VirtualRigError(f'effect {text!r} cannot be read: write NAME=NUMBER or '
                                  'NAME.PARAMETER=NUMBER, in SI units') from problem
    chosen: dict[str, str] = {}
    for text in forms:
        name, equals, form = text.partition('=')
        if not equals and len(values) == 1:
            name, form = next(iter(values)), text
        if name not in values:
            raise VirtualRigError(f'form {text!r}: write NAME=FORM, NAME one of the effects')
        chosen[name] = form
    return tuple(request(name, given, chosen.get(name), rig) for name, given in values.items())
