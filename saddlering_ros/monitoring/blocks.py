"""Evidence, from the means of the residual over blocks, that it has left its materiality.

Each channel is looked at in two ways, and either may raise the alarm.

- Its innovation. If the residual stays within materiality m, however it moves there, the mean of
  an innovation is at most (1 + response) m, as the filter predicts at most response * m. The zero
  was read with the wander of its moment, which stays in the residual. Where m is small against
  the noise, this finds the smallest changes.
- Its level. The wander of the noise, that of the zero included, is counted to what is allowed, as
  far as it goes once in ten times the hours of a false alarm; the rest of the noise is white.
  Where m is large against the noise, this finds a residual just beyond m.

A mean of e-processes is one, so the promise of the detector holds for both together.
"""

from __future__ import annotations

from collections.abc import Sequence
import math

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.monitoring.detector import Alarm, Detector, threshold_of
from saddlering_ros.monitoring.innovations import BlockNoise, ChannelInnovations

Array = NDArray[np.float64]

WANDER_SHARE = 0.1
"""Share of the false alarms that the wander of the noise may cause."""

SINCE_ZERO = math.sqrt(2.0)
"""A level counts from a zero that has a wander of its own: their difference goes this further."""

NOISE_BLOCKS = 500
"""Blocks over which the noise of the moment is compared with that of the rest."""

MIN_NOISE_BLOCKS = 200
MAX_NOISE_RATIO = 2.0
"""A variance of the noise that has grown by more no longer supports the promise."""

MAX_STEP = 5.0
"""A step of the residual counts no more than this in the noise of the moment."""


class BlockWatch:
    """Watches the means of C channels over blocks of `block` seconds."""

    def __init__(
        self, noise: Sequence[BlockNoise], block: float, false_alarm_hours: float
    ) -> None:
        self._channels = len(noise)
        self._whiteners = [ChannelInnovations(item) for item in noise]
        self._white = np.sqrt([item.white for item in noise])
        self._wander = np.array([
            wander_limit(item, block, false_alarm_hours, self._channels) for item in noise])
        self.detector = Detector(2 * self._channels, threshold_of(false_alarm_hours, block))
        self._forget_noise()

    def reset(self) -> None:
        """Begin anew, without the past."""
        for whitener in self._whiteners:
            whitener.reset()
        self.detector.reset()
        self._forget_noise()

    def _forget_noise(self) -> None:
        self._before = np.full(self._channels, np.nan)
        self._ratio, self._blocks = np.ones(self._channels), 0

    @property
    def noise_grew(self) -> bool:
        """Whether the noise of some channel is far larger than it was at rest."""
        return self._blocks >= MIN_NOISE_BLOCKS and bool(
            self._ratio.max() > MAX_NOISE_RATIO)

    def step(self, means: Array, materiality: Array) -> Alarm | None:
        """Take the means (C,) of one block; NaN where a channel is not known."""
        count = self._channels
        values, bounds = np.full(2 * count, np.nan), np.zeros(2 * count)
        for place, (whitener, mean) in enumerate(
                zip(self._whiteners, means.tolist(), strict=True)):
            if not math.isfinite(mean):
                whitener.reset()
                continue
            bound = ((1.0 + whitener.response) * materiality[place]
                     + (1.0 - whitener.response) * self._wander[place])
            values[place], scale = whitener.step(mean)
            bounds[place] = bound / scale
        values[count:] = means / self._white
        bounds[count:] = (materiality + SINCE_ZERO * self._wander) / self._white
        self._compare_noise(values[:count])
        alarm = self.detector.step(values, bounds)
        if alarm is None:
            return None
        return Alarm(alarm.block, alarm.channel % count, alarm.sign, alarm.since, alarm.evidence)

    def _compare_noise(self, innovations: Array) -> None:
        """Follow the variance of the innovations by their differences, which no level moves."""
        step = np.clip(innovations - self._before, -MAX_STEP, MAX_STEP)
        self._before = innovations
        self._blocks += 1
        share = 1.0 / min(self._blocks, NOISE_BLOCKS)
        known = np.isfinite(step)
        self._ratio[known] += share * (0.5 * step[known]**2 - self._ratio[known])


def wander_limit(
    noise: BlockNoise, block: float, false_alarm_hours: float, channels: int
) -> float:
    """How far the wander of a channel goes once in WANDER_SHARE of the false alarms [its unit].

    A Gaussian AR(1) process of time constant T leaves +-z standard deviations about
    2 z phi(z) / T times a second, phi the density of the normal distribution.
    """
    if noise.wander <= 0.0 or noise.memory <= 0.0:
        return 0.0
    times = 3600.0 * false_alarm_hours * -math.log(noise.memory) / block
    allowed = WANDER_SHARE / (2.0 * channels * max(times, 1.0))
    low, high = 1.0, 40.0
    for _ in range(60):
        z = 0.5 * (low + high)
        rate = z * math.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi)
        low, high = (z, high) if rate > allowed else (low, z)
    return high * math.sqrt(noise.wander)
