"""Doubtful properties of a test on its rig: its zero, its kind, the units of its readings.

Units are judged by what the rig must show: a test begins at the rig's preload, and a probe
publishes the span that the rig file gives. A note says what a record looks like; it is read as it
stands.
"""

from dataclasses import replace
import math

import numpy as np

from saddlering_ros.doubts import Finding
from saddlering_ros.doubts.comparison import rig_in_words
from saddlering_ros.doubts.units import LENGTH_UNITS
from saddlering_ros.doubts.wiring import exchange_findings, wiring_findings
from saddlering_ros.quantities import quantity
from saddlering_ros.record.batches import Floats
from saddlering_ros.record.plateaus import find_holds
from saddlering_ros.record.record import RawRecord, Record
from saddlering_ros.record.scratch import complete_rows, count_where, extremes
from saddlering_ros.record.topics import PROBE_TOPICS
from saddlering_ros.rig import geometry, Rig, short_digest, TRUE_TO_SCALE
from saddlering_ros.rig.geometry import gap_increment, MIN_SAMPLES, zero_of_record

FORCE_UNITS = {
    'kgf': 9.80665, 'daN': 10.0, 'lbf': 4.4482216, 'kips': 4448.2216, 'kN': 1e3, 't': 9806.65}

UNIT_TOLERANCE = 0.03
"""Largest deviation of a ratio from that of a unit for the note: 25 bags start within 1.4 % of
their preload."""

PEAK_SHARE = 0.3
"""Share of full scale, in another unit, which the highest load reaches."""

PARTS, PARITY_ERRORS = 20, 5.0
"""Parts of a record over which the parity is averaged, and standard deviations of these means by
which the parity may follow the load."""

MIN_HOLDS = 8
"""Number of holds with which a dynamic record looks static."""

MAX_FOLLOWING = 0.004
"""Share of the largest motion by which the parity may follow the load, or change (rms) beside it.
In 17 bags with sound probes it follows by 0.0016 at most, with a probe of twice the usual error of
gain by 0.014. Beside it 40 sound bags have 0.0003, a clock of one probe that is 50 ms off 0.008 in
a ramp of 1 s, and one of 0.5 s 0.03 in a ramp of 4 s."""

MIN_LINE = 60.0
"""Ratio of the power of a line of the spectrum to the median about it. One of 1 000 records of
white noise reaches it, with a line of a fifth of the noise; the line must also exceed the noise.
Bags of the virtual rig stay below 36."""

OVERLOAD = 1.1
"""Share of the full scale, in any unit, below which the highest load stays."""

TOO_FAST = 1.2
"""Rate of the load, as a multiple of full scale in rig.full_scale_time, that no rise exceeds
between a quarter and three quarters of the range, over MIN_SAMPLES samples and more."""

OFF_WHOLE = 0.03
"""Distance [deg] from a whole number of degrees of an elevation that was stated in radians, with
three decimals or more."""

STATIC_SHARE = 0.6
"""Share of its time in holds with which a dynamic record looks static."""

MIN_LINE_SAMPLES, LINE_REACH = 200, 12
"""Samples that show a line of the spectrum, and lines on either side with which it is compared."""

MIN_PEAK = 0.5
"""Share of the full scale that the highest load of a test reaches: a plan's tests reach all of it,
and below a tenth (`wiring.MIN_LOAD_SPAN`) not even the wiring can be seen."""

OFF_PRELOAD = 0.04
"""Share of the full scale by which a record may start beside the preload."""

MIN_ZERO = 0.5
"""Share of the preload that a zero at the preload has. 25 bags start within 1.4 % of it; with a
tare at the preload, or without pressure, a record starts at zero."""

MAX_TURN = math.radians(10.0)
"""Error [rad] of the elevation from tilt over lift against that of the nearest simulated ring,
beside what the curvature of the two adds. 19 sound rings of another simulator stay within it."""

EXPECTED_LOADS, MAX_ROWS = 200, 20_000
"""Loads at which the ring is simulated, at rest; and rows of a record that are enough."""

STEP = 20
"""Steps [deg] of other elevations with which a test is compared."""

MAX_MOTION = 1.5
"""Motion of a ring over that of a simulated one which it may be: below 1.0 in 112 tests of sound
virtual rings. With it 19 of 28 at 30 degrees do not pass for 70, without it 2."""

STIFFNESSES = 24
"""Contact stiffnesses K1 of the simulated rings, between the bounds of the rig. At 70 degrees a
stiff ring hardly takes up its clearance, and tilt over lift gives 67 to 22 degrees."""

USUAL_SHIFT = math.radians(2.5)
"""By which clearances lower the elevation that tilt over lift gives: -0.7 to 4.3 degrees in 46
drawn sound rings at 0 to 50 degrees. At 70 the clearance is hardly taken up, and it is 4 to 37."""

SURE_WITHIN, SURE_LIMIT = math.radians(3.0), math.radians(25.0)
"""Uncertainty [rad] up to which the data can tell it (below 3 degrees in these 46 rings, above 4.5
in all 14 at 70), and the error of the elevation from which on no cause of the catalogue imitates
it: of 32, each of its largest plausible size, unequal rows turn it furthest, by 21 degrees."""


def findings_on_rig(rig: Rig, run: Record, record: RawRecord) -> list[Finding]:
    """Probable faults of a run on this rig: wiring, zero, kind, units."""
    spans = [(record[name].min_range, record[name].max_range) for name in PROBE_TOPICS]
    findings = wiring_findings(rig, run.elevation, run.load, run.gaps)
    if not findings and run.has_one_clock:
        findings = _elevation(rig, run, must_be_sure=True)
        if not rig.probes.absent:
            findings += [*parity_findings(rig, run.load, run.gaps),
                         *line_findings(rig, float(run.time[-1]), run.load, run.gaps)]
    stated, radians = math.degrees(run.elevation), math.degrees(math.degrees(run.elevation))
    if (abs(stated) <= math.pi / 2.0 + 1e-3 and abs(stated - round(stated, 2)) >= 1e-6
            and abs(radians - round(radians)) <= OFF_WHOLE):
        findings.append(Finding(
            f'the elevation of {stated:g} deg looks like radians: give --elevation {radians:.0f}, '
            'or correct the metadata of the bag'))
    return [*findings, *exchange_findings(rig, run.time, run.load, run.gaps),
            *rig_findings(rig, run.test, run.time, run.load, spans)]


def parity_findings(rig: Rig, load: Floats, gaps: Floats) -> list[Finding]:
    """One finding if the parity of the radial probes in gaps (4, N) [m] moves, load (N,) [N].

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
    # Means over minutes of cycles hide most of the motion.
    largest = float(np.ptp(np.percentile(increments, [1.0, 99.0], axis=1), axis=0).max())
    if moved < max(MAX_FOLLOWING * largest, PARITY_ERRORS * spread):
        noise = float(np.std(np.diff(increments[0] + increments[2]))) / math.sqrt(8.0 * count)
        return [] if spread < max(MAX_FOLLOWING * largest, PARITY_ERRORS * noise) else [Finding(
            f'the parity of probes 1 and 3 changes by {quantity(spread, "m", digits=2)} rms, and '
            'not with the load; that of a rigid ring is constant: a clock, a delay or a drift of '
            'one of them (diagnose reports which)')]
    return [Finding(
        f'the parity of probes 1 and 3 follows the load by {quantity(moved, "m", digits=2)}; that '
        'of a rigid ring is constant: cross-talk, a gain, a bracket or the ring itself (diagnose '
        'reports which)')]


def line_findings(rig: Rig, seconds: float, load: Floats, gaps: Floats) -> list[Finding]:
    """One finding if the parity of the radial probes holds an oscillation of one frequency.

    gaps (4, N) [m] over `seconds`. A vibration of the ring does not change the parity. The cause
    is a pickup, a vibration of the frame, or a frequency above half the sampling rate (aliasing).
    """
    _, gaps = complete_rows(load, gaps)
    if gaps.shape[1] < MIN_LINE_SAMPLES:
        return []
    increments = gap_increment(rig.probes, gaps, gaps[:, 0])
    parity = 0.5 * (increments[0] + increments[2])
    window = np.hanning(parity.size)
    power = np.abs(np.fft.rfft((parity - parity.mean()) * window)) ** 2
    # The median of the lines about each, those next to it left out; none for the outermost.
    windows = np.lib.stride_tricks.sliding_window_view(power, 2 * LINE_REACH + 1)
    beside = np.abs(np.arange(-LINE_REACH, LINE_REACH + 1)) > 2
    usual = np.asarray(np.maximum(np.median(windows[:, beside], axis=1), 1e-300))
    place = int(np.argmax(power[LINE_REACH:-LINE_REACH] / usual)) + LINE_REACH
    size = 4.0 * math.sqrt(power[place]) / parity.size
    noise = float(np.std(np.diff(parity))) / math.sqrt(2.0)
    if power[place] < MIN_LINE * usual[place - LINE_REACH] or size < noise:
        return []
    return [Finding(
        f'the parity of probes 1 and 3 oscillates by {quantity(size, "m", digits=2)} at '
        f'{quantity(place / seconds, "Hz")}, which a rigid ring cannot: mains pickup, a vibration '
        'of the probes, or one above half the sampling rate that is seen at a wrong frequency '
        '(aliasing): filter before sampling')]


def rig_findings(rig: Rig, test: str, time: Floats, load: Floats,
                 spans: list[tuple[float, float]]) -> list[Finding]:
    """Findings on a test of a kind on a rig; spans [m] as the probes publish them."""
    if count_where(np.isfinite, load) < len(load):
        kept = np.isfinite(load)
        time, load = time[kept], load[kept]
    findings = [*_unit_of_load(rig, time, load), *_unit_of_time(rig, time, load)]
    wanted = rig.probes.max_range
    for number, (_, high) in enumerate(spans, start=1):
        looks = [name for name, factor in LENGTH_UNITS.items() if _is_near(high * factor, wanted)]
        if looks and not _is_near(high, wanted):
            findings.append(Finding(
                f'probe {number} publishes a span up to {high:.4g} m and the rig file gives '
                f'{wanted:.4g} m, which looks like {looks[0]}: publish metres', units=looks[0]))
    if test == 'dynamic':
        holds = find_holds(time, load)
        held = sum(float(time[stop - 1] - time[start]) for start, stop in holds)
        if len(holds) >= MIN_HOLDS and held >= STATIC_SHARE * float(time[-1] - time[0]):
            findings.append(Finding(
                f'the load is held at {len(holds)} levels, which looks like a static test: give '
                '--test static, or correct the metadata of the bag'))
    return findings


def _is_near(value: float, wanted: float) -> bool:
    return abs(value / wanted - 1.0) < UNIT_TOLERANCE


def units_of_preload(rig: Rig, load: float) -> list[str]:
    """Other units in which `load` would be the preload of the rig."""
    return [name for name, factor in FORCE_UNITS.items()
            if rig.preload > 0.0 and _is_near(load * factor, rig.preload)]


def below_preload(rig: Rig, load: float) -> str:
    """Words on a zero at far less than the preload of the rig; '' of another one."""
    return '' if load >= MIN_ZERO * rig.preload or rig.preload < rig.limits.rest_band else (
        f'is below the preload ({rig.force_words(rig.preload, 2)}): the load was tared there or '
        'not applied yet, or rig.preload is wrong, and the simulated ring starts elsewhere'
        if load > -rig.limits.rest_band else 'is a pull: publish a pushing load as positive')


def _unit_of_time(rig: Rig, time: Floats, load: Floats) -> list[Finding]:
    """A finding if the first rise of the load is faster than the hydraulics."""
    low, high = extremes(load)
    top = int(np.argmax(load >= 0.25 * low + 0.75 * high))
    bottom = top - int(np.argmax(load[top::-1] <= 0.75 * low + 0.25 * high))
    rise, seconds = float(load[top] - load[bottom]), float(time[top] - time[bottom])
    share = rise * rig.full_scale_time / rig.full_scale_load
    if top - bottom < MIN_SAMPLES or share < TOO_FAST * seconds:
        return []
    return [Finding(
        f'the load rises by {rig.force_words(rise)} within {quantity(seconds, "s", digits=2)}, '
        f'faster than the hydraulics can (rig.full_scale_time is '
        f'{quantity(rig.full_scale_time, "s")}): the unit or rate of the time is wrong, and so '
        'will D be; or the rig file is')]


def _unit_of_load(rig: Rig, time: Floats, load: Floats) -> list[Finding]:
    zero = zero_of_record(rig, time, load)
    start, peak, full = zero.load, float(extremes(load)[1]), rig.full_scale_load
    looks = [name for name in units_of_preload(rig, start)
             if PEAK_SHARE < peak * FORCE_UNITS[name] / full < OVERLOAD]
    if looks:
        units = f'{" or ".join(looks)} (the preload is {rig.preload:.4g} N)'
        return [Finding(
            f'the load begins at {start:.4g} and ends at {peak:.4g} at most, which looks like '
            f'{units}: publish newtons, or K comes out about '
            f'{FORCE_UNITS[looks[0]]:.2g} times too small', units=units)]
    if peak > OVERLOAD * full:
        return [Finding(
            f'the load reaches {rig.force_words(peak)} and the full scale is '
            f'{rig.force_words(full)}: the unit or the gain of the load, or full_scale_load of '
            'the rig file, is wrong')]
    if peak < MIN_PEAK * full:
        return [Finding(
            f'the load reaches {rig.force_words(peak, 2)} at most and the full scale is '
            f'{rig.force_words(full)}: load the ring further; or the unit or the gain of the '
            'load, or full_scale_load of the rig file, is wrong')]
    if words := below_preload(rig, start):
        return [Finding(f'the zero, at {rig.force_words(start, 2)}, {words}')]
    preload = rig.force_words(rig.preload)
    if not zero.near_preload and abs(start - rig.preload) <= OFF_PRELOAD * full:
        return [Finding(
            f'no half second of a steady load near the preload ({preload}) has {MIN_SAMPLES} '
            'readings: displacements count from the first reading alone: rest longer, or record '
            'faster')]
    if not zero.near_preload:
        return [Finding(
            f'the record starts at {rig.force_words(start)}, which is not near the preload '
            f'({preload}): displacements count from there')]
    before = load[:zero.start]
    highest = float(extremes(before)[1]) if len(before) else start
    near = geometry.NEAR_PRELOAD_SHARE * full
    return [] if highest <= rig.preload + near else [Finding(
        f'the load was {rig.force_words(highest)} before its first rest near the preload '
        f'({preload}), {time[zero.start] - time[0]:.3f} s after the start: {len(before)} of '
        f'{len(load)} samples lie before this zero, and are neither simulated nor judged: record '
        'from a rest at the preload on')]


def check_rig(rig: Rig, record: RawRecord, run: Record) -> list[Finding]:
    """A finding for each contradiction between bag and rig; [] if there is none."""
    findings, probes = [], rig.probes
    if run.rig_hash not in ('', rig.digest):
        findings.append(Finding(
            f'it was recorded on a rig with the hash {short_digest(run.rig_hash)}, and this rig '
            f'is another ({rig_in_words(rig)})'))
    for number in probes.present:
        raw = record[PROBE_TOPICS[number - 1]]
        stated, wanted = (raw.min_range, raw.max_range), (probes.min_range, probes.max_range)
        if not np.allclose(stated, wanted, rtol=1e-3, atol=1e-9):
            findings.append(Finding(
                f'probe {number} states a range of {stated[0] * 1e3:g} to {stated[1] * 1e3:g} mm, '
                f'the rig file {wanted[0] * 1e3:g} to {wanted[1] * 1e3:g} mm '
                '(rig.probes.min_range, max_range)'))
        low, high = map(float, extremes(raw.values))
        if low < probes.min_range or high > probes.max_range:
            findings.append(Finding(
                f'probe {number} reads {low * 1e3:.3f} to {high * 1e3:.3f} mm, outside of the '
                'range in the rig file (rig.probes.min_range, max_range)'))
    kept = np.isfinite(run.load)
    # A wrong cable turns the elevation that the motion gives: it alone is to be corrected.
    wiring = wiring_findings(rig, run.elevation, run.load, run.gaps)
    return [*findings, *_unit_of_load(rig, run.time[kept], run.load[kept]),
            *(wiring or _elevation(rig, run))]


def _elevation(rig: Rig, run: Record, must_be_sure: bool = False) -> list[Finding]:
    """A finding if the motion is that of no simulated ring at the elevation stated.

    must_be_sure: nobody asked; no finding where a sound ring or a cause of the catalogue does it.
    """
    measured = _measured_elevations(rig, run)
    if not measured.size:
        return []
    apparent = measured[0, 0] + USUAL_SHIFT
    uncertainty = abs(_turned(measured[1, 0] - measured[0, 0]))
    if must_be_sure and (uncertainty > SURE_WITHIN
                         or abs(_turned(apparent - run.elevation)) < SURE_LIMIT):
        return []
    if _agrees(rig, run, measured, run.elevation):
        return []
    within = uncertainty + USUAL_SHIFT
    if abs(_turned(apparent - run.elevation)) < within:  # it is their size that no ring gives
        return [Finding(
            'tilt and axial motion by the load are not those of a ring, although their ratio '
            'agrees with the elevation that the bag states: the unit of the load or of the '
            'probes, or the bounds of K1 in the rig file are wrong')]
    return [Finding(
        'tilt and axial motion agree with an elevation of about '
        f'{math.degrees(apparent % math.pi):.0f} deg (within '
        f'{math.degrees(within):.2g}) and the bag states '
        f'{math.degrees(run.elevation):g}: the elevation, the trunnion (rig.trunnion), the '
        "probes' span (rig.probes.axial_span) or the pitch radius (rig.axial_rows.pitch_radius) "
        'is wrong, or a fault of the ring turns it (diagnose tells which)')]


def elevations_alike(rig: Rig, run: Record) -> list[float]:
    """Other elevations [deg], in steps from the stated one, with which the motion agrees too."""
    measured, stated = _measured_elevations(rig, run), math.degrees(run.elevation)
    others = [stated + step for step in range(-80, 81, STEP) if step and 0 <= stated + step < 90]
    return [one for one in others if _agrees(rig, run, measured, math.radians(one))]


def _measured_elevations(rig: Rig, run: Record) -> Floats:
    """What `_apparent_elevations` gives for a run."""
    step = slice(None, None, 1 + len(run.load) // MAX_ROWS)
    load, gaps = complete_rows(run.load[step], run.gaps[:, step])
    if not len(load):
        return np.empty(0)
    moved = geometry.measured_displacement(rig.probes, gap_increment(rig.probes, gaps, gaps[:, 0]))
    return _apparent_elevations(rig, load, np.asarray(moved.delta_y), np.asarray(moved.gamma))


def _agrees(rig: Rig, run: Record, measured: Floats, elevation: float) -> bool:
    """Whether a simulated ring at an elevation [rad] moves as measured.

    A ring in its clearances does not turn force and moment as stiff rows do. How far this shifts
    the angle depends on the contact law, which nobody knows yet: a ring of any stiffness speaks
    for the elevation that gives the angles over both parts of the load and is not much too stiff.
    """
    # `info` of a bag without a doubt needs no simulator, whose import takes a second.
    from saddlering_ros.ring.simulator import static_batch

    load = np.linspace(rig.preload, float(np.nanmax(run.load)), EXPECTED_LOADS)
    contacts = [replace(TRUE_TO_SCALE, K1=float(stiffness)).to_array()
                for stiffness in np.geomspace(*rig.bounds['K1'], STIFFNESSES)]
    for _, delta_y, gamma in static_batch(rig, contacts, elevation, load):
        expected = _apparent_elevations(rig, load, delta_y, gamma)
        if not (measured.size and expected.size):
            return True
        (angles, motion), (simulated, least) = measured.T, expected.T
        apart = np.abs(_turned(angles - simulated)) - abs(_turned(angles[1] - angles[0]))
        if apart.max() <= MAX_TURN and (motion <= MAX_MOTION * least).all():
            return True
    return False


def _turned(angle: Floats | float) -> Floats:
    """Each angle [rad] between two lines, from -pi/2 to pi/2."""
    return np.asarray(angle + math.pi / 2.0) % math.pi - math.pi / 2.0


def _apparent_elevations(rig: Rig, load: Floats, delta_y: Floats, gamma: Floats) -> Floats:
    """Elevations [rad] that tilt over lift gives, from 0 to pi, over two parts of the load.

    Beside each stands the motion of the axial rows by the load [m/N], so that it is (2, 2).
    The axial rows, radius R, turn a force F_y and a moment M into delta_y = F_y / k and
    gamma = 2 M / (k R^2), whatever their stiffness k; M / F_y = -(y_t cot(theta) + x_t). Slopes
    are taken over the upper quarter of the load, where the clearance is mostly closed, and over
    the upper half: the change of the angle is its uncertainty, which includes the noise.
    (0,) if neither tilt nor lift moves. load [N], delta_y [m], gamma [rad]: (N,).
    """
    found = []
    for share in (0.75, 0.5):
        kept = load > load.min() + share * np.ptp(load)
        if np.count_nonzero(kept) < 10 or np.ptp(load[kept]) < 0.05 * rig.full_scale_load:
            return np.empty(0)
        around = load[kept] - load[kept].mean()
        lift, tilt = float(around @ delta_y[kept]), float(around @ gamma[kept])
        if lift == 0.0 or not rig.trunnion.y:
            return np.empty(0)
        lever = -tilt / lift * rig.axial_rows.pitch_radius ** 2 / 2.0
        found.append((math.atan2(1.0, (lever - rig.trunnion.x) / rig.trunnion.y),
                      math.hypot(lift, rig.axial_rows.pitch_radius * tilt) / (around @ around)))
    return np.array(found)
