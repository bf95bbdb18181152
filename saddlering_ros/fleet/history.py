"""Histories of the numbers of a ring, drifts of rings and of rigs, and the remaining life.

A number follows a local linear trend, by a Kalman filter:

    level' = level + slope dt + noise,   slope' = slope + noise,   reading = level + error

(Harvey, Forecasting, Structural Time Series Models and the Kalman Filter, 1989, chapter 2.) After
maintenance the level is unknown. The variances of both noises are found by maximum
likelihood; a drift is tested by a slope that is constant beside a level that wanders. The first
passage of the trend through a limit gives the remaining life, with an interval.

A load cell that drifts scales every stiffness and damping of every ring that its rig tests. Two
rules follow. An equal drift of all coordinates has two possible causes, the ring and the load
cell. If the rings of one rig drift together in calendar time, the rig is the cause.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom, chi2, ttest_1samp
from scipy.stats import t as student

from saddlering_ros.fleet import statistics
from saddlering_ros.fleet.statistics import Array, COORDINATES, LEVEL, SessionFigures
from saddlering_ros.quantities import WIDTH_95

DIFFUSE = 1e4
"""Standard deviation of an unknown value, in usual standard deviations of a reading."""

MIN_SESSIONS = 4
"""Fewer sessions between two services show no trend."""

COARSE_REACH, FINE_REACH, GRID = 12.0, 0.5, 4
"""Logarithms of both noises are searched on grids of 2 GRID + 1 points a side, each finer."""

COVERAGE = 0.95  # of the intervals predicted
MIN_PREDICTIONS = 3  # one or two show no coverage
MIN_COVERAGE_P = 0.05  # a drift that predicts worse gives no life

PATHS, STEPS = 4000, 400
"""Drawn futures, whose quantiles of 5 % are then true to 0.3 %, and steps of each."""
HORIZON = 20.0
"""Longest time looked ahead, in times that the mean trend takes to the limit."""

INTERVAL = (0.05, 0.95)  # quantiles: 90 %

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

DEAD_WEIGHT = (
    'Hang a known dead weight on the load cell. If the reading is wrong, the load cell drifts; '
    'if it is right, the contact of the ring does.')
AFTER_SERVICE = 'Repeat the test after the next service. A drift that starts again is wear.'
RIG_CHECK = (
    'Test a ring that has been in store on this rig, and check the load cell with a dead weight. '
    'If the stored ring has changed too, the rig is at fault.')
NAMES = {
    'stiffness_1': 'stiffness of the axial rows', 'stiffness_2': 'stiffness of the radial row',
    'damping_1': 'damping of the axial rows', 'damping_2': 'damping of the radial row',
    'exponent_1': 'exponent of the axial rows', 'exponent_2': 'exponent of the radial row',
    'load_gain': 'gain of the load cell', 'contact_stiffness': 'contact of the ring'}

Slopes = Mapping[str, tuple[float, float]]
"""Slope and its standard deviation by the name of a coordinate or a cause."""


@dataclass(frozen=True)
class TimeSeries:
    """Readings (N,) with deviations at ascending times; renewed (N,): the first after service."""

    time: Array
    value: Array
    std: Array
    renewed: NDArray[np.bool_]


@dataclass(frozen=True)
class History:
    """State of a series: filtered level and deviation (N,), drift, and predictions.

    surprises (N,): each reading's distance from its one-session-ahead prediction in standard
    deviations, NaN where nothing could be predicted; slope a unit of time with its deviation and
    the p-value of `no drift`; covariance (2, 2) of the last level and the slope, with `free`
    degrees of freedom; level_noise: variance that the level gains a unit of time.
    """

    series: TimeSeries
    level: Array
    level_std: Array
    surprises: Array
    slope: float
    slope_std: float
    drift_p_value: float
    covariance: Array
    free: int
    level_noise: float

    @property
    def predictions(self) -> int:
        """How many readings were predicted."""
        return int(np.isfinite(self.surprises).sum())

    @property
    def coverage(self) -> float:
        """Share of readings inside the 95 % interval predicted for them, NaN without any."""
        seen = self.surprises[np.isfinite(self.surprises)]
        return float(np.mean(np.abs(seen) < WIDTH_95)) if seen.size else float('nan')


@dataclass(frozen=True)
class RingHistory:
    """Histories of coordinates and causes by name; clock: service_hours [h] or years."""

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
    slopes: Slopes
    p_value: float
    group: tuple[str, ...]
    next_test: str


@dataclass(frozen=True)
class RemainingLife:
    """Time to the limit from the last reading (unit of the history): median and 90 % interval.

    Infinite if this share of the paths never reaches the limit.
    """

    median: float
    low: float
    high: float


def words_of(group: Sequence[str], titles: Mapping[str, str]) -> str:
    """A group of coordinates or causes as a person reads it; titles: of causes by their ids."""
    return ' or '.join(titles.get(name) or NAMES.get(name) or name.replace('_', ' ')
                       for name in group)


def follow(series: TimeSeries) -> History | None:
    """The history of a series; None where it has fewer than two readings."""
    if series.value.size < 2 or not np.ptp(series.time) > 0.0:
        return None
    span, unit = float(np.ptp(series.time)), float(np.median(series.std))
    scaled = TimeSeries(series.time / span, series.value / unit, series.std / unit, series.renewed)
    noises, reach = (0.0, 0.0), COARSE_REACH
    if series.value.size >= MIN_SESSIONS:  # the noises that make the readings most likely
        centre = (0.0, 0.0)
        while reach > FINE_REACH:
            shifts = [reach * step / GRID for step in range(-GRID, GRID + 1)]
            centre = max(
                ((centre[0] + one, centre[1] + other) for one in shifts for other in shifts),
                key=lambda logs: _filtered(scaled, math.exp(logs[0]), math.exp(logs[1]))[1])
            reach /= GRID
        noises = math.exp(centre[0]), math.exp(centre[1])
    (level, level_std, surprises), _ = _filtered(scaled, *noises)
    slope, slope_std, p_value, covariance, free = _trend(scaled)
    back = np.array([unit, unit / span])
    return History(
        series, level * unit, level_std * unit, surprises, slope * unit / span,
        slope_std * unit / span, p_value, covariance * np.outer(back, back), free,
        noises[0] * unit**2 / span)


def _trend(series: TimeSeries) -> tuple[float, float, float, Array, int]:
    """Slope of a series, its deviation, p-value of none, covariance with the last level, freedom.

    By generalised least squares: each stretch between services has a level of its own, which
    wanders; how much is estimated from the same data, so the test is Student's.
    """
    stretch = np.cumsum(series.renewed.astype(int))
    levels = (stretch[:, None] == np.unique(stretch)).astype(float)
    design = np.column_stack([series.time, levels])
    free = series.value.size - design.shape[1]
    if free < MIN_SESSIONS - 2:
        return 0.0, math.inf, 1.0, np.full((2, 2), np.inf), max(free, 0)
    elapsed = series.time - [series.time[stretch == number].min() for number in stretch]
    walk = np.where(stretch[:, None] == stretch, np.minimum(elapsed[:, None], elapsed), 0.0)

    def fit(log_noise: float) -> tuple[float, Array, Array, float]:
        root = np.linalg.cholesky(np.diag(series.std**2) + np.exp(log_noise) * walk)
        columns, target = np.linalg.solve(root, design), np.linalg.solve(root, series.value)
        gram = columns.T @ columns
        solution = np.linalg.solve(gram, columns.T @ target)
        left = target - columns @ solution
        cost = (2.0 * np.log(np.diag(root)).sum() + np.linalg.slogdet(gram)[1] + left @ left)
        return float(cost), solution, np.linalg.inv(gram), float(left @ left)

    grid = np.concatenate([[-40.0], np.linspace(-8.0, 12.0, 41)])
    _, solution, spread, left = min((fit(value) for value in grid), key=lambda fitted: fitted[0])
    spread = spread * max(1.0, left / free)
    last = np.concatenate([[series.time[-1]], levels[-1]])
    both = np.stack([last, np.eye(last.size)[0]])
    deviation = float(np.sqrt(spread[0, 0]))
    p_value = float(2.0 * student.sf(abs(solution[0]) / deviation, free))
    return float(solution[0]), deviation, p_value, both @ spread @ both.T, free


def _filtered(series: TimeSeries, level_noise: float, slope_noise: float) -> tuple[Array, float]:
    """Level, its deviation and surprises (3, N) of the local linear trend, and log likelihood.

    The Kalman filter in plain numbers: matrices cost more here.
    """
    level, slope = float(series.value[0]), 0.0
    p_level, p_both, p_slope = DIFFUSE**2, 0.0, DIFFUSE**2
    rows: list[tuple[float, float, float]] = []
    likelihood, readings_seen, before = 0.0, 0, float(series.time[0])
    readings = zip(series.time.tolist(), series.value.tolist(), series.std.tolist(),
                   series.renewed.tolist(), strict=True)
    for index, (now, value, std, renewed) in enumerate(readings):
        step, before = now - before, now
        if index:
            level += slope * step
            p_level += step * (2.0 * p_both + step * p_slope) + (
                level_noise * step + slope_noise * step**3 / 3.0)
            p_both += step * p_slope + 0.5 * slope_noise * step**2
            p_slope += slope_noise * step
        if index and renewed:
            p_level, p_both, readings_seen = DIFFUSE**2, 0.0, min(readings_seen, 1)
        variance, apart = p_level + std**2, value - level
        predicted = readings_seen >= 2 and variance < 0.01 * DIFFUSE**2
        if predicted:
            likelihood -= 0.5 * (math.log(variance) + apart**2 / variance)
        gain, slope_gain = p_level / variance, p_both / variance
        level, slope = level + gain * apart, slope + slope_gain * apart
        p_level, p_both, p_slope = (
            (1.0 - gain) * p_level, (1.0 - gain) * p_both, p_slope - slope_gain * p_both)
        readings_seen += 1
        rows.append((level, math.sqrt(max(p_level, 0.0)),
                     apart / math.sqrt(variance) if predicted else math.nan))
    return np.array(rows).T, likelihood


def remaining_life(history: History, limit: float) -> RemainingLife | None:
    """First passage of simulated futures of a drift through `limit`.

    None unless the drift is significant and leads to the limit, and the predictions one session
    ahead held their coverage. Last level and slope err together: a slope that is too steep has
    led to a level that is too far. Few sessions leave their covariance uncertain, so the errors
    are Student's.
    """
    distance = limit - float(history.level[-1])
    if history.drift_p_value > LEVEL or history.slope * distance <= 0.0 \
            or history.predictions < MIN_PREDICTIONS:
        return None
    inside = round(history.coverage * history.predictions)
    if binom.cdf(inside, history.predictions, COVERAGE) <= MIN_COVERAGE_P:
        return None
    step = HORIZON * abs(distance / history.slope) / STEPS
    chance = np.random.default_rng(0)
    root = np.linalg.cholesky(history.covariance + 1e-12 * np.diag(np.diag(history.covariance)))
    errors = root @ chance.standard_normal((2, PATHS))
    errors *= np.sqrt(history.free / chance.chisquare(history.free, PATHS))
    level, slopes = float(history.level[-1]) + errors[0], history.slope + errors[1]
    times = np.where((level - limit) * np.sign(distance) >= 0.0, 0.0, np.inf)
    for number in range(1, STEPS + 1):
        before = level
        level = before + slopes * step
        level = level + math.sqrt(history.level_noise * step) * chance.standard_normal(PATHS)
        crossed = np.isinf(times) & ((level - limit) * np.sign(distance) >= 0.0)
        share = np.clip((limit - before) / np.where(level == before, 1.0, level - before), 0, 1)
        times[crossed] = (number - 1 + share[crossed]) * step
    low, median, high = np.quantile(times, [INTERVAL[0], 0.5, INTERVAL[1]], method='lower')
    return RemainingLife(float(median), float(low), float(high))


def histories_of(ring: str, sessions: Sequence[SessionFigures]) -> RingHistory:
    """Histories of every coordinate and cause that enough sessions measured."""
    hours, years = np.array([(one.service_hours, one.time / YEAR) for one in sessions]).T
    dated = np.lexsort((hours, years))[:np.isfinite(years).sum()]
    by_hours = bool(np.isfinite(hours).all() and np.ptp(hours) > 0.0
                    and (np.diff(hours[dated]) >= 0.0).all())  # a counter was not set back
    times = hours if by_hours else years
    readings = {
        name: np.array([(session.value[number], session.covariance[number, number])
                        for session in sessions]) for number, name in enumerate(COORDINATES)}
    for name in sorted({name for session in sessions for name in session.causes}):
        sizes = np.array([session.causes.get(name, (np.nan, np.nan)) for session in sessions])
        readings[name] = np.column_stack([sizes[:, 0], sizes[:, 1] ** 2])
    services = np.cumsum([session.maintenance for session in sessions])
    histories: dict[str, History] = {}
    for name, (values, spread) in ((name, pairs.T) for name, pairs in readings.items()):
        good = np.isfinite(values) & np.isfinite(spread) & (spread > 0.0) & np.isfinite(times)
        if not good.any():
            continue
        renewed = np.diff(services[good], prepend=services[good][0]) > 0
        order = np.argsort(times[good], kind='stable')
        history = follow(TimeSeries(*(column[order] for column in (
            times[good], values[good], np.sqrt(spread[good]), renewed))))
        if history is not None:
            histories[name] = history
    return RingHistory(ring, sessions[-1].bench, 'service_hours' if by_hours else 'years',
                       histories)


def significant_drifts(histories: Sequence[RingHistory]) -> tuple[list[Drift], list[Drift]]:
    """Drifts of rings and of rigs, at most the share LEVEL of each falsely found.

    A ring whose drift is no larger than that of its rig is not listed. Only slopes of one clock
    are compared: an hour of service is no year.
    """
    candidates = []
    for bench, clock in sorted({(ring.bench, ring.clock) for ring in histories if ring.bench}):
        its_rings = [ring for ring in histories if (ring.bench, ring.clock) == (bench, clock)]
        if len(its_rings) >= MIN_RINGS_OF_RIG:
            slopes, p_value = _common_slopes(its_rings)
            group = ('load_gain',) if scales_alike(slopes) else tuple(slopes)
            candidates.append(Drift(bench, 'rig', clock, slopes, p_value, group, RIG_CHECK))
    rigs = _standing(candidates)
    common = {(drift.owner, drift.clock): drift.slopes for drift in rigs}
    tested = []
    for ring in histories:
        of_rig = common.get((ring.bench, ring.clock), {})
        slopes = dict[str, tuple[float, float]]()
        p_values = []
        for name, history in ring.of.items():
            slope, std, p_value = history.slope, history.slope_std, history.drift_p_value
            if name in of_rig and math.isfinite(std):
                shared, shared_std = of_rig[name]
                slope, std = slope - shared, math.hypot(std, shared_std)
                p_value = float(chi2.sf((slope / std) ** 2, 1)) if p_value < 1.0 else 1.0
            slopes[name] = (slope, std)
            p_values.append(p_value)
        strongest = max(slopes, key=lambda name: abs(slopes[name][0] / slopes[name][1]),
                        default='')
        group, next_test = ((('contact_stiffness', 'load_gain'), DEAD_WEIGHT)
                            if scales_alike(slopes) else ((strongest,), AFTER_SERVICE))
        bonferroni = min([1.0, *(len(p_values) * value for value in p_values)])
        tested.append(Drift(ring.ring, 'ring', ring.clock, slopes, bonferroni, group, next_test))
    return _standing(tested), rigs


def _standing(drifts: Sequence[Drift]) -> list[Drift]:
    """Those that stand, at most the share LEVEL of them falsely."""
    stands = statistics.benjamini_hochberg([drift.p_value for drift in drifts])
    return [drift for drift, is_real in zip(drifts, stands, strict=True) if is_real]


def scales_alike(slopes: Slopes) -> bool:
    """Whether the scaled slopes are there and equal, so that a gain of the load explains them."""
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


def _common_slopes(rings: Sequence[RingHistory]) -> tuple[Slopes, float]:
    """Median slope of a rig's rings in every scaled coordinate, and the p-value of none.

    A load cell moves all scaled coordinates alike, so one number a ring is tested: their mean.
    Student's test over rings, and most must drift the same way: a few that wear fast widen the
    spread and do not pass for a rig.
    """
    scaled = [{name: ring.of[name] for name in SCALED
              if name in ring.of and math.isfinite(ring.of[name].slope_std)} for ring in rings]
    slopes: dict[str, tuple[float, float]] = {}
    for name in SCALED:
        values = np.array([histories[name].slope for histories in scaled if name in histories])
        if values.size >= MIN_RINGS_OF_RIG:
            spread = 1.4826 * float(np.median(np.abs(values - np.median(values))))
            slopes[name] = (float(np.median(values)), 1.2533 * spread / math.sqrt(values.size))
    gains = np.array([
        np.average([history.slope for history in histories.values()],
                   weights=[1.0 / history.slope_std**2 for history in histories.values()])
        for histories in scaled if histories])
    if gains.size < MIN_RINGS_OF_RIG:
        return slopes, 1.0
    together = max(np.mean(gains > 0.0), np.mean(gains < 0.0))
    return slopes, float(ttest_1samp(gains, 0.0).pvalue) if together >= MAX_RINGS else 1.0
