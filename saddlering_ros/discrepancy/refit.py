"""Bounded least squares for many candidate models at once, their simulations put in one batch.

Each refit is a generator that asks for points and is sent their whitened residuals, so a simulator
that runs its batch in parallel is kept busy. Levenberg-Marquardt in bound-scaled coordinates; base
columns are kept and improved by Broyden's update, effect columns are differenced at every step.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from saddlering_ros.discrepancy.candidate import Candidate, Fit
from saddlering_ros.discrepancy.metric import Whitening
from saddlering_ros.discrepancy.system import Array, DiscrepancyError, Parameter, Point

#: The whole range of a parameter counts as so many standard deviations: keeps idle ones still.
PRIOR = 1.0

PERIODIC_REACH = 0.25
"""A step turns a periodic parameter by so much of its period at most."""

MIN_MOVE = 1e-6
"""A step shorter than this, in shares of every range, ends a refit."""

QUIET_ROUNDS, FAILED_ROUNDS = 2, 4
"""A refit ends after so many rounds in a row of no account, or of steps that led uphill."""

MAX_BASE_STARTS, COARSE_BASE = 6, 6
"""So many starts of the base are followed for so many rounds before the best are fitted."""


WHITENED_AT_ONCE = 8_000_000
"""Numbers whitened together: one product of matrices is faster than one for every refit."""


@dataclass(frozen=True)
class Asked:
    """What a refit asks for: a point, and others that lie `steps` aside of it."""

    points: list[Point]
    steps: list[float]


@dataclass(frozen=True)
class Told:
    """What it is sent: the whitened residual (n,), sensitivities (n, k), and the prediction."""

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
) -> Asking:
    """Levenberg-Marquardt from `start`; asks for points, is sent residual and sensitivities.

    `full_jacobian` differences every column at every step; else the base columns start from
    `base_columns` (`fresh_base`: from differences at `start`, where an effect changes them) and
    are improved as the fit goes.
    """
    base = metric.experiment.system.base_parameters
    parameters = candidate.parameters(base)
    count, fixed = start.size, len(base)
    full_jacobian = full_jacobian or base_columns is None
    differenced = list(range(count)) if full_jacobian else list(range(fixed, count))

    def around(theta_unit: Array) -> Asked:
        thetas, steps = neighbours(parameters, theta_unit, differenced)
        return Asked([candidate.point(base, item) for item in thetas], steps)

    periodic = np.array([item.periodic for item in parameters])

    def cost(residual: Array, theta_unit: Array) -> float:
        apart = np.where(periodic, 0.0, theta_unit - 0.5)
        value = float(residual @ residual + PRIOR**2 * (apart**2).sum())
        return value if np.isfinite(value) else np.inf

    theta_unit = _inside(start, periodic)
    usual = differenced
    if fresh_base:
        differenced = list(range(count))
    told = yield around(theta_unit)
    residual, prediction = told.residual, told.prediction
    columns = np.zeros((residual.size, count))
    if base_columns is not None:
        columns[:, :fixed] = base_columns
    columns[:, differenced] = told.columns
    differenced = usual
    best = cost(residual, theta_unit)
    history, damping, quiet, failed, converged = [best], 1e-3, 0, 0, False
    for _ in range(rounds):
        if not np.isfinite(best):
            break
        move = _bounded_step(columns, residual, theta_unit, damping, periodic)
        converged = bool(np.abs(move).max() < MIN_MOVE)
        if converged:
            break
        trial = _inside(theta_unit + move, periodic)
        told = yield around(trial)
        value = cost(told.residual, trial)
        if value < best:
            if not full_jacobian:
                surprise = told.residual - residual - columns @ move
                reach = move[:fixed]
                if reach @ reach > 0.25 * (move @ move):
                    columns[:, :fixed] += np.outer(surprise, reach) / (move @ move)
            gain = best - value
            theta_unit, residual, prediction, best = trial, told.residual, told.prediction, value
            columns[:, differenced] = told.columns
            damping = max(damping * 0.2, 1e-9)
            quiet = quiet + 1 if gain < max(0.02, 1e-4 * best) else 0
            failed = 0
        else:
            damping = min(damping * 12.0, 1e6)
            failed += 1
        history.append(best)
        converged = quiet >= QUIET_ROUNDS or failed >= FAILED_ROUNDS
        if converged:
            break
    return Fit(
        candidate,
        theta_unit,
        float(residual @ residual) if np.isfinite(best) else np.inf,
        residual,
        columns,
        prediction,
        candidate.point(base, theta_unit),
        tuple(history),
        converged,
    )


def _differences(columns: Array) -> Array:
    """Sensitivities (n, k); none where the simulator failed one step aside."""
    return np.where(np.isfinite(columns).all(axis=0), columns, 0.0)


def _inside(theta_unit: Array, periodic: NDArray[np.bool_]) -> Array:
    """Bound-scaled parameters between 0 and 1; periodic ones go round."""
    return np.where(periodic, theta_unit % 1.0, np.clip(theta_unit, 0.0, 1.0))


def neighbours(
    parameters: Sequence[Parameter],
    theta_unit: Array,
    differenced: Sequence[int],
) -> tuple[list[Array], list[float]]:
    """`theta_unit`, and the same one step aside in each of `differenced`; the steps."""
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


def _bounded_step(
    columns: Array,
    residual: Array,
    theta_unit: Array,
    damping: float,
    periodic: NDArray[np.bool_],
) -> Array:
    """Damped Gauss-Newton step that stays between 0 and 1."""
    gram = columns.T @ columns
    slope = columns.T @ residual
    gram[np.diag_indices_from(gram)] += PRIOR**2
    slope = slope + PRIOR**2 * np.where(periodic, 0.0, theta_unit - 0.5)
    gram[np.diag_indices_from(gram)] *= 1.0 + damping
    # In coordinates scaled by the diagonal: K and n of one contact are all but parallel.
    scale = 1.0 / np.sqrt(np.diag(gram))
    scaled = gram * np.outer(scale, scale)
    free = -np.linalg.solve(scaled, slope * scale) * scale
    least = np.where(periodic, -PERIODIC_REACH, -theta_unit)
    most = np.where(periodic, PERIODIC_REACH, 1.0 - theta_unit)
    if np.all((free >= least) & (free <= most)):
        return np.asarray(free)
    root = np.linalg.cholesky(scaled + 1e-12 * np.eye(theta_unit.size)).T
    target = -np.linalg.solve(root.T, slope * scale)
    low, high = least / scale, most / scale
    answer = lsq_linear(root, target, bounds=(low - 1e-12, high + 1e-12), method='bvls')
    return np.asarray(np.clip(answer.x * scale, least, most))


def run_refits(
    metric: Whitening,
    refits: Sequence[Asking],
    check: Callable[[], None] = lambda: None,
) -> list[Fit]:
    """Drive refits side by side, all their points in one batch per round."""
    done: dict[int, Fit] = {}
    waiting = {number: next(item) for number, item in enumerate(refits)}
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
    """Residual and sensitivities of each, simulated and whitened together."""
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
    """The start that each parameter declares, the middle of its range where it does not."""
    return np.array([item.first_guess for item in base])


def fit_base(
    metric: Whitening,
    start: Array | None,
    seed: int,
    check: Callable[[], None] = lambda: None,
) -> Fit:
    """The model without effects: a spread of starts, then bounded least squares from the best."""
    base = metric.experiment.system.base_parameters
    empty = Candidate()
    random = np.random.default_rng(seed)
    if start is not None:
        thetas = [np.clip(start, 0.0, 1.0)]
    else:
        declared = declared_start(base)
        spread = (np.argsort(random.random((len(base), 24)), axis=1).T + 0.5) / 24
        asked = [declared, *spread]
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
        coarse.sort(key=lambda fit: fit.misfit)
        thetas = [fit.theta_unit for fit in coarse[:2]]
    fits = run_refits(
        metric,
        [refit(metric, empty, item, rounds=25, full_jacobian=True) for item in thetas],
        check,
    )
    best = min(fits, key=lambda fit: fit.misfit)
    if not np.isfinite(best.misfit):
        raise DiscrepancyError(
            'simulator: it fails at every start of the base parameters: give each parameter a '
            'start at which the simulator runs'
        )
    return best
