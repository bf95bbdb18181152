"""Doubtful properties of a test on its rig: its zero, its kind, the units of its readings.

Units are judged by what the rig must show: a test begins at the rig's preload, and a probe
publishes the span that the rig file gives. A note says what a record looks like; it is read as it
stands.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.doubts.comparison import rig_in_words
from saddlering_ros.doubts.readings import LENGTH_UNITS
from saddlering_ros.doubts.wiring import wiring_notes
from saddlering_ros.quantities import quantity
from saddlering_ros.record.displacement import displacement_of_run
from saddlering_ros.record.plateaus import find_holds
from saddlering_ros.record.record import RawRecord, Record
from saddlering_ros.record.scratch import complete_rows, count_where, extremes
from saddlering_ros.record.topics import PROBE_TOPICS
from saddlering_ros.rig import gap_increment, Rig, short_digest, zero_of_record

Floats = NDArray[np.float64]

FORCE_UNITS = {'kgf': 9.80665, 'daN': 10.0, 'lbf': 4.4482216, 'kips': 4448.2216}

UNIT_TOLERANCE = 0.03
"""Largest deviation of a ratio from that of a unit for the note."""

PEAK_TOLERANCE = 1.1
"""Share of full scale, in another unit, below which its record stays, and above ..."""

PEAK_SHARE = 0.3

PARTS = 20
"""Parts of a record over which the parity is averaged."""

MIN_HOLDS = 8
MIN_HELD_SHARE = 0.6
"""Number of holds, and share of its time in them, with which a dynamic record looks static."""


PARITY_SHARE = 0.004
"""Share of the largest motion by which the parity may follow the load without a note."""

PARITY_ERRORS = 5.0
"""... and so many standard deviations of its means over a twentieth of the record."""


MIN_LINE_SAMPLES = 200
LINE_REACH = 12
"""Lines of the spectrum on either side of one with which it is compared ..."""

LINE_RATIO = 60.0
"""... and by what factor its power exceeds their median. Chance: once in 1e14 records."""


def parity_notes(rig: Rig, load: Floats, gaps: Floats) -> list[str]:
    """One line if the parity of the radial probes in gaps (4, N) [m] follows the load (N,) [N].

    The parity (d1 + d3)/2 of a rigid ring is zero with any contact.
    """
    load, gaps = complete_rows(load, gaps)
    count = len(load) // PARTS
    if count < 5 or float(np.ptp(load)) < 0.1 * rig.full_scale_load:
        return []
    increments = gap_increment(rig.probes, gaps, gaps[:, 0])
    rows = np.stack([*increments, 0.5 * (increments[0] + increments[2]), load])
    means = rows[:, :PARTS * count].reshape(6, PARTS, count).mean(axis=2)
    parity, force = means[4], means[5]
    slope, start = np.polyfit(force, parity, 1)
    moved = abs(float(slope)) * float(np.ptp(force))
    spread = float(np.std(parity - start - slope * force, ddof=2))
    if moved < max(PARITY_SHARE * float(np.ptp(means[:4], axis=1).max()), PARITY_ERRORS * spread):
        return []
    return [f'the parity of probes 1 and 3 follows the load by {quantity(moved, "m", digits=2)}; '
            'that of a rigid ring is constant: cross-talk, a gain, a bracket or the ring itself '
            '(diagnose reports which)']


def line_notes(rig: Rig, seconds: float, load: Floats, gaps: Floats) -> list[str]:
    """One line if the parity of the radial probes holds an oscillation of one frequency.

    gaps (4, N) [m] over `seconds`. The ring's own vibration leaves the parity as it is: what
    shows there is picked up, or a vibration of the frame, or what lies above half the sampling
    rate and is folded below it.
    """
    _, gaps = complete_rows(load, gaps)
    if gaps.shape[1] < MIN_LINE_SAMPLES:
        return []
    increments = gap_increment(rig.probes, gaps, gaps[:, 0])
    parity = 0.5 * (increments[0] + increments[2])
    window = np.hanning(parity.size)
    power = np.abs(np.fft.rfft((parity - parity.mean()) * window)) ** 2
    usual = _median_about(power)
    place = int(np.argmax(power[LINE_REACH:-LINE_REACH] / usual)) + LINE_REACH
    size = 4.0 * math.sqrt(power[place]) / parity.size
    noise = float(np.std(np.diff(parity))) / math.sqrt(2.0)
    if power[place] < LINE_RATIO * usual[place - LINE_REACH] or size < noise:
        return []
    return [f'the parity of probes 1 and 3 oscillates by {quantity(size, "m", digits=2)} at '
            f'{quantity(place / seconds, "Hz")}, which a rigid ring cannot: mains pickup, '
            'a vibration of '
            'the probes, or one above half the sampling rate that is seen at a wrong frequency '
            '(aliasing): filter before sampling']


def _median_about(power: Floats) -> Floats:
    """The median of the lines about each, those next to it left out; none for the outermost."""
    windows = np.lib.stride_tricks.sliding_window_view(power, 2 * LINE_REACH + 1)
    beside = np.abs(np.arange(-LINE_REACH, LINE_REACH + 1)) > 2
    return np.asarray(np.maximum(np.median(windows[:, beside], axis=1), 1e-300))


def rig_notes(
    rig: Rig, test: str, time: Floats, load: Floats, spans: list[tuple[float, float]],
) -> list[str]:
    """One line each for a test of a kind on a rig; spans [m] as the probes publish them."""
    if count_where(np.isfinite, load) < len(load):
        kept = np.isfinite(load)
        time, load = time[kept], load[kept]
    return [*_unit_of_load(rig, time, load), *_unit_of_probes(rig, spans),
            *_kind(test, time, load)]


def _unit_of_load(rig: Rig, time: Floats, load: Floats) -> list[str]:
    zero = zero_of_record(rig, time, load)
    start, peak = zero.load, float(extremes(load)[1])
    looks = [
        name for name, factor in FORCE_UNITS.items()
        if rig.preload > 0.0 and abs(start * factor / rig.preload - 1.0) < UNIT_TOLERANCE
        and PEAK_SHARE < peak * factor / rig.full_scale_load < PEAK_TOLERANCE
    ]
    if looks:
        return [f'the load begins at {start:.4g} and ends at {peak:.4g} at most, which looks like '
                f'{" or ".join(looks)} (the preload is {rig.preload:.4g} N): publish newtons, or '
                f'K comes out about {FORCE_UNITS[looks[0]]:.2g} times too small']
    if peak > PEAK_TOLERANCE * rig.full_scale_load:
        return [f'the load reaches {rig.force_words(peak)} and the full scale is '
                f'{rig.force_words(rig.full_scale_load)}: the unit or the gain of the load, or '
                'full_scale_load of the rig file, is wrong']
    if not zero.near_preload:
        return [f'the record starts at {rig.force_words(start)}, which is not near the preload '
                f'({rig.force_words(rig.preload)}): displacements count from there']
    return []


def _unit_of_probes(rig: Rig, spans: list[tuple[float, float]]) -> list[str]:
    notes = []
    wanted = rig.probes.max_range
    for number, (_, high) in enumerate(spans, start=1):
        if not math.isfinite(high) or abs(high / wanted - 1.0) < UNIT_TOLERANCE:
            continue
        looks = [name for name, factor in LENGTH_UNITS.items()
                 if abs(high * factor / wanted - 1.0) < UNIT_TOLERANCE]
        if looks:
            notes.append(
                f'probe {number} publishes a span up to {high:.4g} m and the rig file gives '
                f'{wanted:.4g} m, which looks like {looks[0]}: publish metres')
    return notes


def _kind(test: str, time: Floats, load: Floats) -> list[str]:
    if test != 'dynamic':
        return []
    holds = find_holds(time, load)
    held = sum(float(time[stop - 1] - time[start]) for start, stop in holds)
    if len(holds) < MIN_HOLDS or held < MIN_HELD_SHARE * float(time[-1] - time[0]):
        return []
    return [f'the load is held at {len(holds)} levels, which looks like a static test: give '
            '--test static, or correct the metadata of the bag']


MAX_ELEVATION_ERROR = math.radians(20.0)
"""Accuracy [degrees] of the elevation from tilt over lift, on sound rings of 48 and 97 rollers."""

MAX_OVERLOAD, MIN_PEAK = 1.05, 0.5
"""Shares of the full scale between which the highest load of a test lies."""

MAX_START_ERROR = 0.04
"""Share of the full scale by which a record may start beside the preload."""


def check_rig(rig: Rig, record: RawRecord, run: Record) -> list[str]:
    """One line for each contradiction between bag and rig; [] if there is none."""
    return [*_hash(rig, run), *_ranges(rig, record), *_loads(rig, run),
            *wiring_notes(rig, run.elevation, run.load, run.gaps), *_elevation(rig, run)]


def apparent_elevation(rig: Rig, run: Record) -> float | None:
    """The elevation [rad] that tilt over lift gives, from 0 to pi; None if neither moves.

    The axial rows, radius R, turn a force F_y and a moment M into delta_y = F_y / k and
    gamma = 2 M / (k R^2), whatever their stiffness k; M / F_y = -(y_t cot(theta) + x_t). Slopes
    are taken over the upper half of the load, where the clearance is taken up.
    """
    measured = displacement_of_run(rig, run)
    kept = run.complete & (run.load > 0.5 * (run.load.max() + run.load.min()))
    load = run.load[kept]
    if len(load) < 10 or np.ptp(load) < 0.05 * rig.full_scale_load or not rig.trunnion.y:
        return None
    around = load - load.mean()
    lift, tilt = (float(around @ np.asarray(getattr(measured.displacement, name))[kept])
                  for name in ('delta_y', 'gamma'))
    if lift == 0.0:
        return None
    cotangent = (-tilt / lift * rig.axial_rows.pitch_radius ** 2 / 2.0
                 - rig.trunnion.x) / rig.trunnion.y
    return math.atan2(1.0, cotangent)


def _hash(rig: Rig, run: Record) -> list[str]:
    if not run.rig_hash or run.rig_hash == rig.digest:
        return []
    return [f'it was recorded on a rig with the hash {short_digest(run.rig_hash)}, and this rig '
            f'is another ({rig_in_words(rig)})']


def _ranges(rig: Rig, record: RawRecord) -> list[str]:
    probes = rig.probes
    lines = []
    for number in probes.present:
        raw = record[PROBE_TOPICS[number - 1]]
        stated = (raw.min_range, raw.max_range)
        if not np.allclose(stated, (probes.min_range, probes.max_range), rtol=1e-3, atol=1e-9):
            lines.append(
                f'probe {number} states a range of {stated[0] * 1e3:g} to {stated[1] * 1e3:g} mm, '
                f'the rig file {probes.min_range * 1e3:g} to {probes.max_range * 1e3:g} mm '
                '(rig.probes.min_range, max_range)')
        low, high = map(float, extremes(raw.values))
        if low < probes.min_range or high > probes.max_range:
            lines.append(f'probe {number} reads {low * 1e3:.3f} to {high * 1e3:.3f} mm, outside '
                         'of the range in the rig file (rig.probes.min_range, max_range)')
    return lines


def _loads(rig: Rig, run: Record) -> list[str]:
    peak, start = float(np.nanmax(run.load)), float(np.nanmedian(run.load[:10]))
    full = rig.full_scale_load
    lines = []
    if not MIN_PEAK * full <= peak <= MAX_OVERLOAD * full:
        lines.append(f'the highest load is {rig.force_words(peak)}, the full scale in the rig '
                     f'file {rig.force_words(full)} (rig.full_scale_load)')
    if abs(start - rig.preload) > MAX_START_ERROR * full:
        lines.append(f'the record starts at {rig.force_words(start, 2)}, the preload in the rig '
                     f'file is {rig.force_words(rig.preload, 2)} (rig.preload)')
    return lines


def _elevation(rig: Rig, run: Record) -> list[str]:
    found = apparent_elevation(rig, run)
    if found is None:
        return []
    apart = (found - run.elevation + math.pi / 2.0) % math.pi - math.pi / 2.0
    if abs(apart) <= MAX_ELEVATION_ERROR:
        return []
    return ['tilt and axial motion agree with an elevation of about '
            f'{math.degrees(run.elevation + apart):.0f} '
            f'deg and the bag states {math.degrees(run.elevation):g}: the elevation, the trunnion '
            "(rig.trunnion), the probes' span (rig.probes.axial_span) or the pitch radius "
            '(rig.axial_rows.pitch_radius) is wrong']
