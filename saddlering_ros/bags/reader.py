"""From a bag to the arrays of a test, with every input that cannot be used named in one line.

`bag_info` gives the content of a bag and all its faults, not only the first one.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.bags.folder import open_directory
from saddlering_ros.bags.scan import OnShare, Scan, scan
from saddlering_ros.doubts import readings
from saddlering_ros.doubts.on_rig import findings_on_rig
from saddlering_ros.doubts.units import check_load_unit, check_probe_unit
from saddlering_ros.errors import BagError, counted
from saddlering_ros.quantities import finite_json
from saddlering_ros.record.batches import Floats, gap_mask, JITTER_NS, Stamps
from saddlering_ros.record.plateaus import plateaus
from saddlering_ros.record.quality import topic_quality, TopicQuality
from saddlering_ros.record.record import RawRecord, RawTopic, Record, TestMetadata
from saddlering_ros.record.scratch import count_where, extremes, scratch_copy, spread_changes
from saddlering_ros.record.topics import LOAD_TOPIC, PROBE_TOPICS, RIG_TOPICS, TOPICS
from saddlering_ros.rig import load_rig, Rig
from saddlering_ros.rig.description import OPPOSITE


def read_raw(path: Path | str, topics: Sequence[str] | None = None,
             on_progress: OnShare = lambda share: None, rig: Rig | None = None) -> RawRecord:
    """The rig topics of the bag at `path` as recorded.

    topics: None for all of the rig. An optional topic that is missing, empty or unreadable is left
    out, the last with a note. The opposite probe stands for one that is absent from the `rig`
    (None: it has all). Readings are not judged (NaN stays NaN). BagError if stamps go back.
    """
    wanted = tuple(TOPICS if topics is None else topics)
    unknown = set(wanted) - set(TOPICS)
    if unknown:
        raise BagError(
            f'{path}: {min(unknown)} is not a topic of the rig: give some of {", ".join(TOPICS)}')
    return _raw_record(scan(open_directory(path), wanted, on_progress), wanted, rig)


def _raw_record(scanned: Scan, wanted: Sequence[str], rig: Rig | None) -> RawRecord:
    if scanned.damage is not None:
        assert scanned.fault is not None
        raise scanned.fault
    read = {name: raw_topic(scanned, name) for name in wanted
            if TOPICS[name].required and name != readings.absent_topic(rig)}
    return _completed(scanned, read, scanned.facts, wanted, rig)


def _completed(scanned: Scan, read: dict[str, RawTopic], facts: TestMetadata,
               wanted: Sequence[str], rig: Rig | None) -> RawRecord:
    """The record with that of an absent probe and the optional topics, or a note on a fault."""
    notes, absent = list(scanned.notes), readings.absent_topic(rig)
    if rig is not None and absent in wanted:
        read[absent] = readings.mirrored_topic(rig, read)
    for name in wanted:
        topic = None if TOPICS[name].required else scanned.topics.get(name)
        if topic and (topic.count or topic.fault or topic.types != {TOPICS[name].type}):
            try:
                read[name] = raw_topic(scanned, name)
            except BagError as fault:
                notes.append(f'left out: {fault}')
    return RawRecord(scanned.path, read, facts, tuple(notes))


def read_run(path: Path | str, *, test: str | None = None, elevation: float | None = None,
             rig: Rig | None = None, on_progress: OnShare = lambda share: None) -> Record:
    """The test in the bag at `path`, aligned on the load's stamps.

    test and elevation [rad] replace the statements of the bag. BagError, one line, for a fault
    that makes the bag unusable. With a rig, the notes also name probes that look swapped, stuck,
    dead or of the wrong polarity. on_progress receives the share of bytes read so far.
    """
    directory = open_directory(path)
    record = _raw_record(scan(directory, TOPICS, on_progress), tuple(TOPICS), rig)
    facts = usable_facts(record.path, record.facts, test, elevation)
    if elevation is None:
        readings.check_inclinometer(record, facts)
    run = replace(readings.run_of_record(record, facts, rig), sha256=directory.sha256())
    run = run if elevation is None else replace(run, elevation=float(elevation))
    if rig is not None:
        run.notes.extend(findings_on_rig(rig, run, record))
    return run


def usable_facts(path: Path, stated: TestMetadata, test: str | None,
                 elevation: float | None) -> TestMetadata:
    """Metadata of the bag and of the options together; BagError if they are not enough."""
    facts = stated.overruled(test, None if elevation is None else math.degrees(elevation))
    if facts.problems:
        raise BagError(f'{path}: {facts.problems[0]}')
    return facts


def raw_topic(scanned: Scan, name: str) -> RawTopic:
    """One rig topic of a scanned bag in stamp order; BagError if it cannot be used."""
    where = f'{scanned.path}: {name}'
    topic = scanned.topics.get(name)
    fewest = readings.MIN_SAMPLES if TOPICS[name].required else 1
    if scanned.fault is not None and (topic is None or topic.count < fewest):
        raise scanned.fault
    if not scanned.message_count:
        raise BagError(
            f'{scanned.path}: holds no messages: check that the rig ran and record again')
    if topic is None:
        have = ', '.join(sorted(scanned.topics)) or 'none'
        radial = (f', or state rig.probes.absent: {name[-1]} in the rig file if the rig does not '
                  'have this probe') if name in [PROBE_TOPICS[one - 1] for one in OPPOSITE] else ''
        space = next((one.removesuffix(name) for one in scanned.topics if one.endswith(name)), '')
        remedy = (f'it stands in the namespace {space}, and a bag holds names without one: record '
                  f'by saddlering record OUT --namespace {space[1:]}, or rename the topics'
                  ) if space else f'record this topic too{radial}'
        raise BagError(f'{scanned.path}: has no topic {name} (it has: {have}): {remedy}')
    if topic.fault:
        raise BagError(f'{where}: {topic.fault}')
    wrong = sorted(kind for kind in topic.types if kind != TOPICS[name].type)
    if not topic.count and wrong:
        raise BagError(f'{where}: its type is {wrong[0]} and should be {TOPICS[name].type}: '
                       'record the topic of the rig, or remap it')
    if topic.count < fewest:
        raise BagError(
            f'{where}: holds {counted(topic.count, "message")}, too few for a test: check that '
            'its driver ran, and record again')
    stamps, values = topic.stamps.array(), topic.values.array()
    keep, reordered, duplicates = put_in_order(where, stamps, topic.log_times.array, values)
    notes = []
    if reordered:
        verb = 'message was stored late and is|messages were stored late and are'
        notes.append(f'{name}: {counted(reordered, verb)} sorted')
    if duplicates:
        verb = 'message repeats|messages repeat'
        notes.append(f'{name}: {counted(duplicates, verb)} the stamp of another, left out')
    if notes:
        stamps, values = scratch_copy(stamps[keep]), scratch_copy(values[keep])
    if len(stamps) < fewest:
        raise BagError(f'{where}: holds {counted(len(stamps), "different stamp")}, too few for a '
                       'test: let the driver stamp each sample')
    spans = np.concatenate([np.empty((0, 2)), *topic.spans])
    if (spans != spans[:1]).any() and np.isfinite(spans).all():
        notes.append(f'{name}: min_range or max_range changes during the record')
    low, high = spans[0].tolist() if len(spans) else (math.nan, math.nan)
    if not scanned.cuts and scanned.damage is None:  # These numbers count the readable part.
        for array in (topic.stamps, topic.values, topic.log_times):
            array.clear()
    return RawTopic(
        topic=name, type=TOPICS[name].type, frame_id=topic.frame_id, stamps=stamps, values=values,
        min_range=low, max_range=high, notes=tuple(notes))


MAX_DUPLICATES = 0.01
"""Share of stamps with two different readings above which the clock stands still at times."""

MAX_HOLE_NS = 1_000_000_000
"""Time without a message [ns] that no recorder leaves which stores messages late."""

MAX_BREAKS = 0.05
"""Share of messages stored before an earlier one above which the order of the file is random."""

REGULAR_SHARE = 0.8
"""Share of intervals near the typical one from which on stamps count as regular."""

_FAR = np.iinfo(np.int64).max

LONGEST_LEAP_NS = 3600 * 1_000_000_000
"""Jump ahead [ns] of stamps above which they were set and not measured."""


def put_in_order(where: str, stamps: Stamps, log_times: Callable[[], Stamps],
                 values: Floats) -> tuple[NDArray[np.int64] | slice, int, int]:
    """Order of the messages (N,) of a topic by stamp, without repeated ones; BagError if none.

    Returned are the messages to keep, in order of their stamps (indices, or a slice for all), and
    the numbers of those that were stored late and of those left out.

    The rule. A recorder may store messages in another order than that of their creation, but a
    clock must not go back. Stamps that count as reordered are sorted. They are in order to within
    jitter (`JITTER_NS`), in the file or by their log times, and their late messages fill places
    without other messages. Stamps go back in three cases: both orders break by more than jitter;
    most late messages lie between or upon others, at most half a period away (two passes over the
    same stretch of time); or later messages lie more than `MAX_HOLE_NS` before all earlier ones,
    because a recorder that reorders leaves no hole.

    Log times [ns] are read only if messages came late.
    """
    if len(stamps) > 1 and extremes(stamps) == (0, 0):
        raise BagError(f'{where}: all stamps are zero: let the driver fill header.stamp')
    if len(stamps) and not count_where(lambda block: block[1:] <= block[:-1], stamps, ahead=1):
        _check_leaps(where, stamps)
        return slice(None), 0, 0
    lateness = _lateness(stamps)
    late = lateness > 0
    order = np.argsort(stamps, kind='stable')
    if late.any():
        _check_late(where, stamps, log_times(), lateness, order)
    ordered = stamps[order]
    _check_leaps(where, ordered)
    repeated = np.zeros(len(ordered), dtype=bool)
    repeated[1:] = np.diff(ordered) == 0
    contradicting, readings = repeated.copy(), values[order]
    contradicting[1:] &= readings[1:] != readings[:-1]
    if contradicting.sum() > max(1.0, MAX_DUPLICATES * len(ordered)):
        raise BagError(
            f'{where}: {int(contradicting.sum())} of {len(ordered)} messages have the stamp of '
            f'another message with a different reading, first {ordered[contradicting][0]} ns: the '
            'clock stops at times; record again with a stamp for each sample')
    return order[~repeated], int(late.sum()), int(repeated.sum())


def _lateness(stamps: Stamps) -> NDArray[np.int64]:
    """Distance of each stamp behind the newest before it [ns]; 0 for stamps in order."""
    return np.maximum.accumulate(stamps) - stamps if len(stamps) else stamps


def _check_late(where: str, stamps: Stamps, log_times: Stamps, lateness: NDArray[np.int64],
                order: NDArray[np.int64]) -> None:
    by_log = np.argsort(log_times, kind='stable')
    log_lateness = _lateness(stamps[by_log])
    if lateness.max() > JITTER_NS and log_lateness.max() > JITTER_NS:
        index = int(by_log[np.argmax(log_lateness > JITTER_NS)])
        raise _going_back(where, stamps, index, int(log_lateness.max()))
    # The typical time between samples [ns]. Sorted intervals show it if the order of the file is
    # random. If the order breaks only now and then, the intervals of the file show it, because
    # two passes over one stretch of time would halve the sorted ones.
    intervals, steps = np.diff(stamps[order]), np.diff(stamps)
    seen = intervals if (steps < 0).sum() > MAX_BREAKS * len(steps) else steps
    period = float(np.median(seen[seen > 0])) if (seen > 0).any() else 0.0
    # Lateness [ns] too small to separate a clock set back from swapped neighbours: little more
    # than a period where stamps come at regular intervals, three where they do not.
    regular = np.mean(np.abs(steps - period) <= 0.45 * period) > REGULAR_SHARE
    if lateness.max() <= (1.2 if regular else 3.0) * period:
        return
    nearest = np.minimum(np.append(intervals, _FAR), np.append(_FAR, intervals))
    late = lateness[order] > 0
    doubled = late & (nearest <= 0.55 * period)
    apart = (intervals > MAX_HOLE_NS) & (np.diff(order) < 0)
    if 2 * doubled.sum() > late.sum() or apart.any():
        index = int(np.argmax(lateness > 0))
        raise _going_back(where, stamps, index, int(lateness.max()))


def _going_back(where: str, stamps: Stamps, index: int, furthest: int) -> BagError:
    after = (stamps[:index].max() - stamps[0]) / 1e9 if index else 0.0
    return BagError(
        f'{where}: stamps go back by {furthest / 1e9:.6g} s, first at message {index} '
        f'({after:.3f} s into the record): the clock was set back, or the file holds two '
        'recordings; record again with a steady clock')


def _check_leaps(where: str, ordered: Stamps) -> None:
    if count_where(lambda block: np.diff(block) > LONGEST_LEAP_NS, ordered, ahead=1):
        leaps = np.diff(ordered)
        index = int(np.argmax(leaps))
        raise BagError(
            f'{where}: stamps leap ahead by {leaps[index] / 1e9:.6g} s behind stamp '
            f'{ordered[index]} ns: the clock was set, or a header.stamp was not filled; record '
            'again')


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
        return dict(finite_json({**asdict(self), 'path': str(self.path), 'usable': self.usable}))


def bag_info(path: Path | str, *, test: str | None = None, elevation: float | None = None,
             rig: Rig | None = None, on_progress: OnShare = lambda share: None) -> BagInfo:
    """Examine a bag; BagError only if there is none. Arguments: as of `read_run`."""
    scanned = scan(open_directory(path), TOPICS, on_progress)
    facts = scanned.facts.overruled(test, None if elevation is None else math.degrees(elevation))
    problems = [] if scanned.damage is None else [str(scanned.fault)]
    notes: list[str] = []
    rig = rig or load_rig()
    raw = {}
    for name in [name for name in RIG_TOPICS if name != readings.absent_topic(rig)]:
        try:
            raw[name] = raw_topic(scanned, name)
        except BagError as fault:
            problems.append(str(fault))
    problems += [f'{scanned.path}: {problem}' for problem in facts.problems]
    problems += _faults(str(scanned.path), raw, rig)
    run, count = None, None
    if not problems:
        record = _completed(scanned, dict(raw), facts, tuple(TOPICS), rig)
        try:
            if elevation is None:
                readings.check_inclinometer(record, facts)
            run = readings.run_of_record(record, facts, rig)
            notes = [*run.notes, *findings_on_rig(rig, run, record)]
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
                check_load_unit(place, topic.values, rig.limits)
                continue
            check_probe_unit(place, topic.values, topic.min_range, topic.max_range)
            if LOAD_TOPIC in raw:
                readings.check_overlap(where, raw[LOAD_TOPIC].stamps, name, topic.stamps)
        except BagError as fault:
            yield str(fault)


def _topics(of_bag: Scan, raw: dict[str, RawTopic], start: int | None,
            quality: dict[str, TopicQuality]) -> Iterator[TopicInfo]:
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
