"""Octaves of half waves of a whitened record, and their coefficients in its samples.

A narrow octave has an orthonormal basis. A wide octave is read from the cosine transform of the
whitened samples in N log N operations. Whitened waves are almost waves, because the noise changes
little over an octave.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.fft import dct, idct

from saddlering_ros.estimation.process import Array
from saddlering_ros.estimation.whitening import Whitener

MAX_BASIS = 512
"""Half waves in a basis at most; the cost of wider ones would grow with the square."""

MAX_BASIS_NUMBERS = 2_000_000
"""Largest number of values in a basis, which limits its memory to 16 MB."""

NOISE_DRAWS = 8
"""Number of draws that give the mean square of the noise of a wide octave, to 1.3 % (twelve seeds,
600 half waves); half as many give it to 1.6 %."""


@dataclass(frozen=True)
class _Octave:
    """Half waves `first` to `stop` of samples at `time` (N,) [s], block means over `width` (N,).

    parts, whiteners: of each channel, where its samples are in a stacked vector.
    """

    time: Array
    width: Array
    first: int
    stop: int
    parts: list[slice]
    whiteners: list[Whitener]

    @property
    def duration(self) -> float:
        """Duration [s] of the record."""
        return max(float(np.ptp(self.time)), 1e-300)


class BasisBand(_Octave):
    """A narrow octave, by bases (N, k) of each channel, whitened and plain."""

    @cached_property
    def _bases(self) -> list[tuple[Array, Array]]:
        share = (self.time - self.time[0]) / self.duration
        waves = np.cos(np.pi * share[:, None] * np.arange(self.first, self.stop)[None, :])
        bases = [np.linalg.qr(whitener.whiten(waves))[0] for whitener in self.whiteners]
        return [(basis, whitener.colour(basis))
                for basis, whitener in zip(bases, self.whiteners, strict=True)]

    @cached_property
    def noise(self) -> Array:
        """Mean square (C,) of the noise alone in each channel of this octave."""
        return np.array([float(np.average((plain**2).sum(axis=1), weights=self.width))
                         for _, plain in self._bases])

    def coefficients(self, white: Array) -> list[Array]:
        """Part of stacked whitened samples (n,) in this octave, by channel, with unit variance."""
        return [basis.T @ white[part]
                for part, (basis, _) in zip(self.parts, self._bases, strict=True)]

    def seen(self, coefficients: Sequence[Array]) -> Array:
        """The same part in units of the channels (C, N)."""
        return np.array([plain @ coefficient for (_, plain), coefficient
                         in zip(self._bases, coefficients, strict=True)])


class TransformBand(_Octave):
    """A wide octave, by the cosine transform; its methods are those of `BasisBand`."""

    @cached_property
    def noise(self) -> Array:
        drawn = np.random.default_rng(0).normal(size=(self.stop - self.first, NOISE_DRAWS))
        return np.array([
            float(np.average((self._measured(whitener, drawn) ** 2).mean(axis=1),
                             weights=self.width)) for whitener in self.whiteners])

    def coefficients(self, white: Array) -> list[Array]:
        return [dct(white[part], norm='ortho')[self.first : self.stop] for part in self.parts]

    def seen(self, coefficients: Sequence[Array]) -> Array:
        return np.array([
            self._measured(whitener, coefficient[:, None])[:, 0]
            for whitener, coefficient in zip(self.whiteners, coefficients, strict=True)])

    def _measured(self, whitener: Whitener, coefficients: Array) -> Array:
        spectrum = np.zeros((self.time.size, coefficients.shape[1]))
        spectrum[self.first : self.stop] = coefficients
        return whitener.colour(np.asarray(idct(spectrum, axis=0, norm='ortho')))


def octaves_of(
    time: Array, width: Array, parts: list[slice], whiteners: list[Whitener], begin: int, last: int
) -> Iterator[BasisBand | TransformBand]:
    """Octaves from half wave `begin` to `last`."""
    while begin <= last:
        stop = min(2 * begin - 1, last + 1)
        count = stop - begin
        is_narrow = count <= MAX_BASIS and count * time.size <= MAX_BASIS_NUMBERS
        kind = BasisBand if is_narrow else TransformBand
        yield kind(time, width, begin, stop, parts, whiteners)
        begin = stop
