"""Refusal of impossible readings, and notes on doubtful ones of a topic or of two clocks."""

from __future__ import annotations

from collections.abc import Sequence
import math

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.doubts.finding import Finding, Kind
from saddlering_ros.errors import BagError
from saddlering_ros.quantities import quantity
from saddlering_ros.record.batches import gap_mask
from saddlering_ros.record.quality import filter_lag, median_of_known, rate_share, TopicQuality
from saddlering_ros.record.scratch import count_where, extremes, spread
from saddlering_ros.rig import LoadLimits, TONNE

LENGTH_UNITS = {
    'inches': 0.0254, 'feet': 0.3048, 'millimetres': 1e-3, 'mils': 25.4e-6, 'micrometres': 1e-6,
    'centimetres': 1e-2, 'nanometres': 1e-9}
"""Lengths [m] in which a probe may publish by mistake."""

MIN_SAMPLES = 10
"""Smallest number of samples of a topic in a test."""

MAX_SPAN = 0.1
"""Smallest gap [m] beyond any eddy-current probe, which shows another unit."""

FAR_OUTSIDE = 20.0
"""Distance of a typical gap from the probe's span, in spans, that shows another unit."""

GAPS = Kind('gaps', '{count} gap{plural} in the stamps, the longest {longest:.3f} s')

NO_READING = Kind(
    'no_reading', 'has no reading at {count} of {stamps} load stamps', threshold=0.005)
"""Share of load stamps without a reading, as at both ends of a record."""

AT_LIMIT_OF_SPAN = Kind(
    'at_limit_of_span',
    '{count} of {readings} readings are at or beyond the limits of its span ({low:g} to {high:g} '
    'm){unit}')
NO_SPAN = Kind('no_span', 'states no span (min_range, max_range)')
NEVER_CHANGES = Kind('never_changes', 'the reading never changes')

HELD = Kind(
    'held',
    '{percent:.0f} % of consecutive readings are equal: the sensor reads at about {update:.3g} Hz '
    'and is published at {rate:.4g} Hz; readings are up to {age:.3g} ms old, which shifts D1 and '
    "D2: record at the sensor's own rate")
COARSE = Kind(
    'coarse',
    'its resolution of {step} is coarser than its noise ({noise} rms): rounding counts as noise; '
    'use a finer range of the converter')
SPIKES = Kind(
    'spikes',
    '{count} of its readings are spikes, the first at sample {first}: identification and '
    'diagnosis leave them out')
STALL = Kind(
    'stall',
    '{count} equal readings in a row from {seconds:.2f} s on: the converter or the logger stopped')
AT_LIMIT = Kind(
    'at_limit',
    '{count} readings equal the {value} that no other reading exceeds: the sensor or its '
    'amplifier is at a limit')
FILTERED = Kind(
    'filtered',
    '{subject} low-passed at about {bandwidth:.2g} Hz and the other readings are not, or less: a '
    'lag of about {lag:.1f} ms, which shifts D1 and D2: give all channels the same filter')
DRIFT = Kind(
    'clock_drift',
    'load and probes are stamped at rates that differ by {percent:.3g} %: if both should have one '
    'rate, a clock drifts by {drift:.3g} ms over the record, which shifts D1 and D2')

def check_values(where: str, stamps: NDArray[np.int64], values: NDArray[np.float64]) -> None:
    """Raise BagError if any of `values` (N,) at `stamps` (N,) [ns] is NaN or infinite."""
    if count_where(np.isfinite, values) == len(values):
        return
    bad = ~np.isfinite(values)
    first = int(np.argmax(bad))
    kinds = ' and '.join(
        name for name, found in (('NaN', np.isnan(values)), ('infinite', np.isinf(values)))
        if found.any())
    raise BagError(
        f'{where}: {int(bad.sum())} of {len(values)} readings are {kinds}, first at stamp '
        f'{stamps[first]} ns ({(stamps[first] - stamps[0]) / 1e9:.3f} s into the record): check '
        'the sensor and record again')


def check_load_unit(where: str, load: NDArray[np.float64], limits: LoadLimits) -> None:
    """Raise BagError if the load (N,) cannot be newtons of a pushing cylinder of this rig."""
    low, high = map(float, extremes(load))
    shown = f'the load runs from {low:.4g} to {high:.4g} N'
    if -low > max(high, limits.negative_max):
        raise BagError(f'{where}: {shown}, mostly negative: publish a pushing load as positive')
    if high < limits.unit_min:
        guess = 'tonnes' if high <= 1.5 * limits.full_scale / TONNE else 'kilonewtons'
        raise BagError(f'{where}: {shown}, which looks like {guess}: publish newtons, load the '
                       f"ring, or correct the rig file's full_scale_load ({limits.full_scale:g} "
                       'N)')
    if high > limits.unit_max:
        raise BagError(f'{where}: {shown}, far beyond the cylinder: publish newtons, or '
                       f"correct the rig file's full_scale_load ({limits.full_scale:g} N)")


def check_probe_unit(
    where: str, gaps: NDArray[np.float64], min_range: float, max_range: float,
) -> None:
    """Raise BagError if the gaps (N,) of a probe cannot be metres."""
    typical = float(np.median(np.abs(spread(gaps))))
    if _is_span(min_range, max_range) and max_range < MAX_SPAN:
        distance = max(min_range - typical, typical - max_range, 0.0)
        limit = FAR_OUTSIDE * (max_range - min_range)
        span = f"the probe's span of {min_range:g} to {max_range:g} m"
        if distance > limit:
            raise BagError(
                f'{where}: readings around {typical:.4g} m are far outside {span} and look like '
                f'{_guess_unit(typical, min_range, max_range)}: publish metres')
        return
    if typical > MAX_SPAN:
        raise BagError(
            f'{where}: readings around {typical:.4g} m are beyond any eddy-current probe and '
            f'look like {_guess_unit(typical, 0.0, 0.01)}: publish range, min_range and '
            'max_range in metres')


def check_overlap(
    where: str, load_stamps: NDArray[np.int64], topic: str, stamps: NDArray[np.int64],
) -> None:
    """Raise BagError if a probe and the load were not recorded at the same time."""
    if stamps[0] <= load_stamps[-1] and load_stamps[0] <= stamps[-1]:
        return
    apart = (int(stamps[0]) - int(load_stamps[0])) / 1e9
    raise BagError(
        f'{where}: {topic} and the load do not overlap in time (their stamps begin '
        f'{abs(apart):.6g} s apart): synchronise the clocks, or start both recordings together')


def load_findings(stamps: NDArray[np.int64]) -> list[Finding]:
    """Faults of the stamps of the load."""
    return _gaps('load', stamps, gap_mask(stamps))


def probe_findings(
    topic: str,
    stamps: NDArray[np.int64],
    gaps: NDArray[np.float64],
    min_range: float,
    max_range: float,
    is_gap: NDArray[np.bool_],
    aligned: NDArray[np.float64],
) -> list[Finding]:
    """Faults of the readings of a probe; `aligned` (N,) are those at the stamps of the load."""
    findings = _gaps(topic, stamps, is_gap)
    absent = count_where(np.isnan, aligned)
    if absent > NO_READING.limit * len(aligned):
        findings.append(NO_READING.at(topic, count=absent, stamps=len(aligned)))
    if _is_span(min_range, max_range):
        at_limit = count_where(lambda part: (part <= min_range) | (part >= max_range), gaps)
        if at_limit:
            unit = unit_outside(gaps, min_range, max_range)
            findings.append(AT_LIMIT_OF_SPAN.at(
                topic, count=at_limit, readings=len(gaps), low=min_range, high=max_range,
                unit=unit))
    else:
        findings.append(NO_SPAN.at(topic))
    lowest, highest = extremes(gaps)
    if lowest == highest:
        findings.append(NEVER_CHANGES.at(topic))
    return findings


def _gaps(topic: str, stamps: NDArray[np.int64], is_gap: NDArray[np.bool_]) -> list[Finding]:
    count = int(is_gap.sum())
    if not count:
        return []
    before = np.flatnonzero(is_gap)
    longest = int((stamps[before + 1] - stamps[before]).max()) / 1e9
    return [GAPS.at(topic, count=count, plural='s' * (count > 1), longest=longest)]


def _is_span(low: float, high: float) -> bool:
    return math.isfinite(low) and math.isfinite(high) and low < high


def unit_outside(gaps: NDArray[np.float64], min_range: float, max_range: float) -> str:
    """Words on the unit of a probe's gaps (N,), of which most lie outside of its span."""
    typical = float(np.median(np.abs(spread(gaps))))
    if not _is_span(min_range, max_range) or min_range < typical < max_range:
        return ''
    return f' and look like {_guess_unit(typical, min_range, max_range)}'


def _guess_unit(typical: float, low: float, high: float) -> str:
    """The unit in which a typical reading lies nearest to the middle of a span in metres."""
    middle = 0.5 * (low + high)
    inside = {abs(math.log(typical * factor / middle)): name
              for name, factor in LENGTH_UNITS.items() if low < typical * factor < high}
    return inside[min(inside)] if inside else 'another unit'


def quality_findings(topic: str, quality: TopicQuality, unit: str) -> list[Finding]:
    """What makes a topic's readings doubtful."""
    findings = []
    if quality.is_held:
        findings.append(HELD.at(
            topic, percent=100.0 * quality.repeated, update=quality.update_rate,
            rate=quality.rate, age=1e3 / quality.update_rate))
    elif quality.is_coarse:
        findings.append(COARSE.at(topic, step=quantity(quality.resolution, unit),
                                  noise=quantity(quality.noise, unit)))
    if quality.spikes.size:
        findings.append(SPIKES.at(topic, count=quality.spikes.size, first=int(quality.spikes[0])))
    start, count = quality.stall
    if count:
        findings.append(STALL.at(topic, count=count, seconds=start / quality.rate))
    value, often = quality.limit
    if often:
        findings.append(AT_LIMIT.at(topic, count=often, value=quantity(value, unit)))
    return findings


def clock_findings(
    load: TopicQuality, probes: Sequence[TopicQuality], seconds: float,
) -> list[Finding]:
    """Findings on load and probes together over a record of `seconds`."""
    findings = []
    lag = filter_lag(load, probes)
    if lag:
        slow, subject = ((load.bandwidth, 'the load seems') if lag > 0.0 else
                         (median_of_known([one.bandwidth for one in probes]), 'the probes seem'))
        findings.append(FILTERED.at(subject=subject, bandwidth=slow, lag=1e3 * abs(lag)))
    share = rate_share(load, probes, seconds)
    if share:
        findings.append(DRIFT.at(percent=100.0 * abs(share), drift=1e3 * abs(share) * seconds))
    return findings
