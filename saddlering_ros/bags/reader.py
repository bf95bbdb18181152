"""From a bag to the arrays of a test, with every input that cannot be used named in one line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
import math
from pathlib import Path

import numpy as np

from saddlering_ros.bags.folder import open_directory
from saddlering_ros.bags.scan import OnShare, Scan, scan, ScannedTopic
from saddlering_ros.doubts.finding import lines
from saddlering_ros.doubts.on_rig import findings_on_rig
from saddlering_ros.doubts.reading import absent_topic, mirrored_topic, run_of_record
from saddlering_ros.doubts.readings import MIN_SAMPLES
from saddlering_ros.errors import BagError
from saddlering_ros.record.metadata import TestMetadata
from saddlering_ros.record.record import RawRecord, RawTopic, Record
from saddlering_ros.record.scratch import scratch_copy
from saddlering_ros.record.stamps import put_in_order
from saddlering_ros.record.topics import ELEVATION, PROBE_TOPICS, TOPICS
from saddlering_ros.rig import OPPOSITE, Rig

RADIAL_TOPICS = tuple(PROBE_TOPICS[number - 1] for number in OPPOSITE)
"""Topics of probes that a rig may lack."""

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
        run.notes.extend(lines(findings_on_rig(rig, run, record)))
    return run


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
