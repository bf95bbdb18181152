"""A record cut into stretches without a missing sample, and their noise as a process.

The time constants follow from the stretches, so that nothing depends on the unit of time or of the
channel.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.estimation.allan import allan_columns, allan_variances, mixture
from saddlering_ros.estimation.errors import EstimationError
from saddlering_ros.estimation.process import (
    ChannelNoise,
    mean_correlation,
    mean_variance,
)

Array = NDArray[np.float64]

PARTS_PER_DECADE = 2
"""Relaxations per decade of time constants: closer ones cannot be separated."""

MAX_PARTS = 12
"""Largest number of relaxations of a channel; the cost of whitening grows with its square."""

MIN_SAMPLES = 16
"""Smallest number of samples for noise."""


@dataclass(frozen=True)
class ChannelRecord:
    """One channel of one run: `values` (N,) at `time` (N,) [s], NaN where a sample is missing.

    The values are readings, or residuals once there is a prediction.
    """

    run: str
    time: Array
    values: Array

    @property
    def step(self) -> float:
        """Usual spacing of the samples [s]."""
        return float(np.median(np.diff(self.time)))

    @property
    def duration(self) -> float:
        return float(self.time[-1] - self.time[0])

    def stretches(self, start: float = -np.inf, end: float = np.inf) -> Iterator[Array]:
        """Values between `start` and `end` [s], in stretches without a missing sample."""
        there = np.isfinite(self.values) & (self.time >= start) & (self.time <= end)
        index = np.flatnonzero(there)
        if index.size == 0:
            return
        wide = np.diff(self.time[index]) > 2.5 * self.step
        broken = (np.diff(index) > 1) | wide
        for part in np.split(index, np.flatnonzero(broken) + 1):
            if part.size >= 2:
                yield self.values[part]


def relaxation_grid(step: float, longest: float) -> Array:
    """Time constants [s] from `step` to `longest`, evenly spaced on a log scale."""
    if longest <= step:
        return np.zeros(0)
    count = round(PARTS_PER_DECADE * np.log10(longest / step)) + 1
    return np.geomspace(step, longest, int(np.clip(count, 1, MAX_PARTS)))


def noise_of_stretches(
    stretches: Sequence[Array],
    step: float,
    longest: float,
    where: str,
    known: ChannelNoise | None = None,
) -> ChannelNoise:
    """White noise and relaxations that fit the Allan variances of `stretches` best.

    longest [s]: largest averaging time and time constant. where: place for the message if
    there are too few samples. known: noise that is subtracted first; the result is the excess.
    """
    rows = [(np.asarray(row - row.mean()), step) for row in stretches]
    count = sum(row.size for row, _ in rows)
    if count < MIN_SAMPLES:
        raise EstimationError(
            f'noise: {where} has only {count} samples: give at least '
            f'{MIN_SAMPLES}, or Noise.white(std)'
        )
    scales, seen, pairs = allan_variances(rows)
    used = scales <= max(longest, step) * (1.0 + 1e-9)
    scales, seen, pairs = scales[used], seen[used], pairs[used]
    if not seen.max(initial=0.0) > 0.0:
        raise EstimationError(
            f'noise: {where} does not vary: give Noise.white(std) with the resolution of '
            'the instrument'
        )
    constants = relaxation_grid(step, longest)
    columns = allan_columns(scales, constants)
    if known is not None:
        parts = np.append(known.white, [variance for variance, _ in known.parts()])
        taus = np.array([tau for _, tau in known.parts()])
        expected = allan_columns(scales, taus) @ parts + known.floor * step / scales
        seen = np.maximum(seen - expected, 0.0)
    solved = mixture(columns, seen, pairs)
    white = max(float(solved[0]), 1e-9 * float(seen.max()) * step)
    noise = ChannelNoise(white, solved[1:], 0.0, 1, constants)
    sizes = [row.size for row, _ in rows]
    return replace(noise, pairs=effective_degrees(noise, step, sizes))


def effective_degrees(noise: ChannelNoise, step: float, sizes: Sequence[int]) -> int:
    """Number of independent samples in stretches of `sizes`, from the sum of squared correlations.

    The variance of a variance estimate from N samples of correlation r_k equals that of N /
    sum r_k^2 independent samples (Bartlett).
    """
    lags = np.arange(max(sizes)) * step
    own = noise.white / step + noise.floor
    tail = np.zeros(lags.size)
    for variance, tau in noise.parts():
        ratio = np.array([step / tau])
        own += float(variance * mean_variance(ratio)[0])
        edge = float(mean_correlation(ratio)[0])
        tail += variance * edge**2 * np.exp(-np.maximum(lags - step, 0.0) / tau)
    squares = np.cumsum((tail / own) ** 2) - (tail[0] / own) ** 2
    total = 0.0
    for size in sizes:
        total += size / (1.0 + 2.0 * float(squares[size - 1]))
    return max(1, int(total))


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
    return replace(
        noise,
        slow=np.append(noise.slow, np.full(longer.size, slowest)),
        time_constants=np.append(noise.time_constants, longer),
    )
