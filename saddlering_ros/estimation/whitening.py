"""Residuals whitened by a noise process in O(N): even and uneven samples, block means, gaps.

The covariance of T relaxations is semiseparable, and its Cholesky factor has T numbers a sample
(Foreman-Mackey, Agol, Ambikasaran and Angus, Astron. J. 154 (2017) 220).

A narrow octave of half waves of a whitened record has an orthonormal basis. A wide octave is read
from the cosine transform of the whitened samples in N log N operations. Whitened waves are almost
waves, because the noise changes little over an octave.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.fft import dct, idct

from saddlering_ros.compiled import Compiler
from saddlering_ros.estimation import process
from saddlering_ros.estimation.process import Array, ChannelNoise, EstimationError

OVERLAP = 0.1
"""Largest overlap of neighbouring blocks, as a share of a block, by jitter of stamps."""


@dataclass(frozen=True)
class Whitener:
    """Cholesky factor L of a noise covariance, as its N x (4 T + 1) numbers.

    `whiten` applies L^-1 and `colour` applies L. The result equals that of the dense factor to
    rounding.
    """

    ahead: Array  # (N, T): covariance of a sample with what its first edge carries on
    gaps: Array  # (N, T): decay over the gap before a sample
    inside: Array  # (N, T): decay over the sample itself
    pivots: Array  # (N,): squares of the diagonal of L, infinite where a sample is missing
    gains: Array  # (N, T): what a whitened sample adds to the state of each relaxation

    @property
    def present(self) -> Array:
        """Mask (N,) of the samples that are present."""
        return np.asarray(np.isfinite(self.pivots))

    def whiten(self, columns: Array) -> Array:
        """L^-1 times columns (N, B) or (N,); 0 where a sample is missing."""
        matrix = np.array(columns.reshape(len(columns), -1), dtype=np.float64, order='C')
        self.whiten_in_place(matrix)
        return matrix.reshape(columns.shape)

    def whiten_in_place(self, columns: Array) -> None:
        """`whiten` of a contiguous array (N, B), which is overwritten."""
        whiten_kernel(self.ahead, self.gaps, self.inside, self.pivots, self.gains, columns)

    def colour(self, columns: Array) -> Array:
        """L times columns (N, B) or (N,); 0 where a sample is missing."""
        matrix = np.array(columns.reshape(len(columns), -1), dtype=np.float64, order='C')
        colour_kernel(self.ahead, self.gaps, self.inside, self.pivots, self.gains, matrix)
        return matrix.reshape(columns.shape)


def build_whitener(noise: ChannelNoise, time: Array, width: Array, hold: Array | None = None,
                   present: Array | None = None, jitter: float = 0.0) -> Whitener:
    """Whitener of means over `width` (N,) about `time` (N,) [s], in order of time.

    hold (N,) numbers the levels at which a coarse converter keeps its part of the noise; a level
    that returns later counts as another one. present (N,) is 0 where a sample is missing. jitter
    [unit^2] is added to every variance.
    """
    if np.any(np.diff(time) < 0.0):
        raise EstimationError('noise: the samples of a run must be in order of time')
    parts = noise.parts()
    variance = np.array([values[0] for values in parts])
    tau = np.array([values[1] for values in parts])
    ratio = width[:, None] / tau
    edge = process.mean_correlation(ratio)
    variances = noise.white / width + noise.floor + jitter
    variances = variances + process.mean_variance(ratio) @ variance
    gap = np.diff(time, prepend=time[0]) - 0.5 * (width + np.append(width[0], width[:-1]))
    # Blocks may overlap by the jitter of their stamps; distances along the run stay exact.
    gap = np.maximum(gap, -OVERLAP * np.minimum(width, np.append(width[0], width[:-1])))
    gaps = np.exp(-gap[:, None] / tau)
    inside = np.exp(-ratio)
    ahead, behind = variance * edge, edge
    if noise.held > 0.0:
        variances = variances + noise.held
        # 1 where a sample is at the level of the one before it.
        stays = np.zeros(time.size) if hold is None else np.append(0.0, np.diff(hold) == 0.0)
        ones = np.ones((time.size, 1))
        ahead, behind = np.hstack([ahead, noise.held * ones]), np.hstack([behind, ones])
        gaps, inside = np.hstack([gaps, stays[:, None]]), np.hstack([inside, ones])
    there = np.ones(time.size) if present is None else present.astype(np.float64)
    pivots, gains = np.empty(time.size), np.empty_like(ahead)
    ahead, gaps, inside = (np.ascontiguousarray(values) for values in (ahead, gaps, inside))
    bad = factorise_kernel(
        variances, ahead, np.ascontiguousarray(behind), gaps, inside, there, pivots, gains)
    if bad:
        raise EstimationError(
            f'noise: the covariance is singular at sample {bad - 1}: give the channel some white '
            'noise')
    return Whitener(ahead, gaps, inside, pivots, gains)


def independent(variances: Array) -> Whitener:
    """Whitener of independent readings of given variances (N,)."""
    none = np.zeros((variances.size, 0))
    return Whitener(none, none, none, np.ascontiguousarray(variances), none)


kernel = Compiler(__file__)


@kernel(nogil=True, error_model='numpy')
def factorise_kernel(variances, ahead, behind, gaps, inside, present, pivots, gains):  # type: ignore[no-untyped-def]
    """Fill `pivots` (N,), squares of L's diagonal, and `gains` (N, T); 0 if all are positive.

    variances (N,); ahead, behind (N, T): u and v; gaps, inside (N, T): decay over the gap
    before a sample and over the sample itself; present (N,): 0 where a sample is missing. Returns
    1 + the place of a pivot that is not positive.
    """
    count, parts = ahead.shape
    state = np.zeros((parts, parts))
    reach = np.zeros(parts)
    for n in range(count):
        for i in range(parts):
            for j in range(parts):
                state[i, j] *= gaps[n, i] * gaps[n, j]
        pivot = variances[n]
        for i in range(parts):
            total = 0.0
            for j in range(parts):
                total += state[i, j] * ahead[n, j]
            reach[i] = total
            pivot -= ahead[n, i] * total
        if present[n] and not pivot > 0.0:
            return n + 1
        if not present[n]:
            pivot = np.inf
        pivots[n] = pivot
        for i in range(parts):
            gains[n, i] = (behind[n, i] - inside[n, i] * reach[i]) / pivot
        for i in range(parts):
            for j in range(parts):
                state[i, j] *= inside[n, i] * inside[n, j]
                if present[n]:
                    state[i, j] += pivot * gains[n, i] * gains[n, j]
    return 0


@kernel(nogil=True, error_model='numpy')
def whiten_kernel(ahead, gaps, inside, pivots, gains, columns):  # type: ignore[no-untyped-def]
    """L^-1 times `columns` (N, B), in place; 0 where a sample is missing."""
    count, parts = ahead.shape
    width = columns.shape[1]
    state = np.zeros((parts, width))
    for n in range(count):
        for i in range(parts):
            decay = gaps[n, i]
            share = ahead[n, i]
            for b in range(width):
                state[i, b] *= decay
                columns[n, b] -= share * state[i, b]
        missing = pivots[n] == np.inf
        for i in range(parts):
            decay = inside[n, i]
            gain = gains[n, i]
            for b in range(width):
                state[i, b] *= decay
                if not missing:
                    state[i, b] += gain * columns[n, b]
        scale = 0.0 if missing else 1.0 / np.sqrt(pivots[n])
        for b in range(width):
            columns[n, b] = 0.0 if missing else scale * columns[n, b]


@kernel(nogil=True, error_model='numpy')
def colour_kernel(ahead, gaps, inside, pivots, gains, columns):  # type: ignore[no-untyped-def]
    """L times `columns` (N, B), in place; 0 where a sample is missing."""
    count, parts = ahead.shape
    width = columns.shape[1]
    state = np.zeros((parts, width))
    shock = np.zeros(width)
    for n in range(count):
        missing = pivots[n] == np.inf
        scale = 0.0 if missing else np.sqrt(pivots[n])
        for b in range(width):
            shock[b] = 0.0 if missing else scale * columns[n, b]
            columns[n, b] = shock[b]
        for i in range(parts):
            decay = gaps[n, i]
            onward = inside[n, i]
            gain = gains[n, i]
            share = 0.0 if missing else ahead[n, i]
            for b in range(width):
                reached = decay * state[i, b]
                columns[n, b] += share * reached
                state[i, b] = onward * reached + gain * shock[b]


MIN_STRENGTH = 1e-3
"""Smallest effect of an error that is removed, in units of the scatter of the residuals."""

MIN_STRENGTH_OF_MANY = 0.03
"""The same limit for hundreds of errors."""


@dataclass(frozen=True)
class SharedErrors:
    """Independent errors of unit variance that residuals (n,) share.

    directions (n, k) orthonormal, strength (k,) over the residuals' own scatter; mixture (M, k):
    the part that each of the M errors has in a direction.
    """

    directions: Array
    strength: Array
    mixture: Array

    @classmethod
    def none(cls, size: int) -> 'SharedErrors':
        """No shared error of residuals (size,)."""
        return cls(np.zeros((size, 0)), np.zeros(0), np.zeros((0, 0)))

    @classmethod
    def of(cls, answers: Array) -> 'SharedErrors':
        """Shared errors of residuals with the responses (n, M) to M errors of any size."""
        left, strength, right = np.linalg.svd(answers, full_matrices=False)
        kept = strength > MIN_STRENGTH
        return cls(np.ascontiguousarray(left[:, kept]), strength[kept], right[kept].T)

    @classmethod
    def of_many(cls, answers: Array) -> 'SharedErrors':
        """The same for hundreds of errors, none of which is thousands of times the noise."""
        variance, mixture = np.linalg.eigh(answers.T @ answers)
        kept = variance > MIN_STRENGTH_OF_MANY**2
        strength, mixture = np.sqrt(variance[kept]), mixture[:, kept]
        return cls(answers @ (mixture / strength), strength, mixture)

    @property
    def shrink(self) -> Array:
        """Parts (k,) of residuals along the directions that are removed."""
        return np.asarray(1.0 - 1.0 / np.sqrt(1.0 + self.strength**2))

    @property
    def volume(self) -> float:
        """Logarithm of the determinant of the covariance, over that of the scatter alone."""
        return float(np.log1p(self.strength**2).sum())

    @property
    def dimensions(self) -> float:
        """Number of dimensions that the errors remove from the residuals."""
        return float((1.0 - (1.0 - self.shrink) ** 2).sum())

    def apply(self, columns: Array) -> Array:
        """Whitened columns (n, B) or (n,)."""
        # With a few columns, the product of rows takes half the time of that of columns.
        along = self.shrink * (columns.T @ self.directions)
        return np.asarray(columns - (along @ self.directions.T).T)

    def along(self, residual: Array) -> Array:
        """The errors along the directions (k,) that a residual (n,) makes most likely."""
        share = self.strength / (1.0 + self.strength**2)
        return np.asarray(share * (self.directions.T @ residual))

    def likely(self, residual: Array) -> Array:
        """The errors (M,) that a residual (n,) makes most likely."""
        return np.asarray(self.mixture @ self.along(residual))


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


def octaves_of(time: Array, width: Array, parts: list[slice], whiteners: list[Whitener],
               begin: int, last: int) -> Iterator[BasisBand | TransformBand]:
    """Octaves from half wave `begin` to `last`."""
    while begin <= last:
        stop = min(2 * begin - 1, last + 1)
        count = stop - begin
        is_narrow = count <= MAX_BASIS and count * time.size <= MAX_BASIS_NUMBERS
        kind = BasisBand if is_narrow else TransformBand
        yield kind(time, width, begin, stop, parts, whiteners)
        begin = stop
