"""Declarations of the noise of a channel: `Noise.white`, `from_rest`, `unknown` ..."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.optimize import nnls

from saddlering_ros.discrepancy.noise.residuals import noise_of_residuals
from saddlering_ros.discrepancy.system import Array, DiscrepancyError
from saddlering_ros.estimation.process import ChannelNoise
from saddlering_ros.estimation.stretch_noise import (
    ChannelRecord,
    continued,
    noise_of_stretches,
    relaxation_grid,
)

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
        return _FromRest(tuple(tuple(item) for item in intervals))

    @staticmethod
    def from_repeats(repeats: Sequence[str | Array]) -> Noise:
        """Noise as the difference between repeats of one test.

        `repeats` are names of runs, or records (N,) of the channel sampled like the runs.
        """
        return _FromRepeats(tuple(repeats))

    @staticmethod
    def spectrum(frequency: Array, density: Array) -> Noise:
        """Noise of a one-sided power spectral density [unit^2 / Hz] at `frequency` [1 / time]."""
        both = (np.asarray(item, dtype=np.float64) for item in (frequency, density))
        return _Spectrum(*both)

    @staticmethod
    def unknown() -> Noise:
        """Noise learnt from the remainder of a flexible fit of the residuals (the default)."""
        return _Unknown()

    @abstractmethod
    def resolve(self, records: Sequence[ChannelRecord]) -> Mapping[str, ChannelNoise]:
        """The process by run. The records hold readings first and residuals later."""


@dataclass(frozen=True)
class _White(Noise):
    std: float

    def __post_init__(self) -> None:
        if not (np.isfinite(self.std) and self.std > 0.0):
            raise DiscrepancyError(f'noise: std is {self.std:g}: give a number above zero')

    def resolve(self, records: Sequence[ChannelRecord]) -> Mapping[str, ChannelNoise]:
        noise = ChannelNoise(
            0.0, np.zeros(0), 0.0, KNOWN_EXACTLY, np.zeros(0), floor=self.std**2
        )
        return {record.run: noise for record in records}


@dataclass(frozen=True)
class _FromRest(Noise):
    intervals: tuple[tuple[object, ...], ...]

    def __post_init__(self) -> None:
        if not self.intervals:
            raise DiscrepancyError('noise: from_rest needs at least one interval (start, end)')
        for item in self.intervals:
            start, end = self._ends(item)
            if not start < end:
                raise DiscrepancyError(
                    f'noise: the interval at rest from {start:g} to {end:g} is empty: give the '
                    'start first'
                )

    def resolve(self, records: Sequence[ChannelRecord]) -> Mapping[str, ChannelNoise]:
        stretches: list[Array] = []
        longest = 0.0
        step = min(record.step for record in records)
        for record in records:
            for item in self.intervals:
                if len(item) == 3 and item[0] != record.run:
                    continue
                start, end = self._ends(item)
                found = list(record.stretches(start, end))
                stretches += found
                longest = max([longest, *(part.size * record.step for part in found)])
        noise = noise_of_stretches(stretches, step, 0.25 * longest, 'the declared rest')
        return {
            record.run: continued(noise, 0.25 * longest, record.duration) for record in records
        }

    @staticmethod
    def _ends(item: tuple[object, ...]) -> tuple[float, float]:
        start, end = item[-2:]
        return float(str(start)), float(str(end))


@dataclass(frozen=True)
class _FromRepeats(Noise):
    repeats: tuple[str | Array, ...]

    def __post_init__(self) -> None:
        if len(self.repeats) < 2:
            raise DiscrepancyError('noise: from_repeats needs two repeats or more')

    def resolve(self, records: Sequence[ChannelRecord]) -> Mapping[str, ChannelNoise]:
        step = min(record.step for record in records)
        stack = self._stack(records)
        count = stack.shape[0]
        grown = np.sqrt(count / (count - 1.0))
        own = [np.asarray(row * grown, np.float64) for row in stack - stack.mean(axis=0)]
        time = np.linspace(0.0, step * (stack.shape[1] - 1), stack.shape[1])
        stretches = [part for row in own for part in ChannelRecord('', time, row).stretches()]
        longest = 0.25 * max((part.size for part in stretches), default=0) * step
        noise = noise_of_stretches(stretches, step, longest, 'the difference of the repeats')
        degrees = max(1, noise.pairs * (count - 1) // count)
        noise = ChannelNoise(
            noise.white, noise.slow, 0.0, degrees, noise.time_constants, noise.floor
        )
        return {record.run: noise for record in records}

    def _stack(self, records: Sequence[ChannelRecord]) -> Array:
        """Repeats (K, N) on the time of the first."""
        known = {record.run: record for record in records}
        rows: list[Array] = []
        first: ChannelRecord | None = None
        for repeat in self.repeats:
            if not isinstance(repeat, str):
                rows.append(np.asarray(repeat, dtype=np.float64))
                continue
            if repeat not in known:
                raise DiscrepancyError(
                    f'noise: from_repeats names the run {repeat!r}, which is not among '
                    f'{", ".join(known)}'
                )
            record = known[repeat]
            first = first or record
            shifted = record.time - record.time[0]
            wanted = first.time - first.time[0]
            values = record.values
            if shifted.size != wanted.size or not np.allclose(shifted, wanted):
                values = np.interp(wanted, shifted, values, right=np.nan)
            rows.append(values)
        length = min(row.size for row in rows)
        return np.array([row[:length] for row in rows])


@dataclass(frozen=True)
class _Spectrum(Noise):
    frequency: Array
    density: Array

    def __post_init__(self) -> None:
        good = self.frequency.size == self.density.size >= 2
        if not (good and np.all(self.frequency > 0.0) and np.all(self.density > 0.0)):
            raise DiscrepancyError(
                'noise: a spectrum needs two frequencies or more, all above zero, and a density '
                'above zero at each'
            )

    def resolve(self, records: Sequence[ChannelRecord]) -> Mapping[str, ChannelNoise]:
        low, high = float(self.frequency.min()), float(self.frequency.max())
        constants = relaxation_grid(0.5 / (np.pi * high), 0.5 / (np.pi * low))
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
                'relaxations cannot represent: give from_rest, or smooth the spectrum'
            )
        white = max(float(solved[0]), 1e-9 * float(self.density.min()))
        noise = ChannelNoise(white, solved[1:], 0.0, KNOWN_EXACTLY, constants)
        return {record.run: noise for record in records}


@dataclass(frozen=True)
class _Unknown(Noise):
    learns_from_residuals: ClassVar[bool] = True

    def resolve(self, records: Sequence[ChannelRecord]) -> Mapping[str, ChannelNoise]:
        return {record.run: noise_of_residuals(record) for record in records}
