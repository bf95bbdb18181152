"""Bounded least squares for many candidate models at once, their simulations put in one batch.

Each refit is a generator that asks for points and is sent their whitened residuals, so a simulator
that runs its batch in parallel is kept busy. Levenberg-Marquardt in bound-scaled coordinates; base
columns are kept and improved by Broyden's update, effect columns are taken afresh at every step.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import lsq_linear

from saddlering_ros.discrepancy.likelihood import Likelihood
from saddlering_ros.discrepancy.system import Array, Effect, Parameter, Point

#: The whole range of a parameter counts as so many standard deviations: keeps idle ones still.
PRIOR = 1.0

QUIET_ROUNDS, FAILED_ROUNDS = 2, 4
"""A refit ends after so many rounds in a row of no account, or of steps that led uphill."""


@dataclass(frozen=True)
class Candidate:
    """A model: the base and some effects, each in one variant."""

    effects: tuple[tuple[Effect, int], ...] = ()

    @property
    def ids(self) -> tuple[str, ...]:
        return tuple(effect.id for effect, _ in self.effects)

    def parameters(self, base: Sequence[Parameter]) -> tuple[Parameter, ...]:
        own = [parameter for effect, _ in self.effects for parameter in effect.parameters]
        return (*base, *own)

    def plus(self, effect: Effect, variant: int) -> Candidate:
        return Candidate((*self.effects, (effect, variant)))

    def without(self, effect_id: str) -> Candidate:
        return Candidate(tuple(item for item in self.effects if item[0].id != effect_id))

    def slices(self, fixed: int) -> Iterator[tuple[Effect, int, slice]]:
        """Each effect, its variant, and its place among parameters after `fixed` base ones."""
        start = fixed
        for effect, variant in self.effects:
            stop = start + len(effect.parameters)
            yield effect, variant, slice(start, stop)
            start = stop

    def point(self, base: Sequence[Parameter], place: Array) -> Point:
        """Point at bound-scaled coordinates `place`."""
        values = np.array(
            [item.from_unit(float(u)) for item, u in zip(base, place[: len(base)], strict=True)]
        )
        effects: dict[str, Mapping[str, float]] = {}
        for effect, variant, part in self.slices(len(base)):
            own = {
                item.name: item.from_unit(float(u))
                for item, u in zip(effect.parameters, place[part], strict=True)
            }
            effects[effect.id] = {**own, **effect.variants[variant]}
        return Point(values, effects)


@dataclass(frozen=True)
class Fit:
    """A candidate at its optimum: `place` bound-scaled, `misfit` the whitened sum of squares."""

    candidate: Candidate
    place: Array
    misfit: float
    whitened: Array
    jacobian: Array
    prediction: Array
    point: Point
    history: tuple[float, ...] = field(default=())

    def covariance(self, inflation: float = 1.0) -> Array:
        """Covariance in bound-scaled coordinates."""
        gram = self.jacobian.T @ self.jacobian + PRIOR**2 * np.eye(self.place.size)
        return np.asarray(np.linalg.inv(gram) * inflation)


Asking = Generator[list[Point], Array, Fit]


def refit(
    likelihood: Likelihood,
    candidate: Candidate,
    start: Array,
    base_columns: Array | None = None,
    *,
    rounds: int = 8,
    full: bool = False,
    afresh: bool = False,
) -> Asking:
    """Levenberg-Marquardt from `start`; asks for places, is sent predictions (n, B).

    `full` differences every column at every step; else the base columns start from `base_columns`
    (`afresh`: from differences at `start`, where an effect changes them) and are improved as the
    fit goes.
    """
    base = likelihood.system.base_parameters
    measured = likelihood.measured()
    parameters = candidate.parameters(base)
    count, fixed = start.size, len(base)
    full = full or base_columns is None
    differenced = list(range(count)) if full else list(range(fixed, count))
    columns = np.zeros((likelihood.size, count))
    if base_columns is not None:
        columns[:, :fixed] = base_columns

    def around(place: Array) -> tuple[list[Point], list[float]]:
        places, steps = neighbours(parameters, place, differenced)
        return [candidate.point(base, item) for item in places], steps

    def read(answer: Array, steps: list[float]) -> tuple[Array, Array, Array]:
        joined = likelihood.whiten(
            np.column_stack(
                [answer[:, 0] - measured]
                + [(answer[:, 1 + k] - answer[:, 0]) / step for k, step in enumerate(steps)]
            )
        )
        return joined[:, 0], joined[:, 1:], answer[:, 0]

    def cost(residual: Array, place: Array) -> float:
        return float(residual @ residual + PRIOR**2 * ((place - 0.5) ** 2).sum())

    place = np.clip(start, 0.0, 1.0)
    usual = differenced
    if afresh:
        differenced = list(range(count))
    asked, steps = around(place)
    residual, fresh, prediction = read((yield asked), steps)
    columns[:, differenced] = fresh
    differenced = usual
    best = cost(residual, place)
    history, damping, quiet, failed = [best], 1e-3, 0, 0
    for _ in range(rounds):
        move = _bounded_step(columns, residual, place, damping)
        if np.abs(move).max() < 1e-6:
            break
        trial = place + move
        asked, steps = around(trial)
        new_residual, fresh, new_prediction = read((yield asked), steps)
        value = cost(new_residual, trial)
        if value < best:
            if not full:
                surprise = new_residual - residual - columns @ move
                reach = move[:fixed]
                if reach @ reach > 0.25 * (move @ move):
                    columns[:, :fixed] += np.outer(surprise, reach) / (move @ move)
            gain = best - value
            place, residual, prediction, best = trial, new_residual, new_prediction, value
            columns[:, differenced] = fresh
            damping = max(damping * 0.2, 1e-9)
            quiet = quiet + 1 if gain < max(0.02, 1e-4 * best) else 0
            failed = 0
        else:
            damping = min(damping * 12.0, 1e6)
            failed += 1
        history.append(best)
        if quiet >= QUIET_ROUNDS or failed >= FAILED_ROUNDS:
            break
    return Fit(
        candidate,
        place,
        float(residual @ residual),
        residual,
        columns,
        prediction,
        candidate.point(base, place),
        tuple(history),
    )


def neighbours(
    parameters: Sequence[Parameter],
    place: Array,
    differenced: Sequence[int],
) -> tuple[list[Array], list[float]]:
    """`place` and, for each coordinate in `differenced`, a place one step aside; the steps."""
    asked, steps = [place], []
    for index in differenced:
        step = parameters[index].step
        if place[index] + step > 1.0:
            step = -step
        moved = place.copy()
        moved[index] += step
        asked.append(moved)
        steps.append(step)
    return asked, steps


@dataclass(frozen=True)
class Tangent:
    """All sensitivities of a fit in bound-scaled coordinates: plain (n, p) and whitened (n, p)."""

    plain: Array
    white: Array


def tangent(likelihood: Likelihood, fit: Fit) -> Tangent:
    """Finite differences of every parameter at the fit."""
    base = likelihood.system.base_parameters
    parameters = fit.candidate.parameters(base)
    places, steps = neighbours(parameters, fit.place, range(fit.place.size))
    answers = likelihood.predict([fit.candidate.point(base, place) for place in places])
    plain = (answers[:, 1:] - answers[:, :1]) / np.array(steps)
    return Tangent(plain, likelihood.whiten(plain))


def _bounded_step(columns: Array, residual: Array, place: Array, damping: float) -> Array:
    """Damped Gauss-Newton step that stays between 0 and 1."""
    gram = columns.T @ columns
    slope = columns.T @ residual
    gram[np.diag_indices_from(gram)] += PRIOR**2
    slope = slope + PRIOR**2 * (place - 0.5)
    gram[np.diag_indices_from(gram)] *= 1.0 + damping
    # In coordinates scaled by the diagonal: K and n of one contact are all but parallel.
    scale = 1.0 / np.sqrt(np.diag(gram))
    scaled = gram * np.outer(scale, scale)
    free = -np.linalg.solve(scaled, slope * scale) * scale
    if np.all((place + free >= 0.0) & (place + free <= 1.0)):
        return free
    root = np.linalg.cholesky(scaled + 1e-12 * np.eye(place.size)).T
    target = -np.linalg.solve(root.T, slope * scale)
    low, high = -place / scale, (1.0 - place) / scale
    answer = lsq_linear(root, target, bounds=(low - 1e-12, high + 1e-12), method='bvls')
    return np.clip(place + answer.x * scale, 0.0, 1.0) - place


def run_refits(
    likelihood: Likelihood,
    refits: Sequence[Asking],
    check: Callable[[], None] = lambda: None,
) -> list[Fit]:
    """Drive refits side by side, all their points in one batch per round."""
    done: dict[int, Fit] = {}
    waiting = {number: next(item) for number, item in enumerate(refits)}
    while waiting:
        check()
        order = list(waiting)
        answers = likelihood.predict([point for number in order for point in waiting[number]])
        start = 0
        for number in order:
            width = len(waiting[number])
            part = answers[:, start : start + width]
            start += width
            try:
                waiting[number] = refits[number].send(part)
            except StopIteration as stop:
                done[number] = stop.value
                del waiting[number]
    return [done[number] for number in range(len(refits))]


def declared_place(base: Sequence[Parameter]) -> Array:
    """The start that each parameter declares, the middle of its range where it does not."""
    return np.array([0.5 if item.start is None else item.to_unit(item.start) for item in base])


def fit_base(
    likelihood: Likelihood,
    start: Array | None,
    seed: int,
    check: Callable[[], None] = lambda: None,
) -> Fit:
    """The model without effects: a spread of starts, then bounded least squares from the best."""
    base = likelihood.system.base_parameters
    empty = Candidate()
    random = np.random.default_rng(seed)
    if start is not None:
        places = [np.clip(start, 0.0, 1.0)]
    else:
        declared = declared_place(base)
        spread = (np.argsort(random.random((len(base), 24)), axis=1).T + 0.5) / 24
        asked = [declared, *spread]
        check()
        whitened = likelihood.whiten(
            likelihood.predict([empty.point(base, place) for place in asked])
            - likelihood.measured()[:, None]
        )
        order = np.argsort((whitened**2).sum(axis=0))
        places = [asked[int(order[0])], asked[int(order[1])]]
    fits = run_refits(
        likelihood,
        [refit(likelihood, empty, place, rounds=25, full=True) for place in places],
        check,
    )
    return min(fits, key=lambda fit: fit.misfit)
