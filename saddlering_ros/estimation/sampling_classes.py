"""Noise of runs with several sampling rates, each from its own class and the richest one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.estimation.errors import EstimationError
from saddlering_ros.estimation.process import ChannelNoise, TIME_CONSTANTS
from saddlering_ros.estimation.rest import RestSegment
from saddlering_ros.estimation.rest_noise import HeldSeries, measure_noise, TOO_SHORT

Array = NDArray[np.float64]

SEEN_SHARE = 0.25
"""Share of its length up to which a stretch at rest shows time constants of noise."""

FEW_STRETCHES = 10
"""Smallest number of stretches at rest that show noise slower than a stretch."""

MIN_SAMPLES = 16
"""Smallest number of samples at rest in runs with equal sampling for a noise of their own."""

LENT_FROM = 0.3
"""Time constant [s] from which noise is that of the instrument at any rate."""


@dataclass(frozen=True)
class Silence:
    """A record that is noise alone, read by instruments of the same kind.

    segments: rows (1, n); ratios (C,): variance of the noise of each channel over that of the
    record.
    """

    segments: Sequence[RestSegment]
    ratios: Array


@dataclass(frozen=True)
class Quiet:
    """Noise of runs with equal sampling.

    segments: stretches at rest; series: means over consecutive holds; silence: source of the
    shape of the noise, if there is one.
    """

    segments: Sequence[RestSegment]
    series: Sequence[HeldSeries] = ()
    silence: Silence | None = None

    @property
    def is_usable(self) -> bool:
        """Whether there are enough samples."""
        return sum(segment.values.shape[1] for segment in self.segments) >= MIN_SAMPLES

    def noise(self, count: int, longest: float) -> list[ChannelNoise]:
        """Noise of each of `count` channels, of time constants up to `longest` [s]."""
        if self.silence is None:
            return measure_noise(self.segments, count, self.series, longest)
        shape = measure_noise(self.silence.segments, 1, (), longest_seen(self.silence.segments))
        return [shape[0].times(float(ratio)) for ratio in self.silence.ratios]


def sampling_class(step: float) -> int:
    """Class of the sampling rate of samples `step` [s] apart."""
    return round(20 * np.log10(step))


def noise_by_class(
    classes: Mapping[int, Quiet], count: int, slowest: float = np.inf
) -> dict[int, list[ChannelNoise]]:
    """Noise of each of `count` channels, by class of sampling rates.

    slowest: largest time constant of the richest class in its longest stretches. Slower noise
    serves only an analysis in which the level of each channel is free.
    """
    usable = {key: quiet for key, quiet in classes.items() if quiet.is_usable}
    if not usable:
        raise EstimationError(TOO_SHORT)
    # Slow noise belongs to the instrument and not to the rate: the richest class gives it.
    richest = max(usable, key=lambda key: len(usable[key].segments))
    best = usable[richest]
    learnt = {
        key: quiet.noise(count, slowest * _span(quiet.segments) if key == richest
                         else longest_seen(quiet.segments))
        for key, quiet in usable.items()
    }
    if best.silence is None and not best.series and len(best.segments) < FEW_STRETCHES:
        learnt[richest] = [_going_on(item, best.segments) for item in learnt[richest]]
    lent = [np.where(TIME_CONSTANTS >= LENT_FROM, item.slow, 0.0) for item in learnt[richest]]
    return {
        key: [replace(own, slow=np.maximum(own.slow, slow))
              for own, slow in zip(noise, lent, strict=True)]
        for key, noise in learnt.items()
    }


def longest_seen(segments: Sequence[RestSegment]) -> float:
    """Time constant [s] up to which stretches at rest separate noise and trend."""
    return SEEN_SHARE * _span(segments)


def _span(segments: Sequence[RestSegment]) -> float:
    """Length [s] of the longest stretch."""
    return max(segment.step * segment.values.shape[1] for segment in segments)


def _going_on(noise: ChannelNoise, segments: Sequence[RestSegment]) -> ChannelNoise:
    """Noise that is as large beyond the longest stretch at rest as at the longest stretch."""
    span = _span(segments)
    longest = noise.deviation(0.25 * span) ** 2
    slow = np.where(span < TIME_CONSTANTS, np.maximum(noise.slow, longest), noise.slow)
    return replace(noise, slow=slow)
