"""Evidence, from block means, that a residual has left its materiality, at a bounded rate.

Each channel is looked at in two ways, and either may raise the alarm.

- Its innovation. If the residual stays within materiality m, however it moves there, the mean of
  an innovation is at most (1 + response) m, as the filter predicts at most response * m. The zero
  was read with the wander of its moment, which stays in the residual. Where m is small against
  the noise, this finds the smallest changes.
- Its level. The wander of the noise, that of the zero included, is counted to what is allowed, as
  far as it goes once in ten times the hours of a false alarm; the rest of the noise is white.
  Where m is large against the noise, this finds a residual just beyond m.

A mean of e-processes is one, so the promise of the detector holds for both together: on average at
most one false alarm in a given number of blocks.

The detector is a mixture Shiryaev-Roberts e-detector (Shin, Ramdas and Rinaldo, N. Engl. J. Stat.
Data Sci. 2 (2024) 229). For a mean of at most m in units of the noise, exp(l (x - m) - l^2 / 2)
has a mean of at most 1 for every l > 0. The sum over all possible onsets is R' = (R + 1) exp(...).
Its mean is at most the number of blocks. The mean time to a false alarm at R >= A is therefore at
least A blocks. A mixture of l finds small and large changes; both signs of every channel share A.

The noise of a probe is white noise and a slow wander. Means over a block have the covariance of an
AR(1) process and white noise; a scalar Kalman filter turns them into innovations of unit variance
(R. E. Kalman, J. Basic Eng. 82 (1960) 35). It is learnt while the load rests, from samples as they
come, with assumptions on the probes that a rest of seconds cannot show. The rule of rest is that
of a record (`estimation.rest.Rest`), without a look ahead.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import lambertw

from saddlering_ros.errors import SaddleringError
from saddlering_ros.estimation.noise import noise_alone
from saddlering_ros.estimation.process import Array, ChannelNoise
from saddlering_ros.estimation.rest import BLOCK_SECONDS, MIN_SAMPLES, Rest
from saddlering_ros.monitoring import DEFAULT_PERCENT
from saddlering_ros.quantities import MAX_LOG
from saddlering_ros.record.batches import SECOND
from saddlering_ros.rig import ContactParameters, Rig
from saddlering_ros.ring.simulator import static_response

SIZES = np.geomspace(0.06, 4.0, 10)
"""Changes beyond materiality that are looked for, in standard deviations of one block."""

MAX_BEYOND = 6.0
"""A block counts for no more than this beyond materiality: one wild block is not a change."""


@dataclass(frozen=True)
class Alarm:
    """An alarm: number of the block, channel, block of the likely onset, log evidence."""

    block: int
    channel: int
    since: int
    evidence: float


class Detector:
    """Evidence of a change in any of `channels`, block by block."""

    def __init__(self, channels: int, blocks_a_false_alarm: float) -> None:
        self.threshold = math.log(blocks_a_false_alarm * 2 * channels)
        self._channels = channels
        self._signs = np.repeat([1.0, -1.0], channels)[:, None]
        self.block = 0
        self.reset()

    def reset(self) -> None:
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

        Both in standard deviations of the values. NaN, not known, leaves the evidence unchanged.
        """
        beyond = np.minimum(
            self._signs * np.tile(values, 2)[:, None] - np.tile(bounds, 2)[:, None], MAX_BEYOND)
        is_known = np.isfinite(beyond)
        gain = np.where(is_known, SIZES * beyond - 0.5 * SIZES**2, 0.0)
        grown = np.minimum(np.logaddexp(self._evidence, 0.0) + gain, MAX_LOG)
        self._evidence = np.where(is_known, grown, self._evidence)
        self._since = np.where(self._run <= 0.0, self.block, self._since)
        self._run = np.maximum(self._run, 0.0) + gain
        evidence = self.evidence
        place = int(np.argmax(evidence))
        self.block += 1
        if evidence.flat[place] < self.threshold:
            return None
        best = int(np.argmax(self._run[place]))
        return Alarm(self.block - 1, place % self._channels, int(self._since[place, best]),
                     float(evidence.flat[place]))


WANDER_SHARE = 0.1
"""Share of the false alarms that the wander of the noise may cause."""

SINCE_ZERO = math.sqrt(2.0)
"""A level counts from a zero that has a wander of its own: their difference goes this further."""

NOISE_BLOCKS = 500
"""Blocks over which the noise of the moment is compared with that of the rest."""

MIN_NOISE_BLOCKS = 200  # variance to 10 %
MAX_NOISE_RATIO = 2.0
"""A variance of the noise that has grown by more no longer supports the promise."""

MAX_STEP = 5.0
"""A step of the residual counts no more than this in the noise of the moment."""


class BlockWatch:
    """Watches the means of C channels over blocks of `block` seconds."""

    def __init__(self, noise: Sequence['BlockNoise'], block: float,
                 false_alarm_hours: float) -> None:
        self._channels = len(noise)
        self._innovations = Innovations(noise)
        self._white = np.sqrt([one.white for one in noise])
        self._wander = np.array([
            wander_limit(one, block, false_alarm_hours, self._channels) for one in noise])
        self.detector = Detector(2 * self._channels, 3600.0 * false_alarm_hours / block)
        self.reset()

    def reset(self) -> None:
        self._innovations.reset()
        self.detector.reset()
        self._before = np.full(self._channels, np.nan)
        self._ratio, self._blocks = np.ones(self._channels), 0

    @property
    def noise_grew(self) -> bool:
        """Whether the noise of some channel is far larger than it was at rest."""
        return self._blocks >= MIN_NOISE_BLOCKS and bool(self._ratio.max() > MAX_NOISE_RATIO)

    def step(self, means: Array, materiality: Array) -> Alarm | None:
        """Take the means (C,) of one block; NaN where a channel is not known."""
        response = self._innovations.response
        innovations, scale = self._innovations.step(means)
        bound = (1.0 + response) * materiality + (1.0 - response) * self._wander
        values = np.concatenate([innovations, means / self._white])
        bounds = np.concatenate([
            bound / scale, (materiality + SINCE_ZERO * self._wander) / self._white])
        # Follow the variance of the innovations by their differences, which no level moves.
        step = np.clip(innovations - self._before, -MAX_STEP, MAX_STEP)
        self._before = innovations
        self._blocks += 1
        share = 1.0 / min(self._blocks, NOISE_BLOCKS)
        is_known = np.isfinite(step)
        self._ratio[is_known] += share * (0.5 * step[is_known]**2 - self._ratio[is_known])
        alarm = self.detector.step(values, bounds)
        return None if alarm is None else replace(alarm, channel=alarm.channel % self._channels)


def wander_limit(noise: 'BlockNoise', block: float, false_alarm_hours: float,
                 channels: int) -> float:
    """How far the wander of a channel goes once in WANDER_SHARE of the false alarms [its unit].

    A Gaussian AR(1) process of time constant T leaves +-z standard deviations about
    2 z phi(z) / T times a second, phi the density of the normal distribution.
    """
    if noise.wander <= 0.0 or noise.memory <= 0.0:
        return 0.0
    times = 3600.0 * false_alarm_hours * -math.log(noise.memory) / block
    allowed = WANDER_SHARE / (2.0 * channels * max(times, 1.0))  # z phi(z), of which z > 1
    z = math.sqrt(-lambertw(-2.0 * math.pi * allowed**2, -1).real)
    return z * math.sqrt(noise.wander)


@dataclass(frozen=True)
class BlockNoise:
    """Noise of the means of one channel over blocks."""

    white: float  # variance
    wander: float  # variance of the wandering part
    memory: float  # correlation of the wandering part from one block to the next


def block_noise(noise: ChannelNoise, step: float) -> BlockNoise:
    """Noise of means over blocks of `step` [s], by their covariances at lags of 0 to 2 blocks."""
    covariance = noise.covariance(step * np.arange(3.0), np.full(3, step))
    here, near, far = (float(value) for value in covariance[0])
    if near <= 0.0 or far <= 0.0:
        return BlockNoise(here, 0.0, 0.0)
    memory = min(far / near, 0.9999)
    wander = min(near / memory, here)
    return BlockNoise(max(here - wander, 1e-6 * here), wander, memory)


class Innovations:
    """Innovations of C channels, block by block.

    `response` (C,): next prediction of the filter if every mean so far was 1. Means within m of 0
    have innovations within (1 + response) m, the noise apart.
    """

    def __init__(self, noise: Sequence[BlockNoise]) -> None:
        self._white, self._level, self._memory = np.array(
            [(one.white, one.wander, one.memory) for one in noise]).T
        self.reset()

    def reset(self) -> None:
        """Forget the past: the zero was renewed."""
        self._wander, self._variance = np.zeros(len(self._level)), self._level
        self.response = np.zeros(len(self._level))

    def step(self, values: Array) -> tuple[Array, Array]:
        """Innovations of block means (C,) in standard deviations, and these; NaN begins anew."""
        is_known, memory = np.isfinite(values), self._memory
        scale = np.sqrt(self._variance + self._white)
        surprise = values - self._wander
        gain = self._variance / (scale * scale)
        wander, variance = self._wander + gain * surprise, (1.0 - gain) * self._variance
        self._wander = np.where(is_known, memory * wander, 0.0)
        self._variance = np.where(
            is_known, memory**2 * variance + (1.0 - memory**2) * self._level, self._level)
        self.response = np.where(
            is_known, memory * (self.response + gain * (1.0 - self.response)), 0.0)
        return surprise / scale, scale


MAX_REST = 20.0
"""A rest is read no longer than this [s]; then watching begins, whether the load moves or not."""

MOVED_SIGMAS = 5.0
"""Standard deviations of a reading by which the mean of a block at rest may move, beside the
materiality, which may be set to 0."""

MAX_ALONE = 1.0
"""Time [s] for which the residual may be further away before the load has left its rest: a ring
with friction breaks away at once, and a slow load is seen to move later."""

LEVEL_SIGMAS = 2.0
"""Standard deviations of the estimate by which the noise is taken larger."""

UNKNOWN = BlockNoise(math.inf, 0.0, 0.0)
"""Noise of a channel that could not be read while the load rested."""


class MonitoringError(SaddleringError):
    """A record or settings that cannot be monitored."""


@dataclass(frozen=True)
class RestNoise:
    """Result of a rest."""

    noise: tuple[BlockNoise, ...]  # of block means, by channel
    samples: int  # readings in a block
    interval: float  # [s] between readings
    seconds: float  # length of the rest
    first: bool  # whether nothing had moved before

    @property
    def block(self) -> float:
        """Length of a block [s]."""
        return self.samples * self.interval


class RestLearner:
    """Takes samples until a rest has ended (or is long enough), and then gives its noise."""

    def __init__(self, band: float, block: float) -> None:
        self._band, self._block = band, block
        self.restart()

    def restart(self, *, moved: bool = False, alone: bool = False) -> None:
        """Begin anew; moved: the ring has moved, and settles at first; alone: the load has not."""
        self.moved, self.moved_alone = moved, alone
        self._begun: tuple[Array, Array] | None = None
        self._left = 0.0
        self._stamps: list[int] = []
        self._rows: list[tuple[float, ...]] = []
        self._rest = Rest(self._band)
        self._load, self._begin = 0.0, 0

    def step(self, stamp: int, residual: tuple[float, ...], load: float,
             allowed: ArrayLike = math.inf) -> RestNoise | None:
        """Take a sample: stamp [ns], residual (C,), load [N]; the noise when it is known.

        allowed (C,): a residual that moves further while the load rests is no noise.
        """
        if not self._stamps:
            self._begin = stamp
        ended = False
        if stamp - self._begin >= BLOCK_SECONDS * SECOND:
            # Judge the block that ends: whether the load has left its rest in it.
            count = len(self._stamps) - self._rest.samples
            ended = not self._rest.takes(self._load / count, count)
            if not ended:
                self._load, self._begin = 0.0, stamp
                # Whether the residual is further from the first block than noise is.
                rows = np.array(self._rows[-count:])
                mean = rows.mean(axis=0)
                if self._begun is None:
                    self._begun = mean, MOVED_SIGMAS * rows.std(axis=0)
                limit = np.asarray(allowed) + self._begun[1]
                leaves = np.any(np.abs(mean - self._begun[0]) > limit)
                self._left = self._left + BLOCK_SECONDS if leaves else 0.0
                if self._left > MAX_ALONE:
                    self.restart(moved=True, alone=True)
        self._stamps.append(stamp)
        self._rows.append(residual)
        self._load += load
        rested = self._stamps[self._rest.samples - 1] - self._stamps[0]
        if not ended and rested < MAX_REST * SECOND:
            return None
        noise = self._read(ended=ended)
        if noise is None:
            self.restart(moved=True)
        return noise

    def _read(self, *, ended: bool) -> RestNoise | None:
        """The noise of the samples at rest; None if they are too few."""
        if self._rest.samples < MIN_SAMPLES:
            return None
        interval = float(np.median(np.diff(self._stamps[:self._rest.samples]))) / SECOND
        quiet = self._rest.quiet(interval, has_moved=self.moved, moves_on=ended)
        if quiet is None:
            return None
        stamps, rows = self._stamps[quiet], self._rows[quiet]
        seconds = (stamps[-1] - stamps[0]) / SECOND
        samples = max(1, round(self._block / interval))
        larger = (1.0 + LEVEL_SIGMAS / math.sqrt(2.0 * len(stamps)))**2
        noise = [UNKNOWN] * len(rows[0])
        for place, channel in enumerate(np.array(rows).T):
            if np.isfinite(channel).all():
                one = block_noise(noise_alone([channel], interval), samples * interval)
                noise[place] = BlockNoise(larger * one.white, larger * one.wander, one.memory)
        return RestNoise(tuple(noise), samples, interval, seconds, not self.moved)


PROBE_WANDER = 5e-5
"""Wander assumed of a probe at least, as a share of its range: catalogues of eddy-current probes
state resolutions and drifts of 0.005 % of it. A rest of seconds shows too little of a wander that
takes seconds."""

FASTEST_WANDER = 1.0
"""Time [s] within which the wander is assumed to move: a slower one is more predictable."""

FAST_MEMORY = 0.5
"""Noise of a block of which less stays to the next block is no wander."""


def least_wander(rig: Rig) -> Array:
    """Standard deviation of the wander of delta_x, delta_y, gamma that is assumed at least (3,).

    The first two are half a difference or sum of two probes, gamma a difference over their span.
    """
    probes = rig.probes
    single = PROBE_WANDER * (probes.max_range - probes.min_range)
    half = single / math.sqrt(2.0)
    return np.array([half, half, 2.0 * half / probes.axial_span])


def assumed_noise(read: BlockNoise, least: float, block: float) -> BlockNoise:
    """The noise for watching: that of a rest, and a wander of at least `least`.

    Noise between white and a slow wander is counted to both.
    """
    is_slow = read.memory >= math.exp(-block / FASTEST_WANDER)
    white = read.white + (0.0 if is_slow else read.wander)
    wander = max(read.wander if read.memory >= FAST_MEMORY else 0.0, least**2)
    return BlockNoise(white, wander, math.exp(-block / FASTEST_WANDER) if wander else 0.0)


LOADS = 26
"""Loads at which the motion is looked at: a channel may turn back on the way to full scale."""


def sound_motion(rig: Rig, contact: ContactParameters, elevation: float) -> Array:
    """Motion from preload to full scale at an elevation [rad], (3, LOADS) [m, m, rad]."""
    loads = np.linspace(rig.preload, rig.full_scale_load, LOADS)
    return np.asarray(static_response(rig, contact.to_array(), elevation, loads))


def materiality(rig: Rig, contact: ContactParameters, elevation: float,
                percent: float = DEFAULT_PERCENT) -> Array:
    """`percent` of the range of `sound_motion` of each channel, (3,) [m, m, rad]."""
    if not 0.0 <= percent < math.inf:
        raise MonitoringError(f'materiality is {percent:g} %: give 0 or more')
    return np.asarray(0.01 * percent * np.ptp(sound_motion(rig, contact, elevation), axis=1))
