"""Octaves of half waves in one run, faster than the slow structure, in whitened samples.

A narrow octave has an orthonormal basis. A wide octave is read from the cosine transform of the
whitened samples in N log N operations. Whitened waves are almost waves, because the noise changes
little over an octave.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy.fft import dct, idct

from saddlering_ros.discrepancy.problem.problem import Metric
from saddlering_ros.discrepancy.problem.system import Array, RunBlocks
from saddlering_ros.estimation.whitening import Whitener

WAVE_SAMPLES = 4
"""Samples per half wave at the fastest structure. A faster wave has too few samples to be told
from scatter."""

MAX_BASIS = 512
"""Largest number of half waves in a basis. Wider octaves are read from a cosine transform, whose
cost does not grow with the square."""

MAX_BASIS_NUMBERS = 2_000_000
"""Largest number of values in a basis, which limits its memory to 16 MB."""

NOISE_DRAWS = 8
"""Number of draws that give the plain size of the noise of a wide octave, to a few percent."""


class Band(Protocol):
    """One octave of one run.

    first: number of the first half wave; duration [s] of the run; noise (C,): mean square of
    the noise alone in each channel of this octave.
    """

    @property
    def run(self) -> int: ...

    @property
    def first(self) -> int: ...

    @property
    def duration(self) -> float: ...

    @property
    def noise(self) -> Array: ...

    def coefficients(self, white: Array) -> list[Array]:
        """Part of stacked whitened samples (n,) in this octave, by channel, with unit variance."""
        ...

    def seen(self, coefficients: Sequence[Array]) -> Array:
        """The same part in units of the channels (C, N)."""
        ...


@dataclass(frozen=True)
class BasisBand:
    """A narrow octave: samples and bases (N, k) by channel, whitened and plain."""

    run: int
    first: int
    duration: float
    parts: list[slice]
    white: list[Array]
    plain: list[Array]
    noise: Array

    def coefficients(self, white: Array) -> list[Array]:
        return [basis.T @ white[part] for part, basis in zip(self.parts, self.white, strict=True)]

    def seen(self, coefficients: Sequence[Array]) -> Array:
        pairs = zip(self.plain, coefficients, strict=True)
        return np.array([basis @ coefficient for basis, coefficient in pairs])


@dataclass(frozen=True)
class TransformBand:
    """A wide octave: half waves `first` to `stop` of the cosine transform."""

    run: int
    first: int
    duration: float
    stop: int
    parts: list[slice]
    whiteners: list[Whitener]
    width: Array

    def coefficients(self, white: Array) -> list[Array]:
        return [dct(white[part], norm='ortho')[self.first : self.stop] for part in self.parts]

    def seen(self, coefficients: Sequence[Array]) -> Array:
        rows = []
        for whitener, coefficient in zip(self.whiteners, coefficients, strict=True):
            rows.append(self._measured(whitener, coefficient[:, None])[:, 0])
        return np.array(rows)

    @cached_property
    def noise(self) -> Array:
        random = np.random.default_rng(0)
        drawn = random.normal(size=(self.stop - self.first, NOISE_DRAWS))
        return np.array(
            [
                float(
                    np.average(
                        (self._measured(whitener, drawn) ** 2).mean(axis=1), weights=self.width)
                )
                for whitener in self.whiteners
            ]
        )

    def _measured(self, whitener: Whitener, coefficients: Array) -> Array:
        spectrum = np.zeros((self.width.size, coefficients.shape[1]))
        spectrum[self.first : self.stop] = coefficients
        return whitener.colour(np.asarray(idct(spectrum, axis=0, norm='ortho')))


@dataclass(frozen=True)
class _Octave:
    """Half waves `first` to `stop` of one run, with the samples and whitener of each channel."""

    index: int
    run: RunBlocks
    parts: list[slice]
    whiteners: list[Whitener]
    first: int
    stop: int

    @property
    def duration(self) -> float:
        return max(float(np.ptp(self.run.time)), 1e-300)

    @property
    def is_narrow(self) -> bool:
        count = self.stop - self.first
        return count <= MAX_BASIS and count * self.run.time.size <= MAX_BASIS_NUMBERS


def fast_bands(metric: Metric, first: int) -> list[Band]:
    """Octaves from half wave `first` up to the limit of the samples of a run."""
    bands: list[Band] = []
    slices = metric.problem.slices
    for index, run in enumerate(metric.problem.runs):
        last = run.time.size // WAVE_SAMPLES
        pairs = zip(metric.whiteners, slices, strict=True)
        whiteners = [whitener for whitener, part in pairs if part[0] == index]
        parts = [part for number, _, part in slices if number == index]
        begin = first
        while begin <= last:
            stop = min(2 * begin - 1, last + 1)
            octave = _Octave(index, run, parts, whiteners, begin, stop)
            bands.append(_basis_band(octave) if octave.is_narrow else _transform_band(octave))
            begin = stop
    return bands


def _basis_band(octave: _Octave) -> Band:
    run = octave.run
    share = (run.time - run.time[0]) / octave.duration
    waves = np.cos(np.pi * share[:, None] * np.arange(octave.first, octave.stop)[None, :])
    white, plain, noise = [], [], []
    for whitener in octave.whiteners:
        basis, _ = np.linalg.qr(whitener.whiten(waves))
        white.append(basis)
        plain.append(whitener.colour(basis))
        noise.append(float(np.average((plain[-1] ** 2).sum(axis=1), weights=run.width)))
    return BasisBand(
        octave.index, octave.first, octave.duration, octave.parts, white, plain, np.array(noise))


def _transform_band(octave: _Octave) -> Band:
    return TransformBand(
        octave.index, octave.first, octave.duration, octave.stop, octave.parts, octave.whiteners,
        octave.run.width)
