"""The content of a bag and all its faults, not only the first one."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
import math
from pathlib import Path
from typing import Any

import numpy as np

from saddlering_ros.bags.reader import raw_topic
from saddlering_ros.bags.scan import OnShare, Scan, scan
from saddlering_ros.doubts import readings
from saddlering_ros.doubts.on_rig import findings_on_rig
from saddlering_ros.doubts.readings import absent_topic, mirrored_topic, run_of_record
from saddlering_ros.errors import BagError
from saddlering_ros.quantities import finite_json
from saddlering_ros.record.batches import gap_mask
from saddlering_ros.record.metadata import TestMetadata
from saddlering_ros.record.plateaus import plateaus
from saddlering_ros.record.quality import topic_quality, TopicQuality, UNKNOWN_QUALITY
from saddlering_ros.record.record import RawRecord, RawTopic, Record
from saddlering_ros.record.scratch import count_where, extremes, spread_changes
from saddlering_ros.record.topics import LOAD_TOPIC, PROBE_TOPICS, RIG_TOPICS
from saddlering_ros.rig import load_rig, Rig


@dataclass(frozen=True)
class TopicInfo:
    """One topic of a bag.

    type and count are of any topic; all other fields are of the rig's topics alone. rate [Hz]: by
    the median period; start, duration [s]: relative to the earliest stamp; gaps, longest_gap [s]:
    of the stamps; lowest, highest: readings [SI]; repeated: share of readings equal to the
    reading before; update_rate [Hz]: of new readings; resolution: greatest common step [SI];
    noise: white noise [SI]; bandwidth: of that noise [Hz], NaN if unknown; spikes: their number.
    """

    topic: str
    type: str
    count: int
    rate: float = math.nan
    start: float = math.nan
    duration: float = math.nan
    gaps: int = 0
    longest_gap: float = 0.0
    lowest: float = math.nan
    highest: float = math.nan
    frame_id: str = ''
    repeated: float = math.nan
    update_rate: float = math.nan
    resolution: float = math.nan
    noise: float = math.nan
    bandwidth: float = math.nan
    spikes: int = 0


@dataclass(frozen=True)
class BagInfo:
    """Content of a bag; problems prevent its use, notes do not.

    size [bytes]; compressions and schema encodings of the files; duration [s] and start [ns]
    by header stamps of the rig's topics (NaN and None if there are none); load_range [N];
    plateaus: their number (None if not a static test); facts as found; sha256 of its files.
    """

    path: Path
    name: str
    files: int
    size: int
    message_count: int
    compressions: tuple[str, ...]
    schema_encodings: tuple[str, ...]
    facts: TestMetadata
    topics: tuple[TopicInfo, ...]
    start: int | None
    duration: float
    load_range: tuple[float, float]
    plateaus: int | None
    sha256: str = ''
    problems: tuple[str, ...] = field(default=())
    notes: tuple[str, ...] = field(default=())

    @property
    def usable(self) -> bool:
        """Whether the bag can be read as a test."""
        return not self.problems

    def as_dict(self) -> dict[str, Any]:
        """Everything as plain numbers and text, NaN as None, for JSON."""
        mapping = asdict(self)
        mapping['path'] = str(self.path)
        mapping['usable'] = self.usable
        plain: dict[str, Any] = finite_json(mapping)
        return plain


def bag_info(
    path: Path | str, *, test: str | None = None, elevation: float | None = None,
    rig: Rig | None = None, on_progress: OnShare = lambda share: None,
) -> BagInfo:
    """Examine the bag at `path`; BagError only if there is no bag at all.

    `test`, `elevation` [rad], `rig` (default: as of `load_rig`) and `on_progress` as in
    `read_run`.
    """
    found = scan(path, on_progress=on_progress)
    degrees = None if elevation is None else math.degrees(elevation)
    facts = found.facts.overruled(test, degrees)
    problems, notes = [], []
    if found.damage is not None:
        problems.append(str(found.fault))
    raw = {}
    rig = rig or load_rig()
    absent = absent_topic(rig)
    for name in RIG_TOPICS:
        if name == absent:
            continue
        try:
            raw[name] = raw_topic(found, name)
        except BagError as fault:
            problems.append(str(fault))
    problems += [f'{found.path}: {problem}' for problem in facts.problems]
    problems += _faults_of_readings(found.path, raw, rig)
    read = raw if problems or not absent else {**raw, absent: mirrored_topic(rig, raw)}
    record = RawRecord(found.path, read, facts, found.notes)
    run, count = None, None
    if not problems:
        try:
            run = run_of_record(record, facts, rig)
        except BagError as fault:
            problems.append(str(fault))
    if run is not None:
        notes += [*run.notes, *map(str, findings_on_rig(rig, run, record))]
    if run is not None and run.test == 'static':
        try:
            count = len(plateaus(run, errors=False))
        except BagError as fault:
            problems.append(str(fault))
            count = 0
    return _assemble(found, facts, raw, run, count, problems, notes)


def _faults_of_readings(path: Path, raw: dict[str, RawTopic], rig: Rig) -> list[str]:
    faults = []
    for name, topic in raw.items():
        where = f'{path}: {name}'
        try:
            readings.check_values(where, topic.stamps, topic.values)
            if name == LOAD_TOPIC:
                readings.check_load_unit(where, topic.values, rig.limits)
            else:
                readings.check_probe_unit(where, topic.values, topic.min_range, topic.max_range)
                if LOAD_TOPIC in raw:
                    readings.check_overlap(str(path), raw[LOAD_TOPIC].stamps, name, topic.stamps)
        except BagError as fault:
            faults.append(str(fault))
    return faults


def _assemble(
    found: Scan, facts: TestMetadata, raw: dict[str, RawTopic], run: Record | None,
    count: int | None, problems: list[str], notes: list[str],
) -> BagInfo:
    start = min((int(topic.stamps[0]) for topic in raw.values()), default=None)
    stop = max((int(topic.stamps[-1]) for topic in raw.values()), default=None)
    duration = math.nan if start is None or stop is None else (stop - start) / 1e9
    lowest, highest = extremes(
        raw[LOAD_TOPIC].values if LOAD_TOPIC in raw else np.array([math.nan]))
    return BagInfo(
        path=found.path, name=found.directory.name, files=len(found.directory.files),
        size=found.size, message_count=found.message_count,
        compressions=tuple(sorted(found.compressions)),
        schema_encodings=tuple(sorted(found.schema_encodings)), facts=facts,
        topics=_topics(found, raw, start, run), start=start, duration=duration,
        load_range=(float(lowest), float(highest)), plateaus=count,
        sha256=found.directory.sha256(), problems=tuple(dict.fromkeys(problems)),
        notes=tuple(notes))


def _topics(
    found: Scan, raw: dict[str, RawTopic], start: int | None, run: Record | None,
) -> tuple[TopicInfo, ...]:
    """The rig's topics first, then all others by name."""
    others = sorted(set(found.topics) - set(RIG_TOPICS))
    infos = []
    for name in (LOAD_TOPIC, *PROBE_TOPICS, *others):
        scanned = found.topics.get(name)
        if scanned is None:
            continue
        kind = ', '.join(sorted(scanned.types))
        if name in raw and start is not None:
            seen = None if run is None else run.quality.get(name)
            infos.append(_rig_topic(raw[name], kind, scanned.count, start, seen))
        else:
            infos.append(TopicInfo(name, kind, scanned.count))
    return tuple(infos)


def _rig_topic(
    raw: RawTopic, kind: str, count: int, start: int, seen: TopicQuality | None,
) -> TopicInfo:
    before = np.flatnonzero(gap_mask(raw.stamps))
    gaps = raw.stamps[before + 1] - raw.stamps[before]
    lowest, highest = map(float, extremes(raw.values))
    is_finite = count_where(np.isfinite, raw.values) == len(raw.values)
    if seen is None:
        seen = topic_quality(raw.stamps, raw.values) if is_finite else UNKNOWN_QUALITY
    return TopicInfo(
        topic=raw.topic, type=kind, count=count,
        rate=1e9 / float(np.median(spread_changes(raw.stamps))),
        start=(int(raw.stamps[0]) - start) / 1e9,
        duration=int(raw.stamps[-1] - raw.stamps[0]) / 1e9, gaps=len(gaps),
        longest_gap=float(gaps.max()) / 1e9 if len(gaps) else 0.0, lowest=lowest, highest=highest,
        frame_id=raw.frame_id, repeated=seen.repeated, update_rate=seen.update_rate,
        resolution=seen.resolution, noise=seen.noise, bandwidth=seen.bandwidth,
        spikes=int(seen.spikes.size))
