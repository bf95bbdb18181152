"""From a bag to the arrays of a test, with every input that cannot be used named in one line."""

from collections.abc import Callable, Sequence
from dataclasses import replace
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.bags.folder import open_directory
from saddlering_ros.bags.scan import OnShare, Scan, scan
from saddlering_ros.doubts import readings as doubts
from saddlering_ros.doubts.on_rig import findings_on_rig
from saddlering_ros.doubts.readings import absent_topic, MIN_SAMPLES, mirrored_topic, run_of_record
from saddlering_ros.errors import BagError
from saddlering_ros.record.batches import JITTER_NS
from saddlering_ros.record.record import RawRecord, RawTopic, Record, TestMetadata
from saddlering_ros.record.scratch import count_where, extremes, scratch_copy
from saddlering_ros.record.topics import PROBE_TOPICS, TOPICS
from saddlering_ros.rig import Rig
from saddlering_ros.rig.description import OPPOSITE


def read_raw(
    path: Path | str, topics: Sequence[str] | None = None,
    on_progress: OnShare = lambda share: None, rig: Rig | None = None,
) -> RawRecord:
    """The rig topics of the bag at `path` as recorded.

    topics: None for all of the rig. An optional topic that is missing or unreadable is left out,
    the latter with a note. The opposite probe stands for one that is absent from the `rig` (None:
    it has all). Readings are not judged (NaN stays NaN). BagError if stamps go back.
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
    absent = absent_topic(rig)
    read = {name: raw_topic(scanned, name)
            for name in wanted if TOPICS[name].required and name != absent}
    if rig is not None and absent in wanted:
        read[absent] = mirrored_topic(rig, read)
    return with_optional(RawRecord(scanned.path, read, scanned.facts, scanned.notes), scanned,
                         wanted)


def with_optional(record: RawRecord, scanned: Scan, wanted: Sequence[str]) -> RawRecord:
    """The record with those optional topics that the bag holds, or a note on a fault of one."""
    read, notes = dict(record.topics), list(record.notes)
    for name in wanted:
        if name in scanned.topics and not TOPICS[name].required:
            try:
                read[name] = raw_topic(scanned, name)
            except BagError as fault:
                notes.append(f'left out: {fault}')
    return replace(record, topics=read, notes=tuple(notes))


def read_run(
    path: Path | str, *, test: str | None = None, elevation: float | None = None,
    rig: Rig | None = None, on_progress: OnShare = lambda share: None,
) -> Record:
    """The test in the bag at `path`, aligned on the load's stamps.

    test and elevation [rad] replace the statements of the bag. BagError, one line, for a fault
    that makes the bag unusable. With a rig, the notes also name probes that look swapped, stuck,
    dead or of the wrong polarity. on_progress receives the share of bytes read so far.
    """
    directory = open_directory(path)
    record = _raw_record(scan(directory, TOPICS, on_progress), tuple(TOPICS), rig)
    facts = usable_facts(record.path, record.facts, test, elevation)
    if elevation is None:
        doubts.check_inclinometer(record, facts)
    run = replace(run_of_record(record, facts, rig), sha256=directory.sha256())
    run = run if elevation is None else replace(run, elevation=float(elevation))
    if rig is not None:
        run.notes.extend(map(str, findings_on_rig(rig, run, record)))
    return run


def usable_facts(
    path: Path, stated: TestMetadata, test: str | None, elevation: float | None,
) -> TestMetadata:
    """Metadata of the bag and of the options together; BagError if they are not enough."""
    facts = stated.overruled(test, None if elevation is None else math.degrees(elevation))
    if facts.problems:
        raise BagError(f'{path}: {facts.problems[0]}')
    return facts


def raw_topic(scanned: Scan, name: str) -> RawTopic:
    """One rig topic of a scanned bag in stamp order; BagError if it cannot be used."""
    where = f'{scanned.path}: {name}'
    topic = scanned.topics.get(name)
    fewest = MIN_SAMPLES if TOPICS[name].required else 1
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
            f'{where}: holds {topic.count} messages, too few for a test: check that its driver '
            'ran, and record again')
    stamps, values = topic.stamps.array(), topic.values.array()
    keep, reordered, duplicates = put_in_order(where, stamps, topic.log_times.array, values)
    notes = []
    if reordered:
        notes.append(f'{name}: {reordered} messages were stored late and are sorted')
    if duplicates:
        notes.append(f'{name}: {duplicates} messages repeat the stamp of another and are left out')
    if notes:
        stamps, values = scratch_copy(stamps[keep]), scratch_copy(values[keep])
    if len(stamps) < fewest:
        raise BagError(f'{where}: holds {len(stamps)} different stamps, too few for a test: '
                       'let the driver stamp each sample')
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


def put_in_order(
    where: str, stamps: NDArray[np.int64], log_times: Callable[[], NDArray[np.int64]],
    values: NDArray[np.float64],
) -> tuple[NDArray[np.int64] | slice, int, int]:
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


def _lateness(stamps: NDArray[np.int64]) -> NDArray[np.int64]:
    """Distance of each stamp behind the newest before it [ns]; 0 for stamps in order."""
    return np.maximum.accumulate(stamps) - stamps if len(stamps) else stamps


def _check_late(
    where: str, stamps: NDArray[np.int64], log_times: NDArray[np.int64],
    lateness: NDArray[np.int64], order: NDArray[np.int64],
) -> None:
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


def _going_back(where: str, stamps: NDArray[np.int64], index: int, furthest: int) -> BagError:
    after = (stamps[:index].max() - stamps[0]) / 1e9 if index else 0.0
    return BagError(
        f'{where}: stamps go back by {furthest / 1e9:.6g} s, first at message {index} '
        f'({after:.3f} s into the record): the clock was set back, or the file holds two '
        'recordings; record again with a steady clock')


def _check_leaps(where: str, ordered: NDArray[np.int64]) -> None:
    if count_where(lambda block: np.diff(block) > LONGEST_LEAP_NS, ordered, ahead=1):
        leaps = np.diff(ordered)
        index = int(np.argmax(leaps))
        raise BagError(
            f'{where}: stamps leap ahead by {leaps[index] / 1e9:.6g} s behind stamp '
            f'{ordered[index]} ns: the clock was set, or a header.stamp was not filled; record '
            'again')
