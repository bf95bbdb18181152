"""What a machine of the benchmark is made of."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.discrepancy import Model, Run

Array = NDArray[np.float64]
DRAWN_SHARE = 0.1
"""True base parameters differ by up to this share from machine to machine."""

NOISE_SHARE = 0.003
"""Noise of a sample as a share of the channel's range."""


@dataclass(frozen=True)
class Draw:
    """Run `number` of the machine that `seed` stands for: what its record is made of.

    true: base parameters; hidden: parameters of the effects that are in the record.
    """

    seed: int
    number: int
    true: Mapping[str, float]
    hidden: Mapping[str, float]

    @cached_property
    def random(self) -> np.random.Generator:
        """The chances of this run."""
        return np.random.default_rng([self.seed, 2, self.number])

    def size(self, name: str) -> float:
        """A hidden parameter, 0 where its effect is not in the record."""
        return self.hidden.get(name, 0.0)

    def run(self, time: Array, inputs: Mapping[str, object], outputs: Mapping[str, Array]) -> Run:
        """The record."""
        return Run(f'run {self.number}', time, inputs, outputs)


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
        return self.make(Draw(seed, number, self.truth(seed), hidden))


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


def without(model: Model, effects: Sequence[str]) -> Model:
    """The model with a smaller catalogue."""
    gone = {name: value for name, value in model.neutral().items()
            if name.split('.')[0] in effects}
    kept = {name: effect for name, effect in model.effects.items() if name not in effects}
    simulate = model.simulate
    return replace(model, effects=kept,
                   simulate=lambda values, run: simulate({**gone, **values}, run))


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
