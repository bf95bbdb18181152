"""The history of one number of one ring: a local linear trend followed by a Kalman filter.

    level' = level + slope dt + noise,   slope' = slope + noise,   reading = level + error

(Harvey, Forecasting, Structural Time Series Models and the Kalman Filter, 1989, chapter 2.) After
maintenance the level is anything again. The variances of both noises are found by maximum
likelihood; a drift is tested by a slope that is constant beside a level that wanders.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.stats import binom
from scipy.stats import t as student

Array = NDArray[np.float64]

DIFFUSE = 1e4
"""Standard deviation of what is not known at all, in usual standard deviations of a reading."""

MIN_SESSIONS = 4
"""Fewer sessions between two services show no trend."""

COVERAGE = 0.95
MIN_PREDICTIONS = 3
MIN_COVERAGE_P = 0.05


@dataclass(frozen=True)
class Series:
    """Readings (N,) with standard deviations at ascending times (any unit).

    renewed (N,): whether the reading is the first after maintenance.
    """

    time: Array
    value: Array
    std: Array
    renewed: NDArray[np.bool_]


@dataclass(frozen=True)
class Forecast:
    """State after the last reading: level, slope, their covariance (2, 2), noise a unit time."""

    time: float
    level: float
    slope: float
    covariance: Array
    level_noise: float
    slope_noise: float


@dataclass(frozen=True)
class History:
    """What is known of a series: filtered level and deviation (N,), drift, and predictions.

    slope a unit of time with its deviation and the p-value of `no drift`; surprises (N,): each
    reading's distance from its one-session-ahead prediction in standard deviations, NaN where
    nothing could be predicted.
    """

    series: Series
    level: Array
    level_std: Array
    slope: float
    slope_std: float
    drift_p_value: float
    surprises: Array
    forecast: Forecast

    @property
    def predictions(self) -> int:
        """How many readings were predicted."""
        return int(np.isfinite(self.surprises).sum())

    @property
    def coverage(self) -> float:
        """Share of readings inside the 95 % interval predicted for them, NaN without any."""
        seen = self.surprises[np.isfinite(self.surprises)]
        return float(np.mean(np.abs(seen) < 1.96)) if seen.size else float('nan')

    @property
    def predicts_well(self) -> bool:
        """Whether enough readings were predicted and as many lie inside as should."""
        if self.predictions < MIN_PREDICTIONS:
            return False
        inside = round(self.coverage * self.predictions)
        return bool(binom.cdf(inside, self.predictions, COVERAGE) > MIN_COVERAGE_P)


def follow(series: Series) -> History | None:
    """The history of a series; None where it has fewer than two readings."""
    if series.value.size < 2 or not np.ptp(series.time) > 0.0:
        return None
    span = float(np.ptp(series.time))
    unit = float(np.median(series.std))
    scaled = Series(series.time / span, series.value / unit, series.std / unit, series.renewed)
    level_noise, slope_noise = _noises(scaled)
    level, deviation, surprises, state, spread, _ = _filtered(scaled, level_noise, slope_noise)
    slope, slope_std, p_value = drift(scaled)
    back = np.array([unit, unit / span])
    forecast = Forecast(
        float(series.time[-1]), float(state[0] * unit), float(state[1] * unit / span),
        spread * np.outer(back, back), level_noise * unit**2 / span,
        slope_noise * unit**2 / span**3)
    return History(series, level * unit, deviation * unit, slope * unit / span,
                   slope_std * unit / span, p_value, surprises, forecast)


def drift(series: Series) -> tuple[float, float, float]:
    """Slope, its deviation, and the p-value of no slope, by generalised least squares.

    Each stretch between services has a level of its own, which wanders; how much is estimated
    from the same data, so the test is Student's.
    """
    stretch = np.cumsum(series.renewed.astype(int))
    levels = (stretch[:, None] == np.unique(stretch)).astype(float)
    design = np.column_stack([series.time, levels])
    free = series.value.size - design.shape[1]
    if free < MIN_SESSIONS - 2:
        return 0.0, float('inf'), 1.0
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
    inflation = max(1.0, left / free)
    deviation = float(np.sqrt(spread[0, 0] * inflation))
    p_value = float(2.0 * student.sf(abs(found[0]) / deviation, free))
    return float(found[0]), deviation, p_value


def _noises(series: Series) -> tuple[float, float]:
    """Variances a unit of time of level and slope that make the readings most likely."""
    if series.value.size < MIN_SESSIONS:
        return 0.0, 0.0

    def cost(logs: Array) -> float:
        return -_filtered(series, float(np.exp(logs[0])), float(np.exp(logs[1])))[5]

    starts = [np.array(start) for start in ((-6.0, -6.0), (2.0, -6.0), (-6.0, 2.0))]
    bounds = [(-14.0, 14.0)] * 2
    best = min((minimize(cost, start, method='L-BFGS-B', bounds=bounds) for start in starts),
               key=lambda item: float(item.fun))
    return float(np.exp(best.x[0])), float(np.exp(best.x[1]))


def _filtered(
    series: Series, level_noise: float, slope_noise: float
) -> tuple[Array, Array, Array, Array, Array, float]:
    """Level, deviation, surprises (N,), last state (2,), covariance (2, 2), log likelihood."""
    state = np.array([series.value[0], 0.0])
    spread = np.diag([DIFFUSE**2, DIFFUSE**2])
    levels, deviations, surprises = [], [], []
    likelihood = 0.0
    known = 0
    for index, (now, value, std) in enumerate(
            zip(series.time, series.value, series.std, strict=True)):
        if index:
            step = float(now - series.time[index - 1])
            move = np.array([[1.0, step], [0.0, 1.0]])
            noise = np.array([
                [level_noise * step + slope_noise * step**3 / 3.0, slope_noise * step**2 / 2.0],
                [slope_noise * step**2 / 2.0, slope_noise * step]])
            state, spread = move @ state, move @ spread @ move.T + noise
        if index and series.renewed[index]:
            spread[0, :] = spread[:, 0] = 0.0
            spread[0, 0] = DIFFUSE**2
            known = min(known, 1)
        variance = spread[0, 0] + std**2
        apart = value - state[0]
        predicted = known >= 2 and variance < 0.01 * DIFFUSE**2
        surprises.append(apart / np.sqrt(variance) if predicted else np.nan)
        if predicted:
            likelihood -= 0.5 * (np.log(variance) + apart**2 / variance)
        gain = spread[:, 0] / variance
        state = state + gain * apart
        spread = spread - np.outer(gain, spread[0])
        spread = 0.5 * (spread + spread.T)
        known += 1
        levels.append(state[0])
        deviations.append(np.sqrt(max(spread[0, 0], 0.0)))
    return (np.array(levels), np.array(deviations), np.array(surprises), state, spread,
            float(likelihood))
