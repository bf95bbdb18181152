"""Which faults of data loggers move a result without a note, from which severity on?

    python benchmarks/logger_faults.py [--only WORD ...] [--rounds 4]

A virtual rig records a static test and a ramp at 50 degrees. Each fault is put into both records
with a severity that falls by a factor of three from an obvious one. A severity is silent if
delta_x, delta_y, gamma, K or D move by more than their stated 95 % interval and neither `info` nor
`identify` has a line that the sound records do not have.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
import math
import sys

from frame import arguments, table
import numpy as np
from rigs import as_read, NO_SCATTER, RIG
from scipy.signal import lfilter

from saddlering_ros.bags.reader import put_in_order
from saddlering_ros.doubts.on_rig import findings_on_rig
from saddlering_ros.doubts.readings import run_of_record
from saddlering_ros.errors import SaddleringError
from saddlering_ros.identification.methods import identify
from saddlering_ros.identification.result import Identification
from saddlering_ros.quantities import WIDTH_95
from saddlering_ros.record.displacement import displacement_of_run
from saddlering_ros.record.record import RawRecord, RawTopic, Record, TestMetadata
from saddlering_ros.record.topics import LOAD_TOPIC, PROBE_TOPICS
from saddlering_ros.rig import PARAMETER_NAMES, TONNE, TRUE_TO_SCALE
from saddlering_ros.virtual_rig import experiment

Topics = dict[str, RawTopic]
ELEVATION = 50.0
FALL = 3.0
"""Factor between severities."""


def raw_record(test: str) -> RawRecord:
    """A sound record of the virtual rig, of equal rollers, as the reader finds it."""
    schedule = (experiment.static_schedule(RIG, hold=2.0, step=RIG.full_scale_load / 12.0)
                if test == 'static' else experiment.dynamic_schedule(RIG))
    ring = experiment.PhysicalRig(RIG, TRUE_TO_SCALE, math.radians(ELEVATION), (), NO_SCATTER, 1)
    return as_read(experiment.record_test(experiment.TestPlan(ring, schedule, 1)), RIG.probes,
                   TestMetadata(test, ELEVATION), f'{test}_50')


# -- faults --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Fault:
    """A fault: what it does to a record, the severity that is obvious, its unit.

    no_data: why no data can show it, where that is so.
    """

    act: Callable[[Topics, float], Topics]
    obvious: float
    unit: str
    no_data: str = ''


Change = Callable[[RawTopic, float], RawTopic]


def each(names: tuple[str, ...], change: Change, obvious: float, unit: str, scale: float = 1.0,
         no_data: str = '') -> Fault:
    """A change of each of some topics by its severity, of which one unit is `scale` in SI."""
    def act(topics: Topics, severity: float) -> Topics:
        return {name: change(topic, scale * severity) if name in names else topic
                for name, topic in topics.items()}
    return Fault(act, obvious, unit, no_data)


def held(topic: RawTopic, seconds: float) -> RawTopic:
    """Taken every so many seconds, published at every stamp."""
    slot = np.floor((topic.stamps - topic.stamps[0]) * 1e-9 / seconds)
    first = np.maximum.accumulate(np.where(np.diff(slot, prepend=-1.0) > 0,
                                           np.arange(slot.size), 0))
    return replace(topic, values=topic.values[first])


def low_passed(topic: RawTopic, seconds: float) -> RawTopic:
    """First-order filter with this time constant."""
    keep = math.exp(-period(topic) / seconds)
    start = topic.values[0]
    moved = lfilter([1.0 - keep], [1.0, -keep], topic.values - start) + start
    return replace(topic, values=np.asarray(moved))


def period(topic: RawTopic) -> float:
    """Time from one stamp to the next [s]."""
    return float(np.median(np.diff(topic.stamps))) * 1e-9


def late(topic: RawTopic, seconds: float) -> RawTopic:
    return replace(topic, stamps=topic.stamps + round(1e9 * seconds))


def drifting(topic: RawTopic, share: float) -> RawTopic:
    """A clock that runs fast by a share."""
    since = topic.stamps - topic.stamps[0]
    return replace(topic, stamps=topic.stamps + np.rint(share * since).astype(np.int64))


def gained(topic: RawTopic, share: float) -> RawTopic:
    start = topic.values[:50].mean()
    return replace(topic, values=start + (1.0 + share) * (topic.values - start))


def stretch(topic: RawTopic, begin: float, seconds: float, value: float | None) -> RawTopic:
    """A stretch from a share of the record on with one value; None: that of its begin."""
    values, first = topic.values.copy(), int(begin * topic.values.size)
    values[first:first + max(1, round(seconds / period(topic)))] = (
        values[first] if value is None else value)
    return replace(topic, values=values)


def spiked(topic: RawTopic, size: float) -> RawTopic:
    """Spikes of either sign in one reading of a hundred."""
    random = np.random.default_rng(3)
    struck = random.random(topic.values.size) < 0.01
    signs = random.choice([-1.0, 1.0], topic.values.size)
    return replace(topic, values=topic.values + np.where(struck, size * signs, 0.0))


def rounded(topic: RawTopic, step: float) -> RawTopic:
    return replace(topic, values=step * np.rint(topic.values / step))


def clipped(topic: RawTopic, share: float) -> RawTopic:
    """Cut off where `share` of its travel is left out."""
    low, high = float(topic.values.min()), float(topic.values.max())
    start = float(topic.values[:50].mean())
    if high - start > start - low:
        return replace(topic, values=np.minimum(topic.values, high - share * (high - start)))
    return replace(topic, values=np.maximum(topic.values, low + share * (start - low)))


def dropped(topic: RawTopic, share: float) -> RawTopic:
    kept = np.random.default_rng(5).random(topic.values.size) >= share
    return replace(topic, stamps=topic.stamps[kept], values=topic.values[kept])


def aliased(topic: RawTopic, size: float) -> RawTopic:
    """A vibration above half the sampling rate, as samples without a filter show it."""
    time = (topic.stamps - topic.stamps[0]) * 1e-9
    return replace(topic, values=topic.values + size * np.sin(2.0 * math.pi * 1.7 * time))


def cross_talk(topics: Topics, source: str, target: str, share: float) -> Topics:
    """A share of one signal in another topic."""
    probe, other = topics[target], topics[source]
    seen = np.interp(probe.stamps, other.stamps, other.values)
    return {**topics, target: replace(probe, values=probe.values + share * (seen - seen[0]))}


def swapped(topics: Topics, first: int, second: int, share: float) -> Topics:
    """The cables of two probes change places for the last `share` of the record."""
    one, other = topics[PROBE_TOPICS[first]], topics[PROBE_TOPICS[second]]
    count = min(len(one), len(other))
    part = slice(round((1.0 - share) * count), count)
    values, others = one.values.copy(), other.values.copy()
    values[part], others[part] = other.values[part], one.values[part]
    return {**topics, one.topic: replace(one, values=values),
            other.topic: replace(other, values=others)}


LOAD, PROBES, ONE_PROBE = (LOAD_TOPIC,), PROBE_TOPICS, (PROBE_TOPICS[1],)
SAME_AXIS = ('an axial probe that reads more or less is a ring of another tilting stiffness: only '
             'a calibration of the probes shows it')
SAME_CLOCK = ('an offset of one ramp is a damping: the readings are those of another ring; ramps '
              'of two speeds show it to diagnose')
SOFTER = 'all displacements in proportion are a softer ring: only a calibration shows it'

FAULTS: dict[str, Fault] = {
    'load held': each(LOAD, held, 60.0, 'ms', 1e-3),
    'probes held': each(PROBES, held, 60.0, 'ms', 1e-3),
    'load low-passed': each(LOAD, low_passed, 24.0, 'ms', 1e-3),
    'probes low-passed': each(PROBES, low_passed, 24.0, 'ms', 1e-3),
    'clock drift': each(PROBES, drifting, 0.3, '%', 1e-2),
    'clocks apart': each(PROBES, late, 30.0, 'ms', 1e-3, SAME_CLOCK),
    'gains of all probes': each(PROBES, gained, 10.0, '%', 1e-2, SOFTER),
    'probe spikes in 1 %': each(PROBES, spiked, 200.0, 'um', 1e-6),
    'one probe cut off': each(ONE_PROBE, clipped, 15.0, '%', 1e-2),
    'one probe stalled': each(
        ONE_PROBE, lambda one, s: stretch(one, 0.3, s, None), 600.0, 'ms', 1e-3),
    'load stalled': each(LOAD, lambda one, s: stretch(one, 0.3, s, None), 600.0, 'ms', 1e-3),
    'resolution of the probes': each(PROBES, rounded, 5.0, 'um', 1e-6),
    'resolution of the load': each(LOAD, rounded, 1.0, 't', TONNE),
    'lost readings of the probes': each(PROBES, dropped, 30.0, '%', 1e-2),
    'cross-talk 2 to 1': Fault(
        lambda t, s: cross_talk(t, PROBES[1], PROBES[0], 1e-2 * s), 10.0, '%'),
    'cross-talk 4 to 2': Fault(
        lambda t, s: cross_talk(t, PROBES[3], PROBES[1], 1e-2 * s), 10.0, '%', SAME_AXIS),
    'cross-talk of the load to 2': Fault(
        lambda t, s: cross_talk(t, LOAD_TOPIC, PROBES[1], 1e-6 * s / RIG.full_scale_load), 10.0,
        'um at full scale', SAME_AXIS),
    'aliased vibration of the probes': each(PROBES, aliased, 20.0, 'um', 1e-6),
    'aliased ripple of the load': each(LOAD, aliased, 1.0, 't', TONNE),
    'dropout of one probe': each(
        ONE_PROBE, lambda one, s: stretch(one, 0.45, s, 0.0), 300.0, 'ms', 1e-3),
    'dropout of the load': each(
        LOAD, lambda one, s: stretch(one, 0.45, s, 0.0), 300.0, 'ms', 1e-3),
    **{f'swapped cables {a + 1} and {b + 1}': Fault(
        lambda t, s, a=a, b=b: swapped(t, a, b, 1e-2 * s), 100.0, '% of the record')
        for a in range(4) for b in range(a + 1, 4)},
}


# -- measuring -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Tried:
    """Runs with a fault of one severity and what is found from them.

    refused: why, if they are. move and figure: the largest move from what the sound runs give over
    its interval, and of which figure; said: lines that the sound runs do not have.
    """

    runs: tuple[Record, ...] = ()
    found: Identification | None = None
    refused: str = ''
    move: float = math.inf
    figure: str = ''
    said: tuple[str, ...] = ()

    @property
    def lines(self) -> list[str]:
        """Every note that `info` or `identify` has."""
        return [*(note for run in self.runs for note in run.notes),
                *(note for note in self.found.notes if 'iterations' not in note),
                self.found.status]

    @property
    def is_silent(self) -> bool:
        return self.move > 1.0 and not self.said and not self.refused


def tried(records: tuple[RawRecord, ...]) -> Tried:
    """The records judged as `info` and `identify` judge a bag."""
    runs = tuple(run_of_record(record, record.facts, RIG) for record in records)
    for run, record in zip(runs, records, strict=True):
        run.notes.extend(findings_on_rig(RIG, run, record))
    return Tried(runs, identify(runs, RIG))


def faulty(records: tuple[RawRecord, ...], sound: Tried, fault: Fault, severity: float) -> Tried:
    """Put a fault into the sound records and look at all figures again."""
    try:
        new = tried(tuple(replace(one, topics={
            name: as_stored(topic) for name, topic in fault.act(one.topics, severity).items()})
            for one in records))
    except SaddleringError as refusal:
        return Tried(refused=str(refusal))
    move, figure = max(moves(sound, new))
    return replace(new, move=move, figure=figure, said=tuple(
        line for line in dict.fromkeys(new.lines) if line not in sound.lines))


def as_stored(topic: RawTopic) -> RawTopic:
    """The topic as the reader has it, from messages that were stored as they came."""
    arrival = topic.stamps[0] + np.arange(len(topic)) * int(np.median(np.diff(topic.stamps)))
    keep, reordered, duplicates = put_in_order(
        topic.topic, topic.stamps, lambda: arrival, topic.values)
    notes: tuple[str, ...] = ()
    if reordered or duplicates:
        notes = (f'{topic.topic}: {reordered} messages put in order, {duplicates} left out',)
    return replace(topic, stamps=topic.stamps[keep], values=topic.values[keep], notes=notes)


def moves(old: Tried, new: Tried) -> Iterator[tuple[float, str]]:
    """Moves of parameters over their intervals; of channels (rms) over twice a reading's noise."""
    for index, name in enumerate(PARAMETER_NAMES):
        if old.found.determined[name] and new.found.determined[name]:
            first, last = (getattr(one.found.parameters.contact, name) for one in (old, new))
            yield abs(last - first) / (WIDTH_95 * float(new.found.std[index])), name
    for before, after in zip(old.runs, new.runs, strict=True):
        if before.time.size != after.time.size:
            continue
        motions = [displacement_of_run(RIG, run).displacement for run in (before, after)]
        for name in ('delta_x', 'delta_y', 'gamma'):
            first, last = (np.asarray(getattr(one, name)) for one in motions)
            noise = float(np.sqrt(np.nanmean(np.diff(first[:50], 2) ** 2) / 6.0))
            change = float(np.sqrt(np.nanmean((last - first) ** 2)))
            yield change / (4.0 * noise), f'{name} of {before.test}'


def main() -> int:
    args = arguments(__doc__, {'rounds': 1}, only=(), rounds=4)
    records = (raw_record('static'), raw_record('dynamic'))
    sound, rows, unknown = tried(records), [], 0
    for name, fault in FAULTS.items():
        if args.only and not any(word in name for word in args.only):
            continue
        trials: dict[float, Tried] = {}
        for severity in (fault.obvious / FALL**number for number in range(args.rounds)):
            trials[severity] = faulty(records, sound, fault, severity)
            if trials[severity].move < 1.0:
                break
        silent = [severity for severity, trial in trials.items() if trial.is_silent]
        worst, first = trials.get(min(silent, default=0.0)), trials[fault.obvious]
        rows.append((
            name, fault.unit, min(trials), fault.obvious, min(silent, default='none'),
            f'{worst.figure}, {worst.move:.1f}' if worst else '',
            fault.no_data if worst else (first.refused or '; '.join(first.said[:1]))[:110]))
        unknown += bool(silent) and not fault.no_data
        print(*rows[-1], sep=' | ', flush=True)
    table('Faults by severity', ('fault', 'unit', 'least tried', 'most tried', 'smallest silent',
                                 'figure, over its interval', 'why, or what is reported'), rows)
    print(f'\n{unknown} faults are silent although data could show them')
    return 1 if unknown else 0


if __name__ == '__main__':
    sys.exit(main())
