"""The noise of every run and channel: as declared for any machine, or learnt at rest for a ring.

A declaration (`Noise.white`, `from_rest`, `unknown` ...) resolves to a process by the learner of
`estimation`. A misfit far from the noise gives a warning.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np
from scipy.optimize import nnls

from saddlering_ros.discrepancy.problem.system import Array, DiscrepancyError, RunBlocks
from saddlering_ros.estimation import record_noise
from saddlering_ros.estimation.noise import HeldSeries, noise_by_class, RestSource, sampling_class
from saddlering_ros.estimation.process import ChannelNoise
from saddlering_ros.estimation.record_noise import ChannelRecord, continued, noise_of_stretches
from saddlering_ros.estimation.rest import RestSegment
from saddlering_ros.estimation.statistics import fisher_chance, fisher_share_below

KNOWN_EXACTLY = 1_000_000
"""Degrees of freedom of a declared level."""

MAX_SPECTRUM_ERROR = 0.5
"""Largest rms error of the logarithm of a spectrum in the fit by relaxations."""


class Noise(ABC):
    """Declared noise of one channel. Use the constructors; the engine calls `resolve`."""

    learns_from_residuals: ClassVar[bool] = False

    @staticmethod
    def white(std: float) -> Noise:
        """Independent noise of standard deviation `std` [the channel's unit] in every sample."""
        return _White(float(std))

    @staticmethod
    def from_rest(intervals: Sequence[tuple[float, float] | tuple[str, float, float]]) -> Noise:
        """Noise as measured while the system rests.

        Each interval is (start, end) [unit of time] in every run, or (run, start, end) in one.
        """
        return _FromRest(tuple(tuple(interval) for interval in intervals))

    @staticmethod
    def from_repeats(repeats: Sequence[str | Array]) -> Noise:
        """Noise as the difference between repeats of one test.

        `repeats` are names of runs, or records (N,) of the channel sampled like the runs.
        """
        return _FromRepeats(tuple(repeats))

    @staticmethod
    def spectrum(frequency: Array, density: Array) -> Noise:
        """Noise of a one-sided power spectral density [unit^2 / Hz] at `frequency` [1 / time]."""
        return _Spectrum(np.asarray(frequency, dtype=np.float64),
                         np.asarray(density, dtype=np.float64))

    @staticmethod
    def unknown() -> Noise:
        """Noise learnt from the remainder of a flexible fit of the residuals (the default)."""
        return _Unknown()

    @abstractmethod
    def resolve(self, records: Sequence[ChannelRecord]) -> Mapping[str, ChannelNoise]:
        """The process by run. The records hold readings first and residuals later."""


def white_noise(std: float, pairs: int) -> ChannelNoise:
    """Independent noise of every sample; pairs: degrees of freedom of its level."""
    return ChannelNoise(0.0, np.zeros(0), 0.0, pairs, np.zeros(0), floor=std**2)


@dataclass(frozen=True)
class _White(Noise):
    std: float

    def __post_init__(self) -> None:
        if not (np.isfinite(self.std) and self.std > 0.0):
            raise DiscrepancyError(f'noise: std is {self.std:g}: give a number above zero')

    def resolve(self, records: Sequence[ChannelRecord]) -> Mapping[str, ChannelNoise]:
        noise = white_noise(self.std, KNOWN_EXACTLY)
        return {record.run: noise for record in records}


@dataclass(frozen=True)
class _FromRest(Noise):
    intervals: tuple[tuple[str | float, ...], ...]

    def __post_init__(self) -> None:
        if not self.intervals:
            raise DiscrepancyError('noise: from_rest needs at least one interval (start, end)')
        for interval in self.intervals:
            start, end = map(float, interval[-2:])
            if not start < end:
                raise DiscrepancyError(
                    f'noise: the interval at rest from {start:g} to {end:g} is empty: give the '
                    'start first')

    def resolve(self, records: Sequence[ChannelRecord]) -> Mapping[str, ChannelNoise]:
        stretches: list[Array] = []
        longest = 0.0
        step = min(record.step for record in records)
        for record in records:
            for interval in self.intervals:
                if len(interval) == 3 and interval[0] != record.run:
                    continue
                inside = list(record.stretches(*map(float, interval[-2:])))
                stretches += inside
                longest = max([longest, *(row.size * record.step for row in inside)])
        noise = noise_of_stretches(stretches, step, 0.25 * longest, 'the declared rest')
        return {
            record.run: continued(noise, 0.25 * longest, record.duration) for record in records}


@dataclass(frozen=True)
class _FromRepeats(Noise):
    repeats: tuple[str | Array, ...]

    def __post_init__(self) -> None:
        if len(self.repeats) < 2:
            raise DiscrepancyError('noise: from_repeats needs two repeats or more')

    def resolve(self, records: Sequence[ChannelRecord]) -> Mapping[str, ChannelNoise]:
        by_run = {record.run: record for record in records}
        rows, wanted = [], None
        for repeat in self.repeats:
            if not isinstance(repeat, str):
                rows.append(np.asarray(repeat, dtype=np.float64))
                continue
            if repeat not in by_run:
                raise DiscrepancyError(
                    f'noise: from_repeats names the run {repeat!r}, which is not among '
                    f'{", ".join(by_run)}')
            values, time = by_run[repeat].values, by_run[repeat].time
            time = time - time[0]
            if wanted is None:
                wanted = time
            if time.size != wanted.size or not np.allclose(time, wanted):
                values = np.interp(wanted, time, values, right=np.nan)
            rows.append(values)
        # Repeats (K, N) on the time of the first.
        stack = np.array([row[:min(row.size for row in rows)] for row in rows])
        step, count = min(record.step for record in records), len(stack)
        grown = np.sqrt(count / (count - 1.0))
        time = np.linspace(0.0, step * (stack.shape[1] - 1), stack.shape[1])
        stretches = [
            stretch for row in stack - stack.mean(axis=0)
            for stretch in ChannelRecord('', time, np.asarray(row * grown)).stretches()]
        longest = 0.25 * max((stretch.size for stretch in stretches), default=0) * step
        noise = noise_of_stretches(stretches, step, longest, 'the difference of the repeats')
        degrees = max(1, noise.pairs * (count - 1) // count)
        return dict.fromkeys(by_run, replace(noise, pairs=degrees))


@dataclass(frozen=True)
class _Spectrum(Noise):
    frequency: Array
    density: Array

    def __post_init__(self) -> None:
        good = self.frequency.size == self.density.size >= 2
        if not (good and np.all(self.frequency > 0.0) and np.all(self.density > 0.0)):
            raise DiscrepancyError(
                'noise: a spectrum needs two frequencies or more, all above zero, and a density '
                'above zero at each')

    def resolve(self, records: Sequence[ChannelRecord]) -> Mapping[str, ChannelNoise]:
        low, high = float(self.frequency.min()), float(self.frequency.max())
        constants = record_noise.relaxation_grid(0.5 / (np.pi * high), 0.5 / (np.pi * low))
        angular = 2.0 * np.pi * self.frequency[:, None]
        slow = 4.0 * constants / (1.0 + (angular * constants) ** 2)
        columns = np.column_stack([np.full(self.frequency.size, 2.0), slow])
        unit = columns.max(axis=0)
        solved, _ = nnls(columns / unit / self.density[:, None], np.ones(self.density.size))
        solved = solved / unit
        error = np.log(np.maximum(columns @ solved, 1e-300) / self.density)
        if float(np.sqrt(np.mean(error**2))) > MAX_SPECTRUM_ERROR:
            raise DiscrepancyError(
                'noise: the spectrum rises with frequency or has lines, which white noise and '
                'relaxations cannot represent: give from_rest, or smooth the spectrum')
        white = max(float(solved[0]), 1e-9 * float(self.density.min()))
        noise = ChannelNoise(white, solved[1:], 0.0, KNOWN_EXACTLY, constants)
        return {record.run: noise for record in records}


@dataclass(frozen=True)
class _Unknown(Noise):
    learns_from_residuals: ClassVar[bool] = True

    def resolve(self, records: Sequence[ChannelRecord]) -> Mapping[str, ChannelNoise]:
        return {record.run: record_noise.noise_of_residuals(record) for record in records}


MAX_CHANCE = 1e-3
"""Chance of as small a misfit from noise alone, below which the noise is overestimated ..."""

MAX_RATIO = 0.5
"""... if the misfit is also below this share of the expected one."""


def overestimated(statistic: float, dimensions: float, degrees: float) -> bool:
    """Whether a whitened misfit over `dimensions` is far below the misfit of noise alone.

    degrees: degrees of freedom of the level of the noise.
    """
    if dimensions <= 0 or statistic >= MAX_RATIO * dimensions:
        return False
    chance = fisher_share_below(statistic / dimensions, dimensions, degrees)
    return bool(chance < MAX_CHANCE)


def underestimated(statistic: float, dimensions: float, degrees: float) -> bool:
    """Whether a whitened misfit over `dimensions` is far above the misfit of noise alone."""
    if dimensions <= 0 or statistic <= dimensions / MAX_RATIO:
        return False
    return bool(fisher_chance(statistic / dimensions, dimensions, degrees) < MAX_CHANCE)


def noise_sentence(
    side: Literal['over', 'under'], statistic: float, dimensions: float, where: str
) -> str:
    """The warning for a reader if the noise is over- or underestimated."""
    remedy = {
        'under': 'and no cause explains it; give the noise of the channel as it is, leave it to '
                 'be learnt (Noise.unknown), or declare a model error',
        'over': 'no conclusion is possible; give the noise of the channel (Noise.white, '
                'Noise.from_rest) or a smaller model error',
    }[side]
    return (
        f'noise {side}estimated in {where}: the misfit is {statistic:.3g} where noise alone would '
        f'give about {dimensions:.3g}{", " if side == "under" else ": "}{remedy}')


def learn_noise(
    runs: Sequence[RunBlocks], residuals: Sequence[Array] | None = None
) -> dict[tuple[str, int], ChannelNoise]:
    """Noise by run name and channel; runs with equal sampling share one estimate.

    `residuals` (C, N) per run, if given, add the noise between holds.
    """
    segments: dict[int, list[RestSegment]] = {}
    series: dict[int, list[HeldSeries]] = {}
    # A run without rest has a class of its own.
    keys = [sampling_class(run.rest[0].step) if run.rest else -1 for run in runs]
    for number, (key, run) in enumerate(zip(keys, runs, strict=True)):
        if run.rest:
            segments.setdefault(key, []).extend(run.rest)
        held = None if residuals is None else _held_series(run, residuals[number])
        if held is not None:
            series.setdefault(key, []).append(held)
    if not segments:
        raise DiscrepancyError(
            'noise: no stretch at rest in any run: record one in which the input is held')
    classes = {key: RestSource(rest, series.get(key, ())) for key, rest in segments.items()}
    count = runs[0].channels.shape[0]
    learnt = noise_by_class(classes, count)
    first = next(iter(learnt.values()))
    return {
        (run.name, channel): learnt.get(key, first)[channel]
        for key, run in zip(keys, runs, strict=True) for channel in range(count)}


def _held_series(run: RunBlocks, residual: Array) -> HeldSeries | None:
    """Means of a residual over consecutive holds, if the run is made of holds."""
    hold = run.hold
    if hold is None:
        return None
    levels, place = np.unique(hold, return_inverse=True)
    if levels.size < 8 or levels.size > 0.6 * hold.size:
        return None
    weight = np.bincount(place, run.width)
    time = np.bincount(place, run.width * run.time) / weight
    order = np.argsort(time)
    means = np.array([np.bincount(place, run.width * row) / weight for row in residual])
    return HeldSeries(means[:, order], time[order], weight[order].astype(np.float64))
