"""Noise learnt from residuals: what a flexible fit over time leaves, read as a process.

Slow structure of a residual may be a cause, so none of it may become noise. A flexible fit takes
all waves slower than `SLOW_WAVES` half waves a run; what is left is swift. Its level is assumed to
go on at slower times (a spectrum flat below), and its degrees of freedom are those of the swift
part: tests against this noise are F tests with so many. A record need not rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.fft import dct, idct

from saddlering_ros.discrepancy.system import Array
from saddlering_ros.estimation.allan import allan_columns, allan_variances
from saddlering_ros.estimation.process import ChannelNoise
from saddlering_ros.estimation.stretch_noise import (
    ChannelRecord,
    noise_of_stretches,
    relaxation_grid,
)

SLOW_WAVES = 40
"""Half waves a run that a flexible fit takes."""

MIN_SAMPLES_PER_WAVE = 5
"""A run of fewer samples than this for each half wave gets a less flexible fit."""


def swift_part(values: Array) -> tuple[Array, int]:
    """What a flexible fit over the order of samples leaves (N,); its number of half waves."""
    waves = min(SLOW_WAVES, values.size // MIN_SAMPLES_PER_WAVE)
    spectrum = dct(values, norm='ortho')
    spectrum[: waves + 1] = 0.0
    return np.asarray(idct(spectrum, norm='ortho')), waves


def noise_of_residuals(record: ChannelRecord) -> ChannelNoise:
    """Noise of one channel of one run, from the swift part of its residual.

    Missing samples are bridged for the flexible fit and left out of the statistics.
    """
    values, longest = _swift(record)
    swift = replace(record, values=values)
    where = f'run {record.run}'
    noise = noise_of_stretches(list(swift.stretches()), record.step, longest, where)
    # Below the swift part the level is no surer than at the slowest waves seen.
    return replace(noise, pairs=min(noise.pairs, max(1, round(record.duration / longest))))


def widened(noise: ChannelNoise, record: ChannelRecord) -> ChannelNoise:
    """`noise` and the broadband model error that the swift part of a residual shows beyond it.

    Noise measured at rest is not all there is on most machines. An excess counts if it is half
    the level at some averaging time, and more than chance gives.
    """
    values, longest = _swift(record)
    stretches = list(replace(record, values=values).stretches())
    where = f'run {record.run}'
    if not _exceeds(stretches, record.step, longest, noise):
        return noise
    extra = noise_of_stretches(stretches, record.step, longest, where, known=noise)
    return replace(
        noise,
        white=noise.white + extra.white,
        slow=np.append(noise.slow, extra.slow),
        time_constants=np.append(noise.time_constants, extra.time_constants),
        pairs=min(noise.pairs, extra.pairs),
    )


def with_model_error(
    noise: ChannelNoise, share: float, span: float, step: float, duration: float
) -> ChannelNoise:
    """`noise` and a declared broadband model error of `share` of the channel's range `span`.

    Its variance is spread evenly over all decades of time from `step` to `duration` [s], and as
    much is of each sample alone: whitening then gives no band of frequencies all the weight.
    """
    if share <= 0.0:
        return noise
    constants = relaxation_grid(step, duration)
    each = (share * span) ** 2 / (constants.size + 1)
    return replace(
        noise,
        slow=np.append(noise.slow, np.full(constants.size, each)),
        time_constants=np.append(noise.time_constants, constants),
        floor=noise.floor + each,
    )


def _exceeds(
    stretches: Sequence[Array], step: float, longest: float, noise: ChannelNoise
) -> bool:
    """Whether the Allan variance of `stretches` exceeds that of `noise` at some averaging time."""
    scales, seen, pairs = allan_variances([(row, step) for row in stretches])
    used = scales <= max(longest, step) * (1.0 + 1e-9)
    parts = noise.parts()
    expected = allan_columns(scales, np.array([tau for _, tau in parts])) @ np.append(
        noise.white, [variance for variance, _ in parts]
    )
    expected = expected + noise.floor * step / scales
    limit = expected * (1.0 + np.maximum(0.5, 4.0 * np.sqrt(3.0 / pairs)))
    return bool(np.any(seen[used] > limit[used]))


def _swift(record: ChannelRecord) -> tuple[Array, float]:
    """Swift part (N,) of a residual, NaN where missing; the longest averaging time left [s]."""
    there = np.isfinite(record.values)
    bridged = np.interp(record.time, record.time[there], record.values[there])
    swift, waves = swift_part(bridged)
    longest = 0.5 * record.duration / max(waves, 1)
    # The fit took its share of the variance of the samples too.
    taken = np.sqrt(record.values.size / max(record.values.size - waves - 1.0, 1.0))
    return np.where(there, swift * taken, np.nan), longest
