"""White noise and relaxations fitted to the spectrum of a filtered residual.

The remainder of a flexible fit has no slow part, so that statistics over time would be biased. Its
spectrum above the removed waves is unbiased. The parts maximise the Whittle likelihood: the lines
of a spectrum are independent and exponentially distributed about their expectation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import dct

from saddlering_ros.discrepancy.system import Array
from saddlering_ros.estimation.process import (
    ChannelNoise,
    mean_correlation,
    mean_variance,
)

MAX_BINS = 120
"""Bins of the averaged lines, evenly spaced on a log scale, for speed with little loss."""

ROUNDS = 300
"""Rounds of the multiplicative update; each one raises the likelihood."""

BINS_AN_OCTAVE = 2
"""Bins of the comparison of a spectrum with a known one."""


@dataclass(frozen=True)
class Spectrum:
    """Mean squares `power` (F,) of `lines` (F,) lines about `frequency` (F,) [cycles a sample]."""

    frequency: Array
    power: Array
    lines: Array


def spectrum_above(values: Array, waves: int, bins: int) -> Spectrum:
    """Spectrum of values (N,), NaN where missing, above `waves` half waves, in at most `bins`."""
    there = np.isfinite(values)
    count = values.size
    power = dct(np.where(there, values, 0.0), norm='ortho')[waves + 1 :] ** 2
    power *= count / max(int(there.sum()), 1)
    edges = np.geomspace(waves + 1, count, bins + 1)
    begin = np.unique(np.round(edges[:-1]).astype(int)) - waves - 1
    lines = np.diff(np.append(begin, power.size))
    half_waves = np.arange(waves + 1, count, dtype=np.float64)
    return Spectrum(
        np.add.reduceat(half_waves, begin) / lines / (2.0 * count),
        np.add.reduceat(power, begin) / lines,
        lines.astype(np.float64),
    )


def expected_power(noise: ChannelNoise, frequency: Array, step: float) -> Array:
    """Mean squares (F,) of lines at `frequency` in `noise` with samples of `step` [s]."""
    parts = noise.parts()
    columns = _columns(frequency, np.array([tau for _, tau in parts]), step)
    white = noise.white + noise.floor * step
    return np.asarray(columns @ np.append(white, [variance for variance, _ in parts]))


def parts_of_spectrum(
    spectrum: Spectrum, constants: Array, step: float, known: Array | None = None
) -> Array:
    """White density and variances of relaxations (1 + T,) with the greatest likelihood.

    known (F,): expectation of a noise that is present besides.
    """
    columns = _columns(spectrum.frequency, constants, step)
    unit = columns.mean(axis=0)
    columns = columns / unit
    beside = np.zeros(spectrum.power.size) if known is None else known
    excess = np.maximum(spectrum.power - beside, 0.0).mean()
    weights = np.full(unit.size, max(float(excess), np.finfo(float).tiny) / unit.size)
    for _ in range(ROUNDS):
        total = columns @ weights + beside
        pull = columns.T @ (spectrum.lines * spectrum.power / total**2)
        weights = weights * np.sqrt(pull / (columns.T @ (spectrum.lines / total)))
    return np.asarray(weights / unit)


def exceeds(spectrum: Spectrum, known: Array) -> bool:
    """Whether a spectrum exceeds `known` (F,) somewhere by half and by more than chance."""
    chance = 4.0 * np.sqrt(2.0 / spectrum.lines)
    return bool(np.any(spectrum.power > known * (1.0 + np.maximum(0.5, chance))))


def _columns(frequency: Array, constants: Array, step: float) -> Array:
    """Mean squares (F, 1 + T) of lines of unit white density and of each unit relaxation."""
    cosine = np.cos(2.0 * np.pi * frequency)
    columns = [np.full(frequency.size, 1.0 / step)]
    for tau in constants:
        ratio = np.array([step / tau])
        edge, own = float(mean_correlation(ratio)[0]), float(mean_variance(ratio)[0])
        keep = float(np.exp(-ratio[0]))
        tail = (cosine - keep) / (1.0 - 2.0 * keep * cosine + keep**2)
        columns.append(own + 2.0 * edge**2 * tail)
    return np.column_stack(columns)
