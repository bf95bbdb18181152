"""Noise and materiality of the residual: what is no change of the ring.

Noise is learnt while the load rests, from samples as they come, with assumptions on the probes
that a rest of seconds cannot show. Materiality is the residual that is allowed without an alarm.
The rule of rest is that of a record (`estimation.rest.Rest`), without a look ahead.
"""

from dataclasses import dataclass
import math

import numpy as np

from saddlering_ros.errors import SaddleringError
from saddlering_ros.estimation.noise import noise_alone
from saddlering_ros.estimation.rest import BLOCK_SECONDS, MIN_SAMPLES, MIN_SECONDS, Rest
from saddlering_ros.monitoring.detector import Array, block_noise, BlockNoise
from saddlering_ros.record.batches import SECOND
from saddlering_ros.rig import ContactParameters, Rig
from saddlering_ros.ring.simulator import static_response

MAX_REST = 20.0
"""A rest is read no longer than this [s]; then watching begins, whether the load moves or not."""

LEVEL_SIGMAS = 2.0
"""Standard deviations of the estimate by which the noise is taken larger."""

UNKNOWN = BlockNoise(math.inf, 0.0, 0.0)
"""Noise of a channel that could not be read while the load rested."""


class MonitoringError(SaddleringError):
    """A record or settings that cannot be monitored."""


@dataclass(frozen=True)
class RestNoise:
    """Result of a rest: noise of block means per channel, the blocks, the rest itself.

    samples: readings in a block; interval [s]: between readings; seconds: length of the rest;
    first: whether nothing had moved before.
    """

    noise: tuple[BlockNoise, ...]
    samples: int
    interval: float
    seconds: float
    first: bool

    @property
    def block(self) -> float:
        """Length of a block [s]."""
        return self.samples * self.interval


class RestLearner:
    """Takes samples until a rest has ended (or is long enough), and then gives its noise."""

    def __init__(self, band: float, block: float) -> None:
        self._band, self._block = band, block
        self.restart()

    def restart(self, *, moved: bool = False) -> None:
        """Begin anew; moved: the load has just moved, so that the ring settles at first."""
        self.moved = moved
        self._stamps: list[int] = []
        self._rows: list[tuple[float, ...]] = []
        self._rest = Rest(self._band)
        self._load, self._begin = 0.0, 0

    def step(self, stamp: int, residual: tuple[float, ...], load: float) -> RestNoise | None:
        """Take a sample: stamp [ns], residual (C,), load [N]; the noise when it is known."""
        if not self._stamps:
            self._begin = stamp
        ended = False
        if stamp - self._begin >= BLOCK_SECONDS * SECOND:
            # Judge the block that ends: whether the load has left its rest in it.
            count = len(self._stamps) - self._rest.samples
            ended = not self._rest.takes(self._load / count, count)
            if not ended:
                self._load, self._begin = 0.0, stamp
        self._stamps.append(stamp)
        self._rows.append(residual)
        self._load += load
        rested = self._stamps[self._rest.samples - 1] - self._stamps[0]
        if not ended and rested < MAX_REST * SECOND:
            return None
        found = self._read(ended=ended)
        if found is None:
            self.restart(moved=True)
        return found

    def _read(self, *, ended: bool) -> RestNoise | None:
        """The noise of the samples at rest; None if they are too few."""
        if self._rest.samples < MIN_SAMPLES:
            return None
        interval = float(np.median(np.diff(self._stamps[:self._rest.samples]))) / SECOND
        quiet = self._rest.quiet(interval, has_moved=self.moved, moves_on=ended)
        stamps, rows = self._stamps[quiet], self._rows[quiet]
        seconds = (stamps[-1] - stamps[0]) / SECOND if stamps else 0.0
        if seconds < MIN_SECONDS or len(stamps) < MIN_SAMPLES:
            return None
        samples = max(1, round(self._block / interval))
        factor = 1.0 + LEVEL_SIGMAS / math.sqrt(2.0 * len(stamps))
        noise = tuple(
            block_noise(noise_alone([channel], interval), samples * interval).inflated(factor)
            if np.isfinite(channel).all() else UNKNOWN for channel in np.array(rows).T)
        return RestNoise(noise, samples, interval, seconds, not self.moved)


WANDER_SHARE = 5e-5
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
    single = WANDER_SHARE * (probes.max_range - probes.min_range)
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


DEFAULT_PERCENT = 2.0
"""Share of the range of the motion from preload to full scale [%]."""

LOADS = 26
"""Loads at which the motion is looked at: a channel may turn back on the way to full scale."""


def sound_motion(rig: Rig, contact: ContactParameters, elevation: float) -> Array:
    """Motion of the model from preload to full scale, (3, LOADS) [m, m, rad].

    elevation: of the load [rad].
    """
    loads = np.linspace(rig.preload, rig.full_scale_load, LOADS)
    return np.asarray(static_response(rig, contact.to_array(), elevation, loads))


def materiality(
    rig: Rig, contact: ContactParameters, elevation: float, percent: float = DEFAULT_PERCENT
) -> Array:
    """`percent` of the range of each channel from preload to full scale, (3,) [m, m, rad].

    elevation: of the load [rad].
    """
    if not 0.0 <= percent < math.inf:
        raise MonitoringError(f'materiality is {percent:g} %: give 0 or more')
    return np.asarray(0.01 * percent * np.ptp(sound_motion(rig, contact, elevation), axis=1))
