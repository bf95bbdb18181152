"""Noise learnt from a record: from its stretches, its residual, or what two records share.

The time constants follow from the record, so that nothing depends on the unit of time or of the
channel.

Slow structure of a residual may be a cause and must not become noise. A flexible fit therefore
removes all waves slower than `SLOW_WAVES` half waves per run, and the remainder is fast. The level
of the remainder is assumed to continue at slower times (a flat spectrum below). Its degrees of
freedom are those of the fast part, and tests against this noise are F tests with this number. The
record needs no rest. The remainder has no slow part, so that statistics over time would be biased,
but its spectrum above the removed waves is not. White noise and relaxations maximise the Whittle
likelihood there (P. Whittle, Ark. Mat. 2 (1953) 423): the lines of a spectrum are independent and
exponentially distributed about their expectation.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.fft import dct, idct
from scipy.optimize import nnls

from saddlering_ros.errors import counted
from saddlering_ros.estimation import process
from saddlering_ros.estimation.noise import MIN_SAMPLES, MIN_WHITE, Statistics
from saddlering_ros.estimation.process import allan_columns, Array, ChannelNoise, EstimationError

PARTS_PER_DECADE = 2
"""Relaxations per decade of time constants: closer ones cannot be separated."""

MAX_PARTS = 12
"""Largest number of relaxations of a channel; the cost of whitening grows with its square."""

SLOW_WAVES = 40
"""Half waves per run that a flexible fit removes."""

MIN_SLOW_WAVES = 20
"""Half waves that a flexible fit removes from a run of few samples: those that are tested."""

SAMPLES_PER_WAVE, MIN_SAMPLES_PER_WAVE = 10, 5
"""Samples per half wave above that number of half waves, and smallest number in a run."""

MAX_BINS = 120
"""Bins of the averaged lines, evenly spaced on a log scale, for speed with little loss."""

ROUNDS = 300
"""Rounds of the multiplicative update; each one raises the likelihood."""

RELAXATIONS_TRIED = 20
"""Time constants of a single relaxation that are tried."""

MIN_SPACING = 1.5
"""Usual spacing of a channel's samples over that of its run, from which the channel is recorded at
a rate of its own: 1 if less than half of the samples are missing, and 2 or more otherwise."""

BINS_AN_OCTAVE = 2
"""Bins of the comparison of a spectrum with an expected one."""

COMMON_TIMES = np.array([1.0, 2.0, 4.0, 8.0])
"""Possible time constants [s] of a common wander."""


@dataclass(frozen=True)
class ChannelRecord:
    """One channel of one run: readings, or residuals once there is a prediction."""

    run: str
    time: Array  # (N,) [s]
    values: Array  # (N,), NaN where a sample is missing

    @property
    def step(self) -> float:
        """Usual spacing of the samples [s]."""
        return float(np.median(np.diff(self.time)))

    @property
    def duration(self) -> float:
        return float(self.time[-1] - self.time[0])

    def at_own_rate(self) -> 'ChannelRecord':
        """The samples that are there alone, where they have a rate of their own."""
        there = np.isfinite(self.values)
        own = replace(self, time=self.time[there], values=self.values[there])
        return own if own.step > MIN_SPACING * self.step else self

    def stretches(self, start: float = -np.inf, end: float = np.inf) -> Iterator[Array]:
        """Values between `start` and `end` [s], in stretches without a missing sample."""
        there = np.isfinite(self.values) & (self.time >= start) & (self.time <= end)
        index = np.flatnonzero(there)
        if index.size == 0:
            return
        wide = np.diff(self.time[index]) > 2.5 * self.step
        broken = (np.diff(index) > 1) | wide
        for stretch in np.split(index, np.flatnonzero(broken) + 1):
            if stretch.size >= 2:
                yield self.values[stretch]


def relaxation_grid(step: float, longest: float) -> Array:
    """Time constants [s] from `step` to `longest`, evenly spaced on a log scale."""
    if longest <= step:
        return np.zeros(0)
    count = round(PARTS_PER_DECADE * np.log10(longest / step)) + 1
    return np.geomspace(step, longest, int(np.clip(count, 1, MAX_PARTS)))


def noise_of_stretches(stretches: Sequence[Array], step: float, longest: float,
                       where: str) -> ChannelNoise:
    """White noise and relaxations that fit the Allan variances of `stretches` best.

    longest [s]: largest averaging time and time constant; where: place for messages.
    """
    rows = [(np.asarray(row - row.mean()), step) for row in stretches]
    sizes = [row.size for row, _ in rows]
    if sum(sizes) < MIN_SAMPLES:
        raise EstimationError(
            f'noise: {where} has only {counted(sum(sizes), "sample")}: give at least '
            f'{MIN_SAMPLES}, or Noise.white(std)')
    scales, observed, pairs = process.allan_variances(rows)
    used = scales <= max(longest, step) * (1.0 + 1e-9)
    observed = observed[used]
    if not observed.max(initial=0.0) > 0.0:
        raise EstimationError(
            f'noise: {where} does not vary: give Noise.white(std) with the resolution of '
            'the instrument')
    constants = relaxation_grid(step, longest)
    parts = Statistics(observed, allan_columns(scales[used], constants), pairs[used]).mixture()
    white = max(float(parts[0]), MIN_WHITE * float(observed.max()) * step)
    return _with_degrees(ChannelNoise(white, parts[1:], 0.0, 1, constants), step, sizes)


def _with_degrees(noise: ChannelNoise, step: float, sizes: Sequence[int]) -> ChannelNoise:
    """The same with the number of independent samples in stretches of `sizes`.

    The variance of a variance estimate from N samples of correlation r_k equals that of N /
    sum r_k^2 independent samples (Bartlett).
    """
    lags = np.arange(max(sizes)) * step
    variance_of_sample = noise.white / step + noise.floor
    tail = np.zeros(lags.size)
    for variance, tau in noise.parts():
        ratio = np.array([step / tau])
        variance_of_sample += float(variance * process.mean_variance(ratio)[0])
        edge = float(process.mean_correlation(ratio)[0])
        tail += variance * edge**2 * np.exp(-np.maximum(lags - step, 0.0) / tau)
    squares = np.cumsum((tail / variance_of_sample) ** 2) - (tail[0] / variance_of_sample) ** 2
    total = 0.0
    for size in sizes:
        total += size / (1.0 + 2.0 * float(squares[size - 1]))
    return replace(noise, pairs=max(1, int(total)))


def continued(noise: ChannelNoise, seen: float, duration: float) -> ChannelNoise:
    """Slow noise that is as large at longer times as at the longest observed ones.

    A stretch of `seen` seconds shows no slower noise. If its slowest relaxation is present,
    noise is assumed to continue; white noise is not.
    """
    slowest = float(noise.slow[noise.time_constants > 0.3 * seen].sum())
    if slowest <= 0.0 or duration <= 1.5 * seen:
        return noise
    longer = relaxation_grid(seen * 10.0 ** (1.0 / PARTS_PER_DECADE), duration)
    if longer.size == 0:
        longer = np.array([duration])
    return noise.with_relaxations(np.full(longer.size, slowest), longer)


def noise_of_residuals(record: ChannelRecord, walk: float = 0.0) -> ChannelNoise:
    """Noise of one channel of one run, from the fast part of its residual.

    Missing samples are interpolated for the flexible fit and left out of the statistics. walk: of
    a random walk beside it, which is known [unit over the root of the unit of time].
    """
    values, waves = _fast_values(record)
    wander = None if walk == 0.0 else _relaxing(0.5 * walk**2 * record.duration, record.duration)
    noise = _noise_of_fast_values(record, values, waves, wander)
    # Below the fast part the level is as uncertain as at the slowest waves of the fast part.
    noise = replace(noise, pairs=max(1, min(noise.pairs, 2 * waves)))
    return noise if wander is None else noise.with_relaxations(wander.slow, wander.time_constants)


def _relaxing(variance: float, time_constant: float) -> ChannelNoise:
    """One relaxation; as long as a record, it is a random walk there."""
    return ChannelNoise(0.0, np.array([variance]), 0.0, 1, np.array([time_constant]))


def walk_of(record: ChannelRecord) -> float:
    """The random walk in white noise, relaxations and a walk that fit a whole residual best."""
    fast = relaxation_grid(record.step, 0.5 * record.duration / SLOW_WAVES)
    found = _likeliest(
        _whole_spectrum(record), np.append(fast, record.duration), record.step)
    return float((2.0 * found.slow[-1] / record.duration) ** 0.5)


def widened(noise: ChannelNoise, record: ChannelRecord) -> ChannelNoise:
    """`noise` plus the broadband model error in the fast part of a residual.

    On most machines the noise at rest is not the whole noise. An excess counts if it is half
    the level at some averaging time and larger than chance.
    """
    values, waves = _fast_values(record)
    octaves = np.log2(values.size / (waves + 1.0))
    coarse = _spectrum_above(values, waves, max(1, round(BINS_AN_OCTAVE * octaves)))
    tolerable = 1.0 + np.maximum(0.5, 4.0 * np.sqrt(2.0 / coarse.lines))
    expected = _expected_power(noise, coarse.frequency, record.step)
    if not np.any(coarse.power > expected * tolerable):
        return noise
    extra = _noise_of_fast_values(record, values, waves, noise)
    return replace(
        noise.with_relaxations(extra.slow, extra.time_constants), white=noise.white + extra.white,
        pairs=min(noise.pairs, extra.pairs))


def with_model_error(noise: ChannelNoise, share: float, span: float, step: float,
                     duration: float) -> ChannelNoise:
    """`noise` and a declared broadband model error of `share` of the channel's range `span`.

    Its variance is spread evenly over all decades of time from `step` to `duration` [s]; an equal
    part is independent in each sample. No band of frequencies then has all the weight.
    """
    if share <= 0.0:
        return noise
    constants = relaxation_grid(step, duration)
    each = (share * span) ** 2 / (constants.size + 1)
    wider = noise.with_relaxations(np.full(constants.size, each), constants)
    return replace(wider, floor=noise.floor + each)


def _fast_values(record: ChannelRecord) -> tuple[Array, int]:
    """Remainder (N,) of a flexible fit over the order of samples, and its number of half waves.

    Missing samples are interpolated for the fit, and NaN in the remainder.
    """
    there = np.isfinite(record.values)
    spectrum = dct(np.interp(record.time, record.time[there], record.values[there]), norm='ortho')
    waves = min(SLOW_WAVES, max(MIN_SLOW_WAVES, there.size // SAMPLES_PER_WAVE))
    waves = min(waves, there.size // MIN_SAMPLES_PER_WAVE)
    spectrum[: waves + 1] = 0.0
    return np.where(there, idct(spectrum, norm='ortho'), np.nan), waves


def _noise_of_fast_values(record: ChannelRecord, values: Array, waves: int,
                          present: ChannelNoise | None = None) -> ChannelNoise:
    """White noise and relaxations of greatest likelihood for a fast part (N,) beyond `present`."""
    sizes = [row.size for row in replace(record, values=values).stretches()]
    if sum(sizes) < MIN_SAMPLES:
        raise EstimationError(
            f'noise: run {record.run} holds {counted(sum(sizes), "sample")}, too few to learn '
            f'from: give at least {MIN_SAMPLES}, or Noise.white(std)')
    step = record.step
    spectrum = _spectrum_above(values, waves, MAX_BINS)
    if not spectrum.power.max(initial=0.0) > 0.0:
        raise EstimationError(
            f'noise: run {record.run} does not vary at all: give Noise.white(std) with the '
            'resolution of the instrument')
    constants = relaxation_grid(step, 0.5 * record.duration / max(waves, 1))
    expected = 0.0 if present is None else _expected_power(present, spectrum.frequency, step)
    return _with_degrees(_likeliest(spectrum, constants, step, expected), step, sizes)


def longest_relaxation(duration: float) -> float:
    """Longest time constant that a record of `duration` can tell from a drift."""
    return 0.05 * duration


def relaxation_of(record: ChannelRecord) -> ChannelNoise:
    """White noise and the one relaxation that fit a whole residual best, its slow part included.

    The relaxation has the time constant of greatest likelihood, up to `longest_relaxation`.
    """
    step, spectrum = record.step, _whole_spectrum(record)

    constants = np.geomspace(
        step, max(longest_relaxation(record.duration), step), RELAXATIONS_TRIED)[:, None]
    parts, expected = _mixtures(spectrum, constants, step)
    best = int(np.argmin((np.log(expected) + spectrum.power / expected) @ spectrum.lines))
    noise = _with_white(spectrum, parts[best], constants[best], step)
    return _with_degrees(noise, step, [int(np.isfinite(record.values).sum())])


def _whole_spectrum(record: ChannelRecord) -> '_Spectrum':
    """Spectrum of a residual less its mean."""
    return _spectrum_above(record.values - np.nanmean(record.values), 0, MAX_BINS)


def _likeliest(spectrum: '_Spectrum', constants: Array, step: float,
               expected: Array | float = 0.0) -> ChannelNoise:
    """White noise and relaxations (T,) of greatest likelihood beside `expected` (F,)."""
    parts, _ = _mixtures(spectrum, constants[None], step, expected)
    return _with_white(spectrum, parts[0], constants, step)


def _mixtures(spectrum: '_Spectrum', constants: Array, step: float,
              expected: Array | float = 0.0) -> tuple[Array, Array]:
    """Likeliest parts (S, 1 + T) with each of S sets of relaxations (S, T), and powers (S, F)."""
    columns = np.array([_spectral_columns(spectrum.frequency, own, step) for own in constants])
    unit = columns.mean(axis=1)
    columns = columns / unit[:, None, :]
    excess = np.maximum(spectrum.power - expected, 0.0).mean()
    weights = np.full(unit.shape, max(float(excess), np.finfo(float).tiny) / unit.shape[1])
    for _ in range(ROUNDS):
        total = (columns @ weights[:, :, None])[:, :, 0] + expected
        pull, push = (np.squeeze(one[:, None, :] @ columns, 1) for one in (
            spectrum.lines * spectrum.power / total**2, spectrum.lines / total))
        weights = weights * np.sqrt(pull / push)
    return weights / unit, (columns @ weights[:, :, None])[:, :, 0] + expected


def _with_white(spectrum: '_Spectrum', parts: Array, constants: Array,
                step: float) -> ChannelNoise:
    """Noise of a white part and relaxations (1 + T,), the white part above rounding."""
    white = max(float(parts[0]), MIN_WHITE * float(spectrum.power.max()) * step)
    return ChannelNoise(white, parts[1:], 0.0, 1, constants)


class _Spectrum(NamedTuple):
    """Mean squares `power` (F,) of `lines` (F,) lines about `frequency` (F,) [cycles a sample]."""

    frequency: Array
    power: Array
    lines: Array


def _spectrum_above(values: Array, waves: int, bins: int) -> _Spectrum:
    """Spectrum of values (N,), NaN where missing, above `waves` half waves, in at most `bins`."""
    there = np.isfinite(values)
    count = values.size
    power = dct(np.where(there, values, 0.0), norm='ortho')[waves + 1 :] ** 2
    power *= count / max(int(there.sum()), 1)
    edges = np.geomspace(waves + 1, count, bins + 1)
    begin = np.unique(np.round(edges[:-1]).astype(int)) - waves - 1
    begin = begin[begin < power.size]  # of a short record, the last edge rounds to its end
    lines = np.diff(np.append(begin, power.size))
    half_waves = np.arange(waves + 1, count, dtype=np.float64)
    return _Spectrum(
        np.add.reduceat(half_waves, begin) / lines / (2.0 * count),
        np.add.reduceat(power, begin) / lines, lines.astype(np.float64))


def _expected_power(noise: ChannelNoise, frequency: Array, step: float) -> Array:
    """Mean squares (F,) of lines at `frequency` in `noise` with samples of `step` [s]."""
    parts = noise.parts()
    columns = _spectral_columns(frequency, np.array([tau for _, tau in parts]), step)
    white = noise.white + noise.floor * step
    return np.asarray(columns @ np.append(white, [variance for variance, _ in parts]))


def _spectral_columns(frequency: Array, constants: Array, step: float) -> Array:
    """Mean squares (F, 1 + T) of lines of unit white density and of each unit relaxation."""
    cosine = np.cos(2.0 * np.pi * frequency)
    columns = [np.full(frequency.size, 1.0 / step)]
    for tau in constants:
        ratio = np.array([step / tau])
        edge = float(process.mean_correlation(ratio)[0])
        level = float(process.mean_variance(ratio)[0])
        keep = float(np.exp(-ratio[0]))
        tail = (cosine - keep) / (1.0 - 2.0 * keep * cosine + keep**2)
        columns.append(level + 2.0 * edge**2 * tail)
    return np.column_stack(columns)


def common_noise(first: Sequence[Array], second: Sequence[Array], weights: Sequence[float],
                 step: float) -> ChannelNoise:
    """Common noise of pairs of segments (n_i,) with samples every `step` [s].

    It follows from the Allan variances of their sum and difference, in which noise of one channel
    cancels. `weights`: of the pairs. Segments of a few seconds hardly determine a slow time
    constant, so that each of COMMON_TIMES counts by its likelihood.
    """
    counts = np.array(process.averaged_counts(max(map(len, first))))
    pairs = np.array([[max(0, len(row) // count - 1) for count in counts] for row in first])
    seen = pairs.sum(axis=0) > 0
    counts, pairs = counts[seen], pairs[:, seen]
    share = np.asarray(weights)[:, None] * pairs
    share = share / share.sum(axis=0)
    kinds = (
        [a + b for a, b in zip(first, second, strict=True)],
        [a - b for a, b in zip(first, second, strict=True)], first, second)
    means = []
    for totals in map(process.RowTotals, kinds):
        means.append(np.zeros(counts.size))
        for column, count in enumerate(counts.tolist()):
            used, variances = totals.variances(count)
            means[-1][column] = share[used, column] @ variances
    of_sum, of_difference, of_first, of_second = means
    common, freedom = 0.25 * (of_sum - of_difference), pairs.sum(axis=0)
    error = np.maximum(np.sqrt((of_first * of_second + common**2) / freedom), 1e-300)
    columns = allan_columns(counts * step, COMMON_TIMES)
    amounts, likelihood = np.zeros((COMMON_TIMES.size, 2)), np.zeros(COMMON_TIMES.size)
    for index in range(COMMON_TIMES.size):
        design = columns[:, [0, 1 + index]] / error[:, None]
        amounts[index], misfit = nnls(design, common / error)
        likelihood[index] = -0.5 * misfit**2
    likelihood = np.exp(likelihood - likelihood.max())
    likelihood /= likelihood.sum()
    return ChannelNoise(float(likelihood @ amounts[:, 0]), likelihood * amounts[:, 1], 0.0,
                        int(freedom[0]), COMMON_TIMES)
