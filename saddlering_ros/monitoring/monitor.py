"""A residual watched sample by sample; live and offline are the same steps, bit for bit.

An alarm has a first guess at its cause, and a line in words.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
import math

import numpy as np

from saddlering_ros.memory_operators import Array, direction_of
from saddlering_ros.monitoring import detector
from saddlering_ros.monitoring.detector import BlockWatch, MonitoringError, RestLearner, RestNoise
from saddlering_ros.quantities import quantity, signed
from saddlering_ros.record.batches import SECOND
from saddlering_ros.rig import MOTION

WAITING, LEARNING, WATCHING, ALARM = range(4)
"""States of a monitor, numbered as in RingAlarm.msg."""

MOVING = 'the load moves, and its noise was not measured at rest before: let the load rest for 2 s'
MOVED_ALONE = ('the residual moved by more than the materiality while the load rested: see to the '
               'load cell and its unit, then let the load rest for 2 s')
NO_EQUILIBRIUM = ('the ring has no equilibrium at preload or full scale with the parameters in '
                  'force: nothing is watched')

MAX_GAP = 3.0
"""A longer pause between samples, in blocks, ends the block and the memory of the noise."""

MAX_BACK = 50_000_000
"""Stamps that go back by more [ns] are of another record."""

SHORT_REST, SEEN = 2.0, 0.9
"""Rest [s] without which the noise is not known well enough for the promise, and the share of it
that is read at least, because its end is seen early."""

HISTORY_BLOCKS = 180_000
"""Blocks remembered: an hour of 20 ms; an onset before that is stamped with the oldest."""

REFINE_AFTER, REFINE_GROWTH = 2.0, 0.1
"""Size and first guess are taken anew after so long [s], or, if that is longer, after this share
of the time since the alarm: samples to come may speak against a guess."""

MAX_LAPSES = 20
"""Newest lapses kept: a driver that fails all night fills neither memory nor message."""


@dataclass(frozen=True)
class MonitorSettings:
    """Settings: length of a block [s], hours of testing for one false alarm."""

    block: float = 0.02
    false_alarm_hours: float = 1000.0

    def __post_init__(self) -> None:
        if not (0.0 < self.block < math.inf and 0.0 < self.false_alarm_hours < math.inf):
            raise MonitoringError('monitoring: block and false_alarm_hours must be above 0')


@dataclass(frozen=True)
class Sample:
    """A residual with its load and what it belongs to."""

    stamp: int  # [ns]
    residual: tuple[float, float, float]  # [m, m, rad], NaN where not known
    load: float  # [N]
    zero: int = 0  # [ns]: stamp of the zero it counts from
    elevation: float = math.nan  # [rad]


@dataclass(frozen=True)
class Raised:
    """A latched alarm in the units of its channel."""

    channel: str
    stamp: int  # [ns] of the alarm
    since: int  # [ns] of the likely onset
    size: float  # [m or rad]: mean residual since then
    evidence: float  # its logarithm
    follows: str  # a key of FOLLOWS, '' if too short to tell

    @property
    def first_guess(self) -> str:
        """Frequent causes of a residual that follows this."""
        return FOLLOWS[self.follows][1]


@dataclass(frozen=True)
class Lapse:
    """The promise of the false alarms did not hold, or the evidence ended."""

    stamp: int  # [ns]
    reason: str
    is_lasting: bool = False  # for the rest of the record


class Monitor:
    """Watches residuals with their load; the first alarm is latched until `reset`.

    rest_band [N]: the load is at rest within it; materiality_of: the residual (3,) that is no
    alarm, by the elevation [rad]; wander (3,): smallest of each channel. `changes` counts news.
    """

    def __init__(self, settings: MonitorSettings, rest_band: float,
                 materiality_of: Callable[[float], Array],
                 wander: Sequence[float] | Array = (0.0, 0.0, 0.0)) -> None:
        self.settings = settings
        self._rest_band, self._materiality_of = rest_band, materiality_of
        self._least_wander = tuple(float(value) for value in wander)
        self._learner = RestLearner(rest_band, settings.block)
        self.alarm: Raised | None = None
        self.lapses: list[Lapse] = []
        self.changes, self.seconds = 0, 0.0
        self.materiality = np.zeros(len(MOTION))
        self._begin_anew()

    def _begin_anew(self) -> None:
        self._learner.restart()
        self.rest: RestNoise | None = None
        self._watch: BlockWatch | None = None
        self._last: Sample | None = None
        # The last blocks: when each began, its means and its load. Untouched zeros take no memory.
        self._stamps = np.zeros(HISTORY_BLOCKS, np.int64)
        self._rows = np.zeros((HISTORY_BLOCKS, len(MOTION) + 1))
        self._blocks = 0
        self._noise_grew, self._known = False, (True,) * len(MOTION)
        self._onset: tuple[int, int] | None = None
        self._refine_at = self._raised_at = 0
        self._clear_evidence()

    @property
    def state(self) -> int:
        if self.alarm is not None:
            return ALARM
        if self._watch is not None:
            return WATCHING
        return WAITING if self._last is None else LEARNING

    @property
    def unwatched(self) -> str:
        """Why no change would be found, in words; '' while changes are found or the load rests."""
        if not np.isfinite(self.materiality).all():
            return NO_EQUILIBRIUM
        if self.state != LEARNING or not self._learner.moved:
            return ''
        return MOVED_ALONE if self._learner.moved_alone else MOVING

    @property
    def stamp(self) -> int:
        """Stamp of the last sample [ns]; 0 before the first."""
        return 0 if self._last is None else self._last.stamp

    @property
    def log_evidence(self) -> float:
        """Logarithm of the strongest evidence so far; -inf before watching begins."""
        return -math.inf if self._watch is None else float(self._watch.detector.evidence.max())

    @property
    def log_threshold(self) -> float:
        """At which logarithm of the evidence the alarm is raised; NaN while not known."""
        return math.nan if self._watch is None else self._watch.detector.threshold

    def reset(self) -> None:
        """Clear the alarm and the evidence; the noise that was learnt stays."""
        self.alarm, self._onset = None, None
        self.lapses = [lapse for lapse in self.lapses if lapse.is_lasting]
        self._clear_evidence()
        self.changes += 1

    def parameters_changed(self) -> None:
        """The ring is simulated with other parameters from now on."""
        if self._last is not None:
            self._take_materiality(self._last.elevation)
            self._lapse('the parameters in force changed: the evidence restarts')
            self._clear_evidence()

    def step(self, sample: Sample) -> None:
        last = self._last
        if last is not None and sample.stamp <= last.stamp:
            if last.stamp - sample.stamp <= MAX_BACK:
                return
            self.lapses = [lapse for lapse in self.lapses if not lapse.is_lasting]
            self._lapse('the stamps jumped back: noise and evidence restart')
            self._begin_anew()
            last = None
        if last is None:
            self._take_materiality(sample.elevation)
            self.changes += 1
        else:  # Begin anew after a new zero, a new elevation or a pause.
            reasons = []
            if sample.zero != last.zero:
                reasons.append('the zero was renewed')
            if sample.elevation != last.elevation and not (
                    math.isnan(sample.elevation) and math.isnan(last.elevation)):
                self._take_materiality(sample.elevation)
                degrees = math.degrees(sample.elevation)
                reasons.append(f'the elevation changed to {degrees:.3f} deg')
            pause = (sample.stamp - last.stamp) / SECOND
            if self.rest is not None and pause > MAX_GAP * self.rest.block + self.rest.interval:
                reasons.append(f'no samples for {pause:.3g} s')
            for reason in reasons:
                self._lapse(f'{reason}: the evidence restarts', sample.stamp)
                self._clear_evidence()
            if self.rest is None and sample.zero != last.zero:
                self._learner.restart(moved=self._learner.moved)
        self._last = sample
        if self.rest is None:
            self._learn(sample)
            return
        if not self._count:
            self._block_began = sample.stamp
        total = self._sum
        for place, value in enumerate(sample.residual):
            total[place] += value
        total[-1] += sample.load
        self._count += 1
        if self._count == self.rest.samples:
            self._judge(self.rest.block)

    def _take_materiality(self, elevation: float) -> None:
        self.materiality = np.asarray(self._materiality_of(elevation), dtype=np.float64)
        if not np.isfinite(self.materiality).all():
            self._lapse(NO_EQUILIBRIUM)

    def _lapse(self, reason: str, stamp: int | None = None, *, is_lasting: bool = False) -> None:
        self.lapses.append(Lapse(self.stamp if stamp is None else stamp, reason, is_lasting))
        del self.lapses[:-MAX_LAPSES]
        self.changes += 1

    def _clear_evidence(self) -> None:
        self._sum, self._count = [0.0] * (len(MOTION) + 1), 0
        if self._watch is not None:
            self._watch.reset()

    def _learn(self, sample: Sample) -> None:
        rest = self._learner.step(sample.stamp, sample.residual, sample.load, self.materiality)
        if rest is None:
            return
        self.rest = rest
        assumed = [detector.assumed_noise(one, least, rest.block)
                   for one, least in zip(rest.noise, self._least_wander, strict=True)]
        self._watch = BlockWatch(assumed, rest.block, self.settings.false_alarm_hours)
        self.changes += 1
        lost = [name for name, one in zip(MOTION, rest.noise, strict=True)
                if one == detector.UNKNOWN]
        if lost:
            self._lapse(f'{" and ".join(lost)} not known while the load rested, and not watched',
                        is_lasting=True)
        if not rest.first:
            self._lapse('the noise is read from a rest after a movement, where the ring still '
                        'creeps: begin the test with a rest', is_lasting=True)
        elif rest.seconds < SEEN * SHORT_REST:
            self._lapse(f'the noise is read from {rest.seconds:.1f} s of rest: rest for '
                        f'{SHORT_REST:g} s before the load moves, else the rate of false alarms '
                        'is not sure', is_lasting=True)

    def _judge(self, block: float) -> None:
        """Judge a whole block, of `block` seconds."""
        assert self._watch is not None
        mean = np.array(self._sum) / self._count
        self._sum, self._count = [0.0] * (len(MOTION) + 1), 0
        self.seconds += block
        known = tuple(math.isfinite(value) for value in mean[:-1])
        if known != self._known:
            self._known = known
            lost = [name for name, is_known in zip(MOTION, known, strict=True) if not is_known]
            self._lapse(f'{" and ".join(lost)} not known, and not watched' if lost
                        else 'all channels are known again')
        index = self._blocks
        self._stamps[index % HISTORY_BLOCKS] = self._block_began
        self._rows[index % HISTORY_BLOCKS] = mean
        self._blocks += 1
        if self.alarm is not None:
            # Take size and first guess anew from the readings since the alarm.
            if self._onset is not None and index >= self._refine_at:
                self._refine_at = index + max(round(REFINE_AFTER / block),
                                              round(REFINE_GROWTH * (index - self._raised_at)))
                self.alarm = self._described(self.alarm)
                self.changes += 1
            return
        alarm = self._watch.step(mean[:-1], self.materiality)
        grew, self._noise_grew = self._noise_grew, self._watch.noise_grew
        if self._noise_grew and not grew:
            self._lapse('the noise is far larger than it was at rest: the rate of false alarms is '
                        'not sure')
        if alarm is not None:
            self._onset = (alarm.channel, index - (alarm.block - alarm.since))
            self.alarm = self._described(
                Raised(MOTION[alarm.channel], self.stamp, 0, 0.0, alarm.evidence, ''))
            self._raised_at, self._refine_at = index, index + round(REFINE_AFTER / block)
            self.changes += 1

    def _described(self, alarm: Raised) -> Raised:
        assert self._onset is not None
        channel, onset = self._onset
        first = max(onset, self._blocks - HISTORY_BLOCKS, 0)
        places = np.arange(first, self._blocks) % HISTORY_BLOCKS
        places = places[np.isfinite(self._rows[places, channel])]
        stamps, rows = self._stamps[places], self._rows[places]
        return replace(
            alarm, since=int(stamps[0]), size=float(rows[:, channel].mean()),
            follows=first_guess(rows[:, channel], rows[:, -1], (stamps - stamps[0]) / SECOND,
                                self._rest_band))


FOLLOWS = {
    '': ('', 'too short to tell: it is judged again as the test goes on, and when the load has '
             'turned'),
    'load': ('the difference follows the load', 'stiffness or exponent of a contact row, geometry,'
             ' or the gain of a probe or of the load cell'),
    'rate': ('the difference follows the rate of the load',
             'damping, or a delay between load and probes'),
    'direction': ('the difference follows the direction of the load',
                  'friction or play in a row, or hysteresis of the load cell'),
    'time': ('the difference follows time',
             'drift of a probe, of the temperature or of the load cell'),
    'offset': ('the difference is an offset', 'a probe that slipped or was touched, or a zero that'
               ' was not at rest'),
    'one direction': (
        'the difference is an offset while the load moves in one direction',
        'friction or play in a row, hysteresis of the load cell, or a probe that slipped (they '
        'can be told apart when the load has turned)'),
    'unclear': (
        'the difference follows neither load, rate, direction nor time',
        'none of load, rate, direction and time alone: record the test and run `saddlering '
        'diagnose`')}
"""What a residual follows, in words, and the frequent causes of one that does."""

MIN_BLOCKS = 10
"""Fewest blocks that show what a residual follows; in fewer it is often chance."""
STEADY_SHARE = 0.35
"""A residual whose scatter is below this share of its mean is an offset."""

ONE_WAY = 0.9
"""Mean direction (-1 to 1) of a load from which on it moves in one direction only."""

MIN_CORRELATION = 0.5  # a quarter of the power
SPAN = 2
"""Blocks to either side over which the rate of the load is taken."""


def first_guess(residual: Array, load: Array, time: Array, rest_band: float) -> str:
    """Which key of FOLLOWS the residual (N,) follows; '' if it is too short for a guess.

    Load and time cannot be told apart while the load moves in one direction. load (N,) [N]; time
    (N,) [s]; rest_band [N]: a load that moves by less has no direction.
    """
    if residual.size < MIN_BLOCKS:
        return ''
    change = np.zeros_like(load)
    change[SPAN:-SPAN] = load[2 * SPAN:] - load[:-2 * SPAN]
    change[:SPAN], change[-SPAN:] = change[SPAN], change[-SPAN - 1]
    direction = np.where(np.abs(change) > rest_band, np.sign(change), 0.0)
    # Friction keeps its direction at rest. This one is late by `rest_band` after a turn, though.
    came = direction_of(load, rest_band)
    is_one_way = np.ptp(load) > rest_band and abs(came.mean()) > ONE_WAY
    if residual.std() < STEADY_SHARE * abs(residual.mean()):
        # Friction after the load has turned is an offset too, until the load turns again; a rest
        # of the load changes nothing.
        return 'one direction' if is_one_way else 'offset'
    regressors = (('load', load), ('rate', change), ('direction', direction), ('direction', came),
                  ('time', time))
    strength, best = max(((abs(float(np.corrcoef(residual, values)[0, 1])), name)
                          for name, values in regressors if np.ptp(values) > 0.0),
                         key=lambda pair: pair[0], default=(0.0, ''))
    if best in ('load', 'time') and is_one_way and (
            abs(direction.mean()) > ONE_WAY or abs(np.corrcoef(load, time)[0, 1]) > ONE_WAY):
        return ''
    return best if strength > MIN_CORRELATION else 'unclear'


def alarm_words(alarm: Raised, origin: int | None = None) -> str:
    """An alarm in one line; with seconds since `origin` [ns] where it is given."""
    delay = quantity(1e-9 * (alarm.stamp - alarm.since), 's')
    when = f'ALARM {delay} after the onset'
    if origin is not None:
        when = (f'ALARM at {1e-9 * (alarm.stamp - origin):.2f} s, onset at '
                f'{1e-9 * (alarm.since - origin):.2f} s')
    size = signed(alarm.size, 'rad' if alarm.channel == 'gamma' else 'm')
    words = (f'{when}: {alarm.channel} has differed from its model by {size} in the mean since '
             'then')
    follows, guess = FOLLOWS[alarm.follows]
    return f'{words}; {follows}; first guess: {guess}' if follows else words


def state_words(monitor: Monitor) -> str:
    """The state of a monitor in one line."""
    if monitor.alarm is not None:
        return alarm_words(monitor.alarm)
    return {WAITING: 'waiting for samples',
            LEARNING: 'reading the noise while the load rests'}.get(monitor.state, 'no alarm')
