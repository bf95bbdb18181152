"""An alarm with a bounded rate: on average at most one false alarm in a given number of blocks.

A mixture Shiryaev-Roberts e-detector (Shin, Ramdas and Rinaldo, N. Engl. J. Stat. Data Sci. 2
(2024) 229). For a mean of at most m in units of the noise, exp(l (x - m) - l^2 / 2) has a mean of
at most 1 for every l > 0. The sum over all possible onsets is R' = (R + 1) exp(...). Its mean is
at most the number of blocks. The mean time to a false alarm at R >= A is therefore at least A
blocks. A mixture of l finds small and large changes; both signs of every channel share A.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SIZES = np.geomspace(0.06, 4.0, 10)
"""Changes beyond materiality that are looked for, in standard deviations of one block."""

MAX_BEYOND = 6.0
"""A block counts for no more than this beyond materiality: one wild block is not a change."""

MAX_LOG = 600.0


@dataclass(frozen=True)
class Alarm:
    """An alarm: number of the block, channel, sign, block of the likely onset, log evidence."""

    block: int
    channel: int
    sign: int
    since: int
    evidence: float


def threshold_of(false_alarm_hours: float, block_seconds: float) -> float:
    """Blocks in the time in which one false alarm is allowed."""
    return 3600.0 * false_alarm_hours / block_seconds


class Detector:
    """Evidence of a change in any of `channels`, block by block."""

    def __init__(self, channels: int, blocks_a_false_alarm: float) -> None:
        self.threshold = math.log(blocks_a_false_alarm * 2 * channels)
        self._channels = channels
        self._signs = np.repeat([1.0, -1.0], channels)[:, None]
        self.block = 0
        self.reset()

    def reset(self) -> None:
        """Begin anew, without the past."""
        shape = (2 * self._channels, SIZES.size)
        self._evidence = np.full(shape, -np.inf)
        self._run = np.zeros(shape)
        self._since = np.full(shape, self.block)

    @property
    def evidence(self) -> Array:
        """Logarithm of the evidence, (2, channels): upward, downward."""
        top = self._evidence.max(axis=1, keepdims=True)
        top = np.where(np.isfinite(top), top, 0.0)
        mixed = top[:, 0] + np.log(np.exp(self._evidence - top).mean(axis=1) + 1e-300)
        return np.asarray(mixed.reshape(2, self._channels))

    def step(self, values: Array, bounds: Array) -> Alarm | None:
        """Take one block: values (channels,), and how far their means may lie from 0.

        Both in standard deviations of the values; NaN where a channel is not known, which leaves
        its evidence as it is.
        """
        beyond = np.minimum(
            self._signs * np.tile(values, 2)[:, None] - np.tile(bounds, 2)[:, None], MAX_BEYOND)
        known = np.isfinite(beyond)
        gain = np.where(known, SIZES * beyond - 0.5 * SIZES**2, 0.0)
        grown = np.minimum(np.logaddexp(self._evidence, 0.0) + gain, MAX_LOG)
        self._evidence = np.where(known, grown, self._evidence)
        self._since = np.where(self._run <= 0.0, self.block, self._since)
        self._run = np.maximum(self._run, 0.0) + gain
        evidence = self.evidence
        place = int(np.argmax(evidence))
        self.block += 1
        if evidence.flat[place] < self.threshold:
            return None
        best = int(np.argmax(self._run[place]))
        return Alarm(
            self.block - 1, place % self._channels, 1 if place < self._channels else -1,
            int(self._since[place, best]), float(evidence.flat[place]))
