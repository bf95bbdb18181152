"""Bounded least squares for many candidate models at once, with all simulations in one batch.

Each refit is a generator that yields points and receives their whitened residuals, so that a
simulator with parallel batches stays busy. The method is Levenberg-Marquardt in bound-scaled
coordinates. Columns of the base are stored and improved by Broyden's update, and columns of
effects are differenced at every step.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass

import numpy as np

from saddlering_ros.discrepancy.candidate import Candidate, Fit
from saddlering_ros.discrepancy.metric import Whitening
from saddlering_ros.discrepancy.system import Array, DiscrepancyError, Parameter, Point
from saddlering_ros.estimation.least_squares import descend, Descent, Rule

#: The whole range of a parameter counts as so many standard deviations: keeps idle ones still.
PRIOR = 1.0

QUIET_GAIN, QUIET_SHARE = 0.02, 1e-4
"""Gains below this number, or below this share of the misfit, are negligible."""

NEGLIGIBLE_GAIN = 0.1 * QUIET_GAIN
"""Smallest expected gain of a step that is taken."""

SPREAD = 24
"""Number of starts of the base that cover the range of every parameter."""

MAX_BASE_STARTS, COARSE_BASE = 6, 6
"""Number of starts of the base that are followed, and of their rounds, before the best are
fitted."""

WHITENED_AT_ONCE = 8_000_000
"""Numbers whitened together, because one product of matrices is faster than one per refit."""


@dataclass(frozen=True)
class Asked:
    """Request of a refit: a point, and others that lie `steps` away from it."""

    points: list[Point]
    steps: list[float]


@dataclass(frozen=True)
class Told:
    """Answer to a request: whitened residual (n,), sensitivities (n, k), and prediction."""

    residual: Array
    columns: Array
    prediction: Array


Asking = Generator[Asked, Told, Fit]


def refit(
    metric: Whitening,
    candidate: Candidate,
    start: Array,
    base_columns: Array | None = None,
    *,
    rounds: int = 8,
    full_jacobian: bool = False,
    fresh_base: bool = False,
    known_start: Fit | None = None,
) -> Asking:
    """Levenberg-Marquardt from `start`; yields requests and receives residuals and sensitivities.

    `full_jacobian`: every column is differenced at every step. Otherwise the columns of the
    base begin with `base_columns` and are improved during the fit (`fresh_base`: they begin
    with differences at `start`, where an effect changes them). known_start: the fit in this
    metric that ended at `start`, with sensitivities to all differenced parameters.
    """
    base = metric.experiment.system.base_parameters
    parameters = candidate.parameters(base)
    every = range(start.size)
    known = None if full_jacobian else base_columns
    differenced = every if known is None else range(len(base), start.size)
    periodic = np.array([item.periodic for item in parameters])
    rule = Rule(periodic, PRIOR, rounds, QUIET_GAIN, QUIET_SHARE, negligible=NEGLIGIBLE_GAIN)
    first = None if known_start is None else Told(
        known_start.whitened, known_start.jacobian[:, list(differenced)], known_start.prediction)
    descent: Generator[Array, Told, Descent[Told]] = descend(
        start, rule, differenced, known, every if fresh_base else None, first)
    aside: Sequence[int] = every if fresh_base else differenced
    told: Told | None = None
    while True:
        try:
            asked = next(descent) if told is None else descent.send(told)
        except StopIteration as stop:
            found: Descent[Told] = stop.value
            break
        thetas, steps = neighbours(parameters, asked, aside)
        told = yield Asked([candidate.point(base, item) for item in thetas], steps)
        aside = differenced
    residual = found.answer.residual
    return Fit(
        candidate=candidate, theta_unit=found.point,
        misfit=float(residual @ residual) if np.isfinite(found.cost) else np.inf,
        whitened=residual, jacobian=found.columns, prediction=found.answer.prediction,
        point=candidate.point(base, found.point), history=found.costs, converged=found.converged)


def _differences(columns: Array) -> Array:
    """Sensitivities (n, k); None if the simulator failed at a neighbour."""
    return np.where(np.isfinite(columns).all(axis=0), columns, 0.0)


def neighbours(
    parameters: Sequence[Parameter],
    theta_unit: Array,
    differenced: Sequence[int],
) -> tuple[list[Array], list[float]]:
    """`theta_unit`, its neighbours by one step in each of `differenced`, and the steps."""
    asked, steps = [theta_unit], []
    for index in differenced:
        step = parameters[index].step
        if theta_unit[index] + step > 1.0 and not parameters[index].periodic:
            step = -step
        moved = theta_unit.copy()
        moved[index] += step
        asked.append(moved)
        steps.append(step)
    return asked, steps


@dataclass(frozen=True)
class Tangent:
    """All sensitivities of a fit in bound-scaled coordinates: plain (n, p) and whitened (n, p)."""

    plain: Array
    white: Array


def tangent(metric: Whitening, fit: Fit) -> Tangent:
    """Sensitivities to every parameter at the fit."""
    base = metric.experiment.system.base_parameters
    parameters = fit.candidate.parameters(base)
    thetas, steps = neighbours(parameters, fit.theta_unit, range(fit.theta_unit.size))
    points = [fit.candidate.point(base, item) for item in thetas]
    answers = metric.experiment.predict_neighbours([points])[0]
    plain = _differences((answers[:, 1:] - answers[:, :1]) / np.array(steps))
    return Tangent(plain, metric.whiten(plain))


def run_refits(
    metric: Whitening,
    refits: Sequence[Asking],
    check: Callable[[], None] = lambda: None,
) -> list[Fit]:
    """Run refits together, with all their points in one batch per round."""
    done: dict[int, Fit] = {}
    waiting: dict[int, Asked] = {}
    for number, item in enumerate(refits):
        try:
            waiting[number] = next(item)
        except StopIteration as stop:
            done[number] = stop.value
    while waiting:
        check()
        order = list(waiting)
        answers = _told(metric, [waiting[key] for key in order])
        for number, told in zip(order, answers, strict=True):
            try:
                waiting[number] = refits[number].send(told)
            except StopIteration as stop:
                done[number] = stop.value
                del waiting[number]
    return [done[number] for number in range(len(refits))]


def _told(metric: Whitening, asked: Sequence[Asked]) -> list[Told]:
    """Residual and sensitivities of each refit, simulated and whitened together."""
    experiment = metric.experiment
    answers = experiment.predict_neighbours([item.points for item in asked])
    raw = []
    for item, answer in zip(asked, answers, strict=True):
        aside = (answer[:, 1:] - answer[:, :1]) / np.array(item.steps)
        raw.append(np.column_stack([answer[:, 0] - experiment.measured, aside]))
    together = max(1, WHITENED_AT_ONCE // experiment.size)
    told, start = [], 0
    while start < len(raw):
        stop, width = start + 1, raw[start].shape[1]
        while stop < len(raw) and width + raw[stop].shape[1] <= together:
            width += raw[stop].shape[1]
            stop += 1
        white = metric.whiten(np.hstack(raw[start:stop]))
        first = 0
        for index in range(start, stop):
            last = first + raw[index].shape[1]
            told.append(Told(white[:, first].copy(), _differences(white[:, first + 1 : last]),
                             answers[index][:, 0]))
            first = last
        start = stop
    return told


def declared_start(base: Sequence[Parameter]) -> Array:
    """The declared start of each parameter, or the middle of its range."""
    return np.array([item.first_guess for item in base])


def spread_starts(base: Sequence[Parameter], seed: int) -> list[Array]:
    """The declared start, and others that cover the range of every parameter evenly."""
    random = np.random.default_rng(seed)
    spread = (np.argsort(random.random((len(base), SPREAD)), axis=1).T + 0.5) / SPREAD
    return [declared_start(base), *spread]


def fit_base(
    metric: Whitening,
    start: Array | None,
    seed: int,
    check: Callable[[], None] = lambda: None,
) -> Fit:
    """The model without effects: many starts, then bounded least squares from the best."""
    base = metric.experiment.system.base_parameters
    empty = Candidate()
    starts: list[Fit | None]
    if start is not None:
        thetas, starts = [np.clip(start, 0.0, 1.0)], [None]
    else:
        asked = spread_starts(base, seed)
        check()
        whitened = metric.whiten(
            metric.experiment.predict([empty.point(base, theta_unit) for theta_unit in asked])
            - metric.experiment.measured[:, None]
        )
        order = np.argsort(np.nan_to_num((whitened**2).sum(axis=0), nan=np.inf))
        coarse = run_refits(
            metric,
            [
                refit(metric, empty, asked[int(number)], rounds=COARSE_BASE, full_jacobian=True)
                for number in order[:MAX_BASE_STARTS]
            ],
            check,
        )
        starts = [*sorted(coarse, key=lambda fit: fit.misfit)[:2]]
        thetas = [fit.theta_unit for fit in starts if fit is not None]
    fits = run_refits(
        metric,
        [
            refit(metric, empty, item, rounds=25, full_jacobian=True, known_start=fit)
            for item, fit in zip(thetas, starts, strict=True)
        ],
        check,
    )
    best = min(fits, key=lambda fit: fit.misfit)
    if not np.isfinite(best.misfit):
        raise DiscrepancyError(
            'simulator: it fails at every start of the base parameters: give each parameter a '
            'start at which the simulator runs'
        )
    return best
