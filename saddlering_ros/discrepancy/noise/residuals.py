"""Noise learnt from residuals: the remainder of a flexible fit over time, read as a process.

Slow structure of a residual may be a cause and must not become noise. A flexible fit therefore
removes all waves slower than `SLOW_WAVES` half waves per run, and the remainder is fast. The level
of the remainder is assumed to continue at slower times (a flat spectrum below). Its degrees of
freedom are those of the fast part, and tests against this noise are F tests with this number. The
record needs no rest.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.fft import dct, idct

from saddlering_ros.discrepancy.noise.spectrum import (
    BINS_AN_OCTAVE,
    exceeds,
    expected_power,
    MAX_BINS,
    parts_of_spectrum,
    spectrum_above,
)
from saddlering_ros.discrepancy.system import Array, DiscrepancyError
from saddlering_ros.estimation.process import ChannelNoise
from saddlering_ros.estimation.stretch_noise import (
    ChannelRecord,
    effective_degrees,
    MIN_SAMPLES,
    relaxation_grid,
)

SLOW_WAVES = 40
"""Half waves per run that a flexible fit removes."""

MIN_SLOW_WAVES = 20
"""Half waves that a flexible fit removes from a run of few samples: those that are tested."""

SAMPLES_PER_WAVE, MIN_SAMPLES_PER_WAVE = 10, 5
"""Samples per half wave above that number of half waves, and smallest number in a run."""


def swift_part(values: Array) -> tuple[Array, int]:
    """Remainder (N,) of a flexible fit over the order of samples, and its number of half waves."""
    waves = min(SLOW_WAVES, max(MIN_SLOW_WAVES, values.size // SAMPLES_PER_WAVE))
    waves = min(waves, values.size // MIN_SAMPLES_PER_WAVE)
    spectrum = dct(values, norm='ortho')
    spectrum[: waves + 1] = 0.0
    return np.asarray(idct(spectrum, norm='ortho')), waves


def noise_of_residuals(record: ChannelRecord) -> ChannelNoise:
    """Noise of one channel of one run, from the fast part of its residual.

    Missing samples are interpolated for the flexible fit and left out of the statistics.
    """
    values, waves = _swift(record)
    noise = _of_spectrum(record, values, waves, None)
    # Below the fast part the level is as uncertain as at the slowest waves of the fast part.
    return replace(noise, pairs=max(1, min(noise.pairs, 2 * waves)))


def widened(noise: ChannelNoise, record: ChannelRecord) -> ChannelNoise:
    """`noise` plus the broadband model error in the fast part of a residual.

    On most machines the noise at rest is not the whole noise. An excess counts if it is half
    the level at some averaging time and larger than chance.
    """
    values, waves = _swift(record)
    octaves = np.log2(values.size / (waves + 1.0))
    coarse = spectrum_above(values, waves, max(1, round(BINS_AN_OCTAVE * octaves)))
    if not exceeds(coarse, expected_power(noise, coarse.frequency, record.step)):
        return noise
    extra = _of_spectrum(record, values, waves, noise)
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

    Its variance is spread evenly over all decades of time from `step` to `duration` [s], and
    an equal part is independent in each sample, so that no band of frequencies receives all
    the weight.
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


def _of_spectrum(
    record: ChannelRecord, values: Array, waves: int, known: ChannelNoise | None
) -> ChannelNoise:
    """Noise of the fast part (N,) of a residual, beyond the `known` noise."""
    sizes = [part.size for part in replace(record, values=values).stretches()]
    if sum(sizes) < MIN_SAMPLES:
        raise DiscrepancyError(
            f'noise: run {record.run} holds {sum(sizes)} samples, too few to learn from: give at '
            f'least {MIN_SAMPLES}, or Noise.white(std)'
        )
    step = record.step
    spectrum = spectrum_above(values, waves, MAX_BINS)
    if not spectrum.power.max(initial=0.0) > 0.0:
        raise DiscrepancyError(
            f'noise: run {record.run} does not vary at all: give Noise.white(std) with the '
            'resolution of the instrument'
        )
    constants = relaxation_grid(step, 0.5 * record.duration / max(waves, 1))
    beside = None if known is None else expected_power(known, spectrum.frequency, step)
    parts = parts_of_spectrum(spectrum, constants, step, beside)
    white = max(float(parts[0]), 1e-9 * float(spectrum.power.max()) * step)
    noise = ChannelNoise(white, parts[1:], 0.0, 1, constants)
    return replace(noise, pairs=effective_degrees(noise, step, sizes))


def _swift(record: ChannelRecord) -> tuple[Array, int]:
    """Fast part (N,) of a residual, NaN where missing; the number of removed half waves."""
    there = np.isfinite(record.values)
    bridged = np.interp(record.time, record.time[there], record.values[there])
    swift, waves = swift_part(bridged)
    return np.where(there, swift, np.nan), waves
