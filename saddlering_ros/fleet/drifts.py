"""Drifts of rings and of rigs: their owner, and the drifts that look alike.

A load cell that drifts scales every stiffness and damping of every ring that its rig tests. Two
rules follow. An equal drift of all coordinates has two possible causes, the ring and the load
cell. If the rings of one rig drift together in calendar time, the rig is the cause.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, ttest_1samp

from saddlering_ros.fleet.history import follow, History, TimeSeries
from saddlering_ros.fleet.observations import COORDINATES, SessionFigures
from saddlering_ros.fleet.statistics import benjamini_hochberg

Array = NDArray[np.float64]

SCALED = ('stiffness_1', 'damping_1', 'stiffness_2', 'damping_2')
"""Coordinates that a gain of the load changes, all by the same amount."""

MIN_RINGS_OF_RIG = 4
"""Smallest number of rings that separates a rig from its rings."""

MAX_RINGS = 0.75
"""Share of a rig's rings that must drift the same way."""

MIN_COMMON = 3.0
"""A common slope of fewer standard deviations is none."""

EQUAL_LEVEL = 0.01
"""Drifts are alike unless they differ at this level."""

YEAR = 365.25 * 24 * 3600.0  # [s]


@dataclass(frozen=True)
class RingHistory:
    """Histories of a ring's coordinates and of the sizes of its causes, by name.

    clock: service_hours [h] or calendar [years].
    """

    ring: str
    bench: str
    clock: str
    of: Mapping[str, History]


@dataclass(frozen=True)
class Drift:
    """A significant drift: of which ring or rig, its slopes a unit of the clock, its causes.

    group: causes that these data cannot separate; next_test: the test that would.
    """

    owner: str
    kind: str
    clock: str
    slopes: Mapping[str, tuple[float, float]]
    p_value: float
    group: tuple[str, ...]
    next_test: str


DEAD_WEIGHT = (
    'Hang a known dead weight on the load cell. If the reading is wrong, the load cell drifts; '
    'if it is right, the contact of the ring does.'
)
AFTER_SERVICE = 'Repeat the test after the next service. A drift that starts again is wear.'
LOAD_GAIN_OR_RING = ('contact_stiffness', 'load_gain')
RIG_CHECK = (
    'Test a ring that has been in store on this rig, and check the load cell with a dead weight. '
    'If the stored ring has changed too, the rig is at fault.'
)


def words_of(group: Sequence[str]) -> str:
    """A group of coordinates or causes as a person reads it."""
    return ' or '.join(NAMES.get(name, name.replace('_', ' ')) for name in group)


NAMES = {
    'stiffness_1': 'stiffness of the axial rows', 'stiffness_2': 'stiffness of the radial row',
    'damping_1': 'damping of the axial rows', 'damping_2': 'damping of the radial row',
    'exponent_1': 'exponent of the axial rows', 'exponent_2': 'exponent of the radial row',
    'load_gain': 'gain of the load cell', 'contact_stiffness': 'contact of the ring',
}


def histories_of(ring: str, sessions: Sequence[SessionFigures]) -> RingHistory:
    """Histories of every coordinate and cause that enough sessions measured."""
    hours = np.array([session.service_hours for session in sessions])
    by_hours = bool(np.isfinite(hours).all()) and len(sessions) > 1 and np.ptp(hours) > 0.0
    times = hours if by_hours else np.array([session.time for session in sessions]) / YEAR
    histories: dict[str, History] = {}
    readings = {
        name: (np.array([session.value[number] for session in sessions]),
               np.array([session.covariance[number, number] for session in sessions]))
        for number, name in enumerate(COORDINATES)
    }
    for name in sorted({name for session in sessions for name in session.causes}):
        sizes = np.array([session.causes.get(name, (np.nan, np.nan)) for session in sessions])
        readings[name] = sizes[:, 0], sizes[:, 1] ** 2
    for name, (values, spread) in readings.items():
        good = np.isfinite(values) & np.isfinite(spread) & (spread > 0.0) & np.isfinite(times)
        if not good.any():
            continue
        serviced = np.cumsum([session.maintenance for session in sessions])[good]
        renewed = np.diff(serviced, prepend=serviced[0]) > 0
        order = np.argsort(times[good], kind='stable')
        history = follow(TimeSeries(times[good][order], values[good][order],
                                    np.sqrt(spread[good])[order], renewed[order]))
        if history is not None:
            histories[name] = history
    clock = 'service_hours' if by_hours else 'years'
    return RingHistory(ring, sessions[-1].bench, clock, histories)


def significant_drifts(histories: Sequence[RingHistory]) -> tuple[list[Drift], list[Drift]]:
    """Drifts of rings and of rigs, at most the share LEVEL of each falsely found.

    A ring whose drift is no larger than that of its rig is not listed.
    """
    benches: dict[str, list[RingHistory]] = {}
    for ring in histories:
        benches.setdefault(ring.bench, []).append(ring)
    candidates = []
    for bench, own in sorted(benches.items()):
        if bench and len(own) >= MIN_RINGS_OF_RIG:
            slopes, p_value = _common_slopes(own)
            group = ('load_gain',) if scales_alike(slopes) else tuple(slopes)
            candidates.append(
                Drift(bench, 'rig', own[0].clock, slopes, p_value, group, RIG_CHECK))
    real = benjamini_hochberg([drift.p_value for drift in candidates])
    rigs = [drift for drift, stands in zip(candidates, real, strict=True) if stands]
    common = {drift.owner: drift.slopes for drift in rigs}
    tests = [_joint_test(ring, common.get(ring.bench, {})) for ring in histories]
    stands = benjamini_hochberg([p_value for _, p_value in tests])
    rings = []
    for ring, (slopes, p_value), stands_out in zip(histories, tests, stands, strict=True):
        if not stands_out:
            continue
        strongest = max(slopes, key=lambda name: abs(slopes[name][0] / slopes[name][1]))
        group, next_test = ((LOAD_GAIN_OR_RING, DEAD_WEIGHT) if scales_alike(slopes)
                            else ((strongest,), AFTER_SERVICE))
        rings.append(Drift(ring.ring, 'ring', ring.clock, slopes, p_value, group, next_test))
    return rings, rigs


def _joint_test(
    ring: RingHistory, common: Mapping[str, tuple[float, float]]
) -> tuple[dict[str, tuple[float, float]], float]:
    """Slopes of a ring beyond its rig's, and the p-value of none (Bonferroni over coordinates)."""
    slopes: dict[str, tuple[float, float]] = {}
    p_values = []
    for name, history in ring.of.items():
        slope, std = history.slope, history.slope_std
        p_value = history.drift_p_value
        if name in common and math.isfinite(std):
            shared, shared_std = common[name]
            slope, wide = slope - shared, math.hypot(std, shared_std)
            p_value = float(chi2.sf((slope / wide) ** 2, 1)) if p_value < 1.0 else 1.0
            std = wide
        slopes[name] = (slope, std)
        p_values.append(p_value)
    return slopes, min([1.0, *(len(p_values) * value for value in p_values)])


def scales_alike(slopes: Mapping[str, tuple[float, float]]) -> bool:
    """Whether a gain of the load explains the slopes of all stiffnesses and dampings.

    Their common slope must be there, and none may differ from it.
    """
    measured = [slopes[name] for name in SCALED
                if name in slopes and math.isfinite(slopes[name][1])]
    if len(measured) < 2:
        return False
    values, deviations = np.array(measured).T
    weight = 1.0 / deviations**2
    mean = float((weight * values).sum() / weight.sum())
    apart = float((weight * (values - mean) ** 2).sum())
    alike = chi2.sf(apart, len(measured) - 1) > EQUAL_LEVEL
    return bool(alike and abs(mean) * math.sqrt(weight.sum()) > MIN_COMMON)


def _common_slopes(rings: Sequence[RingHistory]) -> tuple[dict[str, tuple[float, float]], float]:
    """Median slope of a rig's rings in every scaled coordinate, and the p-value of none.

    A load cell moves all scaled coordinates alike, so one number a ring is tested: their mean.
    Student's test over rings, and most must drift the same way: a few that wear fast widen the
    spread and do not pass for a rig.
    """
    known = [{name: ring.of[name] for name in SCALED
              if name in ring.of and math.isfinite(ring.of[name].slope_std)} for ring in rings]
    slopes: dict[str, tuple[float, float]] = {}
    for name in SCALED:
        values = np.array([own[name].slope for own in known if name in own])
        if values.size >= MIN_RINGS_OF_RIG:
            spread = 1.4826 * float(np.median(np.abs(values - np.median(values))))
            slopes[name] = (float(np.median(values)), 1.2533 * spread / math.sqrt(values.size))
    gains = np.array([
        np.average([history.slope for history in own.values()],
                   weights=[1.0 / history.slope_std**2 for history in own.values()])
        for own in known if own])
    if gains.size < MIN_RINGS_OF_RIG:
        return slopes, 1.0
    together = max(np.mean(gains > 0.0), np.mean(gains < 0.0))
    return slopes, float(ttest_1samp(gains, 0.0).pvalue) if together >= MAX_RINGS else 1.0
