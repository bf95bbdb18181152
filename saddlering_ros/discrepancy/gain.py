"""Misfit reduction: residual rms with and without an extension, on fitted and held-out runs.

One metric is fixed beforehand: the root of the mean, over runs and views, of the squared residual
over the range of the view, without constants that have no meaning. Gain = 1 - metric with / metric
without. It is negative if the extension predicts worse. Base and extension are each fitted in this
metric, on the fitted runs alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from saddlering_ros.discrepancy.candidate import Fit
from saddlering_ros.discrepancy.experiment import Experiment
from saddlering_ros.discrepancy.refit import declared_start, PRIOR, refit, run_refits, tangent
from saddlering_ros.discrepancy.system import Array, RunBlocks
from saddlering_ros.progress import Watch


@dataclass(frozen=True)
class Gain:
    """Gains as shares, 1 for no misfit; `held_out`: None if no run was held out."""

    fit: float
    held_out: float | None
    how: str


@dataclass(frozen=True)
class GainMetric:
    """The metric of the gain for refits: weighted residuals in every view, scaled to `unit`."""

    experiment: Experiment
    unit: float = 1.0

    def whiten(self, columns: Array) -> Array:
        """Stacked columns (n, B) or (n,) in their views, weighted by time, over the range."""
        experiment = self.experiment
        parts = [
            (seen.T * (experiment.root_weights(run, view) / experiment.view_ranges[view])).T
            for view in experiment.system.views
            for run, seen in zip(
                experiment.runs, experiment.view_residuals(columns, view), strict=True
            )
        ]
        return np.concatenate(parts) / self.unit


def plain_fits(
    experiment: Experiment, fits: Sequence[Fit], rounds: int, watch: Watch
) -> list[Fit]:
    """The same models, each fitted in the metric of the gain.

    A base without effects is also fitted from its declared start, because whitened and plain
    least squares can have different minima.
    """
    base = experiment.system.base_parameters
    answers = []
    for fit in fits:
        start = GainMetric(experiment).whiten(fit.prediction - experiment.measured)
        unit = max(float(np.sqrt(start @ start / start.size)), 1e-12)
        metric = GainMetric(experiment, unit)
        starts = [fit.theta_unit]
        if not fit.candidate.effects:
            starts.append(declared_start(base))
        wanted = [
            refit(metric, fit.candidate, item, rounds=rounds, full_jacobian=True)
            for item in starts
        ]
        answers.append(min(run_refits(metric, wanted, watch.check), key=lambda item: item.misfit))
    return answers


def mean_square(
    experiment: Experiment, runs: Sequence[RunBlocks], residuals: Sequence[Array]
) -> float:
    """Mean over runs and views of squared residuals (C, N), relative to range."""
    parts = []
    for run, residual in zip(runs, residuals, strict=True):
        for view, weights in experiment.system.views.items():
            seen = experiment.freed(weights @ residual, run, view)
            parts.append(
                experiment.mean_square(seen, run, view) / experiment.view_ranges[view] ** 2
            )
    return float(np.mean(parts))


def ratio(before: float, after: float) -> float:
    """Gain from two mean squares; negative if the second is larger."""
    if before <= 0.0:
        return 0.0 if after <= 0.0 else -np.inf
    return 1.0 - float(np.sqrt(after / before))


def fitted_gain(experiment: Experiment, less: Fit, fit: Fit) -> float:
    """Gain on the runs that were fitted."""
    before, after = (
        mean_square(
            experiment,
            experiment.runs,
            experiment.by_run(item.prediction - experiment.measured),
        )
        for item in (less, fit)
    )
    return ratio(before, after)


def held_out_gain(experiment: Experiment, held: Sequence[RunBlocks], less: Fit, fit: Fit) -> float:
    """Gain on held-out runs, without a refit."""
    before, after = [], []
    for run in held:
        both = experiment.system.predict_many(run, [less.point, fit.point])
        before.append(both[0] - run.channels)
        after.append(both[1] - run.channels)
    return ratio(mean_square(experiment, held, before), mean_square(experiment, held, after))


def left_out_gain(experiment: Experiment, less: Fit, more: Fit) -> float:
    """Gain on each run, predicted from the others by one Gauss-Newton step without it."""
    return ratio(_left_out(experiment, less), _left_out(experiment, more))


def _left_out(experiment: Experiment, fit: Fit) -> float:
    """Mean square of each run, predicted from the others."""
    start = GainMetric(experiment).whiten(fit.prediction - experiment.measured)
    metric = GainMetric(experiment, max(float(np.sqrt(start @ start / start.size)), 1e-12))
    residual = metric.whiten(fit.prediction - experiment.measured)
    sensitivities = tangent(metric, fit)
    lengths = [run.time.size for _ in experiment.system.views for run in experiment.runs]
    edges = np.concatenate([[0], np.cumsum(lengths)])
    totals, first = [], 0
    for number, run in enumerate(experiment.runs):
        rows = np.zeros(residual.size, bool)
        for view in range(len(experiment.system.views)):
            block = view * len(experiment.runs) + number
            rows[edges[block] : edges[block + 1]] = True
        white = sensitivities.white[~rows]
        gram = white.T @ white + PRIOR**2 * np.eye(white.shape[1])
        slope = white.T @ residual[~rows] + PRIOR**2 * (fit.theta_unit - 0.5)
        theta_unit = np.clip(fit.theta_unit - np.linalg.solve(gram, slope), 0.0, 1.0)
        part = slice(first, first + run.channels.size)
        first = part.stop
        moved = fit.prediction[part] + sensitivities.plain[part] @ (theta_unit - fit.theta_unit)
        left = moved.reshape(run.channels.shape) - run.channels
        totals.append(mean_square(experiment, [run], [left]))
    return float(np.mean(totals))
