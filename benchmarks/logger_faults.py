"""Faults of data acquisition and loggers on sound records: what they move, and what is reported.

python benchmarks/logger_faults.py [--only NAME ...] [--rounds N] [--json FILE]

A virtual rig records a static test and a ramp at 50 degrees. Each fault is put into both records
with a severity that falls by a factor of three from an obvious one. A severity is silent if
delta_x, delta_y, gamma, K or D move by more than their stated 95 % interval and neither `info` nor
`identify` has a line that the sound records do not have.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
import json
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rigs import as_read

from saddlering_ros.doubts.finding import lines
from saddlering_ros.doubts.on_rig import findings_on_rig
from saddlering_ros.doubts.reading import run_of_record
from saddlering_ros.errors import SaddleringError
from saddlering_ros.identification import Identification, identify
from saddlering_ros.record import (
    displacement_of_run,
    LOAD_TOPIC,
    PROBE_TOPICS,
    RawRecord,
    RawTopic,
)
from saddlering_ros.record.metadata import TestMetadata
from saddlering_ros.record.record import Record
from saddlering_ros.record.stamps import put_in_order
from saddlering_ros.rig import default_rig, PARAMETER_NAMES, Rig, TONNE, TRUE_TO_SCALE
from saddlering_ros.virtual_rig import (
    dynamic_schedule,
    PhysicalRig,
    record_test,
    Scatter,
    static_schedule,
    TestPlan,
)

Floats = NDArray[np.float64]
Topics = dict[str, RawTopic]
ELEVATION = 50.0
FALL = 3.0
"""Factor between severities."""


def raw_record(test: str, seed: int = 1, rig: Rig | None = None) -> RawRecord:
    """A sound record of the virtual rig, of equal rollers, as the reader finds it."""
    rig = rig or default_rig()
    schedule = (static_schedule(rig, hold=2.0, step=rig.full_scale_load / 12.0)
                if test == 'static' else dynamic_schedule(rig))
    plan = TestPlan(
        PhysicalRig(rig, TRUE_TO_SCALE, math.radians(ELEVATION), (), Scatter(0.0, 0.0), 1),
        schedule, seed)
    return as_read(record_test(plan), rig.probes, TestMetadata(test, ELEVATION), f'{test}_50')


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


def _each(
    topics: Topics, names: tuple[str, ...], change: Callable[[RawTopic], RawTopic],
) -> Topics:
    return {name: change(topic) if name in names else topic for name, topic in topics.items()}


def _held(topic: RawTopic, rate: float) -> RawTopic:
    """Taken every 1/rate seconds, published at every stamp."""
    slot = np.floor((topic.stamps - topic.stamps[0]) * 1e-9 * rate)
    first = np.maximum.accumulate(np.where(np.diff(slot, prepend=-1.0) > 0,
                                           np.arange(slot.size), 0))
    return replace(topic, values=topic.values[first])


def _low_pass(topic: RawTopic, delay: float) -> RawTopic:
    """First-order filter with a time constant [s]."""
    from scipy.signal import lfilter

    step = float(np.median(np.diff(topic.stamps))) * 1e-9
    keep = math.exp(-step / delay)
    start = topic.values[0]
    moved = lfilter([1.0 - keep], [1.0, -keep], topic.values - start) + start
    return replace(topic, values=np.asarray(moved))


def _stamped(topic: RawTopic, seconds: Callable[[Floats], Floats]) -> RawTopic:
    time = (topic.stamps - topic.stamps[0]) * 1e-9
    return replace(topic, stamps=topic.stamps + np.rint(1e9 * seconds(time)).astype(np.int64))


def _at(topic: RawTopic, share: float, count: int, change: Callable[[Floats], Floats]) -> RawTopic:
    """A change of `count` readings from a share of the record on."""
    values, first = topic.values.copy(), int(share * topic.values.size)
    values[first:first + count] = change(values[first:first + count])
    return replace(topic, values=values)


def _spiked(topic: RawTopic, size: float, share: float, seed: int = 3) -> RawTopic:
    random = np.random.default_rng(seed)
    struck = random.random(topic.values.size) < share
    signs = random.choice([-1.0, 1.0], topic.values.size)
    return replace(topic, values=topic.values + np.where(struck, size * signs, 0.0))


def _rounded(topic: RawTopic, step: float) -> RawTopic:
    return replace(topic, values=step * np.rint(topic.values / step))


def _clipped(topic: RawTopic, share: float) -> RawTopic:
    """Cut off where `share` of its travel is left out."""
    low, high = float(topic.values.min()), float(topic.values.max())
    start = float(topic.values[:50].mean())
    if high - start > start - low:
        return replace(topic, values=np.minimum(topic.values, high - share * (high - start)))
    return replace(topic, values=np.maximum(topic.values, low + share * (start - low)))


def _stalled(topic: RawTopic, seconds: float) -> RawTopic:
    period = float(np.median(np.diff(topic.stamps))) * 1e-9
    count = max(1, round(seconds / period))
    return _at(topic, 0.3, count, lambda part: np.full_like(part, part[0]))


def _dropped(topic: RawTopic, share: float) -> RawTopic:
    kept = np.random.default_rng(5).random(topic.values.size) >= share
    return replace(topic, stamps=topic.stamps[kept], values=topic.values[kept])


def _cross_talk(topics: Topics, share: float, source: int = 1, target: int = 0) -> Topics:
    first, other = topics[PROBE_TOPICS[target]], topics[PROBE_TOPICS[source]]
    seen = np.interp(first.stamps, other.stamps, other.values)
    return {**topics, PROBE_TOPICS[target]: replace(first, values=first.values + share * (
        seen - seen[0]))}


def _cross_talk_of_load(topics: Topics, metres: float) -> Topics:
    """The load's signal in probe 2: so many metres at full scale."""
    probe, load = topics[PROBE_TOPICS[1]], topics[LOAD_TOPIC]
    seen = np.interp(probe.stamps, load.stamps, load.values) / default_rig().full_scale_load
    return {**topics, PROBE_TOPICS[1]: replace(probe, values=probe.values + metres * seen)}


def _aliased(topic: RawTopic, size: float, frequency: float) -> RawTopic:
    """A vibration above half the sampling rate, as samples without a filter show it."""
    time = (topic.stamps - topic.stamps[0]) * 1e-9
    return replace(topic, values=topic.values + size * np.sin(2.0 * math.pi * frequency * time))


def _out(topic: RawTopic, seconds: float) -> RawTopic:
    """A contact that opens: the reading falls to zero."""
    period = float(np.median(np.diff(topic.stamps))) * 1e-9
    return _at(topic, 0.45, max(1, round(seconds / period)), np.zeros_like)


def _swapped(topics: Topics, first: int, second: int, share: float) -> Topics:
    """The cables of two probes change places for the last `share` of the record."""
    one, other = topics[PROBE_TOPICS[first]], topics[PROBE_TOPICS[second]]
    count = min(len(one), len(other))
    start = round((1.0 - share) * count)
    values, others = one.values.copy(), other.values.copy()
    values[start:count], others[start:count] = other.values[start:count], one.values[start:count]
    return {**topics, one.topic: replace(one, values=values),
            other.topic: replace(other, values=others)}


def _set(topic: RawTopic, seconds: float) -> RawTopic:
    """A clock that is set by so many seconds at 40 % of the record."""
    start = round(0.4 * len(topic))
    late = np.where(np.arange(len(topic)) >= start, round(1e9 * seconds), 0)
    return replace(topic, stamps=topic.stamps + late)


def _rolled_over(topic: RawTopic, share: float, turn: float = 2.0) -> RawTopic:
    """A counter too narrow for the last `share` of the travel.

    It wraps by `turn` times the travel: a signed one to the other end, an unsigned one to the
    start.
    """
    start = float(topic.values[:50].mean())
    away = topic.values - start
    far = float(np.abs(away).max())
    wrapped = np.abs(away) > (1.0 - share) * far
    return replace(topic, values=np.where(wrapped, topic.values - turn * np.sign(away) * far,
                                          topic.values))


def _gains(topics: Topics, share: float) -> Topics:
    return _each(topics, PROBE_TOPICS, lambda one: replace(
        one, values=one.values[:50].mean() + (1.0 + share) * (
            one.values - one.values[:50].mean())))


LOAD, PROBES = (LOAD_TOPIC,), PROBE_TOPICS
ONE_PROBE = (PROBE_TOPICS[1],)
ALL = (LOAD_TOPIC, *PROBE_TOPICS)
SAME_AXIS = ('an axial probe that reads more or less is a ring of another tilting stiffness: only '
             'a calibration of the probes shows it')
SAME_CLOCK = ('an offset of one ramp is a damping: the readings are those of another ring; ramps '
              'of two speeds show it to diagnose')

FAULTS: dict[str, Fault] = {
    'load held (ms)': Fault(
        lambda t, s: _each(t, LOAD, lambda one: _held(one, 1e3 / s)), 60.0, 'ms'),
    'probes held (ms)': Fault(
        lambda t, s: _each(t, PROBES, lambda one: _held(one, 1e3 / s)), 60.0, 'ms'),
    'load low-passed (ms)': Fault(
        lambda t, s: _each(t, LOAD, lambda one: _low_pass(one, 1e-3 * s)), 24.0, 'ms'),
    'probes low-passed (ms)': Fault(
        lambda t, s: _each(t, PROBES, lambda one: _low_pass(one, 1e-3 * s)), 24.0, 'ms'),
    'clock drift': Fault(
        lambda t, s: _each(t, PROBES, lambda one: _stamped(one, lambda time: 1e-2 * s * time)),
        0.3, '%'),
    'clocks apart': Fault(
        lambda t, s: _each(t, PROBES, lambda one: _stamped(
            one, lambda time: np.full_like(time, 1e-3 * s))), 30.0, 'ms', SAME_CLOCK),
    'gains of all probes': Fault(
        lambda t, s: _gains(t, 1e-2 * s), 10.0, '%',
        'all displacements in proportion are a softer ring: only a calibration shows it'),
    'one load spike': Fault(
        lambda t, s: _each(t, LOAD, lambda one: _at(one, 0.4, 1, lambda v: v + s * TONNE)),
        50.0, 't'),
    'probe spikes in 1 %': Fault(
        lambda t, s: _each(t, PROBES, lambda one: _spiked(one, 1e-6 * s, 0.01)), 200.0, 'um'),
    'one probe cut off': Fault(
        lambda t, s: _each(t, ONE_PROBE, lambda one: _clipped(one, 1e-2 * s)), 15.0, '%'),
    'one probe stalled': Fault(
        lambda t, s: _each(t, ONE_PROBE, lambda one: _stalled(one, 1e-3 * s)), 600.0, 'ms'),
    'load stalled': Fault(
        lambda t, s: _each(t, LOAD, lambda one: _stalled(one, 1e-3 * s)), 600.0, 'ms'),
    'resolution of the probes': Fault(
        lambda t, s: _each(t, PROBES, lambda one: _rounded(one, 1e-6 * s)), 5.0, 'um'),
    'resolution of the load': Fault(
        lambda t, s: _each(t, LOAD, lambda one: _rounded(one, s * TONNE)), 1.0, 't'),
    'lost readings of the probes': Fault(
        lambda t, s: _each(t, PROBES, lambda one: _dropped(one, 1e-2 * s)), 30.0, '%'),
    'cross-talk 2 to 1': Fault(lambda t, s: _cross_talk(t, 1e-2 * s), 10.0, '%'),
    'cross-talk 4 to 2': Fault(
        lambda t, s: _cross_talk(t, 1e-2 * s, 3, 1), 10.0, '%', SAME_AXIS),
    'cross-talk of the load to 2': Fault(
        lambda t, s: _cross_talk_of_load(t, 1e-6 * s), 10.0, 'um', SAME_AXIS),
    'aliased vibration of the probes': Fault(
        lambda t, s: _each(t, PROBES, lambda one: _aliased(one, 1e-6 * s, 1.7)), 20.0, 'um'),
    'aliased ripple of the load': Fault(
        lambda t, s: _each(t, LOAD, lambda one: _aliased(one, s * TONNE, 1.7)), 1.0, 't'),
    'dropout of one probe': Fault(
        lambda t, s: _each(t, ONE_PROBE, lambda one: _out(one, 1e-3 * s)), 300.0, 'ms'),
    'dropout of the load': Fault(
        lambda t, s: _each(t, LOAD, lambda one: _out(one, 1e-3 * s)), 300.0, 'ms'),
    **{f'swapped cables {a + 1} and {b + 1}': Fault(
        lambda t, s, a=a, b=b: _swapped(t, a, b, 1e-2 * s), 100.0, '% of the record')
        for a in range(4) for b in range(a + 1, 4)},
    'daylight saving, forward': Fault(
        lambda t, s: _each(t, ALL, lambda one: _set(one, s)), 3600.0, 's'),
    'daylight saving, back': Fault(
        lambda t, s: _each(t, ALL, lambda one: _set(one, -s)), 3600.0, 's'),
    'daylight saving of the load alone': Fault(
        lambda t, s: _each(t, LOAD, lambda one: _stamped(
            one, lambda time: np.full_like(time, s))), 3600.0, 's'),
    'leap second, stamps repeat': Fault(
        lambda t, s: _each(t, ALL, lambda one: _set(one, -s)), 1.0, 's'),
    'leap second of the probes alone': Fault(
        lambda t, s: _each(t, PROBES, lambda one: _set(one, s)), 1.0, 's', SAME_CLOCK),
    '32-bit rollover of stamps in ns': Fault(
        lambda t, s: _each(t, ALL, lambda one: _set(one, -s)), 2.0**32 * 1e-9, 's'),
    '32-bit rollover of one probe': Fault(
        lambda t, s: _each(t, ONE_PROBE, lambda one: _rolled_over(one, 1e-2 * s)), 30.0,
        '% of its travel'),
    '32-bit rollover of the load': Fault(
        lambda t, s: _each(t, LOAD, lambda one: _rolled_over(one, 1e-2 * s)), 30.0,
        '% of its travel'),
    'unsigned rollover of one probe': Fault(
        lambda t, s: _each(t, ONE_PROBE, lambda one: _rolled_over(one, 1e-2 * s, 1.0)), 30.0,
        '% of its travel'),
    'unsigned rollover of the load': Fault(
        lambda t, s: _each(t, LOAD, lambda one: _rolled_over(one, 1e-2 * s, 1.0)), 30.0,
        '% of its travel'),
}


# -- measuring -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Outcome:
    """What one severity did: largest move over its interval, of which figure, new lines."""

    severity: float
    move: float
    figure: str
    lines: tuple[str, ...]
    refused: str = ''

    @property
    def is_silent(self) -> bool:
        return self.move > 1.0 and not self.lines and not self.refused


@dataclass(frozen=True)
class Sound:
    """The sound runs and what is found from them."""

    records: tuple[RawRecord, ...]
    runs: tuple[Record, ...]
    found: Identification


def runs_of(records: tuple[RawRecord, ...]) -> tuple[Record, ...]:
    rig = default_rig()
    runs = tuple(run_of_record(record, record.facts, rig) for record in records)
    for run, record in zip(runs, records, strict=True):
        run.notes.extend(lines(findings_on_rig(rig, run, record)))
    return runs


def sound() -> Sound:
    records = (raw_record('static'), raw_record('dynamic'))
    runs = runs_of(records)
    return Sound(records, runs, identify(runs, default_rig()))


def severities(fault: Fault, rounds: int, first: int = 0) -> Iterator[float]:
    for number in range(first, rounds):
        yield fault.obvious / FALL**number


def outcome(known: Sound, fault: Fault, severity: float) -> Outcome:
    """Put a fault into the sound records and look at all figures again."""
    try:
        records = tuple(replace(one, topics={
            name: as_stored(topic) for name, topic in fault.act(one.topics, severity).items()})
            for one in known.records)
        runs = runs_of(records)
        found = identify(runs, default_rig())
    except SaddleringError as refusal:
        return Outcome(severity, math.inf, '', (), str(refusal))
    before = {*known.found.notes, *(note for run in known.runs for note in run.notes)}
    lines = [note for run in runs for note in run.notes]
    lines += [note for note in found.notes if 'iterations' not in note]
    if found.status != known.found.status:
        lines.append(found.status)
    move, figure = max([*_parameter_moves(known.found, found), *_channel_moves(known.runs, runs)])
    return Outcome(severity, move, figure,
                   tuple(line for line in dict.fromkeys(lines) if line not in before))


def as_stored(topic: RawTopic) -> RawTopic:
    """The topic as the reader has it, from messages that were stored as they came."""
    arrival = topic.stamps[0] + np.arange(len(topic)) * int(np.median(np.diff(topic.stamps)))
    order = put_in_order(topic.topic, topic.stamps, lambda: arrival, topic.values)
    notes: tuple[str, ...] = ()
    if order.reordered or order.duplicates:
        notes = (f'{topic.topic}: {order.reordered} messages put in order, {order.duplicates} '
                 'left out',)
    return replace(topic, stamps=topic.stamps[order.keep], values=topic.values[order.keep],
                   notes=notes)


def _parameter_moves(old: Identification, new: Identification) -> Iterator[tuple[float, str]]:
    for index, name in enumerate(PARAMETER_NAMES):
        if not (old.determined[name] and new.determined[name]):
            continue
        first, last = (getattr(one.parameters.contact, name) for one in (old, new))
        yield abs(last - first) / (1.96 * float(new.std[index])), name


def _channel_moves(
    old: tuple[Record, ...], new: tuple[Record, ...]
) -> Iterator[tuple[float, str]]:
    """Largest rms change of a channel over twice the noise of a reading."""
    rig = default_rig()
    for before, after in zip(old, new, strict=True):
        if before.time.size != after.time.size:
            continue
        motions = [displacement_of_run(rig, run).displacement for run in (before, after)]
        for name in ('delta_x', 'delta_y', 'gamma'):
            first, last = (np.asarray(getattr(one, name)) for one in motions)
            noise = float(np.sqrt(np.nanmean(np.diff(first[:50], 2) ** 2) / 6.0))
            change = float(np.sqrt(np.nanmean((last - first) ** 2)))
            yield change / (4.0 * noise), f'{name} of {before.test}'


def table(results: dict[str, list[Outcome]]) -> str:
    """The table of the docs: for each fault the smallest silent severity."""
    rows = ['| fault | unit | severities tried | smallest silent one | figure, over its interval '
            '| reported at the largest |', '|---|---|---|---|---|---|']
    for name, outcomes in results.items():
        fault = FAULTS[name]
        silent = [one for one in outcomes if one.is_silent]
        worst = min(silent, key=lambda one: one.severity, default=None)
        tried = f'{outcomes[-1].severity:.3g} to {outcomes[0].severity:.3g}'
        said = outcomes[0].refused or '; '.join(outcomes[0].lines[:1])
        cell = 'none' if worst is None else f'{worst.severity:.3g}'
        what = '' if worst is None else f'{worst.figure}, {worst.move:.1f}'
        rows.append(f'| {name} | {fault.unit} | {tried} | {cell} | {what} | {said[:110]} |')
    return '\n'.join(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--only', nargs='*')
    parser.add_argument('--rounds', type=int, default=4)
    parser.add_argument('--first', type=int, default=0, help='leave out so many severities')
    parser.add_argument('--json', type=Path)
    args = parser.parse_args()
    known = sound()
    results: dict[str, list[Outcome]] = {}
    for name, fault in FAULTS.items():
        if args.only and not any(word in name for word in args.only):
            continue
        results[name] = []
        for severity in severities(fault, args.rounds, args.first):
            found = outcome(known, fault, severity)
            results[name].append(found)
            print(f'{name}: {severity:.3g} {fault.unit}: {found.figure} {found.move:.2f}'
                  f'{" SILENT" if found.is_silent else ""} {found.refused or found.lines[:2]}',
                  flush=True)
            if found.move < 1.0:
                break
        if args.json:
            args.json.write_text(json.dumps(
                {key: [vars(one) for one in value] for key, value in results.items()}, indent=1))
    print(table(results))


if __name__ == '__main__':
    main()
