"""The topics of a recorded test through the guard of the live nodes, with equal results."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.record.checks import (
    check_load_unit,
    check_probe_unit,
    check_values,
    unit_outside,
)
from saddlering_ros.record.errors import BagError
from saddlering_ros.record.guard import (
    load_limits,
    probe_limits,
    ReadingLimits,
    sound_samples,
    SoundSamples,
)
from saddlering_ros.record.node_rows import complete_rows, degraded_rows, NodeRows
from saddlering_ros.record.scratch import blocks, extremes, scratch_copy, scratch_mask
from saddlering_ros.record.topics import LOAD_TOPIC, PROBE_TOPICS
from saddlering_ros.rig import Rig

if TYPE_CHECKING:
    from saddlering_ros.record.record import RawRecord, RawTopic

MAX_REFUSED_SHARE = 0.05
"""Largest share of refused samples. With more of them the unit, the sensor or the rig file is
wrong."""


@dataclass(frozen=True)
class GuardedTopic:
    """A topic of the rig with its sound samples only; `sound` has the refused ones."""

    topic: RawTopic
    sound: SoundSamples

    def notes(self) -> list[str]:
        """The refused and the doubtful samples, a line each."""
        notes, counts = [], self.sound.counters.refused
        if counts:
            words = ', '.join(
                f'{count} {name.replace("_", " ")}' for name, count in counts.items())
            notes.append(
                f'{self.topic.topic}: {sum(counts.values())} samples are refused, as live nodes '
                f'refuse them ({words}): validity marks what is interpolated across them, and '
                'identification and diagnosis leave it out')
        if self.doubtful:
            notes.append(
                f'{self.topic.topic}: {self.doubtful} samples lie behind a step that the '
                'hydraulics cannot make in its time (rig.full_scale_time), as when a counter '
                'rolls over: validity marks what is simulated by them, and identification and '
                'diagnosis leave it out')
        return notes

    @property
    def doubtful(self) -> int:
        """Number of doubtful samples."""
        return self.sound.counters.doubtful_load


def guarded_topics(record: RawRecord, rig: Rig) -> list[GuardedTopic]:
    """The load and the four probes of `record`; BagError for readings of another unit."""
    return [_guarded(record, record[name],
                     load_limits(rig) if name == LOAD_TOPIC else probe_limits(rig), rig)
            for name in (LOAD_TOPIC, *PROBE_TOPICS)]


def _guarded(record: RawRecord, raw: RawTopic, limits: ReadingLimits, rig: Rig) -> GuardedTopic:
    where = f'{record.path}: {raw.topic}'
    check_values(where, raw.stamps, raw.values)
    sound = sound_samples(limits, raw.stamps, raw.values)
    refused = len(raw) - len(sound.samples)
    wrong = refused + sound.counters.doubtful_load
    many = wrong > MAX_REFUSED_SHARE * len(raw)
    judged = raw.values if many or not refused else sound.samples.values
    if raw.topic == LOAD_TOPIC:
        check_load_unit(where, judged, rig.limits)
    else:
        check_probe_unit(where, judged, raw.min_range, raw.max_range)
    if many:
        unit = '' if raw.topic == LOAD_TOPIC else unit_outside(
            raw.values, raw.min_range, raw.max_range)
        raise BagError(
            f'{where}: {wrong} of {len(raw)} readings cannot be those of this rig (from '
            f'{limits.low:.4g} to {limits.high:.4g}, or change faster than rig.full_scale_time '
            f'allows){unit}: correct the rig file, or see to the sensor')
    if not refused:
        return GuardedTopic(raw, sound)
    return GuardedTopic(
        replace(raw, stamps=sound.samples.stamps, values=sound.samples.values), sound)


def possible_record(record: RawRecord, rig: Rig) -> RawRecord:
    """The same record without readings beyond the limits; single leaps stay, as spikes."""
    topics = dict(record.topics)
    for name in (LOAD_TOPIC, *PROBE_TOPICS):
        limits = load_limits(rig) if name == LOAD_TOPIC else probe_limits(rig)
        raw = topics[name]
        lowest, highest = extremes(raw.values)
        if not limits.low <= lowest <= highest <= limits.high:
            is_possible = (raw.values >= limits.low) & (raw.values <= limits.high)
            topics[name] = replace(raw, stamps=scratch_copy(raw.stamps[is_possible]),
                                   values=scratch_copy(raw.values[is_possible]))
    return replace(record, topics=topics)


def node_rows(guarded: list[GuardedTopic], gaps: NDArray[np.float64]) -> NodeRows | None:
    """Rows that the live nodes use, with aligned gaps (4, N); None: all complete rows."""
    load, *probes = guarded
    stamps = load.topic.stamps
    degraded = degraded_rows(stamps, [one.topic.stamps for one in probes], gaps)
    marked = any(len(one.sound.bridges) + len(one.sound.steps) for one in guarded)
    if not len(degraded) and not marked:
        return None
    given = complete_rows(gaps)
    given[degraded] = True
    bridged = scratch_mask(len(stamps))
    for one in probes:
        marks = one.sound.bridged(stamps)
        for part in blocks(len(stamps), bridged, marks):
            bridged[part] |= marks[part]
    return NodeRows(given, bridged, load.sound.bridged(stamps, to_next=True),
                    load.sound.doubtful(stamps))
