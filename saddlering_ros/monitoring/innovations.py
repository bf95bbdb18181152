"""Independent means of the residual over short blocks: each less its prediction by the last.

The noise of a probe is white noise and a slow wander. Means over a block have the covariance of an
AR(1) process and white noise; a scalar Kalman filter turns them into innovations of unit variance
(R. E. Kalman, J. Basic Eng. 82 (1960) 35).
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np

from saddlering_ros.estimation.process import ChannelNoise


@dataclass(frozen=True)
class BlockNoise:
    """Noise of the means of one channel over blocks: white and wandering variance, memory.

    memory: correlation of the wandering part from one block to the next.
    """

    white: float
    wander: float
    memory: float

    def inflated(self, factor: float) -> BlockNoise:
        """The same noise with its standard deviations `factor` times as large."""
        return BlockNoise(factor**2 * self.white, factor**2 * self.wander, self.memory)


def block_noise(noise: ChannelNoise, step: float) -> BlockNoise:
    """Noise of means over blocks of `step` [s], by their covariances at lags of 0 to 2 blocks."""
    covariance = noise.covariance(step * np.arange(3.0), np.full(3, step))
    here, near, far = (float(value) for value in covariance[0])
    if near <= 0.0 or far <= 0.0:
        return BlockNoise(here, 0.0, 0.0)
    memory = min(far / near, 0.9999)
    wander = min(near / memory, here)
    return BlockNoise(max(here - wander, 1e-6 * here), wander, memory)


class ChannelInnovations:
    """Innovations of one channel, block by block.

    `response` is the prediction of the filter next had every mean so far been 1, the noise apart:
    means that stay within m of nought have innovations within (1 + response) m.
    """

    def __init__(self, noise: BlockNoise) -> None:
        self._noise = noise
        self.reset()

    def reset(self) -> None:
        """Forget the past: the zero was renewed, or samples are missing."""
        self._wander, self._variance = 0.0, self._noise.wander
        self.response = 0.0

    def step(self, value: float) -> tuple[float, float]:
        """The innovation of a block's mean in standard deviations, and that deviation."""
        noise = self._noise
        scale = math.sqrt(self._variance + noise.white)
        surprise = value - self._wander
        gain = self._variance / (scale * scale)
        wander, variance = self._wander + gain * surprise, (1.0 - gain) * self._variance
        self._wander = noise.memory * wander
        self._variance = noise.memory**2 * variance + (1.0 - noise.memory**2) * noise.wander
        self.response = noise.memory * (self.response + gain * (1.0 - self.response))
        return surprise / scale, scale
