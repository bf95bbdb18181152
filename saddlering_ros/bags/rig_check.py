"""Contradictions between a bag and a rig file: a probe's sign, a span, an elevation, a load."""

from __future__ import annotations

import math

import numpy as np

from saddlering_ros.bags.same_rig import rig_in_words
from saddlering_ros.bags.wiring import wiring_notes
from saddlering_ros.record.displacement import displacement_of_run
from saddlering_ros.record.record import RawRecord, Record
from saddlering_ros.record.scratch import extremes
from saddlering_ros.record.topics import PROBE_TOPICS
from saddlering_ros.rig import Rig, short_digest

MAX_ELEVATION_ERROR = math.radians(20.0)
"""Largest error [rad] of the elevation from tilt over lift, on sound rings of 48 and 97 rollers:
20 degrees."""

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
