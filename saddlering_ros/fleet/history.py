"""The history of one number of one ring: a local linear trend followed by a Kalman filter.

    level' = level + slope dt + noise,   slope' = slope + noise,   reading = level + error

(Harvey, Forecasting, Structural Time Series Models and the Kalman Filter, 1989, chapter 2.) After
maintenance the level is unknown. The variances of both noises are found by maximum
likelihood; a drift is tested by a slope that is constant beside a level that wanders. The first
passage of the trend through a limit gives the remaining life, with an interval.
"""

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom
from scipy.stats import t as student

from saddlering_ros.fleet.statistics import LEVEL

Array = NDArray[np.float64]

DIFFUSE = 1e4
"""Standard deviation of an unknown value, in usual standard deviations of a reading."""

MIN_SESSIONS = 4
"""Fewer sessions between two services show no trend."""

COARSE_REACH, FINE_REACH, GRID = 12.0, 0.5, 4
"""Logarithms of both noises are searched on grids of 2 GRID + 1 points a side, each finer."""

COVERAGE = 0.95  # of the intervals predicted
MIN_PREDICTIONS = 3
MIN_COVERAGE_P = 0.05  # a drift that predicts worse gives no life


@dataclass(frozen=True)
class TimeSeries:
    """Readings (N,) with standard deviations at ascending times (any unit).

    renewed (N,): whether the reading is the first after maintenance.
    """

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
        return float(np.mean(np.abs(seen) < 1.96)) if seen.size else float('nan')


def follow(series: TimeSeries) -> History | None:
    """The history of a series; None where it has fewer than two readings."""
    if series.value.size < 2 or not np.ptp(series.time) > 0.0:
        return None
    span = float(np.ptp(series.time))
    unit = float(np.median(series.std))
    scaled = TimeSeries(series.time / span, series.value / unit, series.std / unit, series.renewed)
    noises = _noises(scaled)
    (level, level_std, surprises), _ = _filtered(scaled, *noises)
    slope, slope_std, p_value, covariance, free = _trend(scaled)
    back = np.array([unit, unit / span])
    return History(
        series=series, level=level * unit, level_std=level_std * unit, surprises=surprises,
        slope=slope * unit / span, slope_std=slope_std * unit / span, drift_p_value=p_value,
        covariance=covariance * np.outer(back, back), free=free,
        level_noise=noises[0] * unit**2 / span)


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
    same = stretch[:, None] == stretch
    begun = np.array([series.time[stretch == own].min() for own in stretch])
    elapsed = series.time - begun
    walk = np.where(same, np.minimum(elapsed[:, None], elapsed[None, :]), 0.0)

    def fit(log_noise: float) -> tuple[float, Array, Array, float]:
        total = np.diag(series.std**2) + np.exp(log_noise) * walk
        root = np.linalg.cholesky(total)
        columns = np.linalg.solve(root, design)
        target = np.linalg.solve(root, series.value)
        gram = columns.T @ columns
        found = np.linalg.solve(gram, columns.T @ target)
        left = target - columns @ found
        cost = (2.0 * np.log(np.diag(root)).sum() + np.linalg.slogdet(gram)[1] + left @ left)
        return float(cost), found, np.linalg.inv(gram), float(left @ left)

    grid = np.concatenate([[-40.0], np.linspace(-8.0, 12.0, 41)])
    best = min(grid, key=lambda value: fit(value)[0])
    _, found, spread, left = fit(best)
    spread = spread * max(1.0, left / free)
    last = np.concatenate([[series.time[-1]], levels[-1]])
    both = np.stack([last, np.eye(last.size)[0]])
    deviation = float(np.sqrt(spread[0, 0]))
    p_value = float(2.0 * student.sf(abs(found[0]) / deviation, free))
    return float(found[0]), deviation, p_value, both @ spread @ both.T, free


def _noises(series: TimeSeries) -> tuple[float, float]:
    """Variances a unit of time of level and slope that make the readings most likely."""
    if series.value.size < MIN_SESSIONS:
        return 0.0, 0.0

    centre, reach = (0.0, 0.0), COARSE_REACH
    while reach > FINE_REACH:
        shifts = [reach * step / GRID for step in range(-GRID, GRID + 1)]
        centre = max(
            ((centre[0] + one, centre[1] + other) for one in shifts for other in shifts),
            key=lambda logs: _filtered(series, math.exp(logs[0]), math.exp(logs[1]))[1])
        reach /= GRID
    return math.exp(centre[0]), math.exp(centre[1])


def _filtered(series: TimeSeries, level_noise: float, slope_noise: float) -> tuple[Array, float]:
    """Level, its deviation and surprises (3, N) of the local linear trend, and log likelihood.

    The Kalman filter in plain numbers: matrices cost more here.
    """
    level, slope = float(series.value[0]), 0.0
    p_level, p_both, p_slope = DIFFUSE**2, 0.0, DIFFUSE**2
    levels, deviations, surprises = [], [], []
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
        surprises.append(apart / math.sqrt(variance) if predicted else math.nan)
        if predicted:
            likelihood -= 0.5 * (math.log(variance) + apart**2 / variance)
        gain, slope_gain = p_level / variance, p_both / variance
        level, slope = level + gain * apart, slope + slope_gain * apart
        p_level, p_both, p_slope = (
            (1.0 - gain) * p_level, (1.0 - gain) * p_both, p_slope - slope_gain * p_both)
        readings_seen += 1
        levels.append(level)
        deviations.append(math.sqrt(max(p_level, 0.0)))
    return np.array([levels, deviations, surprises]), likelihood


PATHS, STEPS = 4000, 400
HORIZON = 20.0
"""Longest time looked ahead, in times that the mean trend takes to the limit."""

INTERVAL = (0.05, 0.95)  # quantiles: 90 %


@dataclass(frozen=True)
class RemainingLife:
    """Time to the limit from the last reading (unit of the history): median and 90 % interval.

    Infinite if this share of the paths never reaches the limit.
    """

    median: float
    low: float
    high: float


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
