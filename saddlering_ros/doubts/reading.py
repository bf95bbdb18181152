"""From the topics of a test as recorded to its record: guarded, aligned and judged.

The guard and the aligner are those of the live nodes, to which a whole bag is one batch.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.doubts import readings
from saddlering_ros.doubts.finding import Finding, Kind, lines
from saddlering_ros.doubts.readings import MIN_SAMPLES
from saddlering_ros.errors import BagError
from saddlering_ros.record import scratch
from saddlering_ros.record.aligner import aligned_record
from saddlering_ros.record.batches import align, Bits, GAP_HISTORY, gap_mask, seconds_array
from saddlering_ros.record.displacement import a_pair_reads
from saddlering_ros.record.guard import (
    GuardCounters,
    load_limits,
    probe_limits,
    ReadingLimits,
    SampleGuard,
    sound_samples,
)
from saddlering_ros.record.metadata import TestMetadata
from saddlering_ros.record.quality import topic_quality, TopicQuality
from saddlering_ros.record.record import RawRecord, RawTopic, Record
from saddlering_ros.record.topics import LOAD_TOPIC, PROBE_TOPICS, RIG_TOPICS
from saddlering_ros.rig import load_rig, mirrored_gap, Rig

MAX_REFUSED_SHARE = 0.05
"""Largest share of refused samples. With more of them the unit, the sensor or the rig file is
wrong."""

REFUSED = Kind(
    'refused',
    '{count} samples are refused, as live nodes refuse them ({words}): validity marks what is '
    'interpolated across them, and identification and diagnosis leave it out')
DOUBTFUL_LOAD = Kind(
    'doubtful_load',
    '{count} samples lie behind a step that the hydraulics cannot make in its time '
    '(rig.full_scale_time), as when a counter rolls over: validity marks what is simulated by '
    'them, and identification and diagnosis leave it out')
PROBE_ABSENT = Kind(
    'probe_absent',
    'probe {absent} is absent (rig.probes.absent): delta_x is of probe {partner} alone, with the '
    'ring taken as rigid; the parity is unknown, and causes that show in it cannot be told from '
    'others')

MAX_GAP_SHARE = 0.5
"""Share of a probe's record in gaps above which its stamps come by blocks."""


def run_of_record(record: RawRecord, facts: TestMetadata, rig: Rig | None = None) -> Record:
    """Check the readings and put the probes on the load's stamps."""
    where = str(record.path)
    absent = absent_topic(rig)
    topics, guards = zip(*(guarded_topic(record, name, rig or load_rig())
                           for name in RIG_TOPICS), strict=True)
    load, *probes = topics
    for raw in probes:
        readings.check_overlap(where, load.stamps, raw.topic, raw.stamps)
    gaps, used, published = aligned_record(load.samples, [raw.samples for raw in probes])
    for rows in scratch.blocks(len(load), gaps, used, published):
        is_paired = a_pair_reads(gaps[:, rows])
        used[rows] &= is_paired
        published[rows] &= is_paired
    notes = [*record.notes, *lines(absence_findings(rig)), *load.notes,
             *lines(readings.load_findings(load.stamps))]
    for raw, aligned in zip(probes, gaps, strict=True):
        if raw.topic == absent:
            continue  # Its partner has the same faults, and a note on each.
        notes += raw.notes
        notes += lines(readings.probe_findings(raw.topic, raw.stamps, raw.values, raw.min_range,
                                               raw.max_range, gap_mask(raw.stamps), aligned))
    for raw, guard in zip(topics, guards, strict=True):
        if raw.topic != absent:
            notes += lines(refusal_findings(raw.topic, guard.counters))
    possible = possible_record(record, rig or load_rig())
    found = record_quality(possible)
    notes += lines(record_quality_findings(possible, found, absent))
    if int(np.count_nonzero(used)) < MIN_SAMPLES:
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
        details=facts.details, used=used, published=published,
        probe_marks=marks_of(guards[1:], load.stamps),
        load_marks=marks_of(guards[:1], load.stamps, to_next=True),
        absent=0 if rig is None else rig.probes.absent)


def guarded_topic(record: RawRecord, name: str, rig: Rig) -> tuple[RawTopic, SampleGuard]:
    """A topic without the readings that the live nodes refuse, and the guard that refused them.

    BagError for readings of another unit, and if too many cannot be those of this rig.
    """
    raw, limits = record[name], limits_of(name, rig)
    where = f'{record.path}: {raw.topic}'
    readings.check_values(where, raw.stamps, raw.values)
    sound, guard = sound_samples(limits, raw.samples)
    refused = len(raw) - len(sound)
    wrong = refused + guard.counters.doubtful_load
    many = wrong > MAX_REFUSED_SHARE * len(raw)
    judged = raw.values if many or not refused else sound.values
    if name == LOAD_TOPIC:
        readings.check_load_unit(where, judged, rig.limits)
    else:
        readings.check_probe_unit(where, judged, raw.min_range, raw.max_range)
    if many:
        unit = '' if name == LOAD_TOPIC else readings.unit_outside(
            raw.values, raw.min_range, raw.max_range)
        raise BagError(
            f'{where}: {wrong} of {len(raw)} readings cannot be those of this rig (from '
            f'{limits.low:.4g} to {limits.high:.4g}, or change faster than rig.full_scale_time '
            f'allows){unit}: correct the rig file, or see to the sensor')
    return replace(raw, stamps=sound.stamps, values=sound.values), guard


def limits_of(name: str, rig: Rig) -> ReadingLimits:
    """Limits of the readings of a topic of the rig."""
    return load_limits(rig) if name == LOAD_TOPIC else probe_limits(rig)


def refusal_findings(topic: str, counters: GuardCounters) -> list[Finding]:
    """The refused and the doubtful samples of a topic."""
    findings, counts = [], counters.refused
    if counts:
        words = ', '.join(f'{count} {name.replace("_", " ")}' for name, count in counts.items())
        findings.append(REFUSED.at(topic, count=sum(counts.values()), words=words))
    if counters.doubtful_load:
        findings.append(DOUBTFUL_LOAD.at(topic, count=counters.doubtful_load))
    return findings


def marks_of(
    guards: Sequence[SampleGuard], stamps: NDArray[np.int64], *, to_next: bool = False,
) -> Bits | None:
    """Bits of validity that what the guards refused leaves at `stamps` (N,); None: nothing."""
    if not any(guard.bridges or guard.doubtful for guard in guards):
        return None
    marks: Bits = scratch.scratch_array(stamps.shape, np.uint8)
    marks[:] = 0
    for guard in guards:
        marks |= guard.marks(stamps, to_next=to_next)
    return marks


def possible_record(record: RawRecord, rig: Rig) -> RawRecord:
    """The same record without readings beyond the limits; single leaps stay, as spikes."""
    topics = dict(record.topics)
    for name in (LOAD_TOPIC, *PROBE_TOPICS):
        limits, raw = limits_of(name, rig), topics[name]
        lowest, highest = scratch.extremes(raw.values)
        if not limits.low <= lowest <= highest <= limits.high:
            is_possible = (raw.values >= limits.low) & (raw.values <= limits.high)
            topics[name] = replace(raw, stamps=scratch.scratch_copy(raw.stamps[is_possible]),
                                   values=scratch.scratch_copy(raw.values[is_possible]))
    return replace(record, topics=topics)


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


def record_quality_findings(
    record: RawRecord, found: dict[str, TopicQuality], absent: str = '',
) -> list[Finding]:
    """What of it is doubtful; nothing on the topic of the absent probe."""
    findings = []
    for name, quality in found.items():
        if name == absent:
            continue
        findings += readings.quality_findings(name, quality, 'N' if name == LOAD_TOPIC else 'm')
    load = record[LOAD_TOPIC]
    seconds = float(load.stamps[-1] - load.stamps[0]) * 1e-9
    return findings + readings.clock_findings(
        found[LOAD_TOPIC], [found[name] for name in PROBE_TOPICS], seconds)


def _spikes(
    load: RawTopic, record: RawRecord, found: dict[str, TopicQuality],
) -> NDArray[np.bool_] | None:
    """Mask (5, N) of the load's samples that a spike of the load or of a probe reaches."""
    if not any(one.spikes.size for one in found.values()):
        return None
    spikes = scratch.scratch_mask(len(RIG_TOPICS), len(load))
    for name, reached in zip(RIG_TOPICS, spikes, strict=True):
        # Mark the load's samples (N,) that are aligned with a spike among a topic's readings.
        for spike in found[name].spikes.tolist():
            about = slice(max(spike - GAP_HISTORY - 2, 0), spike + 3)
            stamps = record[name].stamps[about]
            struck = np.zeros(len(stamps))
            struck[spike - about.start] = 1.0
            first, last = np.searchsorted(load.stamps, [stamps[0], stamps[-1]]).tolist()
            near = slice(first, last + 1)
            reached[near] |= np.nan_to_num(align(load.stamps[near], stamps, struck)) > 0.0
    return spikes


def absent_topic(rig: Rig | None) -> str:
    """Topic of the probe that is absent from the rig; '' if none is."""
    return PROBE_TOPICS[rig.probes.absent - 1] if rig is not None and rig.probes.absent else ''


def mirrored_topic(rig: Rig, topics: Mapping[str, RawTopic]) -> RawTopic:
    """The topic that the absent radial probe would have at a rigid ring."""
    other = topics[PROBE_TOPICS[rig.probes.partner - 1]]
    return replace(other, topic=absent_topic(rig), notes=(),
                   values=scratch.scratch_copy(mirrored_gap(rig.probes, other.values)))


def absence_findings(rig: Rig | None) -> list[Finding]:
    """A finding on the absent probe."""
    if not absent_topic(rig):
        return []
    assert rig is not None
    return [PROBE_ABSENT.at(absent=rig.probes.absent, partner=rig.probes.partner)]
