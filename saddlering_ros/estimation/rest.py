"""Stretches of a record at rest, by its load, and the rounding errors that they do not show.

One rule of rest serves all estimates of noise. The zero of a test has a rule of its own
(`rig/geometry.py`).

A converter of step q rounds by up to q/2. Noise of several steps makes this error new in every
reading. A quieter sensor at rest has the same error for seconds, so that its readings seem free of
noise. The hidden part has the variance (q^2 / 12) exp(-4 (pi s / q)^2) at noise s (Widrow and
Kollar, Quantization Noise, 2008, chapter 4: the error that remains with dither).
"""

from dataclasses import dataclass
import math

import numpy as np

from saddlering_ros.estimation.process import Array
from saddlering_ros.record.record import Record
from saddlering_ros.record.topics import PROBE_TOPICS
from saddlering_ros.rig.description import OPPOSITE

Stretches = list[tuple[int, int]]

BLOCK_SECONDS = 0.05
"""Length [s] of the means of the load that are compared."""

MIN_SECONDS = 0.3
"""Shortest part [s] of a rest without settling and guard: six blocks."""

SETTLING_SECONDS = 0.5
"""Time [s] of settling after a movement, at most half the stretch."""

GUARD_SECONDS = 0.1
"""Time [s] before the next movement that is left out, at most a fifth of the stretch."""

MIN_SAMPLES = 8
"""Smallest number of samples of a rest: their scatter is then known within 27 %."""


@dataclass(frozen=True)
class RestSegment:
    """A stretch of a record with the system at rest, at its original rate: a source of noise.

    Segments of one label share a systematic course (for instance creep after a step), whose mean
    is subtracted before noise is measured.
    """

    values: Array  # (C, n) of all channels
    step: float  # [s] between samples
    label: str = ''


@dataclass
class Rest:
    """A rest as it grows by blocks of samples.

    Streams and records use this one rule. Only the blocks differ: those of a record have equal
    numbers of samples, those of a stream end by their stamps, because its interval is not known.
    """

    band: float  # [N]
    samples: int = 0  # how many there are
    level: float = 0.0  # their mean load [N]

    def takes(self, mean: float, count: int) -> bool:
        """Add a block of `count` samples, if its mean load is within the band of the rest's."""
        if self.samples and abs(mean - self.level) >= self.band:
            return False
        self.samples += count
        self.level += (mean - self.level) * count / self.samples
        return True

    def quiet(self, step: float, *, has_moved: bool, moves_on: bool) -> slice | None:
        """The samples without settling and without the start of the next movement; None if few.

        step [s]: between samples; has_moved, moves_on: whether the load moved before and after.
        """
        settling = min(round(SETTLING_SECONDS / step), self.samples // 2) if has_moved else 0
        guard = min(round(GUARD_SECONDS / step), self.samples // 5) if moves_on else 0
        count = self.samples - guard - settling
        is_long = count >= MIN_SAMPLES and (count - 1) * step >= MIN_SECONDS
        return slice(settling, self.samples - guard) if is_long else None


def level_stretches(time: Array, load: Array, band: float) -> Stretches:
    """Stretches [start, stop) of samples over which the mean load stays within `band` [N]."""
    step = float(np.median(np.diff(time)))
    count = max(1, round(BLOCK_SECONDS / step))
    blocks = time.size // count
    level = load[:blocks * count].reshape(-1, count).mean(axis=1)
    stretches, begin = [], 0
    rest = Rest(band)
    for index in range(blocks):
        if not rest.takes(level[index], count):
            stretches.append((begin, index * count))
            begin, rest = index * count, Rest(band, count, float(level[index]))
    return [*stretches, (begin, blocks * count)] if blocks else []


def stretches_at_rest(time: Array, load: Array, band: float) -> Stretches:
    """Stretches [start, stop) of samples at rest, within `band` [N] of their mean load.

    The beginning of a stretch is settling, unless the record begins with the stretch.
    """
    step = float(np.median(np.diff(time)))
    stretches = []
    for begin, end in level_stretches(time, load, band):
        quiet = Rest(band, end - begin).quiet(step, has_moved=begin > 0, moves_on=True)
        if quiet is not None:
            stretches.append((begin + quiet.start, begin + quiet.stop))
    return stretches


def quiet_stretches(stretches: Stretches) -> Stretches:
    """Stretches for noise: only the one before the first movement, if there is one.

    After a movement the ring creeps while the load rests. Creep is no noise.
    """
    return [one for one in stretches if one[0] == 0] or stretches


HELD_SECONDS = 1.0
"""Time [s] after which the rounding error under a held load counts as new. It is shorter than a
plateau, so that the noise of a plateau's mean includes the error."""

HELD_FACTOR = math.sqrt(2.0)
"""A mean over a plateau has the whole error; one over several times HELD_SECONDS has less."""


def hidden_rounding(resolution: float, noise: float) -> float:
    """Rms rounding error that readings at rest hide, by a converter's step and their rms."""
    if not resolution > 0.0:
        return 0.0
    dither = math.sqrt(max(noise**2 - resolution**2 / 12.0, 0.0))
    left = math.exp(-2.0 * (math.pi * dither / resolution) ** 2)
    return resolution / math.sqrt(12.0) * left


def rounding_record(rms: float, lasting: float, step: float, count: int, seed: int) -> Array:
    """An error (count,) of this rms at every `step` [s], new after each `lasting` [s]."""
    random = np.random.default_rng(seed)
    each = max(1, round(lasting / step))
    values = random.uniform(-1.0, 1.0, -(-count // each) + 1) * math.sqrt(3.0) * rms
    start = int(random.integers(each))
    return np.repeat(values, each)[start:start + count]


def probe_rounding(run: Record) -> Array | None:
    """Errors (4, N) [m] to add to a run's probes where noise is read from them; None if none.

    Only a coarse converter hides such errors. A run has the same errors every time.
    """
    rows = np.zeros(run.gaps.shape)
    step = float(np.median(np.diff(run.time)))
    for probe, topic in enumerate(PROBE_TOPICS):
        quality = run.quality.get(topic)
        if quality is None or not quality.is_coarse:
            continue
        rms = hidden_rounding(quality.resolution, quality.noise)
        if run.test == 'static':
            rms, lasting = HELD_FACTOR * rms, HELD_SECONDS
        else:
            # The time in which moving readings pass one step.
            travel = 2.0 * float(np.nanmax(run.gaps[probe]) - np.nanmin(run.gaps[probe]))
            seconds = max(float(run.time[-1] - run.time[0]), 1e-9)
            lasting = quality.resolution / max(travel / seconds, 1e-300)
        rows[probe] = rounding_record(rms, lasting, step, run.time.size, probe)
    if run.absent:
        rows[run.absent - 1] = -rows[OPPOSITE[run.absent] - 1]
    return rows if rows.any() else None
