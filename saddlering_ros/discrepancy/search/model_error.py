"""Model error learnt from a residual: what this machine shows beyond noise, as a process.

Whatever the best model of these runs leaves is taken to be a process that any of its runs could
show again: cosines over the time of each run, whose spreads follow the smoothed spectrum of the
residual. In a metric with these cosines a likelihood ratio counts only what such an error could
not do, so that the evidence for a cause is as sure as the machine is reproducible.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from saddlering_ros.discrepancy.problem.fits import Fit
from saddlering_ros.discrepancy.problem.problem import Metric, nuisance_columns
from saddlering_ros.discrepancy.problem.system import Array
from saddlering_ros.discrepancy.search import selection
from saddlering_ros.discrepancy.search.comparison import SearchLog
from saddlering_ros.discrepancy.search.lack_of_fit import half_waves
from saddlering_ros.discrepancy.search.selection import Alternatives, Search
from saddlering_ros.discrepancy.search.space import in_metric, ModelSpace, refit_full_jacobian

ERROR_WAVES = 60
"""Half waves of the process in a run; what is faster is learnt as noise."""

MAX_COLUMNS = 600
"""Largest number of cosines of all runs and channels."""

SMOOTHED_SHARE, MIN_SMOOTHED = 0.3, 3
"""Lines on each side over which a spread is averaged: share of the frequency, and at least."""

MAX_SINGLES = 6
"""Number of single effects that are refitted in the metric with model error."""

MAX_LEARNT = 3
"""Number of times that model error is learnt from the model that it led to."""

MIN_DEGREES = 4
"""Smallest number of degrees of freedom of the level of the process."""


def search_beside_error(search: Search) -> tuple[Search, Array]:
    """The causes that stand out against model error as large as what they leave."""
    space, fit, log = search.space, search.fit, SearchLog()
    has_forms = space.problem.assumptions.form_error > 0.0
    for _ in range(MAX_LEARNT):
        learnt_from = fit.candidate.key
        space, fit, process = space_beside_error(space, fit)
        fit = best_again(space, search.space, fit) if has_forms else selection.select(space, log)
        fit = selection.prune(space, fit, log)
        if fit.candidate.key == learnt_from:
            break
    alternatives: Alternatives = {}
    if fit.candidate.effects:
        fit, alternatives = selection.check_alternatives(space, fit, log)
    return Search(search.begun, space, fit, alternatives, log), process


def learnt_again(search: Search, fit: Fit) -> tuple[Search, Array]:
    """The search with another model, whose residual is the model error."""
    space, fit, process = space_beside_error(search.space, fit)
    alternatives: Alternatives = {}
    if fit.candidate.effects:
        fit, alternatives = selection.check_alternatives(space, fit, search.log)
    return replace(search, space=space, fit=fit, alternatives=alternatives), process


def space_beside_error(space: ModelSpace, fit: Fit) -> tuple[ModelSpace, Fit, Array]:
    """A space in whose metric the residual of `fit` is model error, the fit, and the process."""
    problem = space.problem
    process, degrees = error_process(space.metric, fit)
    nuisances = nuisance_columns(problem, fit.point, fit.prediction)
    metric = space.metric.marginalise(np.hstack([nuisances, process]))
    beside, fit = in_metric(space, metric, fit)
    beside.pairs = min(space.pairs, degrees)
    beside.max_pairs = min(space.max_pairs, degrees)
    return beside, fit, process


def error_process(metric: Metric, fit: Fit) -> tuple[Array, int]:
    """Columns (n, k) of one standard deviation each, and the degrees of freedom of their level.

    The runs of a channel share one spectrum. What noise alone would leave in a line is no model
    error.
    """
    problem = metric.problem
    residual = metric.without_nuisances(fit.prediction - problem.measured)
    columns: list[Array] = []
    degrees = []
    most = min(ERROR_WAVES, MAX_COLUMNS // len(problem.slices))
    for channel in range(len(problem.system.channel_names)):
        slots = [item for item in problem.slices if item[1] == channel]
        times = [problem.runs[index].time for index, _, _ in slots]
        shapes = [half_waves(time, min(most, time.size // 4)) for time in times]
        power = np.full((len(slots), ERROR_WAVES + 1), np.nan)
        for row, waves, (index, _, part) in zip(power, shapes, slots, strict=True):
            run = problem.runs[index]
            present = 1.0 if run.present is None else run.present[channel]
            weight = np.sqrt(run.width * present)
            weighted = waves * weight[:, None]
            found = np.linalg.lstsq(weighted, weight * residual[part], rcond=1e-6)[0]
            row[: found.size] = found**2
        spread = np.sqrt(_smoothed(power))
        degrees.append(len(slots) * float((spread**2).sum() ** 2 / max((spread**4).sum(), 1e-300)))
        for waves, (_, _, part) in zip(shapes, slots, strict=True):
            block = np.zeros((problem.size, waves.shape[1]))
            block[part] = waves * spread[: waves.shape[1]]
            columns.append(block)
    return np.hstack(columns), max(MIN_DEGREES, int(min(degrees)))


def _smoothed(power: Array) -> Array:
    """Mean square (K + 1,) of each line over the runs (R, K + 1) and the lines about it."""
    answer = np.zeros(power.shape[1])
    for line in range(power.shape[1]):
        half = max(MIN_SMOOTHED, round(SMOOTHED_SHARE * line))
        around = power[:, max(0, line - half) : line + half + 1]
        if np.isfinite(around).any():
            answer[line] = np.nanmean(around)
    return answer


def best_again(space: ModelSpace, before: ModelSpace, fit: Fit) -> Fit:
    """The best of `fit` and of the single effects that fitted best before, in another metric."""
    singles = sorted(before.single_effect_fits(), key=before.penalised)[:MAX_SINGLES]
    refitted = refit_full_jacobian(space.metric, singles, space.settings.rounds)
    return min([space.base, fit, *(space.keep(item) for item in refitted)], key=space.penalised)
