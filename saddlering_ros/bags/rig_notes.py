"""Doubtful properties of a test on its rig: its zero, its kind, the units of its readings.

Units are judged by what the rig must show: a test begins at the rig's preload, and a probe
publishes the span that the rig file gives. A note says what a record looks like; it is read as it
stands.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.quantities import quantity
from saddlering_ros.record.checks import LENGTH_UNITS
from saddlering_ros.record.plateaus import find_holds
from saddlering_ros.record.scratch import complete_rows, count_where, extremes
from saddlering_ros.rig import gap_increment, Rig, zero_of_record

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
