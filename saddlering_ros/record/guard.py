"""A guard before each stream: it refuses an impossible stamp or reading, and no other sample.

The rule. A sample is refused at once if its stamp is not set (0 or less), or if its reading is not
finite or beyond the limits of the rig. A sample whose stamp or reading leaps away from the last
one is held until the next one comes. If the next one continues from the last sound sample, the
held sample was an outlier and is refused. Otherwise the leap was real, and both are passed on. A
clock that was set, a seek and a step of the load therefore pass, one sample later.

The rule uses stamps and readings in their order of arrival, never the wall clock, so that nodes
with the same input refuse the same samples.
"""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
import math

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.quantities import quantity
from saddlering_ros.record import batches
from saddlering_ros.record.batches import Bits, DOUBTFUL_LOAD, GAP_HISTORY, Samples
from saddlering_ros.record.scratch import blocks, GrowingArray
from saddlering_ros.record.topics import LOAD, LOAD_TOPIC, PROBES
from saddlering_ros.rig import Rig

MAX_OVERLOAD = 1.5
"""Largest load as a share of full scale."""

MAX_PULL = 0.1
"""Largest negative load as a share of full scale; the cylinder pushes."""

STEP_SHARE = 0.1
"""Step of the load, as a share of full scale beyond the reach of the hydraulics, after which the
load is doubtful."""

LEFT_SHARE = 0.35
"""A step back from a doubtful load leaves this share of the step there at most."""

NOISE_SHARE = 0.01
"""Noise, as a share of full scale or of a probe's span, that is no leap at any rate."""

MAX_REMEMBERED = 100
"""Largest number of stretches between sound readings whose rows are still to be marked."""

SHORT = 32
"""Number of samples up to which a loop is faster than arrays."""


@dataclass(frozen=True)
class ReadingLimits:
    """Range of a possible reading: low to high, in `unit`."""

    low: float
    high: float
    rate: float = math.inf  # [1/s]
    noise: float = math.inf  # a change by more than noise + rate * dt is a leap
    step: float = math.inf  # a lasting change by more than step + rate * dt is doubtful
    unit: str = ''

    def words(self, reason: str) -> str:
        """': limit ..' that a sample passed which a counter of the guard counts; '' for none."""
        if reason == 'impossible':
            return f': limits {quantity(self.low, self.unit)} and {quantity(self.high, self.unit)}'
        change = {'leaps_of_reading': self.noise, 'doubtful_load': self.step}.get(reason)
        return '' if change is None else (f': limit {quantity(change, self.unit)} + '
                                          f'{quantity(self.rate, self.unit)}/s')


def load_limits(rig: Rig) -> ReadingLimits:
    """Limits of the cylinder's load [N]."""
    full = rig.full_scale_load
    return ReadingLimits(-MAX_PULL * full, MAX_OVERLOAD * full, full / rig.full_scale_time,
                         NOISE_SHARE * full, STEP_SHARE * full, LOAD.unit)


def probe_limits(rig: Rig) -> ReadingLimits:
    """Limits of a probe's gap [m]: its range, and as much again at either end.

    The load moves the gap by a part of the probe's span, so the gap cannot pass the span in less
    time than the load its full scale.
    """
    low, span = rig.probes.min_range, rig.probes.max_range - rig.probes.min_range
    return ReadingLimits(
        low - span, low + 2.0 * span, span / rig.full_scale_time, NOISE_SHARE * span,
        unit=PROBES[0].unit)


def limits_of(topic: str, rig: Rig) -> ReadingLimits:
    """Limits of the readings of a topic of the rig."""
    return load_limits(rig) if topic == LOAD_TOPIC else probe_limits(rig)


@dataclass
class GuardCounters:
    """Numbers of refused samples by reason, and of doubtful ones."""

    without_stamp: int = 0  # the stamp is 0 or less
    not_finite: int = 0
    impossible: int = 0  # beyond the limits
    leaps_of_stamp: int = 0  # one sample differs from those before and after
    leaps_of_reading: int = 0  # one sample differs from those before and after
    doubtful_load: int = 0  # after a step that the hydraulics cannot make

    @property
    def refused(self) -> dict[str, int]:
        """The counters of refused samples by name, those above zero."""
        return {name: count for name, count in vars(self).items()
                if count and name != 'doubtful_load'}


@dataclass
class Steps:
    """Stretches after steps of the load that the hydraulics cannot make."""

    offset: float = 0.0  # [N]: sum of these steps until they return to zero
    since: int | None = None  # [ns]: the last stamp before the first of them
    first: int = 0  # [ns]: the next stamp
    over: list[tuple[int, int]] = field(default_factory=list)  # `since`, first stamp after return

    def add(self, stamp: int, change: float, tolerance: float, changed: int) -> None:
        """Take a further step to `stamp`; the reading has not changed since the stamp `changed`.

        The step returns if little of the offset is left, because the load may have moved
        meanwhile, or if the reading did not change since the first step (an open contact).
        """
        before = self.offset
        self.offset += change
        little = max(tolerance, LEFT_SHARE * abs(before))
        if abs(self.offset) <= little or self.offset * before < 0.0 or changed <= self.first:
            self.end(stamp)

    def end(self, stamp: int) -> None:
        """The readings from `stamp` on are no longer doubtful."""
        if self.since is not None:
            self.over.append((self.since, stamp))
        self.offset, self.since = 0.0, None

    def stretches(self) -> list[tuple[int, int]]:
        """All stretches (last sound stamp, first sound stamp again) in order of time."""
        still = [] if self.since is None else [(self.since, np.iinfo(np.int64).max)]
        return [*self.over, *still]


class SampleGuard:
    """Passes on the sound samples of one stream in batches, and counts the refused ones.

    bridges: stamps [ns] of the sound readings around each refused one that was not yet passed.
    """

    def __init__(self, limits: ReadingLimits, *, remembered: int = MAX_REMEMBERED) -> None:
        self.limits = limits
        self.counters = GuardCounters()
        self._remembered = remembered
        self.bridges: list[tuple[int, int]] = []
        self.doubtful = Steps()
        self._refused_since: int | None = None
        self._steps: deque[int] = deque(maxlen=GAP_HISTORY)
        self._last: tuple[int, float] | None = None
        self._held: tuple[int, float] | None = None
        self._changed = 0

    @property
    def holds(self) -> bool:
        """Whether a sample waits for the next one."""
        return self._held is not None

    def push(self, samples: Samples) -> Samples:
        """The sound samples that are ready, in order of arrival."""
        if not len(samples):
            return samples
        if len(samples) > SHORT:
            if self._is_plain(samples):
                assert self._last is not None
                recent = np.concatenate(([self._last[0]], samples.stamps))[-GAP_HISTORY - 1:]
                self._steps.extend(np.diff(recent).tolist())
                new = np.flatnonzero(np.diff(samples.values, prepend=self._last[1]))
                if len(new):
                    self._changed = int(samples.stamps[new[-1]])
                self._last = int(samples.stamps[-1]), float(samples.values[-1])
                if self.doubtful.since is not None:
                    self.counters.doubtful_load += len(samples)
                return samples
            half = len(samples) // 2
            halves = [self.push(samples.pick(rows))
                      for rows in (slice(0, half), slice(half, None))]
            return replace(samples, stamps=np.concatenate([one.stamps for one in halves]),
                           values=np.concatenate([one.values for one in halves]))
        sound: list[tuple[int, float]] = []
        pairs = list(zip(samples.stamps.tolist(), samples.values.tolist(), strict=True))
        for pair in pairs:
            if self._is_possible(*pair):
                sound += self._judge(pair)
        if sound == pairs:
            return samples
        return replace(samples, stamps=np.array([stamp for stamp, _ in sound], np.int64),
                       values=np.array([value for _, value in sound], np.float64))

    def flush(self) -> Samples:
        """The held sample, after a time without a successor."""
        held, self._held = self._held, None
        if held is None:
            return batches.no_samples()
        self._accept(held)
        return Samples(np.array([held[0]], np.int64), np.array([held[1]]))

    def marks(self, stamps: NDArray[np.int64], *, to_next: bool = False) -> Bits:
        """BRIDGED at those `stamps` (N,), in order, that a refused reading would have influenced.

        They lie between the sound readings before and after the refused one; `to_next` includes
        the later one. Doubtful loads add DOUBTFUL_LOAD. A stretch that may contain later stamps is
        kept for the next call.
        """
        marks = np.zeros(len(stamps), np.uint8)
        if not len(stamps):
            return marks
        newest, steps = int(stamps[-1]), self.doubtful
        for first, last in self.bridges:
            marks[stamps.searchsorted(first, 'right'):
                  stamps.searchsorted(last, 'right' if to_next else 'left')] |= batches.BRIDGED
        self.bridges = [bridge for bridge in self.bridges if bridge[1] > newest]
        for first, last in steps.stretches():
            marks[stamps.searchsorted(first, 'right'):stamps.searchsorted(last)] |= DOUBTFUL_LOAD
        steps.over = [one for one in steps.over if one[1] > newest]
        return marks

    def _is_plain(self, samples: Samples) -> bool:
        """Whether every sample of the batch continues from the one before (the usual case)."""
        if self._held is not None or self._last is None or self._refused_since is not None \
                or len(self._steps) < GAP_HISTORY:
            return False
        if not ((samples.values >= self.limits.low) & (samples.values <= self.limits.high)).all():
            return False
        steps = np.diff(samples.stamps, prepend=self._last[0])
        longest = int(steps.max())
        if steps.min() <= 0 or (longest > batches.GAP_FLOOR_NS
                                and longest > batches.gap_limit(list(self._steps))):
            return False
        leap = self.limits.noise + self.limits.rate * 1e-9 * steps
        return bool((np.abs(np.diff(samples.values, prepend=self._last[1])) <= leap).all())

    def _is_possible(self, stamp: int, value: float) -> bool:
        if stamp <= 0:
            self.counters.without_stamp += 1
            return False
        if not math.isfinite(value):
            self.counters.not_finite += 1
        elif not self.limits.low <= value <= self.limits.high:
            self.counters.impossible += 1
        else:
            return True
        self._bridge_from_last()
        return False

    def _bridge_from_last(self) -> None:
        """Note that rows up to the next sound reading are interpolated."""
        if self._refused_since is None and self._last is not None:
            self._refused_since = self._last[0]

    def _judge(self, sample: tuple[int, float]) -> list[tuple[int, float]]:
        """Samples that are ready after the arrival of `sample`."""
        last = self._last
        goes_on = last is None or (
            self._follows(last[0], sample[0]) and self._is_near(last, sample))
        if self._held is None:
            if goes_on:
                return self._accept(sample)
            self._held = sample
            return []
        held, self._held = self._held, None
        # The held sample may have come early, by at most an ordinary gap.
        if goes_on and self._is_near(held, sample) and (
                0 < held[0] - sample[0] <= batches.gap_limit(list(self._steps))):
            return self._accept(sample) + self._accept(held)
        assert last is not None
        between = (last[0] < held[0] < sample[0] and self._is_near(last, held)
                   and self._is_near(held, sample))
        if goes_on and not between:  # The held one was an outlier.
            if self._follows(last[0], held[0]):
                self.counters.leaps_of_reading += 1
                self._bridge_from_last()
            else:
                self.counters.leaps_of_stamp += 1
            return self._accept(sample)
        self._step_to(held)
        return self._accept(held) + self._judge(sample)

    def _step_to(self, held: tuple[int, float]) -> None:
        """Note a step to the held sample that the hydraulics cannot make.

        The age of a reading counts from its last change, and stamps that stand still tell no rate.
        """
        last = self._last
        if last is None or held[0] <= last[0] or not self._follows(last[0], held[0]):
            return
        change, elapsed = held[1] - last[1], (held[0] - last[0]) * 1e-9
        age = max(elapsed, (held[0] - self._changed) * 1e-9)
        steps, limits = self.doubtful, self.limits
        if steps.since is not None:
            steps.add(held[0], change, limits.step + limits.rate * elapsed, self._changed)
        elif abs(change) > limits.step + limits.rate * age:
            steps.since, steps.first, steps.offset = last[0], held[0], change

    def _follows(self, last: int, stamp: int) -> bool:
        step = stamp - last
        if step <= batches.GAP_FLOOR_NS:  # no gap, for any steps before
            return step >= -batches.JITTER_NS
        return step <= batches.gap_limit(list(self._steps))

    def _is_near(self, last: tuple[int, float], sample: tuple[int, float]) -> bool:
        elapsed = abs(sample[0] - last[0]) * 1e-9
        return abs(sample[1] - last[1]) <= self.limits.noise + self.limits.rate * elapsed

    def _accept(self, sample: tuple[int, float]) -> list[tuple[int, float]]:
        step = 0 if self._last is None else sample[0] - self._last[0]
        if self._last is None or sample[1] != self._last[1]:
            self._changed = sample[0]
        if step < -batches.JITTER_NS:
            self._steps.clear()
            self.bridges.clear()
            self.doubtful = Steps()
            self._refused_since = None
        elif step > 0:
            if step > batches.LEAP_NS:  # Another test begins.
                self.doubtful.end(sample[0])
            self._steps.append(step)
            if self._refused_since is not None:
                self.bridges.append((self._refused_since, sample[0]))
                del self.bridges[:-self._remembered]
                self._refused_since = None
        if self._last is None or step > 0 or step < -batches.JITTER_NS:
            self._last = sample
        self.counters.doubtful_load += self.doubtful.since is not None
        return [sample]


def sound_samples(limits: ReadingLimits, samples: Samples) -> tuple[Samples, SampleGuard]:
    """The sound samples of a whole record, and the guard that all of them passed."""
    def passed(guard: SampleGuard) -> Iterator[Samples]:
        for block in blocks(len(samples), samples.stamps, samples.values):
            yield guard.push(samples.pick(block))
        yield guard.flush()

    guard = SampleGuard(limits, remembered=len(samples) + 1)
    if sum(map(len, passed(guard))) == len(samples):
        return samples, guard
    stamps, values = GrowingArray(np.int64), GrowingArray(np.float64)
    for sound in passed(SampleGuard(limits)):
        stamps.append(sound.stamps)
        values.append(sound.values)
    return replace(samples, stamps=stamps.array(), values=values.array()), guard
