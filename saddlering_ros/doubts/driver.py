"""Faults of a driver of the rig, from some seconds of its topics; no ROS in it."""

from collections.abc import Mapping
from dataclasses import dataclass
import math

import numpy as np

from saddlering_ros.doubts import FAULT, Finding
from saddlering_ros.doubts.on_rig import units_of_preload
from saddlering_ros.doubts.readings import block_words
from saddlering_ros.doubts.units import check_load_unit, check_probe_unit
from saddlering_ros.doubts.wiring import MIN_LOAD_SPAN, wiring_findings
from saddlering_ros.errors import BagError, counted
from saddlering_ros.quantities import quantity
from saddlering_ros.record.batches import align, Floats, gap_mask, Samples, Stamps
from saddlering_ros.record.guard import limits_of, load_limits, SampleGuard
from saddlering_ros.record.quality import between_blocks, white_noise
from saddlering_ros.record.topics import LOAD, LOAD_TOPIC, PROBE_TOPICS, PROBES, RigTopic
from saddlering_ros.rig import Rig
from saddlering_ros.rig.geometry import mirrored_gap

MIN_SAMPLES = 20
"""Fewer samples of a topic cannot be judged."""

RATE_TOLERANCE = 0.05
"""Share by which a rate may differ from the one wanted, and arrival from the stamps."""

FRESHEST = 0.02
"""Share of the samples of a topic that are fresher when they arrive: the last of each block."""

CLOCK_LIMIT, SKEW_LIMIT = 1.0, 0.010
"""Stamps that differ from the clock of this machine, or those of a probe from the load's by the
time of arrival, by more [s] are of another clock."""

SHARED_STAMPS = 0.2
"""Share of samples with the stamp of the one before that shows stamps of whole blocks."""

SPAN_TOLERANCE, NARROW_MARGIN = 0.01, 0.1
"""Shares of the span by which a published range may differ from that of the rig file, and by which
a gap at rest should be further from both ends."""

MOVED = 50.0
"""Readings that spread by more than this many standard deviations of their noise have moved."""


@dataclass(frozen=True, kw_only=True)
class HeardTopic(Samples):
    """Samples received on one topic of the rig, in order of arrival."""

    arrivals: Stamps  # (N,) [ns] by the clock of this machine
    frame_id: str = ''
    publishers: int = 1  # how many there were
    types: tuple[str, ...] = ()  # under which the topic was found

    @property
    def rate(self) -> float:
        """Samples a second by the stamps; NaN if the stamps do not rise."""
        steps = np.diff(self.stamps)
        steps = steps[steps > 0]
        return 1e9 / float(np.median(steps)) if len(steps) else math.nan

    @property
    def delay(self) -> float:
        return delay_of(self.stamps, self.arrivals)

    @property
    def in_order(self) -> tuple[Stamps, Floats]:
        """Stamps, each once and in order, and the finite readings at them."""
        kept = np.isfinite(self.values) & (self.stamps > 0)
        stamps, first = np.unique(self.stamps[kept], return_index=True)
        return stamps, self.values[kept][first]


def delay_of(stamps: Stamps, arrivals: Stamps) -> float:
    """Time from stamp to arrival [s] of the freshest samples of a topic; NaN if there are none."""
    if not len(stamps):
        return math.nan
    return float(np.quantile(arrivals - stamps, FRESHEST)) / 1e9


def shared_words(steps: Stamps | Floats) -> str:
    """What is said of samples with steps (N,) of which many have one stamp; '' of others."""
    shared = int((steps == 0).sum())
    return (f'{shared} of {len(steps)} samples have the stamp of the one before: stamp each '
            'sample of a block with its own time') * (shared > SHARED_STAMPS * len(steps))


def skew_findings(delays: Mapping[str, float]) -> list[Finding]:
    """A fault for each probe stamped by another clock than the load; delays [s] by topic."""
    skews = {name: delay - delays[LOAD_TOPIC] for name, delay in delays.items()}
    return [Finding(f'stamps are {quantity(abs(skew), "s", digits=2)} '
                    f'{"older" if skew > 0.0 else "younger"} than those of the load that '
                    'arrive with them: use one clock for both, and stamp with the time of '
                    'measurement', name, FAULT)
            for name, skew in skews.items() if abs(skew) > SKEW_LIMIT]


def machine_findings(delays: Mapping[str, float]) -> list[Finding]:
    """A fault for each topic stamped by another clock than this machine's; delays [s] by topic."""
    return [Finding(f'stamps are {quantity(abs(delay), "s")} '
                    f'{"behind" if delay > 0.0 else "ahead of"} the clock of this machine: '
                    'synchronise the clocks (chrony, PTP), or stamp in UTC', name, FAULT)
            for name, delay in delays.items() if abs(delay) > CLOCK_LIMIT]


class _Findings(list[Finding]):
    """Findings; `where`: the topic that is judged."""

    where = ''

    def fault(self, words: str) -> None:
        self.append(Finding(words, self.where, FAULT))

    def note(self, words: str) -> None:
        self.append(Finding(words, self.where))


def check_driver(rig: Rig, heard: Mapping[str, HeardTopic], elevation: float,
                 rate: float | None = None) -> list[Finding]:
    """Faults and notes on the topics `heard` (by name, the five of a rig), faults first.

    elevation [rad]: decides the direction in which a load moves each probe; rate [Hz]: required.
    """
    findings, usable = _Findings(), True
    probes = [PROBES[number - 1] for number in rig.probes.present]
    for topic in (LOAD, *probes):
        findings.where = topic.name
        one = heard.get(topic.name)
        if one is not None and len(one) >= MIN_SAMPLES:
            _stamps(findings, topic, one, rate)
            _values(findings, rig, topic, one)
            continue
        usable = False
        wrong = [] if one is None else [kind for kind in one.types if kind != topic.type]
        if wrong:
            findings.fault(f'is published as {wrong[0]}: publish {topic.type}')
        elif one is None or not one.publishers:
            findings.fault('it has no publisher: start the driver, or remap its topic')
        else:
            findings.fault(
                f'{counted(len(one), "sample")} came from {counted(one.publishers, "publisher")}: '
                'check that the driver reads its device, or listen longer')
    if usable:
        names = [topic.name for topic in probes]
        findings += skew_findings({name: heard[name].delay for name in (LOAD_TOPIC, *names)})
        findings.where = min(names, key=lambda name: heard[name].rate)
        slowest, of_load = heard[findings.where].rate, heard[LOAD_TOPIC].rate
        if slowest < 0.5 * of_load:
            findings.note(f'comes at {slowest:.4g} Hz and the load at {of_load:.4g} Hz: '
                          'damping is known better with equal rates')
        _load(findings, rig, heard[LOAD_TOPIC])
        _directions(findings, rig, heard, elevation)
    return sorted(findings, key=lambda one: one.severity != FAULT)


def _stamps(findings: _Findings, topic: RigTopic, one: HeardTopic, rate: float | None) -> None:
    """Faults of the source of a topic and of its stamps."""
    if one.publishers > 1:
        findings.fault(f'{one.publishers} publishers, whose samples are mixed: end all but one')
    if one.frame_id != topic.frame_id:
        findings.note(f'frame_id is {one.frame_id!r}: set it to {topic.frame_id!r}')
    unset = int((one.stamps <= 0).sum())
    if unset:
        findings.fault(f'{unset} of {len(one)} stamps are not set: stamp each sample '
                       'with the time of its measurement')
        return
    steps = np.diff(one.stamps)
    shared, back = int((steps == 0).sum()), int((steps < 0).sum())
    if words := shared_words(steps):
        findings.fault(words)
        return
    if shared:
        findings.fault(f'{counted(shared, "sample has|samples have")} the stamp of the one before')
    if back:
        findings.fault(f'{counted(back, "stamp goes|stamps go")} back: publish samples in the '
                       'order of their measurement')
        return
    pause, are_blocks = between_blocks(steps, float(np.median(steps)))
    if are_blocks:
        findings.fault(f'stamps {block_words(pause / 1e9)}')
        return
    gaps = gap_mask(one.stamps)
    if gaps.any():
        longest = float(steps[gaps].max()) / 1e9
        findings.fault(f'{counted(int(gaps.sum()), "gap")} in the stamps, longest {longest:.3g} '
                       's: samples are lost in the driver or on the way (best effort on a busy '
                       'network)')
    if rate is not None and abs(one.rate / rate - 1.0) > RATE_TOLERANCE:
        findings.fault(f'comes at {one.rate:.4g} Hz, and {rate:g} Hz is required')
    # The freshest of a quarter counts: a sample may wait for a busy machine, and the first ones
    # for whoever listens.
    quarters = np.array_split(one.arrivals - one.stamps, 4)
    stamped = 0.5 * float(one.stamps[-1] - one.stamps[0])
    arrived = stamped + float(quarters[3].min() - quarters[1].min())
    if not gaps.any() and arrived > 0.5e9 and abs(stamped / arrived - 1.0) > RATE_TOLERANCE:
        findings.fault(f'stamps advance by {stamped / 1e9:.3g} s in {arrived / 1e9:.3g} s: the '
                       'stamps are not times, or the driver falls behind')
    findings += machine_findings({topic.name: one.delay})


def _values(findings: _Findings, rig: Rig, topic: RigTopic, one: HeardTopic) -> None:
    values = one.values[np.isfinite(one.values)]
    if len(values) < len(one):
        findings.fault(f'{len(one) - len(values)} of {len(one)} readings are not '
                       'numbers: leave out what was not measured')
    if not len(values):
        return
    if (values == values[0]).all():
        findings.fault(f'the reading never changes ({values[0]:.6g} {topic.unit}): '
                       'a sensor has noise; check that it is connected')
    guard = SampleGuard(limits_of(topic.name, rig))
    guard.push(Samples(one.stamps, one.values))
    counts = guard.counters
    impossible = counts.impossible + counts.leaps_of_reading + counts.doubtful_load
    if impossible and not _in_other_unit(findings, rig, topic, values):
        findings.fault(f'{counted(impossible, "reading")} that this rig cannot have (from '
                       f'{values.min():.4g} to {values.max():.4g} {topic.unit}): the nodes refuse '
                       'them; look for spikes, the unit and the rig file')
    if topic is LOAD:
        return
    low, high = rig.probes.min_range, rig.probes.max_range
    span = high - low
    if not one.high > one.low:
        findings.note(f'states no range: fill in min_range {low:g} and max_range {high:g}')
    elif max(abs(one.low - low), abs(one.high - high)) > SPAN_TOLERANCE * span:
        findings.fault(f'its range is {one.low:.4g} to {one.high:.4g} m and that of '
                       f'the rig file {low:.4g} to {high:.4g} m: correct one of them')
    ended = int(((values <= low) | (values >= high)).sum())
    margin = min(float(np.median(values)) - low, high - float(np.median(values)))
    if ended:
        findings.fault(f'{ended} of {len(values)} readings at or beyond an end '
                       'of the range: check the position and the unit of the probe')
    elif margin < NARROW_MARGIN * span:
        findings.note(f'the gap is {margin * 1e3:.3g} mm from an end of the range: '
                      'move the probe to the middle')


def _in_other_unit(findings: _Findings, rig: Rig, topic: RigTopic, values: Floats) -> bool:
    """Whether the readings as a whole are in another unit, which is then a finding."""
    try:
        if topic is LOAD:
            check_load_unit('', values, rig.limits)
        else:
            check_probe_unit('', values, rig.probes.min_range, rig.probes.max_range)
    except BagError as problem:
        findings.fault(str(problem).removeprefix(': '))
        return True
    return False


def _load(findings: _Findings, rig: Rig, one: HeardTopic) -> None:
    findings.where = LOAD_TOPIC
    values = one.values[np.isfinite(one.values)]
    low, high = (float(values.min()), float(values.max())) if len(values) else (-math.inf, 0.0)
    if low < load_limits(rig).low:
        return  # these readings are refused, which is a finding already
    if low < -rig.limits.negative_max:
        findings.fault(f'the load falls to {low:.4g} N: publish a pushing load as '
                       'positive, and zero the load cell')
    elif high < rig.limits.unit_min and high - low > MOVED * white_noise(values):
        _in_other_unit(findings, rig, LOAD, values)
    elif units := units_of_preload(rig, least := min(
            float(part.mean()) for part in np.array_split(values, min(MIN_SAMPLES, len(values))))):
        findings.note(f'the load is {least:.4g} N at least, which is the preload in '
                      f'{" or ".join(units)} ({rig.preload:.4g} N): publish newtons')
    elif high < rig.limits.unit_min:
        findings.note(f'the load is {low:.4g} to {high:.4g} N: at rest without preload, or not in '
                      f'newtons; sign and unit are known from {rig.preload:.4g} N on')


def _directions(findings: _Findings, rig: Rig, heard: Mapping[str, HeardTopic],
                elevation: float) -> None:
    """Check polarity, order of channels and sign of the load if the load moved enough."""
    stamps, values = heard[LOAD_TOPIC].in_order
    least = MIN_LOAD_SPAN * rig.full_scale_load
    if len(values) < MIN_SAMPLES or float(np.ptp(values)) < least:
        findings.note('the load did not move: polarity, order of the probes and sign of the load '
                      f'are not checked; move it by {rig.force_words(least)} meanwhile')
        return
    probes = rig.probes
    gaps = np.stack([align(stamps, *heard[PROBE_TOPICS[number - 1]].in_order)
                     for number in probes.present])
    if probes.absent:
        other = gaps[probes.partner_row]
        gaps = np.insert(gaps, probes.absent - 1, mirrored_gap(probes, other), axis=0)
    findings += [Finding(finding.words, 'probes', FAULT)
                 for finding in wiring_findings(rig, elevation, values, gaps)]
