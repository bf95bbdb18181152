"""The next test: the possible test that most often leaves only the true model.

Each model in turn is the truth. Its prediction for the test is drawn with its parameters and the
nuisance parameters as the data leave them, and with the noise of the record. Every model is then
judged on the old and the new data, by the rule that keeps an alternative in a group. Models are
linear about their fits, so that a fit to all data needs no further simulation: the misfit grows by
that of the new data in the metric of the model's own prediction (the update of a linear model with
normal errors).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
import math

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, cholesky, solve_triangular

from saddlering_ros.discrepancy.problem.fits import Fit, neighbours, Tangent
from saddlering_ros.discrepancy.problem.problem import (
    Metric,
    model_error_columns,
    offset_columns,
    Problem,
    system_columns,
    timing_columns,
)
from saddlering_ros.discrepancy.problem.system import Array, Effect, Point, Proposal, Settings
from saddlering_ros.discrepancy.search.evidence import alternative_floor, indistinguishable
from saddlering_ros.discrepancy.search.selection import Alternatives
from saddlering_ros.discrepancy.search.space import ModelSpace


@dataclass(frozen=True)
class NextTest:
    """What parts open models: proposed tests, the best first, and the held-out runs."""

    separations: tuple[Separation, ...] = ()
    by_held_out: tuple[HeldOutEvidence, ...] = ()


def next_test_of(space: ModelSpace, fit: Fit, alternatives: Alternatives) -> NextTest:
    """The tests and the held-out runs that part a model and its alternatives."""
    others = [
        OpenModel(other, space.without(fit, name))
        for name, models in alternatives.items()
        for other in models
    ]
    if not others:
        return NextTest()
    open_models = [OpenModel(fit, others[0].less), *others]
    rule = JudgingRule(
        floor=alternative_floor(space.pairs, space.settings),
        excess=max(space.slow_residual(fit).excess, 0.0), log_size=space.log_size,
        settings=space.settings)
    separations = simulate_tests(
        space.metric, open_models, space.tangent_of, space.problem.proposals, rule,
        seed=space.settings.seed) if space.problem.proposals else []
    return NextTest(tuple(separations), _judged_by_held_out(space, open_models, rule))


def _judged_by_held_out(
    space: ModelSpace, open_models: Sequence[OpenModel], rule: JudgingRule
) -> tuple[HeldOutEvidence, ...]:
    """A model and its alternatives judged by the held-out runs, the most likely first.

    Each predicts them with its parameters as the fitted runs leave them.
    """
    proposals = [Proposal(run.name, replace(run, held_out=False), 'held_out')
                 for run in space.problem.held_out]
    if not proposals:
        return ()
    fits = _distinct(open_models)
    misfits = np.array([one.misfit for one in fits])
    for proposal, forecasts in _forecast_each(
            space.metric, open_models, space.tangent_of, proposals):
        measured = proposal.run.channels.ravel()
        misfits = misfits + [float(one.misfits(one.whiten(measured[:, None]))[0])
                             for one in forecasts]
    number = {one.candidate.key: index for index, one in enumerate(fits)}
    own = misfits[[number[one.fit.candidate.key] for one in open_models]]
    less = misfits[[number[one.less.candidate.key] for one in open_models]]
    left = _left(open_models, own, less, rule)
    price = np.array([space.log_size * one.fit.theta_unit.size for one in open_models])
    odds = np.exp(-0.5 * (own + price - (own + price).min()))
    answers = []
    for index, one in enumerate(open_models):
        effects = {effect.id: effect.title for effect, _ in one.fit.candidate.effects}
        new = [name for name in effects if name not in one.less.candidate.ids]
        answers.append(HeldOutEvidence(
            new[0], effects[new[0]], tuple(run.name for run in space.problem.held_out),
            float(own[index] - own.min()), float(odds[index] / odds.sum()), index in left))
    return tuple(sorted(answers, key=lambda one: -one.share))


DRAWS = 100
"""Number of draws with each model as the truth: a share is known to 10 % at worst (95 %)."""


@dataclass(frozen=True)
class OpenModel:
    """A model that the data leave open, and the same model without the cause in question."""

    fit: Fit
    less: Fit


@dataclass(frozen=True)
class HeldOutEvidence:
    """An open alternative judged by held-out runs.

    distance: misfit of fitted and held-out runs beyond that of the best; share: of the
    probability of all alternatives; remains: whether the rule of groups keeps it.
    """

    effect: str
    title: str
    runs: tuple[str, ...]
    distance: float
    share: float
    remains: bool


@dataclass(frozen=True)
class JudgingRule:
    """Limits within which a model stays in a group: see search/evidence.py."""

    floor: float
    excess: float
    log_size: float
    settings: Settings


@dataclass(frozen=True)
class Separation:
    """Result of a proposed test in simulated draws.

    draws: over all truths; alone: draws that leave only the true model; kept: draws that leave
    it at all; by_truth: share of the draws that leave only the true model, for each truth.
    """

    proposal: Proposal
    draws: int
    alone: int
    kept: int
    by_truth: Mapping[tuple[str, ...], float]

    @property
    def share(self) -> float:
        """Share of the draws that leave only the true model."""
        return self.alone / self.draws

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the share (E. B. Wilson, J. Am. Stat. Assoc. 22 (1927) 209)."""
        z, count = 1.96, self.draws
        middle = (self.share + z * z / (2 * count)) / (1 + z * z / count)
        half = math.sqrt(self.share * (1 - self.share) / count + z * z / (4 * count**2))
        half *= z / (1 + z * z / count)
        return max(0.0, middle - half), min(1.0, middle + half)


def simulate_tests(
    metric: Metric,
    open_models: Sequence[OpenModel],
    tangent_of: Callable[[Fit], Tangent],
    proposals: Sequence[Proposal],
    rule: JudgingRule,
    *,
    seed: int = 0,
) -> list[Separation]:
    """Each proposal with its separation of the models, the best first."""
    fits, random = _distinct(open_models), np.random.default_rng(seed)
    answers = [
        _separation(proposal, open_models, fits, forecasts, rule, random)
        for proposal, forecasts in _forecast_each(metric, open_models, tangent_of, proposals)]
    return sorted(answers, key=lambda answer: (-answer.alone, -answer.kept))


def _distinct(open_models: Sequence[OpenModel]) -> list[Fit]:
    """Every fit among the models and what they have without the cause in question."""
    return list({fit.candidate.key: fit for open_model in open_models
                 for fit in (open_model.fit, open_model.less)}.values())


def _forecast_each(
    metric: Metric, open_models: Sequence[OpenModel], tangent_of: Callable[[Fit], Tangent],
    proposals: Sequence[Proposal],
) -> Iterator[tuple[Proposal, list[_Forecast]]]:
    """Each proposal with its prediction by every fit."""
    old, fits = metric.problem, _distinct(open_models)
    seen = [_seen_by(old, proposal, fits) for proposal in proposals]
    joint = old.with_runs([*old.runs, *(proposal.run for proposal in proposals)])
    first = [own[0].values[: proposal.run.channels.size]
             for own, proposal in zip(seen, proposals, strict=True)]
    # Columns of old and proposed runs: those of the test stand, and those of its units.
    prediction = np.concatenate([open_models[0].fit.prediction, *first])
    columns = [offset_columns(joint)]
    prior = joint.assumptions.model_error
    if prior is not None:
        columns += [model_error_columns(joint, prior), timing_columns(joint, prior, prediction)]
    shared, local = np.hstack(columns), system_columns(joint, open_models[0].fit.point)
    nuisances = _Columns(np.hstack([shared, local]), shared.shape[1], old.size)
    known = [_Known.of(metric, fit, tangent_of(fit), nuisances.in_old_data) for fit in fits]
    start = old.size
    for proposal, own in zip(proposals, seen, strict=True):
        part = slice(start, start + proposal.run.channels.size)
        start = part.stop
        whiten = _whitener(metric, proposal)
        again, anew = nuisances.of(part, proposal)
        yield proposal, [
            _Forecast.of(knowledge, view, again, anew, whiten)
            for knowledge, view in zip(known, own, strict=True)
        ]


@dataclass(frozen=True)
class _View:
    """Prediction of a model in a test: values (m,) and sensitivities (m, p)."""

    values: Array
    columns: Array


def _seen_by(problem: Problem, proposal: Proposal, fits: Sequence[Fit]) -> list[_View]:
    """Predictions of a test by each fit, its direct readings last."""
    base = problem.system.base_parameters
    groups, steps = [], []
    for fit in fits:
        parameters = fit.candidate.parameters(base)
        thetas, own = neighbours(parameters, fit.theta_unit, range(fit.theta_unit.size))
        groups.append([fit.candidate.point(base, theta) for theta in thetas])
        steps.append(np.array(own))
    made = groups
    if proposal.as_made is not None:
        made = [[proposal.as_made(point) for point in group] for group in groups]
    answers = problem.predict_run(proposal.run, made)
    views = []
    for fit, group, answer, step in zip(fits, groups, answers, steps, strict=True):
        sizes = {effect.id: effect for effect, _ in fit.candidate.effects}
        direct = np.array([
            [_size(point, sizes, reading.effect) for reading in proposal.readings]
            for point in group
        ]).reshape(len(group), -1)
        rows = np.hstack([np.asarray(answer).reshape(len(group), -1), direct])
        views.append(_View(rows[0], ((rows[1:] - rows[0]) / step[:, None]).T))
    return views


def _size(point: Point, effects: Mapping[str, Effect], name: str) -> float:
    """Size of an effect at a point minus its neutral size."""
    if name not in point.effects:
        return 0.0
    effect = effects[name]
    return point.effects[name][effect.size.name] - effect.neutral


@dataclass(frozen=True)
class _Columns:
    """Nuisance columns (n, k) of the old data and of all tests.

    The old data are the first `old` rows. The first `shared` columns belong to the test stand, the
    others to the units of the machine that carry the load.
    """

    columns: Array
    shared: int
    old: int

    @cached_property
    def seen_before(self) -> NDArray[np.bool_]:
        """Mask (k,) of the columns that act on the old data."""
        return np.asarray(self.columns[: self.old].any(axis=0))

    @property
    def in_old_data(self) -> Array:
        """The columns that act on the old data, in the old data."""
        return self.columns[: self.old, self.seen_before]

    def of(self, part: slice, proposal: Proposal) -> tuple[Array, Array]:
        """Columns of a test: the columns (m, k) of `in_old_data`, and its own columns."""
        whole, seen = self.columns[part], self.seen_before
        again, anew = whole[:, seen], whole[:, ~seen]
        if proposal.is_other_place:
            is_shared = np.arange(seen.size) < self.shared
            again = np.where(is_shared[seen], again, 0.0)
            anew = whole[:, ~(seen & is_shared)]
        anew = anew[:, anew.any(axis=0)]
        readings = ((0, len(proposal.readings)), (0, 0))
        return np.pad(again, readings), np.pad(anew, readings)


def _whitener(metric: Metric, proposal: Proposal) -> Callable[[Array], Array]:
    """Columns (m, B) divided by the expected noise of the test."""
    run = proposal.run
    width = float(np.median(run.width))
    alike = min(
        metric.problem.runs,
        key=lambda run: abs(math.log(float(np.median(run.width)) / width)))
    covariances = [metric.noise[alike.name, channel].covariance(run.time, run.width, run.hold)
                   for channel in range(run.channels.shape[0])]
    lowers = [
        cholesky(matrix + 1e-9 * float(np.diag(matrix).max()) * np.eye(run.time.size), lower=True)
        for matrix in covariances
    ]
    deviations = np.array([reading.std for reading in proposal.readings])

    def whiten(columns: Array) -> Array:
        size = run.time.size
        parts = [
            solve_triangular(lower, columns[number * size : (number + 1) * size], lower=True)
            for number, lower in enumerate(lowers)
        ]
        parts.append(columns[len(lowers) * size :] / deviations[:, None])
        return np.vstack(parts)

    return whiten


@dataclass(frozen=True)
class _Known:
    """Knowledge of a model's parameters and nuisance parameters from the old data.

    mean (k,): offset from the fit; root (k, k): lower factor of the inverse of their
    covariance.
    """

    mean: Array
    root: Array

    @classmethod
    def of(cls, metric: Metric, fit: Fit, tangent: Tangent, nuisances: Array) -> _Known:
        columns = metric.whiten_noise(np.hstack([tangent.plain, nuisances]))
        left = metric.whiten_noise(metric.problem.measured - fit.prediction)
        root = cholesky(columns.T @ columns + np.eye(columns.shape[1]), lower=True)
        mean = cho_solve((root, True), columns.T @ left)
        return cls(mean, root)


@dataclass(frozen=True)
class _Forecast:
    """Whitened prediction of a model for a test: mean (m,) and spread (m, k).

    inner (k, k): lower factor of 1 + spread^T spread; whiten: divides by the expected noise.
    """

    mean: Array
    spread: Array
    inner: Array
    whiten: Callable[[Array], Array]

    @classmethod
    def of(
        cls, known: _Known, view: _View, again: Array, anew: Array,
        whiten: Callable[[Array], Array]
    ) -> _Forecast:
        white = whiten(np.column_stack([view.values, view.columns, again, anew]))
        columns, own = np.split(white[:, 1:], [known.mean.size], axis=1)
        spread = np.hstack([solve_triangular(known.root, columns.T, lower=True).T, own])
        inner = cholesky(np.eye(spread.shape[1]) + spread.T @ spread, lower=True)
        return cls(white[:, 0] + columns @ known.mean, spread, inner, whiten)

    def drawn(self, random: np.random.Generator, draws: int) -> Array:
        """Whitened results (m, draws) of the test if this model is the truth."""
        noise = random.standard_normal((self.mean.size, draws))
        freedom = random.standard_normal((self.spread.shape[1], draws))
        return np.asarray(self.mean[:, None] + noise + self.spread @ freedom)

    def misfits(self, results: Array) -> Array:
        """Increase (draws,) of the misfit of this model by results (m, draws)."""
        away = results - self.mean[:, None]
        along = solve_triangular(self.inner, self.spread.T @ away, lower=True)
        return np.asarray((away**2).sum(axis=0) - (along**2).sum(axis=0))


def _separation(
    proposal: Proposal,
    open_models: Sequence[OpenModel],
    fits: Sequence[Fit],
    forecasts: Sequence[_Forecast],
    rule: JudgingRule,
    random: np.random.Generator,
) -> Separation:
    """Separation of the models by a test, with each model as the truth in turn."""
    number = {fit.candidate.key: index for index, fit in enumerate(fits)}
    own_places = [number[open_model.fit.candidate.key] for open_model in open_models]
    less_places = [number[open_model.less.candidate.key] for open_model in open_models]
    alone, kept, by_truth = 0, 0, {}
    for truth, open_model in enumerate(open_models):
        results = forecasts[own_places[truth]].drawn(random, DRAWS)
        misfits = np.array([
            fit.misfit + forecast.misfits(results)
            for fit, forecast in zip(fits, forecasts, strict=True)
        ])
        own = 0
        for column in misfits.T:
            left = _left(open_models, column[own_places], column[less_places], rule)
            kept += truth in left
            own += left == [truth]
        alone += own
        by_truth[open_model.fit.candidate.ids] = own / DRAWS
    return Separation(proposal, DRAWS * len(open_models), alone, kept, by_truth)


def _left(
    open_models: Sequence[OpenModel], misfits: Array, less: Array, rule: JudgingRule
) -> list[int]:
    """Models that stay in the group at these misfits, in order."""
    price = [rule.log_size * open_model.fit.theta_unit.size for open_model in open_models]
    best = int(np.argmin(np.add(misfits, price)))
    left = []
    for number, open_model in enumerate(open_models):
        # The first model stands for no particular cause; the other names the cause in question.
        taken = (less[best] if number == 0 else less[number]) - misfits[best]
        stays = number == best or indistinguishable(
            distance=misfits[number] - misfits[best], taken=taken, excess=rule.excess,
            fewer=open_models[best].fit.theta_unit.size - open_model.fit.theta_unit.size,
            floor=rule.floor, settings=rule.settings)
        if stays:
            left.append(number)
    return left
