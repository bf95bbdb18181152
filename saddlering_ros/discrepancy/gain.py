"""What an extension is worth: residual rms with and without it, on runs fitted and runs held out.

One metric, fixed beforehand: the root of the mean, over runs and views, of the squared residual
over the view's range, each run freed of its mean. Gain = 1 - metric with / metric without.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from saddlering_ros.discrepancy.candidate import Fit
from saddlering_ros.discrepancy.metric import Metric
from saddlering_ros.discrepancy.refit import PRIOR, Tangent
from saddlering_ros.discrepancy.system import Array, Run, System


@dataclass(frozen=True)
class Gain:
    """Shares between 0 (nothing) and 1 (all); `held_out` None if no run could be held out."""

    fit: float
    held_out: float | None
    how: str


def power(
    views: Mapping[str, Array],
    ranges: Mapping[str, float],
    runs: Sequence[Run],
    residuals: Sequence[Array],
) -> float:
    """Mean squared residual (C, N) per run over views, relative to range."""
    parts = []
    for run, residual in zip(runs, residuals, strict=True):
        for name, weights in views.items():
            seen = weights @ residual
            seen = seen - np.average(seen, weights=run.width)
            parts.append(float(np.average(seen**2, weights=run.width)) / ranges[name] ** 2)
    return float(np.mean(parts))


def ratio(before: float, after: float) -> float:
    """Gain from two mean squares, never under nought."""
    return max(0.0, 1.0 - float(np.sqrt(after / max(before, 1e-300))))


def fitted_gain(metric: Metric, ranges: Mapping[str, float], less: Fit, fit: Fit) -> float:
    """Gain on the runs that were fitted."""
    views = metric.experiment.system.views
    return ratio(
        *(
            power(views, ranges, metric.experiment.runs, _residuals(metric, item))
            for item in (less, fit)
        )
    )


def held_out_gain(
    system: System, held: Sequence[Run], ranges: Mapping[str, float], less: Fit, fit: Fit
) -> float:
    """Gain on sealed runs, nothing refitted."""
    before, after = [], []
    for run in held:
        both = system.predict_many(run, [less.point, fit.point])
        before.append(both[0] - run.channels)
        after.append(both[1] - run.channels)
    return ratio(
        power(system.views, ranges, held, before), power(system.views, ranges, held, after)
    )


def left_out_gain(
    metric: Metric,
    ranges: Mapping[str, float],
    less: tuple[Fit, Tangent],
    more: tuple[Fit, Tangent],
) -> float:
    """Gain on each run predicted from the others: one Gauss-Newton step without it."""
    totals = []
    for fit, sensitivities in (less, more):
        parts, start = [], 0
        for run in metric.experiment.runs:
            rows = slice(start, start + run.channels.size)
            start += run.channels.size
            gram = sensitivities.white.T @ sensitivities.white
            gram -= sensitivities.white[rows].T @ sensitivities.white[rows]
            gram += PRIOR**2 * np.eye(gram.shape[0])
            slope = sensitivities.white.T @ fit.whitened
            slope = slope - sensitivities.white[rows].T @ fit.whitened[rows]
            slope = slope + PRIOR**2 * (fit.theta_unit - 0.5)
            move = (
                np.clip(fit.theta_unit - np.linalg.solve(gram, slope), 0.0, 1.0) - fit.theta_unit
            )
            shifted = fit.prediction[rows] + sensitivities.plain[rows] @ move
            residual = shifted.reshape(run.channels.shape) - run.channels
            parts.append(power(metric.experiment.system.views, ranges, [run], [residual]))
        totals.append(float(np.mean(parts)))
    return ratio(totals[0], totals[1])


def _residuals(metric: Metric, fit: Fit) -> list[Array]:
    return metric.experiment.by_run(fit.prediction - metric.experiment.measured)
