"""From a bag to the arrays of a test, with every input that cannot be used named in one line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.bags.directory import open_directory
from saddlering_ros.bags.exchanges import exchange_notes
from saddlering_ros.bags.rig_notes import line_notes, parity_notes, rig_notes
from saddlering_ros.bags.scan import OnShare, Scan, scan, ScannedTopic
from saddlering_ros.bags.wiring import wiring_notes
from saddlering_ros.record.alignment import align, GAP_HISTORY, gap_mask, seconds_array
from saddlering_ros.record.checks import (
    check_overlap,
    MIN_SAMPLES,
    notes_on_load,
    notes_on_probe,
)
from saddlering_ros.record.errors import BagError
from saddlering_ros.record.guarded import guarded_topics, node_rows, possible_record
from saddlering_ros.record.metadata import TestMetadata
from saddlering_ros.record.quality import (
    notes_between,
    quality_notes,
    topic_quality,
    TopicQuality,
)
from saddlering_ros.record.record import RawRecord, RawTopic, Record
from saddlering_ros.record.scratch import (
    count_where,
    scratch_array,
    scratch_copy,
    scratch_mask,
)
from saddlering_ros.record.stamps import put_in_order
from saddlering_ros.record.topics import (
    ELEVATION,
    LOAD_TOPIC,
    PROBE_TOPICS,
    RIG_TOPICS,
    TOPICS,
)
from saddlering_ros.rig import default_rig, mirrored_gap, OPPOSITE, Rig

RADIAL_TOPICS = tuple(PROBE_TOPICS[number - 1] for number in OPPOSITE)
"""Topics of probes that a rig may lack."""

MAX_GAP_SHARE = 0.5
"""Share of a probe's record in gaps above which its stamps come by blocks."""

ELEVATION_TOLERANCE_DEG = 0.5
"""Difference [degrees] between inclinometer and stated elevation that is a contradiction."""


def read_raw(
    path: Path | str, topics: Sequence[str] | None = None,
    on_progress: OnShare = lambda share: None, rig: Rig | None = None,
) -> RawRecord:
    """The rig topics of the bag at `path` as recorded.

    These are all topics of the rig unless `topics` names some. A missing optional topic is
    left out; an unreadable one too, with a note. The probe that is absent from the `rig` (None:
    it has all) is not read; the opposite probe stands for it.

    Readings are not judged (NaN stays NaN). Stamps are judged (BagError if they go back).
    """
    wanted = tuple(TOPICS if topics is None else topics)
    unknown = set(wanted) - set(TOPICS)
    if unknown:
        raise BagError(
            f'{path}: {min(unknown)} is not a topic of the rig: give some of {", ".join(TOPICS)}')
    found = scan(path, wanted, on_progress)
    if found.damage is not None:
        assert found.fault is not None
        raise found.fault
    return raw_record(found, wanted, rig)


def raw_record(found: Scan, wanted: Sequence[str], rig: Rig | None = None) -> RawRecord:
    """The `wanted` topics of a scanned bag; BagError if a required one cannot be used."""
    absent = absent_topic(rig)
    topics = {name: raw_topic(found, name)
              for name in wanted if TOPICS[name].required and name != absent}
    if rig is not None and absent in wanted:
        topics[absent] = mirrored_topic(rig, topics)
    notes = list(found.notes)
    for name in wanted:
        if TOPICS[name].required or name not in found.topics:
            continue
        try:
            topics[name] = raw_topic(found, name)
        except BagError as fault:
            notes.append(f'left out: {fault}')
    return RawRecord(found.path, topics, found.facts, tuple(notes))


def absent_topic(rig: Rig | None) -> str:
    """Topic of the probe that is absent from the rig; '' if none is."""
    return PROBE_TOPICS[rig.probes.absent - 1] if rig is not None and rig.probes.absent else ''


def mirrored_topic(rig: Rig, topics: Mapping[str, RawTopic]) -> RawTopic:
    """The topic that the absent radial probe would have at a rigid ring."""
    other = topics[PROBE_TOPICS[rig.probes.partner - 1]]
    return replace(other, topic=absent_topic(rig), notes=(),
                   values=scratch_copy(mirrored_gap(rig.probes, other.values)))


def absence_notes(rig: Rig | None) -> list[str]:
    """A line on the absent probe."""
    if not absent_topic(rig):
        return []
    assert rig is not None
    absent, partner = rig.probes.absent, rig.probes.partner
    return [f'probe {absent} is absent (rig.probes.absent): delta_x is of probe {partner} alone, '
            'with the ring taken as rigid; the parity is unknown, and causes that show in it '
            'cannot be told from others']


def read_run(
    path: Path | str, *, test: str | None = None, elevation: float | None = None,
    rig: Rig | None = None, on_progress: OnShare = lambda share: None,
) -> Record:
    """The test in the bag at `path`, aligned on the load's stamps.

    `test` and `elevation` [rad], if given, replace the statements of the bag. BagError, one
    line, for any fault that makes the bag unusable. With a `rig`, the notes also name probes
    that look swapped, stuck, dead or of the wrong polarity on it. `on_progress` receives the
    share of the bag's bytes that was read.
    """
    record = read_raw(path, on_progress=on_progress, rig=rig)
    facts = usable_facts(record.path, record.facts, test, elevation)
    if elevation is None:
        check_measured_elevation(record, facts)
    run = replace(run_of_record(record, facts, rig), sha256=open_directory(path).sha256())
    run = run if elevation is None else replace(run, elevation=float(elevation))
    if rig is not None:
        run.notes.extend(notes_on_rig(rig, run, record))
    return run


def notes_on_rig(rig: Rig, run: Record, record: RawRecord) -> list[str]:
    """Probable faults of a run on this rig: wiring, zero, kind, units."""
    spans = [(record[name].min_range, record[name].max_range) for name in PROBE_TOPICS]
    wiring = wiring_notes(rig, run.elevation, run.load, run.gaps)
    parity = [] if wiring or rig.probes.absent else [*parity_notes(rig, run.load, run.gaps),
                                *line_notes(rig, float(run.time[-1]), run.load, run.gaps)]
    return [*wiring, *parity, *exchange_notes(rig, run.time, run.load, run.gaps),
            *rig_notes(rig, run.test, run.time, run.load, spans)]


def usable_facts(
    path: Path, found: TestMetadata, test: str | None, elevation: float | None,
) -> TestMetadata:
    """Metadata of the bag and of the options together; BagError if they are not enough."""
    facts = found.overruled(test, None if elevation is None else math.degrees(elevation))
    if facts.problems:
        raise BagError(f'{path}: {facts.problems[0]}')
    return facts


def check_measured_elevation(record: RawRecord, facts: TestMetadata) -> None:
    """Raise BagError if the bag's inclinometer contradicts the elevation that it states."""
    if ELEVATION.name not in record.topics or facts.elevation_deg is None:
        return
    measured = math.degrees(float(np.median(record[ELEVATION.name].values)))
    if not abs(measured - facts.elevation_deg) <= ELEVATION_TOLERANCE_DEG:
        raise BagError(
            f'{record.path}: elevation_deg is {facts.elevation_deg:g} and {ELEVATION.name} '
            f'measured {measured:.2f} deg: give elevation_deg=DEG')


def run_of_record(
    record: RawRecord, facts: TestMetadata, rig: Rig | None = None,
) -> Record:
    """Check the readings and put the probes on the load's stamps."""
    where = str(record.path)
    absent = absent_topic(rig)
    guarded = guarded_topics(record, rig or default_rig())
    load, *probes = (one.topic for one in guarded)
    for raw in probes:
        check_overlap(where, load.stamps, raw.topic, raw.stamps)
    gaps = scratch_array((len(probes), len(load)), np.float64)
    notes = [*record.notes, *absence_notes(rig), *load.notes, *notes_on_load(load.stamps)]
    for raw, aligned in zip(probes, gaps, strict=True):
        is_gap = gap_mask(raw.stamps)
        align(load.stamps, raw.stamps, raw.values, aligned=aligned, is_gap=is_gap)
        if raw.topic == absent:
            continue  # Its partner has the same faults, and a note on each.
        notes += raw.notes
        notes += notes_on_probe(
            raw.topic, raw.stamps, raw.values, raw.min_range, raw.max_range, is_gap, aligned)
    notes += [note for one in guarded if one.topic.topic != absent for note in one.notes()]
    possible = possible_record(record, rig or default_rig())
    found = record_quality(possible)
    notes += record_quality_notes(possible, found, absent)
    rows = node_rows(guarded, gaps)
    read = (count_where(lambda part: np.isfinite(part).all(axis=0), gaps) if rows is None
            else int(rows.given.sum()))
    if read < MIN_SAMPLES:
        raise BagError(
            f'{where}: fewer than {MIN_SAMPLES} load stamps have readings of all four probes: '
            + _why_apart(probes))
    assert facts.test is not None
    assert facts.elevation_deg is not None
    others = {name: align(load.stamps, record[name].stamps, record[name].values)
              for name in record if name not in RIG_TOPICS}
    name = Path(where).resolve().name.removesuffix('.zstd').removesuffix('.mcap')
    return Record(
        name=name, path=record.path, test=facts.test,
        elevation=math.radians(facts.elevation_deg), rig=facts.rig, run=facts.run,
        stamps=load.stamps, time=seconds_array(load.stamps, int(load.stamps[0])),
        load=load.values, gaps=gaps, notes=notes,
        spikes=_spikes(load, possible, found), quality=found, others=others,
        details=facts.details, node_rows=rows, absent=0 if rig is None else rig.probes.absent)


def _why_apart(probes: Sequence[RawTopic]) -> str:
    """The remedy for probes without a common reading, by the pattern of their stamps."""
    for raw in probes:
        intervals = np.diff(raw.stamps)
        in_gaps = int(intervals[gap_mask(raw.stamps)].sum())
        if in_gaps > MAX_GAP_SHARE * int(raw.stamps[-1] - raw.stamps[0]):
            period = float(np.median(intervals)) / 1e6
            return (f'the stamps of {raw.topic} come in blocks, {period:.3g} ms apart within a '
                    'block, with gaps between blocks: stamp each sample when it is taken and not '
                    'when its block arrives')
    return 'start and stop all recordings together'


def record_quality(record: RawRecord) -> dict[str, TopicQuality]:
    """Properties of the logger by the readings of the load and of each probe."""
    return {name: topic_quality(record[name].stamps, record[name].values)
            for name in (LOAD_TOPIC, *PROBE_TOPICS)}


def record_quality_notes(
    record: RawRecord, found: dict[str, TopicQuality], absent: str = '',
) -> list[str]:
    """The same in words, a line each; none on the topic of the absent probe."""
    notes = []
    for name, quality in found.items():
        if name == absent:
            continue
        notes += quality_notes(name, quality, 'N' if name == LOAD_TOPIC else 'm')
    load = record[LOAD_TOPIC]
    seconds = float(load.stamps[-1] - load.stamps[0]) * 1e-9
    return notes + notes_between(
        found[LOAD_TOPIC], [found[name] for name in PROBE_TOPICS], seconds)


def _spikes(
    load: RawTopic, record: RawRecord, found: dict[str, TopicQuality],
) -> NDArray[np.bool_] | None:
    """Mask (5, N) of the load's samples that a spike of the load or of a probe reaches."""
    if not any(one.spikes.size for one in found.values()):
        return None
    spikes = scratch_mask(len(RIG_TOPICS), len(load))
    for name, reached in zip(RIG_TOPICS, spikes, strict=True):
        _mark_reached(load.stamps, record[name], found[name].spikes, reached)
    return spikes


def _mark_reached(
    load_stamps: NDArray[np.int64], raw: RawTopic, spikes: NDArray[np.intp],
    reached: NDArray[np.bool_],
) -> None:
    """Mark the load's samples (N,) that are aligned with a spike among a topic's readings."""
    for spike in spikes.tolist():
        about = slice(max(spike - GAP_HISTORY - 2, 0), spike + 3)
        stamps = raw.stamps[about]
        struck = np.zeros(len(stamps))
        struck[spike - about.start] = 1.0
        first, last = np.searchsorted(load_stamps, [stamps[0], stamps[-1]]).tolist()
        near = slice(first, last + 1)
        reached[near] |= np.nan_to_num(align(load_stamps[near], stamps, struck)) > 0.0


def raw_topic(found: Scan, name: str) -> RawTopic:
    """One rig topic of a scanned bag in stamp order; BagError if it cannot be used."""
    where = f'{found.path}: {name}'
    topic = found.topics.get(name)
    fewest = MIN_SAMPLES if TOPICS[name].required else 1
    if found.fault is not None and (topic is None or topic.count < fewest):
        raise found.fault
    if not found.message_count:
        raise BagError(f'{found.path}: holds no messages: check that the rig ran and record again')
    if topic is None:
        have = ', '.join(sorted(found.topics)) or 'none'
        radial = (f', or state rig.probes.absent: {name[-1]} in the rig file if the rig does not '
                  'have this probe') if name in RADIAL_TOPICS else ''
        raise BagError(f'{found.path}: has no topic {name} (it has: {have}): record this topic '
                       f'too{radial}')
    if topic.fault:
        raise BagError(f'{where}: {topic.fault}')
    wrong = sorted(kind for kind in topic.types if kind != TOPICS[name].type)
    if not topic.count and wrong:
        raise BagError(f'{where}: its type is {wrong[0]} and should be {TOPICS[name].type}: '
                       'record the topic of the rig, or remap it')
    if topic.count < fewest:
        raise BagError(
            f'{where}: holds {topic.count} messages, too few for a test: check that its driver '
            'ran, and record again')
    stamps, values = topic.stamps, topic.values
    order = put_in_order(where, stamps, lambda: topic.log_times, values)
    if order.reordered or order.duplicates:
        stamps, values = scratch_copy(stamps[order.keep]), scratch_copy(values[order.keep])
    if len(stamps) < fewest:
        raise BagError(f'{where}: holds {len(stamps)} different stamps, too few for a test: '
                       'let the driver stamp each sample')
    notes = []
    if order.reordered:
        notes.append(f'{name}: {order.reordered} messages were stored late and are sorted')
    if order.duplicates:
        notes.append(f'{name}: {order.duplicates} messages repeat the stamp of another and are '
                     'left out')
    low, high = _span(topic, notes)
    if not found.cuts and found.damage is None:  # These numbers count the readable part.
        topic.release()
    return RawTopic(
        topic=name, type=TOPICS[name].type, frame_id=topic.frame_id, stamps=stamps, values=values,
        min_range=low, max_range=high, notes=tuple(notes))


def _span(topic: ScannedTopic, notes: list[str]) -> tuple[float, float]:
    spans = topic.spans
    if spans.shape[1] == 0 or not len(spans):
        return math.nan, math.nan
    if (spans != spans[0]).any() and np.isfinite(spans).all():
        notes.append(f'{topic.topic}: min_range or max_range changes during the record')
    return float(spans[0, 0]), float(spans[0, 1])
