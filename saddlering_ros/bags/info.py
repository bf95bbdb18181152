"""The content of a bag and all its faults, not only the first one."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
import math
from pathlib import Path
from typing import Any

import numpy as np

from saddlering_ros.bags.folder import open_directory
from saddlering_ros.bags.reader import raw_topic, with_optional
from saddlering_ros.bags.scan import OnShare, Scan, scan
from saddlering_ros.doubts import readings
from saddlering_ros.doubts.on_rig import findings_on_rig
from saddlering_ros.errors import BagError
from saddlering_ros.quantities import finite_json
from saddlering_ros.record.batches import gap_mask
from saddlering_ros.record.plateaus import plateaus
from saddlering_ros.record.quality import topic_quality, TopicQuality
from saddlering_ros.record.record import RawRecord, RawTopic, TestMetadata
from saddlering_ros.record.scratch import count_where, extremes, spread_changes
from saddlering_ros.record.topics import LOAD_TOPIC, RIG_TOPICS, TOPICS
from saddlering_ros.rig import load_rig, Rig


@dataclass(frozen=True)
class TopicInfo:
    """One topic of a bag; fields after `count` are of the rig's topics alone."""

    topic: str
    type: str
    count: int
    rate: float = math.nan  # [Hz] by the median period
    start: float = math.nan  # [s] after the earliest stamp
    duration: float = math.nan  # [s]
    gaps: int = 0  # of the stamps
    longest_gap: float = 0.0  # [s]
    lowest: float = math.nan  # reading [SI]
    highest: float = math.nan  # reading [SI]
    frame_id: str = ''
    repeated: float = math.nan  # share of readings equal to the one before
    update_rate: float = math.nan  # [Hz] of new readings
    resolution: float = math.nan  # greatest common step [SI]
    noise: float = math.nan  # white noise [SI]
    bandwidth: float = math.nan  # of that noise [Hz], NaN if unknown
    spikes: int = 0  # their number


@dataclass(frozen=True)
class BagInfo:
    """Content of a bag; problems prevent its use, notes do not."""

    path: Path
    name: str
    files: int
    size: int  # [bytes]
    message_count: int
    compressions: tuple[str, ...]  # of the chunks
    schema_encodings: tuple[str, ...]  # of the rig's topics
    facts: TestMetadata  # as stated
    topics: tuple[TopicInfo, ...]
    start: int | None  # [ns], earliest header of the rig's topics; None: there is none
    duration: float  # [s] by the same headers, NaN if there are none
    load_range: tuple[float, float]  # [N]
    plateaus: int | None  # their number; None: not a static test
    sha256: str = ''  # of its files
    problems: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def usable(self) -> bool:
        return not self.problems

    def as_dict(self) -> dict[str, Any]:
        """Everything as plain numbers and text, NaN as None, for JSON."""
        plain: dict[str, Any] = finite_json(
            {**asdict(self), 'path': str(self.path), 'usable': self.usable})
        return plain


def bag_info(
    path: Path | str, *, test: str | None = None, elevation: float | None = None,
    rig: Rig | None = None, on_progress: OnShare = lambda share: None,
) -> BagInfo:
    """Examine a bag; BagError only if there is none. Arguments: as of `read_run`."""
    scanned = scan(open_directory(path), TOPICS, on_progress)
    facts = scanned.facts.overruled(test, None if elevation is None else math.degrees(elevation))
    problems = [] if scanned.damage is None else [str(scanned.fault)]
    notes: list[str] = []
    rig = rig or load_rig()
    absent = readings.absent_topic(rig)
    raw = {}
    for name in [name for name in RIG_TOPICS if name != absent]:
        try:
            raw[name] = raw_topic(scanned, name)
        except BagError as fault:
            problems.append(str(fault))
    problems += [f'{scanned.path}: {problem}' for problem in facts.problems]
    problems += _faults(str(scanned.path), raw, rig)
    run, count = None, None
    if not problems:
        read = {**raw, absent: readings.mirrored_topic(rig, raw)} if absent else raw
        record = with_optional(RawRecord(scanned.path, read, facts, scanned.notes), scanned,
                               tuple(TOPICS))
        try:
            if elevation is None:
                readings.check_inclinometer(record, facts)
            run = readings.run_of_record(record, facts, rig)
            notes = [*run.notes, *map(str, findings_on_rig(rig, run, record))]
            if run.test == 'static':
                count = 0
                count = len(plateaus(run))
        except BagError as fault:
            problems.append(str(fault))
    start = min((int(topic.stamps[0]) for topic in raw.values()), default=None)
    stop = max((int(topic.stamps[-1]) for topic in raw.values()), default=None)
    load = raw[LOAD_TOPIC].values if LOAD_TOPIC in raw else np.array([math.nan])
    lowest, highest = map(float, extremes(load))
    return BagInfo(
        path=scanned.path, name=scanned.directory.name, files=len(scanned.directory.files),
        size=scanned.size, message_count=scanned.message_count,
        compressions=tuple(sorted(scanned.compressions)),
        schema_encodings=tuple(sorted(scanned.schema_encodings)), facts=facts,
        topics=tuple(_topics(scanned, raw, start, {} if run is None else run.quality)),
        start=start, duration=math.nan if start is None or stop is None else (stop - start) / 1e9,
        load_range=(lowest, highest), plateaus=count, sha256=scanned.directory.sha256(),
        problems=tuple(dict.fromkeys(problems)), notes=tuple(notes))


def _faults(where: str, raw: Mapping[str, RawTopic], rig: Rig) -> Iterator[str]:
    """The first fault of the readings of each topic."""
    for name, topic in raw.items():
        place = f'{where}: {name}'
        try:
            readings.check_values(place, topic.stamps, topic.values)
            if name == LOAD_TOPIC:
                readings.check_load_unit(place, topic.values, rig.limits)
                continue
            readings.check_probe_unit(place, topic.values, topic.min_range, topic.max_range)
            if LOAD_TOPIC in raw:
                readings.check_overlap(where, raw[LOAD_TOPIC].stamps, name, topic.stamps)
        except BagError as fault:
            yield str(fault)


def _topics(
    of_bag: Scan, raw: dict[str, RawTopic], start: int | None, quality: dict[str, TopicQuality],
) -> Iterator[TopicInfo]:
    """The rig's topics first, then all others by name."""
    for name in (*RIG_TOPICS, *sorted(set(of_bag.topics) - set(RIG_TOPICS))):
        if name not in of_bag.topics:
            continue
        scanned, topic = of_bag.topics[name], raw.get(name)
        info = TopicInfo(name, ', '.join(sorted(scanned.types)), scanned.count)
        if topic is None or start is None:
            yield info
            continue
        stamps, values, seen = topic.stamps, topic.values, quality.get(name)
        before = np.flatnonzero(gap_mask(stamps))
        gaps = stamps[before + 1] - stamps[before]
        lowest, highest = map(float, extremes(values))
        if seen is None:
            is_finite = count_where(np.isfinite, values) == len(values)
            seen = topic_quality(stamps, values) if is_finite else TopicQuality()
        yield replace(
            info, rate=1e9 / float(np.median(spread_changes(stamps))),
            start=(int(stamps[0]) - start) / 1e9, duration=int(stamps[-1] - stamps[0]) / 1e9,
            gaps=len(gaps), longest_gap=float(gaps.max(initial=0)) / 1e9, lowest=lowest,
            highest=highest, frame_id=topic.frame_id, repeated=seen.repeated,
            update_rate=seen.update_rate, resolution=seen.resolution, noise=seen.noise,
            bandwidth=seen.bandwidth, spikes=int(seen.spikes.size))
