"""The declarations of a user: a simulator with its parameters, channels, causes and runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from saddlering_ros.discrepancy.noise import Noise
from saddlering_ros.discrepancy.problem.system import Array, DiscrepancyError, Effect, Parameter

Outputs = Mapping[str, ArrayLike]

MIN_SAMPLES = 8
"""Smallest number of samples of a run: fewer cannot hold a trend, an offset and noise."""


@dataclass(frozen=True)
class Channel:
    """A measured quantity that the simulator predicts.

    offset: 'none' if a constant in the reading is a misfit, 'free' if it has no meaning, or
    the standard deviation of a constant that any such sensor may have [unit]. model_error:
    share of the channel's range by which a sound simulator may be wrong.
    """

    unit: str = ''
    offset: Literal['free', 'none'] | float = 'none'
    noise: Noise = field(default_factory=Noise.unknown)
    model_error: float = 0.0

    def __post_init__(self) -> None:
        if not isinstance(self.noise, Noise):
            raise DiscrepancyError(
                f'channel: noise is {self.noise!r}: give Noise.white(std) or another Noise')
        if isinstance(self.offset, str) and self.offset not in ('free', 'none'):
            raise DiscrepancyError(
                f"channel: offset is {self.offset!r}: give 'free', 'none' or a standard deviation")
        if not isinstance(self.offset, str) and not 0.0 <= self.offset < np.inf:
            raise DiscrepancyError(f'channel: offset {self.offset:g}: a standard deviation')
        if not 0.0 <= self.model_error < 1.0:
            raise DiscrepancyError(
                f'channel: model_error is {self.model_error:g}: a share of the range, 0 to 1')


@dataclass(frozen=True)
class Run:
    """One record: `outputs` by channel (N,) at `time` (N,), NaN where a sample is missing.

    inputs: data for the simulator; coordinates (N,) by name: quantities that a residual may
    depend on (default: the inputs of the same length).
    """

    name: str
    time: Array
    inputs: Mapping[str, object] = field(default_factory=dict)
    outputs: Mapping[str, Array] = field(default_factory=dict)
    coordinates: Mapping[str, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        time = np.asarray(self.time, dtype=np.float64)
        if time.ndim != 1 or time.size < MIN_SAMPLES:
            raise DiscrepancyError(
                f'run {self.name}: {time.size} samples of time: give at least {MIN_SAMPLES}')
        if not np.all(np.isfinite(time)) or np.any(np.diff(time) <= 0.0):
            raise DiscrepancyError(f'run {self.name}: time must rise from sample to sample')
        if not self.outputs:
            raise DiscrepancyError(f'run {self.name}: no outputs: give at least one channel')
        object.__setattr__(self, 'time', time)
        for kind in ('outputs', 'coordinates'):
            object.__setattr__(self, kind, self._checked(kind))

    def _checked(self, kind: str) -> dict[str, Array]:
        """Arrays of floats of the length of `time`."""
        answer = {}
        for name, values in getattr(self, kind).items():
            array = np.asarray(values, dtype=np.float64)
            if array.shape != self.time.shape:
                raise DiscrepancyError(
                    f'run {self.name}: {kind} {name} has shape {array.shape}, time '
                    f'{self.time.shape}'
                )
            if kind == 'coordinates' and not np.all(np.isfinite(array)):
                raise DiscrepancyError(
                    f'run {self.name}: coordinate {name} has a value that is not a number')
            answer[name] = array
        return answer


def _refuse_other_types(name: str, given: object, wanted: type) -> None:
    """Refuse an argument that is not a mapping from names to `wanted`."""
    if not isinstance(given, Mapping):
        raise DiscrepancyError(
            f'model: {name} is a {type(given).__name__}: give a mapping from names to '
            f'{wanted.__name__}'
        )
    for key, value in given.items():
        if not isinstance(value, wanted):
            raise DiscrepancyError(f'model: {name} {key} is {value!r}: give a {wanted.__name__}')


Simulate = Callable[[dict[str, float], Run], Outputs]
SimulateMany = Callable[[list[dict[str, float]], Run], Sequence[Outputs]]


@dataclass(frozen=True)
class Model:
    """A simulator, its fitted parameters (`base`), possible causes (`effects`), its channels.

    simulate(parameters, run) returns every channel at run.time. The parameters hold the base
    by name and those of every effect as 'effect.parameter', neutral if the effect is not in
    the model. simulate_many(list of parameters, run) replaces `simulate` if it is given.
    time_unit: of the time axes of the page.
    """

    simulate: Simulate
    base: Mapping[str, Parameter]
    effects: Mapping[str, Effect] = field(default_factory=dict)
    channels: Mapping[str, Channel] = field(default_factory=dict)
    simulate_many: SimulateMany | None = None
    time_unit: str = ''

    def __post_init__(self) -> None:
        _refuse_other_types('base', self.base, Parameter)
        _refuse_other_types('effects', self.effects, Effect)
        _refuse_other_types('channels', self.channels, Channel)
        if not self.channels:
            raise DiscrepancyError('model: no channels: declare the quantities that the '
                                   'simulator predicts')
        if not self.base:
            raise DiscrepancyError('model: no base parameters: declare the parameters that are '
                                   'always fitted')
        names = [*self.base]
        for key, effect in self.effects.items():
            names += [f'{key}.{name}' for name in effect.parameters]
            names += [f'{key}.{name}' for name in effect.variants[0]]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise DiscrepancyError(f'model: two parameters are called {", ".join(twice)}')
        for key, effect in self.effects.items():
            size = effect.size
            if size.neutral is None and size.scale == 'linear' and (
                size.low > 0.0 or size.high < 0.0):
                raise DiscrepancyError(
                    f'effect {key}: its size {size.name} is never 0 between {size.low:g} and '
                    f'{size.high:g}: give Parameter(..., neutral=) the value at which the effect '
                    'does nothing'
                )
        effects = {key: replace(effect, id=key) for key, effect in self.effects.items()}
        base = {name: replace(parameter, name=name) for name, parameter in self.base.items()}
        object.__setattr__(self, 'effects', effects)
        object.__setattr__(self, 'base', base)

    def neutral(self) -> dict[str, float]:
        """The parameters of every effect that is not in the model."""
        values = {}
        for key, effect in self.effects.items():
            for number, parameter in enumerate(effect.ordered):
                absent = parameter.neutral
                if absent is None:
                    absent = 0.0 if number == 0 else parameter.from_unit(parameter.first_guess)
                values[f'{key}.{parameter.name}'] = absent
            for name, value in effect.variants[0].items():
                values[f'{key}.{name}'] = value
        return values
