"""Candidate models and their fits in a metric.

Bounded least squares runs for many candidates at once, with all simulations in one batch. Each
refit is a generator that yields points and receives their whitened residuals, so that a simulator
with parallel batches stays busy. The method is Levenberg-Marquardt in bound-scaled coordinates.
Columns of the base are stored and improved by Broyden's update, and columns of effects are
differenced at every step.
"""

from collections.abc import Collection, Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from saddlering_ros.discrepancy.problem import system
from saddlering_ros.discrepancy.problem.problem import Problem
from saddlering_ros.discrepancy.problem.system import Array, Effect, Parameter, Point, RunBlocks
from saddlering_ros.estimation.least_squares import bounded_step, descend, Descent, Rule

Key = tuple[tuple[str, int], ...]
"""Key of the fit of a candidate: its effects and variants, in any order."""


@dataclass(frozen=True)
class Candidate:
    """A model: the base and some effects, each in one variant."""

    effects: tuple[tuple[Effect, int], ...] = ()

    @property
    def key(self) -> Key:
        return tuple(sorted((effect.id, variant) for effect, variant in self.effects))

    @property
    def ids(self) -> tuple[str, ...]:
        return tuple(effect.id for effect, _ in self.effects)

    def parameters(self, base: Sequence[Parameter]) -> tuple[Parameter, ...]:
        own = [parameter for effect, _ in self.effects for parameter in effect.ordered]
        return (*base, *own)

    def plus(self, effect: Effect, variant: int) -> 'Candidate':
        return Candidate((*self.effects, (effect, variant)))

    def without(self, effect_id: str) -> 'Candidate':
        return Candidate(tuple(pair for pair in self.effects if pair[0].id != effect_id))

    def slices(self, fixed: int) -> Iterator[tuple[Effect, int, slice]]:
        """Each effect, its variant, and its parameters' indices after `fixed` base parameters."""
        start = fixed
        for effect, variant in self.effects:
            stop = start + len(effect.ordered)
            yield effect, variant, slice(start, stop)
            start = stop

    def point(self, base: Sequence[Parameter], theta_unit: Array) -> Point:
        """Point at bound-scaled coordinates `theta_unit`."""
        values = np.array([
            one.from_unit(float(u)) for one, u in zip(base, theta_unit[: len(base)], strict=True)])
        effects: dict[str, Mapping[str, float]] = {}
        for effect, variant, part in self.slices(len(base)):
            own = {parameter.name: parameter.from_unit(float(u))
                   for parameter, u in zip(effect.ordered, theta_unit[part], strict=True)}
            effects[effect.id] = {**own, **effect.variants[variant]}
        return Point(values, effects)


@dataclass(frozen=True)
class _Settled(Candidate):
    """A model whose effects keep their parameters (k,), bound-scaled: only the base is fitted."""

    kept: Array = field(default_factory=lambda: np.zeros(0))

    def parameters(self, base: Sequence[Parameter]) -> tuple[Parameter, ...]:
        return tuple(base)

    def point(self, base: Sequence[Parameter], theta_unit: Array) -> Point:
        return super().point(base, np.concatenate([theta_unit, self.kept]))


@dataclass(frozen=True)
class Fit:
    """A candidate at its optimum.

    theta_unit (p,): bound-scaled parameters; misfit: the whitened sum of squares; plain (n, p):
    sensitivities of the prediction, if all were differenced at the optimum.
    """

    candidate: Candidate
    theta_unit: Array
    misfit: float
    whitened: Array
    jacobian: Array
    prediction: Array
    point: Point
    history: tuple[float, ...] = field(default=())
    converged: bool = True
    plain: Array | None = None

    @property
    def parts(self) -> list[tuple[Effect, int, slice]]:
        """Each effect, its variant, and the indices of its parameters."""
        return list(self.candidate.slices(self.point.base.size))


PRIOR = 1.0
"""Standard deviations in the whole range of a parameter: idle ones stay, others hardly move."""

QUIET_GAIN, QUIET_SHARE = 0.02, 1e-4
"""Gains below this number, or below this share of the misfit, are negligible. A likelihood ratio
of 0.02 changes no decision: the smallest limit is above 4."""

NEGLIGIBLE_GAIN = 0.1 * QUIET_GAIN
"""Smallest expected gain of a step that is taken: a tenth of a negligible gain."""

SPREAD = 24
"""Number of starts that cover the range of the base. Chosen for cost: one batch."""

MAX_BASE_STARTS, COARSE_BASE = 6, 6
"""Number of starts of the base that are followed, and of their rounds. With fewer starts a base
fit ended in a wrong minimum, in which an effect of no size had p = 1e-173."""

WHITENED_AT_ONCE = 8_000_000
"""Numbers whitened together (64 MB): one product is faster than one per refit."""


class Whitening(Protocol):
    """A metric for refits: its problem, and `whiten`, which divides by the usual size."""

    @property
    def problem(self) -> Problem: ...

    def whiten(self, columns: Array) -> Array:
        """Stacked columns (n, B) or (n,) in units of the usual size."""
        ...


@dataclass(frozen=True)
class Told:
    """Answer to a request: whitened residual (n,), sensitivities (n, k), and prediction.

    plain (n, k): sensitivities of the prediction, if they are known.
    """

    residual: Array
    columns: Array
    prediction: Array
    plain: Array | None


Asked = tuple[list[Point], list[float]]
"""Request of a refit: a point and others, and the steps by which the others lie away from it."""

Asking = Generator[Asked, Told | None, Fit]


def refit(metric: Whitening, candidate: Candidate, start: Array,
          known_columns: Array | None = None, *, rounds: int = 8, fresh_base: bool = False,
          known_start: Fit | None = None) -> Asking:
    """Levenberg-Marquardt from `start`; yields requests and receives residuals and sensitivities.

    Without `known_columns` every column is differenced at every step. With them the columns of
    the first parameters begin there and are improved during the fit (`fresh_base`: those of the
    base begin with differences at `start`, where an effect changes them). known_start: the fit in
    this metric that ended at `start`, with sensitivities to all differenced parameters.
    """
    base = metric.problem.system.base_parameters
    known = 0 if known_columns is None else known_columns.shape[1]
    differenced = list(range(known, start.size))
    aside = [*range(len(base)), *differenced] if fresh_base else differenced
    periodic = np.array([parameter.periodic for parameter in candidate.parameters(base)])
    rule = Rule(periodic, PRIOR, rounds, QUIET_GAIN, QUIET_SHARE, negligible=NEGLIGIBLE_GAIN,
                stays_from=len(base))
    first = None if known_start is None else Told(
        known_start.whitened, known_start.jacobian[:, differenced], known_start.prediction,
        known_start.plain)
    descent: Generator[Array, Told, Descent[Told]] = descend(
        start, rule, differenced, known_columns, aside, first)
    told: Told | None = None
    while True:
        try:
            asked = next(descent) if told is None else descent.send(told)
        except StopIteration as stop:
            end: Descent[Told] = stop.value
            break
        told = yield neighbours(candidate, base, asked, aside)
        aside = differenced
    residual = end.answer.residual
    return Fit(
        candidate=candidate, theta_unit=end.point,
        misfit=float(residual @ residual) if np.isfinite(end.cost) else np.inf,
        whitened=residual, jacobian=end.columns, prediction=end.answer.prediction,
        point=candidate.point(base, end.point), history=end.costs, converged=end.converged,
        plain=None if known else end.answer.plain)


def linear_misfit(fit: Fit, base: Sequence[Parameter]) -> float:
    """The misfit to which the slopes of an unfinished fit lead inside its bounds."""
    periodic = np.array([parameter.periodic for parameter in fit.candidate.parameters(base)])
    move = bounded_step(
        fit.jacobian, fit.whitened, fit.theta_unit, 0.0, Rule(
            periodic, PRIOR, 1, 0.0, 0.0, stays_from=len(base)))
    left = fit.whitened + fit.jacobian @ move
    return float(left @ left)


def stepped_misfit(products: Array) -> float:
    """The misfit after one step without bounds, by products (p + 1, p + 1), the residual last."""
    gram, slope = products[:-1, :-1], products[:-1, -1]
    return float(products[-1, -1] - slope @ np.linalg.solve(
        gram + PRIOR**2 * np.eye(slope.size), slope))


def _differences(columns: Array) -> Array:
    """Sensitivities (n, k); None if the simulator failed at a neighbour."""
    return np.where(np.isfinite(columns).all(axis=0), columns, 0.0)


def neighbours(candidate: Candidate, base: Sequence[Parameter], theta_unit: Array,
               differenced: Iterable[int]) -> Asked:
    """The point at `theta_unit`, those one step away in each of `differenced`, and the steps."""
    parameters, steps = candidate.parameters(base), list[float]()
    points = [candidate.point(base, theta_unit)]
    for index in differenced:
        step = parameters[index].step
        if theta_unit[index] + step > 1.0 and not parameters[index].periodic:
            step = -step
        moved = theta_unit.copy()
        moved[index] += step
        points.append(candidate.point(base, moved))
        steps.append(step)
    return points, steps


def around(fit: Fit, base: Sequence[Parameter]) -> Asked:
    """The point of a fit, those one step away in each parameter, and the steps."""
    return neighbours(fit.candidate, base, fit.theta_unit, range(fit.theta_unit.size))


@dataclass(frozen=True)
class Tangent:
    """All sensitivities of a fit in bound-scaled coordinates: plain (n, p) and whitened (n, p)."""

    plain: Array
    white: Array


def tangent(metric: Whitening, fit: Fit) -> Tangent:
    """Sensitivities to every parameter at the fit."""
    if fit.plain is not None:
        return Tangent(fit.plain, metric.whiten(fit.plain))
    points, steps = around(fit, metric.problem.system.base_parameters)
    answers = metric.problem.predict_neighbours([points])[0]
    plain = _differences((answers[:, 1:] - answers[:, :1]) / np.array(steps))
    return Tangent(plain, metric.whiten(plain))


def centred(metric: Whitening, fit: Fit, white: Array) -> Array:
    """Whitened sensitivities (n, p) by central differences along the directions of `white`.

    A combination of parameters that changes nothing has a length in differences to one side: the
    curvatures of its columns do not cancel, and its interval would be too narrow. So would that of
    a small move which a switch answers with a whole sample: the shorter change counts.
    """
    base = metric.problem.system.base_parameters
    steps = np.array([one.step for one in fit.candidate.parameters(base)])
    rows = np.linalg.svd(white * steps, full_matrices=False)[2]
    least = np.abs(rows * steps).max(axis=0)
    middle = np.clip(fit.theta_unit, least, 1.0 - least)
    answers = metric.problem.predict([
        fit.candidate.point(base, middle + side * move) for move in rows * steps
        for side in (1.0, -1.0)])
    changes = metric.whiten(np.ascontiguousarray(answers[:, ::2] - answers[:, 1::2]) / 2.0)
    straight = white @ (rows * steps).T
    is_shorter = np.linalg.norm(changes, axis=0) <= np.linalg.norm(straight, axis=0)  # no NaN
    changes = np.where(is_shorter, changes, straight)
    return np.asarray(changes @ rows / steps)


def refit_base(metric: Whitening, fit: Fit, names: Collection[str], rounds: int) -> Fit:
    """The base refitted in a metric, beside those effects of a fit, with the sizes found there."""
    base = len(metric.problem.system.base_parameters)
    kept = [(effect, variant, fit.theta_unit[part])
            for effect, variant, part in fit.parts if effect.id in names]
    effects = tuple((effect, variant) for effect, variant, _ in kept)
    candidate = _Settled(effects, np.concatenate([np.zeros(0), *(part for *_, part in kept)]))
    [settled] = run_refits(
        metric, [refit(metric, candidate, fit.theta_unit[:base], rounds=rounds)])
    whole = replace(settled, candidate=Candidate(effects), plain=None,
                    theta_unit=np.concatenate([settled.theta_unit, candidate.kept]))
    sensitivities = tangent(metric, whole)
    return replace(whole, plain=sensitivities.plain, jacobian=sensitivities.white)


def begun_in(metric: Whitening, fit: Fit) -> Fit | None:
    """A fit in another metric of its runs, from which a refit starts; None if not all is known."""
    if fit.plain is None:
        return None
    white = metric.whiten(np.column_stack([fit.prediction - metric.problem.measured, fit.plain]))
    return replace(fit, whitened=white[:, 0].copy(), jacobian=_differences(white[:, 1:]))


def run_refits(metric: Whitening, refits: Sequence[Asking]) -> list[Fit]:
    """Run refits together, with all their points in one batch per round."""
    done: dict[int, Fit] = {}
    told: dict[int, Told | None] = dict.fromkeys(range(len(refits)))  # None begins a refit.
    while told:
        waiting: dict[int, Asked] = {}
        for number, answer in told.items():
            try:
                waiting[number] = refits[number].send(answer)
            except StopIteration as stop:
                done[number] = stop.value
        metric.problem.watch.check()
        told = dict(zip(waiting, _told(metric, list(waiting.values())), strict=True))
    return [done[number] for number in range(len(refits))]


def _told(metric: Whitening, asked: Sequence[Asked]) -> list[Told]:
    """Residual and sensitivities of each refit, simulated and whitened together."""
    problem = metric.problem
    if not asked:
        return []
    answers = problem.predict_neighbours([points for points, _ in asked])
    raw = []
    for (_, steps), answer in zip(asked, answers, strict=True):
        aside = (answer[:, 1:] - answer[:, :1]) / np.array(steps)
        raw.append(np.column_stack([answer[:, 0] - problem.measured, aside]))
    together = max(1, WHITENED_AT_ONCE // problem.size)
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
                             answers[index][:, 0], _differences(raw[index][:, 1:])))
            first = last
        start = stop
    return told


def declared_start(base: Sequence[Parameter]) -> Array:
    """The declared start of each parameter, or the middle of its range."""
    return np.array([parameter.first_guess for parameter in base])


def spread_starts(base: Sequence[Parameter], seed: int) -> list[Array]:
    """The declared start, and others that cover the range of every parameter evenly."""
    random = np.random.default_rng(seed)
    spread = (np.argsort(random.random((len(base), SPREAD)), axis=1).T + 0.5) / SPREAD
    return [declared_start(base), *spread]


def fit_base(metric: Whitening) -> Fit:
    """The model without effects: many starts, then bounded least squares from the best."""
    base = metric.problem.system.base_parameters
    problem, empty = metric.problem, Candidate()
    start = problem.first_guess()
    if start is not None:
        wanted = [refit(metric, empty, np.clip(start, 0.0, 1.0), rounds=25)]
    else:
        asked = spread_starts(base, problem.settings.seed)
        problem.watch.check()
        predicted = problem.predict([empty.point(base, one) for one in asked])
        whitened = metric.whiten(predicted - problem.measured[:, None])
        order = np.argsort(np.nan_to_num((whitened**2).sum(axis=0), nan=np.inf))
        coarse = run_refits(metric, [
            refit(metric, empty, asked[int(number)], rounds=COARSE_BASE)
            for number in order[:MAX_BASE_STARTS]])
        wanted = [refit(metric, empty, fit.theta_unit, rounds=25, known_start=fit)
                  for fit in sorted(coarse, key=lambda fit: fit.misfit)[:2]]
    best = min(run_refits(metric, wanted), key=lambda fit: fit.misfit)
    if not np.isfinite(best.misfit):
        reason = next((f' ({why}; the last in {where})' for why, where in getattr(
            problem.system, 'failed_at', {}).items()), '')
        raise system.DiscrepancyError(
            f'simulator: it fails at every start of the base parameters{reason}: give each '
            'parameter a start at which the simulator runs')
    return best


@dataclass(frozen=True)
class GainMetric:
    """The metric of the gain for refits: weighted residuals in every view, scaled to `unit`."""

    problem: Problem
    unit: float

    @classmethod
    def about(cls, problem: Problem, fit: Fit) -> 'GainMetric':
        """The metric in which the residual of a fit has a mean square of one."""
        seen = problem.in_views(fit.prediction - problem.measured)
        return cls(problem, max(float(np.sqrt(seen @ seen / seen.size)), 1e-12))

    def whiten(self, columns: Array) -> Array:
        """Stacked columns (n, B) or (n,) in their views, weighted by time, over the range."""
        return self.problem.in_views(columns) / self.unit


def refits_to_held_out(problem: Problem, model: Fit) -> Iterator[tuple[RunBlocks, Problem, Fit]]:
    """Each held-out run, the problem in which it is the last fitted one, and the model there."""
    for run in problem.held_out:
        if not np.isfinite(problem.simulate(run, [model.point])[0]).all():
            continue
        joint = problem.with_runs([*problem.runs, replace(run, held_out=False)])
        metric = GainMetric(joint, GainMetric.about(problem, model).unit)
        [fit] = run_refits(metric, [refit(metric, model.candidate, model.theta_unit)])
        yield run, joint, fit


def plain_fits(problem: Problem, fits: Sequence[Fit]) -> list[Fit]:
    """The same models, each fitted in the metric of the gain.

    A base without effects is also fitted from its declared start, because whitened and plain
    least squares can have different minima.
    """
    base, rounds = problem.system.base_parameters, problem.settings.max_rounds
    answers = []
    for fit in fits:
        metric = GainMetric.about(problem, fit)
        wanted = [refit(metric, fit.candidate, fit.theta_unit, rounds=rounds,
                                known_start=begun_in(metric, fit))]
        if not fit.candidate.effects:
            start = declared_start(base)
            wanted.append(refit(metric, fit.candidate, start, rounds=rounds))
        refits = run_refits(metric, wanted)
        answers.append(min(refits, key=lambda refitted: refitted.misfit))
    return answers


@dataclass(frozen=True)
class Gain:
    """Gains as shares, 1 for no misfit; `held_out`: None if no run was held out.

    interval: of `held_out`, 95 %, from draws of stretches; None where it was not computed.
    """

    fit: float
    held_out: float | None
    how: str
    interval: tuple[float, float] | None = None

    @property
    def is_surely_worse(self) -> bool:
        """Whether all of the interval is below zero."""
        return self.interval is not None and self.interval[1] < 0.0
