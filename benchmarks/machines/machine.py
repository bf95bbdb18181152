"""What a machine of the benchmark is made of."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.discrepancy import Channel, Effect, Model, Parameter, Run

Array = NDArray[np.float64]
DRAWN_SHARE = 0.1
"""True base parameters differ by up to this share from machine to machine."""

NOISE_SHARE = 0.003
"""Noise of a sample as a share of the channel's range."""


@dataclass(frozen=True)
class Draw:
    """Run `number` of the machine that `seed` stands for: what its record is made of.

    true: base parameters; hidden: parameters of the effects that are in the record; names: of
    the parameters of every effect; channels: of the model.
    """

    seed: int
    number: int
    true: Mapping[str, float]
    hidden: Mapping[str, float]
    names: Sequence[str]
    channels: Sequence[str]

    @cached_property
    def random(self) -> np.random.Generator:
        """The chances of this run."""
        return np.random.default_rng([self.seed, 2, self.number])

    @cached_property
    def own(self) -> np.random.Generator:
        """The chances of this machine, the same in each of its runs."""
        return np.random.default_rng([self.seed, 7])

    def size(self, name: str) -> float:
        """A hidden parameter, 0 where its effect is not in the record."""
        return self.hidden.get(name, 0.0)

    def law(self, *more: float) -> Array:
        """Base parameters, those of every effect, and what the model does not have."""
        return np.array([*self.true.values(), *map(self.size, self.names), *more])

    def run(self, time: Array, inputs: Mapping[str, object], seen: Iterable[Array],
            noise: float = NOISE_SHARE) -> Run:
        """The record of channels (N,) in the order of the model, with noise, a share of range."""
        return Run(f'run {self.number}', time, inputs, {
            channel: noisy(self.random, one, noise) if noise else one
            for channel, one in zip(self.channels, seen, strict=True)})


@dataclass(frozen=True)
class Machine:
    """A model with what can be hidden in its records: by effect, its true parameters.

    make: the record of a draw; usual: true base parameters, from which those of a machine differ
    by a share drawn for each, except `constant` ones.
    """

    name: str
    source: str
    licence: str
    model: Model
    hidden: Mapping[str, Mapping[str, float]]
    make: Callable[[Draw], Run]
    usual: Mapping[str, float]
    constant: tuple[str, ...] = ()

    def truth(self, seed: int) -> dict[str, float]:
        """True base parameters of the machine that `seed` stands for."""
        random = np.random.default_rng([seed, 1])
        drawn = {name: value * (1.0 + DRAWN_SHARE * random.uniform(-1.0, 1.0))
                 for name, value in self.usual.items()}
        return {**drawn, **{name: self.usual[name] for name in self.constant}}

    def record(self, number: int, seed: int, hidden: Mapping[str, float]) -> Run:
        """Run `number` of the machine that `seed` stands for, with effects hidden in it."""
        return self.make(Draw(seed, number, self.truth(seed), hidden, names_of(self.model.effects),
                              [*self.model.channels]))


def names_of(effects: Mapping[str, Effect]) -> list[str]:
    """The parameters of every effect."""
    return [f'{key}.{name}' for key, effect in effects.items() for name in effect.parameters]


def about(value: float) -> tuple[float, Parameter]:
    """A base parameter: its true value, and bounds around it."""
    return value, Parameter(0.3 * value, 3.0 * value)


def hides(title: str, *true: float, contains: tuple[str, ...] = (),
          **parameters: Parameter) -> tuple[Effect, tuple[float, ...]]:
    """An effect, and its true parameters where it is hidden; with none it never is."""
    return Effect(title, parameters, contains=contains), true


def declared(
    name: str, source: str, licence: str, make: Callable[[Draw], Run],
    simulate: Callable[..., Mapping[str, Array]],
    base: Mapping[str, tuple[float, Parameter]],
    effects: Mapping[str, tuple[Effect, tuple[float, ...]]],
    channels: Mapping[str, Channel],
) -> Machine:
    """A machine, from true value and bounds of each base parameter and from what it `hides`."""
    model = Model(
        simulate, {key: bounds for key, (_, bounds) in base.items()},
        {key: effect for key, (effect, _) in effects.items()}, channels)
    return Machine(
        name, source, licence, model,
        {key: dict(zip(effect.parameters, true, strict=False))
         for key, (effect, true) in effects.items() if true},
        make, {key: value for key, (value, _) in base.items()})


def own_machine(
    name: str, make: Callable[[Draw], Run], kernel: Callable[..., Sequence[Array]],
    base: Mapping[str, tuple[float, Parameter]],
    effects: Mapping[str, tuple[Effect, tuple[float, ...]]],
    channels: Mapping[str, Channel], lacks: Sequence[float] = (), parts: int = 8,
    source: str = 'written for this benchmark', licence: str = 'of this repository',
) -> Machine:
    """A machine whose kernel takes the inputs of a run, its law, and parts of a step.

    The law is base, effects, and what the model does not have, which is `lacks` there. The kernel
    gives the channels (C, N).
    """
    names = [*base, *names_of({key: effect for key, (effect, _) in effects.items()})]

    def simulate(values: dict[str, float], run: Run) -> dict[str, Array]:
        law = np.array([*(values[name] for name in names), *lacks])
        return dict(zip(channels, kernel(*run.inputs.values(), law, parts), strict=True))

    return declared(name, source, licence, make, simulate, base, effects, channels)


Records = tuple[Sequence[Run], Sequence[Run]]
"""Fitted and held-out runs."""


@dataclass(frozen=True)
class Trial:
    """What is diagnosed, and the truth: effects any of which is right, or none.

    removed: the truth is hidden in the records and is not in the catalogue.
    """

    machine: str
    name: str
    seed: int
    model: Model
    records: Callable[[], Records]
    truth: tuple[str, ...] = ()
    removed: bool = False

    @property
    def kind(self) -> str:
        """Whether the catalogue holds what is hidden, if anything is."""
        return 'sound' if not self.truth else 'removed' if self.removed else 'hidden'

    def without_truth(self) -> list[Trial]:
        """The same records and a catalogue without the truth; empty if there is none."""
        if not self.truth:
            return []
        return [replace(self, name=f'{self.name}, removed', removed=True,
                        model=without(self.model, self.truth))]


Repetitions = Sequence[tuple[Any, ...]]
"""What a record of a real machine is read by, for each run."""


def recorded(
    machine: str, seed: int, model: Model, record: Callable[..., Run | None],
    cases: Iterable[tuple[str, tuple[str, ...], Repetitions, Repetitions]],
) -> list[Trial]:
    """Trials of a real machine by name, truth, fitted and held-out runs, and without the truth.

    record: a run, or None for one that was not published.
    """

    def records(*parts: Repetitions) -> Records:
        fitted, held = ([run for each in part if (run := record(*each))] for part in parts)
        return fitted, held

    whole = [Trial(machine, name, seed, model, partial(records, fitted, held), truth)
             for name, truth, fitted, held in cases]
    return [trial for each in whole for trial in (each, *each.without_truth())]


def without(model: Model, effects: Sequence[str]) -> Model:
    """The model with a smaller catalogue."""
    gone = {name: value for name, value in model.neutral().items()
            if name.split('.')[0] in effects}
    kept = {name: effect for name, effect in model.effects.items() if name not in effects}
    simulate = model.simulate
    return replace(model, effects=kept,
                   simulate=lambda values, run: simulate({**gone, **values}, run))


def known(model: Model, *effects: str) -> Model:
    """The model with effects as parameters of the base."""
    base = {f'{effect}.{name}': parameter for effect in effects
            for name, parameter in model.effects[effect].parameters.items()}
    return replace(model, base={**model.base, **base}, effects={
        name: effect for name, effect in model.effects.items() if name not in effects})


def steps(random: np.random.Generator, count: int, low: float, high: float, every: int) -> Array:
    """A drive of `count` samples that steps to a random level about `every` samples."""
    levels = np.empty(count)
    begin = 0
    while begin < count:
        end = begin + int(random.integers(every // 2, 2 * every))
        levels[begin:end] = random.uniform(low, high)
        begin = end
    return levels


def swings(random: np.random.Generator, time: Array, slow: float, fast: float) -> Array:
    """A drive of a few sines of frequencies between `slow` and `fast` [1 / time], about 1 high."""
    frequency = np.geomspace(slow, fast, 4) * random.uniform(0.9, 1.1, 4)
    phase = random.uniform(0.0, 2.0 * np.pi, 4)
    total = np.sin(2.0 * np.pi * time[:, None] * frequency + phase).sum(axis=1)
    return np.asarray(total / 2.0)


def noisy(random: np.random.Generator, truth: Array, share: float = NOISE_SHARE) -> Array:
    """Truth (N,) with white noise and a part of it correlated over a few samples."""
    white = random.normal(size=truth.size)
    slow = np.convolve(random.normal(size=truth.size + 4), np.full(5, 5.0**-0.5), 'valid')
    return np.asarray(truth + share * np.ptp(truth) * (0.8 * white + 0.6 * slow))
