"""When a drifting number will pass a limit: first passage of its local trend, with an interval."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.fleet.history import Forecast, History

Array = NDArray[np.float64]

PATHS, STEPS = 4000, 400
HORIZON = 20.0
"""Longest time looked ahead, in times that the mean trend takes to the limit."""

INTERVAL = (0.05, 0.95)


@dataclass(frozen=True)
class RemainingLife:
    """Time to the limit from the last reading (unit of the history): median and 90 % interval.

    Infinite if this share of the paths never reaches the limit.
    """

    median: float
    low: float
    high: float


def remaining_life(history: History, limit: float, level: float, *, drifts: bool
                   ) -> RemainingLife | None:
    """Remaining life to `limit`; None if it cannot be estimated.

    It can be estimated if the drift is significant (`drifts`), leads to the limit, and the
    predictions one session ahead held their coverage. level: largest p-value of a drift.
    """
    forecast = history.forecast
    if not (drifts and history.drift_p_value <= level and history.predicts_well):
        return None
    distance = limit - forecast.level
    if distance == 0.0 or history.slope * distance <= 0.0:
        return None
    return first_passage(forecast, limit)


def first_passage(forecast: Forecast, limit: float, seed: int = 0) -> RemainingLife:
    """First passage of simulated futures through `limit`.

    Last level and slope err together: a slope that is too steep has led to a level that is too
    far. Few sessions leave their covariance uncertain, so the errors are Student's.
    """
    distance = limit - forecast.level
    step = HORIZON * abs(distance / forecast.slope) / STEPS
    chance = np.random.default_rng(seed)
    root = np.linalg.cholesky(forecast.covariance + 1e-12 * np.diag(np.diag(forecast.covariance)))
    errors = root @ chance.standard_normal((2, PATHS))
    errors *= np.sqrt(forecast.free / chance.chisquare(forecast.free, PATHS))
    level, slopes = forecast.level + errors[0], forecast.slope + errors[1]
    times = np.where((level - limit) * np.sign(distance) >= 0.0, 0.0, np.inf)
    for number in range(1, STEPS + 1):
        before = level
        level = before + slopes * step
        level = level + math.sqrt(forecast.level_noise * step) * chance.standard_normal(PATHS)
        crossed = np.isinf(times) & ((level - limit) * np.sign(distance) >= 0.0)
        share = np.clip((limit - before) / np.where(level == before, 1.0, level - before), 0, 1)
        times[crossed] = (number - 1 + share[crossed]) * step
    low, median, high = np.quantile(times, [INTERVAL[0], 0.5, INTERVAL[1]], method='lower')
    return RemainingLife(float(median), float(low), float(high))
