"""From the topics of a test as recorded to its record: refused, guarded, aligned, with notes.

The guard and the aligner are those of the live nodes, to which a whole bag is one batch.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
import math
from pathlib import Path
import time

import numpy as np

from saddlering_ros.doubts import Finding
from saddlering_ros.doubts.units import check_load_unit, check_probe_unit, is_span, unit_outside
from saddlering_ros.errors import BagError, counted, counted_name
from saddlering_ros.quantities import quantity
from saddlering_ros.record import batches, scratch
from saddlering_ros.record import quality as logger_quality
from saddlering_ros.record.aligner import aligned_record
from saddlering_ros.record.batches import align, Bits, Floats, gap_mask, Mask, Stamps
from saddlering_ros.record.displacement import a_pair_reads
from saddlering_ros.record.guard import limits_of, SampleGuard, sound_samples
from saddlering_ros.record.quality import filter_lag, rate_share, topic_quality, TopicQuality
from saddlering_ros.record.record import RawRecord, RawTopic, Record, TestMetadata
from saddlering_ros.record.scratch import count_where, extremes
from saddlering_ros.record.topics import ELEVATION, LOAD_TOPIC, PROBE_TOPICS, RIG_TOPICS, TOPICS
from saddlering_ros.rig import load_rig, Rig
from saddlering_ros.rig.geometry import mirrored_gap

MIN_SAMPLES = 10
"""Smallest number of samples of a topic in a test."""

MAX_UNREAD = 0.005
"""Share of load stamps without a reading, as at both ends of a record."""

MAX_LATE, MAX_LATE_PERIODS = 2e-4, 0.1
"""Lateness of stamps [s], and in periods, of load or probes beyond the others. 1 ms changes D by
1 to 3 %; stamps with a usual jitter of 2 % of a period are 0.04 periods late."""

MAX_APART = 0.05
"""Time [s] that recordings which begin and end together do not lie apart."""

MIN_SHORTER = 1.0
"""Time [s] by which a load lasts less than the probes, of which a note is made: topics of one
driver begin and end some tenths of a second apart."""

MAX_REFUSED_SHARE = 0.05
"""Largest share of refused samples. With more of them the unit, the sensor or the rig file is
wrong."""

ELEVATION_TOLERANCE_DEG = 0.5
"""Difference [degrees] between inclinometer and stated elevation that is a contradiction."""

MAX_AHEAD = 60.0
"""Time [s] by which the clocks of two machines may differ before a test lies in the future."""

EARLIEST = 946_684_800 * batches.SECOND
"""Stamp [ns] of the year 2000, before which no test was recorded."""

MIN_SECONDS = 0.1
"""Duration of a record below which it is no test: five means of a fit."""


def check_values(where: str, stamps: Stamps, values: Floats) -> None:
    """Raise BagError if any of `values` (N,) at `stamps` (N,) [ns] is NaN or infinite."""
    if count_where(np.isfinite, values) == len(values):
        return
    bad = ~np.isfinite(values)
    first = int(np.argmax(bad))
    kinds = ' and '.join(name for name, kind in (('NaN', np.isnan), ('infinite', np.isinf))
                         if kind(values).any())
    raise BagError(
        f'{where}: {int(bad.sum())} of {len(values)} readings are {kinds}, first at stamp '
        f'{stamps[first]} ns ({(stamps[first] - stamps[0]) / 1e9:.3f} s into the record): check '
        'the sensor and record again')


def check_inclinometer(record: RawRecord, facts: TestMetadata) -> None:
    """Raise BagError if the inclinometer of a record contradicts its stated elevation."""
    assert facts.elevation_deg is not None
    _, measured, _ = _measured_elevation(record)
    if abs(measured - facts.elevation_deg) > ELEVATION_TOLERANCE_DEG:
        raise BagError(
            f'{record.path}: elevation_deg is {facts.elevation_deg:g} and {ELEVATION.name} '
            f'measured {measured:.2f} deg: give elevation_deg=DEG')


def _measured_elevation(record: RawRecord) -> tuple[float, float, float]:
    """The median of an inclinometer between the ends of its usual readings [deg]; NaN for none."""
    values = record[ELEVATION.name].values if ELEVATION.name in record else np.empty(0)
    values = np.degrees(values[np.isfinite(values)])
    low, middle, high = np.quantile(values, [0.05, 0.5, 0.95]) if len(values) else [math.nan] * 3
    return float(low), float(middle), float(high)


def check_overlap(where: str, load_stamps: Stamps, topic: str, stamps: Stamps) -> None:
    """Raise BagError if a probe and the load were not recorded at the same time."""
    if stamps[0] <= load_stamps[-1] and load_stamps[0] <= stamps[-1]:
        return
    apart = (int(stamps[0]) - int(load_stamps[0])) / 1e9
    raise BagError(
        f'{where}: {topic} and the load do not overlap in time (their stamps begin '
        f'{abs(apart):.6g} s apart): synchronise the clocks, or start both recordings together')


def _stream_findings(topic: str, raw: RawTopic) -> list[Finding]:
    """Findings on gaps in the stamps of a topic, and on readings that never change."""
    stamps, (lowest, highest) = raw.stamps, extremes(raw.values)
    findings = [Finding('the reading never changes', topic)] if lowest == highest else []
    before = np.flatnonzero(gap_mask(stamps))
    if not len(before):
        return findings
    longest = int((stamps[before + 1] - stamps[before]).max()) / 1e9
    return [*findings, Finding(f'{counted(len(before), "gap")} in the stamps, the longest '
                               f'{longest:.3f} s', topic)]


def _probe_findings(raw: RawTopic, aligned: Floats) -> list[Finding]:
    """Faults of the readings of a probe; `aligned` (N,) are those at the stamps of the load."""
    findings = _stream_findings(raw.topic, raw)
    low, high = raw.min_range, raw.max_range
    absent = count_where(np.isnan, aligned)
    if absent > MAX_UNREAD * len(aligned):
        findings.append(Finding(
            f'has no reading at {absent} of {len(aligned)} load stamps', raw.topic))
    if not is_span(low, high):
        findings.append(Finding('states no span (min_range, max_range)', raw.topic))
    elif count := count_where(lambda block: (block <= low) | (block >= high), raw.values):
        findings.append(Finding(
            f'{count} of {len(raw.values)} readings are at or beyond the limits of its span '
            f'({low:g} to {high:g} m){unit_outside(raw.values, low, high)}', raw.topic))
    return findings


def block_words(pause: float) -> str:
    """What is said of stamps in blocks with a pause [s] between them."""
    return (f'come in blocks, {quantity(pause, "s")} apart: stamp each sample when it is taken '
            'and not when its block arrives')


def quality_findings(topic: str, quality: TopicQuality, unit: str) -> list[Finding]:
    """What makes a topic's readings doubtful."""
    findings = []
    if quality.is_held:
        findings.append(Finding(
            f'{100.0 * quality.repeated:.0f} % of consecutive readings are equal: the sensor '
            f'reads at about {quality.update_rate:.3g} Hz and is published at {quality.rate:.4g} '
            f'Hz; readings are up to {1e3 / quality.update_rate:.3g} ms old, which shifts D1 and '
            "D2: record at the sensor's own rate", topic))
    elif quality.is_coarse:
        findings.append(Finding(
            f'its resolution of {quantity(quality.resolution, unit)} is coarser than its noise '
            f'({quantity(quality.noise, unit)} rms): rounding counts as noise; use a finer range '
            'of the converter', topic))
    if quality.alternates:
        findings.append(Finding(
            f'every second reading differs by {quantity(quality.alternates, unit)}: two drivers '
            'or two converters publish it: end one of them', topic))
    if quality.spikes.size:
        findings.append(Finding(
            f'{counted(quality.spikes.size, "reading is a spike|readings are spikes")}, the first '
            f'at sample {quality.spikes[0]}: identification and diagnosis leave them out', topic))
    start, count = quality.stall
    if count:
        findings.append(Finding(
            f'{count} equal readings in a row from {start / quality.rate:.2f} s on: the converter '
            'or the logger stopped', topic))
    value, often = quality.limit
    if often:
        findings.append(Finding(
            f'{often} readings equal the {quantity(value, unit)} that no other reading exceeds: '
            'the sensor or its amplifier is at a limit', topic))
    return findings


def clock_findings(load: TopicQuality, probes: Sequence[TopicQuality],
                   seconds: float) -> list[Finding]:
    """Findings on load and probes together over a record of `seconds`."""
    findings, together = [], filter_lag(load, probes)
    parts = [('the probes seem', probes, together)] if together else [
        (f'probe {number} seems', [one], min(filter_lag(load, [one]), 0.0))
        for number, one in enumerate(probes, 1)
        if one.bandwidth < logger_quality.ALONE_LIMIT * one.rate]
    for subject, own, lag in parts:
        if not lag:
            continue
        slow = logger_quality.median_of_known([one.bandwidth for one in own])
        if lag > 0.0:
            slow, subject = load.bandwidth, 'the load seems'
        findings.append(Finding(
            f'{subject} low-passed at about {slow:.2g} Hz and the other readings are not, or '
            f'less: a lag of about {1e3 * abs(lag):.1f} ms, which shifts D1 and D2: give all '
            'channels the same filter'))
    late = [one.lateness - load.lateness for one in probes]
    largest = max(late, key=abs)
    if abs(largest) > max(MAX_LATE, MAX_LATE_PERIODS / load.rate):
        alone = sum(abs(one) > 0.5 * abs(largest) for one in late) == 1
        who = ('the load seems' if largest < 0.0 and not alone else
               f'probe {late.index(largest) + 1} seems' if alone else 'the probes seem')
        findings.append(Finding(
            f'{who} stamped on arrival, by uneven stamps: about {1e3 * abs(largest):.1f} ms later '
            'than the readings were taken, which shifts D1 and D2: stamp them when they are taken'
        ))
    if share := rate_share(load, probes, seconds):
        how = 'interpolated from' if logger_quality.rate_before(load, probes) else 'stamped at'
        findings.append(Finding(
            f'load and probes are {how} rates that differ by {100.0 * abs(share):.3g} %: if both '
            'should have one rate, a clock drifts by '
            f'{1e3 * abs(share) * seconds:.3g} ms over the record, which shifts D1 and D2'))
    return findings


def date_findings(record: RawRecord) -> list[Finding]:
    """A finding if the date of a record is none of a test, by which others are put in order."""
    begin, apart = np.datetime64(record.start, 'ns'), (record.stop - time.time_ns()) / 1e9
    words = f'{str(begin)[:19].replace("T", " ")} UTC'
    if apart > MAX_AHEAD:
        return [Finding(
            f'begins at {words} and ends {quantity(apart, "s")} later than the clock of this '
            'machine: one of both clocks is wrong, or local time was taken for UTC: correct it, '
            'because campaigns and histories order tests by their date')]
    if record.start < EARLIEST and 'import_sources' not in record.facts.details:
        return [Finding(
            f'begins at {words}: the clock of the recorder was not set: set it (chrony, PTP), '
            'because campaigns and histories order tests by their date')]
    return []


def other_clocks(record: RawRecord, absent: str) -> list[Finding]:
    """A finding for each topic stamped by another clock than others, or by one that was set.

    And one for a load that lasts less long than the probes.
    """
    names, findings = [name for name in RIG_TOPICS if name != absent], []
    ends = np.array([record[name].stamps[[0, -1]] for name in names])
    apart = (ends - ends[0] - np.median(ends - ends[0], axis=0)) * 1e-9
    for name, (begin, end) in zip(names, apart.tolist(), strict=True):
        steps, change = np.diff(record[name].stamps) * 1e-9, end - begin
        limit = MAX_APART + 3.0 * float(np.median(steps))
        if abs(change) < limit < min(abs(begin), abs(end)):
            findings.append(Finding(
                f'begins and ends {abs(begin):.2g} s {"later" if begin > 0.0 else "earlier"} than '
                'the others: if all were recorded together, the clocks differ by this time: '
                'correct the stamps, or D1 and D2 are wrong', name))
        elif change > limit > abs(float(steps.max()) - change):
            findings.append(Finding(
                f'stamps leap by {change:.2g} s, and end so much later than those of the others: '
                'the clock was set meanwhile, and no sample is missing: correct the stamps or '
                'repeat the test, or K, n and D are wrong', name))
        elif name == LOAD_TOPIC and change < -max(limit, MIN_SHORTER):
            findings.append(Finding(
                f'lasts {-change:.2g} s less than the others, whose readings before and after it '
                'are not used: see to its driver or recorder, and record again if the test went '
                'on', name))
    return findings


def run_of_record(record: RawRecord, facts: TestMetadata, rig: Rig | None = None) -> Record:
    """Check the readings and put the probes on the load's stamps."""
    where = str(record.path)
    absent = absent_topic(rig)
    topics, guards = zip(*(_guarded_topic(record, name, rig or load_rig())
                           for name in RIG_TOPICS), strict=True)
    load, *probes = topics
    for raw in probes:
        check_overlap(where, load.stamps, raw.topic, raw.stamps)
    gaps, used, published = aligned_record(load.samples, [raw.samples for raw in probes])
    for rows in scratch.blocks(len(load), gaps, used, published):
        is_paired = a_pair_reads(gaps[:, rows])
        used[rows] &= is_paired
        published[rows] &= is_paired
    possible = _possible_record(record, rig or load_rig())
    qualities = {name: topic_quality(possible[name].stamps, possible[name].values)
                 for name in RIG_TOPICS}
    blocks = [f'the stamps of {name} {block_words(one.pause)}'
              for name, one in qualities.items() if one.pause]
    if any(one.has_equal_blocks for one in qualities.values()):
        raise BagError(f'{where}: {blocks[0]}')
    findings: list[str] = [*record.notes, *filter(None, [facts.details.get('recorder_note')])]
    if absent and rig is not None:
        findings.append(Finding(
            f'probe {rig.probes.absent} is absent (rig.probes.absent): delta_x is of probe '
            f'{rig.probes.partner} alone, with the ring taken as rigid; the parity is unknown, '
            'and causes that show in it cannot be told from others'))
    findings += [*load.notes, *_stream_findings('load', load)]
    # The partner of an absent probe has the same faults, and a note on each.
    for raw, aligned in zip(probes, gaps, strict=True):
        if raw.topic != absent:
            findings += [*raw.notes, *_probe_findings(raw, aligned)]
    for raw, guard in zip(topics, guards, strict=True):
        if raw.topic != absent:
            findings += _refused_findings(raw.topic, guard)
    findings += _moved_barrel(record)
    for name, quality in qualities.items():
        if name != absent:
            findings += quality_findings(name, quality, 'N' if name == LOAD_TOPIC else 'm')
    stamps = possible[LOAD_TOPIC].stamps
    seconds = float(stamps[-1] - stamps[0]) * 1e-9
    if seconds < MIN_SECONDS:
        noted = ''.join(f' ({note})' for note in record.notes[:1])
        raise BagError(f'{where}: lasts {quantity(seconds, "s")}, too short for a test: check the '
                       f'unit or the rate of its time{noted}')
    findings += clock_findings(
        qualities[LOAD_TOPIC], [qualities[name] for name in PROBE_TOPICS], seconds)
    findings += date_findings(record)
    findings += (apart := other_clocks(record, absent))
    if int(np.count_nonzero(used)) < MIN_SAMPLES:
        raise BagError(
            f'{where}: fewer than {MIN_SAMPLES} load stamps have readings of all four probes: '
            + (blocks or ['start and stop all recordings together'])[0])
    assert facts.test is not None
    assert facts.elevation_deg is not None
    others = {name: align(load.stamps, record[name].stamps, record[name].values)
              for name in record if name not in RIG_TOPICS}
    name = Path(where).resolve().name.removesuffix('.zstd').removesuffix('.mcap')
    return Record(
        name=name, path=record.path, test=facts.test,
        elevation=math.radians(facts.elevation_deg), rig=facts.rig, run=facts.run,
        stamps=load.stamps, time=batches.seconds_array(load.stamps, int(load.stamps[0])),
        load=load.values, gaps=gaps, notes=findings,
        spikes=_spikes(load, possible, qualities), quality=qualities, others=others,
        details=facts.details, used=used, published=published,
        probe_marks=_marks_of(guards[1:], load.stamps),
        load_marks=_marks_of(guards[:1], load.stamps, to_next=True), has_one_clock=not apart,
        absent=0 if rig is None else rig.probes.absent)


def _refused_findings(name: str, guard: SampleGuard) -> list[Finding]:
    """What the live nodes refuse of a topic, and loads that the hydraulics cannot make."""
    findings, counts = [], guard.counters.refused
    if counts:
        words = ', '.join(f'{counted_name(number, reason)}{guard.limits.words(reason)}'
                          for reason, number in counts.items())
        findings.append(Finding(
            f'{counted(sum(counts.values()), "sample is|samples are")} refused, as live nodes '
            f'do ({words}): validity marks what is interpolated across them, and '
            'identification and diagnosis leave it out', name))
    if guard.counters.doubtful_load:
        findings.append(Finding(
            f'{counted(guard.counters.doubtful_load, "sample lies|samples lie")} behind a '
            'step that the hydraulics cannot make in its time (rig.full_scale_time), as when '
            'a counter rolls over: validity marks what is simulated by them, and '
            'identification and diagnosis leave it out', name))
    return findings


def _moved_barrel(record: RawRecord) -> list[Finding]:
    lowest, _, highest = _measured_elevation(record)
    if not highest - lowest > ELEVATION_TOLERANCE_DEG:  # NaN without an inclinometer
        return []
    return [Finding(
        f'the barrel moved from {lowest:.2f} to {highest:.2f} deg, and the test counts as one '
        'at the stated elevation: repeat it with the barrel at rest', ELEVATION.name)]


def _guarded_topic(record: RawRecord, name: str, rig: Rig) -> tuple[RawTopic, SampleGuard]:
    """A topic without the readings that the live nodes refuse, and the guard that refused them.

    BagError for readings of another unit, and if too many cannot be those of this rig.
    """
    raw, limits = record[name], limits_of(name, rig)
    where = f'{record.path}: {raw.topic}'
    check_values(where, raw.stamps, raw.values)
    sound, guard = sound_samples(limits, raw.samples)
    refused = len(raw) - len(sound)
    wrong = refused + guard.counters.doubtful_load
    many = wrong > MAX_REFUSED_SHARE * len(raw)
    judged = raw.values if many or not refused else sound.values
    if name == LOAD_TOPIC:
        check_load_unit(where, judged, rig.limits)
    else:
        check_probe_unit(where, judged, raw.min_range, raw.max_range)
    if many:
        hint = '' if name == LOAD_TOPIC else unit_outside(
            raw.values, raw.min_range, raw.max_range)
        low, high = (quantity(limit, TOPICS[name].unit) for limit in (limits.low, limits.high))
        raise BagError(
            f'{where}: {wrong} of {len(raw)} readings cannot be those of the rig file (from {low} '
            f'to {high}, or change faster than rig.full_scale_time allows){hint}: give the file '
            'of this ring (--rig) or correct it, or see to the sensor')
    return replace(raw, stamps=sound.stamps, values=sound.values), guard


def _marks_of(guards: Sequence[SampleGuard], stamps: Stamps, *,
              to_next: bool = False) -> Bits | None:
    """Bits of validity that what the guards refused leaves at `stamps` (N,); None: nothing."""
    if not any(guard.bridges or guard.doubtful.stretches() for guard in guards):
        return None
    marks: Bits = scratch.scratch_array(stamps.shape, np.uint8)
    for guard in guards:
        marks |= guard.marks(stamps, to_next=to_next)
    return marks


def _possible_record(record: RawRecord, rig: Rig) -> RawRecord:
    """The same record without readings beyond the limits; single leaps stay, as spikes."""
    topics = dict(record.topics)
    for name in RIG_TOPICS:
        limits, raw = limits_of(name, rig), topics[name]
        lowest, highest = extremes(raw.values)
        if not limits.low <= lowest <= highest <= limits.high:
            is_possible = (raw.values >= limits.low) & (raw.values <= limits.high)
            topics[name] = replace(raw, stamps=scratch.scratch_copy(raw.stamps[is_possible]),
                                   values=scratch.scratch_copy(raw.values[is_possible]))
    return replace(record, topics=topics)


def _spikes(load: RawTopic, record: RawRecord, qualities: dict[str, TopicQuality]) -> Mask | None:
    """Mask (5, N) of the load's samples that a spike of the load or of a probe reaches."""
    if not any(one.spikes.size for one in qualities.values()):
        return None
    spikes = scratch.scratch_array((len(RIG_TOPICS), len(load)), np.bool_)
    for name, reached in zip(RIG_TOPICS, spikes, strict=True):
        # Mark the load's samples (N,) that are aligned with a spike among a topic's readings.
        for spike in qualities[name].spikes.tolist():
            about = slice(max(spike - batches.GAP_HISTORY - 2, 0), spike + 3)
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
