"""The next test after an open verdict: the one that parts the alternatives.

The next test is the possible test that most often leaves only the true model, which each model is
in turn, by the rule that keeps an alternative in a group. Models are linear about their fits, so
that a fit to all data needs no further simulation: the misfit grows by that of the new data in
the metric of the model's own prediction (the update of a linear model with normal errors). A test
that is best by these forecasts is judged again by refits, because models are not quite linear.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
import math
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, cholesky, solve_triangular

from saddlering_ros.discrepancy.problem import metric as metrics
from saddlering_ros.discrepancy.problem import system as systems
from saddlering_ros.discrepancy.problem.fits import around, Fit
from saddlering_ros.discrepancy.problem.problem import Problem
from saddlering_ros.discrepancy.problem.system import Array, RunBlocks
from saddlering_ros.discrepancy.search.evidence import alternative_floor, open_distance
from saddlering_ros.discrepancy.search.selection import error_process, Search
from saddlering_ros.discrepancy.search.space import ModelSpace, refit_full_jacobian
from saddlering_ros.discrepancy.verdict.results import HeldOutEvidence, Separation

DRAWS = 100
"""Number of draws with each model as the truth: a share is known to 10 % at worst (95 %)."""

MAX_BESIDE = 0.5
"""Share of the draws up to which one of two causes may stay beside the other, which is true, where
a test parts them."""

MAX_REFITS = 100
"""Refits from which on no further test is judged by them: some three seconds on a ring."""

MAX_ANEW = 1e4
"""Largest spread of an error of a test, in standard deviations of the noise: free by measure. A
constant of 1e7 ranges left no digit of a misfit, so that no test parted two causes."""

JOINT_FITS = 2
"""Fits of open models to all runs: the noise is learnt from a model that does not know the
held-out runs, and then from the best one that does."""


def open_models(search: Search) -> 'OpenModels | None':
    """The models that a search leaves open; None if it leaves one."""
    space, fit = search.space, search.fit
    others = [(other, space.without(fit, name))
              for name, models in search.alternatives.items() for other in models]
    if not others:
        return None
    space.watch.progress('next test', 0.85)
    pairs = [(fit, others[0][1]), *others]
    fits = list({fit.candidate.key: fit for pair in pairs for fit in pair}.values())
    keys = [fit.candidate.key for fit in fits]
    own, less = ([keys.index(fit.candidate.key) for fit in side]
                 for side in zip(*pairs, strict=True))
    return OpenModels(
        space, fits, own, less, np.array([fits[place].theta_unit.size for place in own]),
        floor=alternative_floor(space.pairs, space.settings),
        excess=max(space.slow_residual(fit).excess, 0.0))


@dataclass(frozen=True)
class OpenModels:
    """Models that the data leave open, each beside the same model without the cause in question.

    own, less: their places among the distinct fits; sizes: their numbers of parameters. floor,
    excess: limits within which a model stays in a group (see search/evidence.py).
    """

    space: ModelSpace
    fits: Sequence[Fit]
    own: Sequence[int]
    less: Sequence[int]
    sizes: NDArray[np.int64]
    floor: float
    excess: float

    def separations(self) -> tuple[Separation, ...]:
        """Each proposed test with each model as the truth in turn, the best test first.

        Linear models can promise too much. So the best tests are judged by refits, until none of
        the others promises more, where the system has tangents, which make refits cheap.
        """
        problem, random = self.space.problem, np.random.default_rng(self.space.settings.seed)
        alone = attrgetter('alone', 'kept')
        rest = sorted((self._counted(proposal, misfits) for proposal, misfits in
                       self._forecast_each(problem.proposals, random)), key=alone, reverse=True)
        if not isinstance(problem.system, systems.SystemWithTangents):
            return tuple(rest)
        judged, refits = list[Separation](), 0
        while rest and refits < MAX_REFITS and all(one.alone < rest[0].alone for one in judged):
            best = rest.pop(0)
            if best.proposal.as_made is None and not best.proposal.readings:
                refits += len(self.own) * len(self.fits)
                best = replace(self._counted(
                    best.proposal, self._refitted(best.proposal, random)), refitted=True)
            judged.append(best)
        return (*sorted(judged, key=alone, reverse=True), *rest)

    def _counted(self, proposal: systems.Proposal, drawn: Iterable[Array]) -> Separation:
        """What a test leaves open, from misfits (fits, draws) with each model as the truth."""
        causes = [self.fits[place].candidate.ids for place in self.own]
        alone, kept, by_truth = 0, 0, dict.fromkeys(causes, 0.0)
        beside = dict.fromkeys(product(by_truth, repeat=2), 0.0)
        for truth, (cause, misfits) in enumerate(zip(causes, drawn, strict=True)):
            left = [np.flatnonzero(np.less_equal(*self._behind(column))).tolist()
                    for column in misfits.T]
            kept += sum(truth in models for models in left)
            # A cause at another place, such as another probe, is the same cause.
            open_causes = [{causes[model] for model in models} for models in left]
            single = sum(names == {cause} for names in open_causes)
            alone += single
            weight = 1.0 / DRAWS / causes.count(cause)
            by_truth[cause] += weight * single
            for other in by_truth:
                beside[cause, other] += weight * sum(other in names for names in open_causes)
        together = {one: {one} for one in by_truth}
        for first, second in combinations(by_truth, 2):
            if beside[first, second] + beside[second, first] > 2.0 * MAX_BESIDE:
                joined = together[first] | together[second]
                together.update(dict.fromkeys(joined, joined))
        return Separation(
            proposal, DRAWS * len(self.own), alone, kept, by_truth,
            tuple(dict.fromkeys(tuple(one for one in together if one in together[cause])
                                for cause in together)))

    def _refitted(self, proposal: systems.Proposal,
                  random: np.random.Generator) -> Iterator[Array]:
        """Misfits (fits, DRAWS) of all fits, refitted to a test as each model predicts it.

        The test has the small errors that the old data show beside the model.
        """
        metric, old, run = self.space.metric, self.space.metric.problem, proposal.run
        joint, alike = old.with_runs([*old.runs, run]), metric.alike(run)
        noise = {**metric.noise, **{(run.name, channel): metric.noise[alike.name, channel]
                                    for channel in range(len(run.channels))}}
        begun = self._begun([run])
        for truth, fit in ((begun[place], self.fits[place]) for place in self.own):
            nuisances = metrics.nuisance_columns(joint, truth.point, truth.prediction)
            seen = nuisances[: old.size].any(axis=0)
            mean, _ = self._known(fit, nuisances[: old.size, seen])
            errors = nuisances[old.size:, seen] @ mean[fit.theta_unit.size:]
            made = replace(run, channels=(truth.prediction[old.size:] + errors).reshape(
                run.channels.shape))
            metric = metrics.Metric.of(old.with_runs([*old.runs, made]), noise, noise)
            fits = refit_full_jacobian(metric.marginalise(nuisances), begun, old.settings.rounds)
            # To first order, as the residual of an optimum is orthogonal to its sensitivities.
            chance = random.standard_normal((made.channels.size, DRAWS))
            yield np.array([one.misfit + 2.0 * one.whitened[old.size:] @ chance for one in fits])

    def _begun(self, runs: Sequence[RunBlocks]) -> list[Fit]:
        """All fits with their predictions and sensitivities in further runs too."""
        views = [_seen_by(self.space.problem, systems.Proposal('', run), self.fits)
                 for run in runs]
        return [replace(
            fit, prediction=np.concatenate([fit.prediction, *(values for values, _ in seen)]),
            plain=np.vstack([self.space.tangent_of(fit).plain, *(slopes for _, slopes in seen)]))
            for fit, seen in zip(self.fits, zip(*views, strict=True), strict=True)]

    def judged_by_held_out(self, *, is_beside_error: bool) -> tuple[HeldOutEvidence, ...]:
        """The models fitted to the held-out runs too, the most likely first.

        is_beside_error: whether the models are judged beside learnt error of the model.
        """
        problem = self.space.problem
        held_out = tuple(run.name for run in problem.held_out)
        if not held_out:
            return ()
        joint = problem.with_runs([
            *problem.runs, *(replace(run, held_out=False) for run in problem.held_out)])
        fits = self._begun(problem.held_out)
        best = fits[self.own[0]]
        if not np.isfinite(best.prediction).all():
            return ()
        for _ in range(JOINT_FITS):
            metric = metrics.noise_metric(joint, best.prediction)
            nuisances = metrics.nuisance_columns(joint, best.point, best.prediction)
            if is_beside_error:
                process, _ = error_process(metric.marginalise(nuisances), best)
                nuisances = np.hstack([nuisances, process])
            fits = refit_full_jacobian(
                metric.marginalise(nuisances), fits, problem.settings.rounds)
            misfits = np.array([fit.misfit for fit in fits])
            best = fits[self.own[self._best(misfits)]]
        behind, limits = self._behind(misfits)
        priced = misfits[list(self.own)] + self.space.log_size * self.sizes
        # At its limit, a model is as likely as it is that the true one is beyond it by chance.
        wider = np.maximum(limits / (-2.0 * math.log(self.space.settings.alternative_rate)), 1.0)
        odds = np.exp(-0.5 * (priced - priced.min()) / wider)
        answers = []
        for index, (place, less) in enumerate(zip(self.own, self.less, strict=True)):
            new = [name for name in self.fits[place].candidate.ids
                   if name not in self.fits[less].candidate.ids]
            answers.append(HeldOutEvidence(
                new[0], problem.titles[new[0]], held_out, float(behind[index] - behind.min()),
                float(odds[index] / odds.sum()), bool(behind[index] <= limits[index])))
        return tuple(sorted(answers, key=lambda answer: -answer.share))

    def _best(self, misfits: Array) -> int:
        return int(np.argmin(misfits[list(self.own)] + self.space.log_size * self.sizes))

    def _behind(self, misfits: Array) -> tuple[Array, Array]:
        """Misfit of each model beyond that of the best, and the largest that leaves it open."""
        whole, less = misfits[list(self.own)], misfits[list(self.less)]
        best = self._best(misfits)
        # The first model stands for no particular cause; another one names its own.
        less[0] = less[best]
        limits = [open_distance(
            taken=taken, excess=self.excess, floor=self.floor, settings=self.space.settings)
            for taken in less - whole[best]]
        return whole - whole[best], np.maximum(limits, self.floor)

    def _forecast_each(
        self, proposals: Sequence[systems.Proposal], random: np.random.Generator
    ) -> Iterator[tuple[systems.Proposal, list[Array]]]:
        """Each proposal, and misfits (fits, DRAWS) of all fits with each model as the truth."""
        if not proposals:
            return
        metric, first = self.space.metric, self.fits[self.own[0]]
        old = metric.problem
        views = [_seen_by(old, proposal, self.fits) for proposal in proposals]
        joint = old.with_runs([*old.runs, *(proposal.run for proposal in proposals)])
        # Columns of old and proposed runs: those of the test stand, and those of its units.
        prediction = np.concatenate([first.prediction, *(
            view[0][0][: proposal.run.channels.size]
            for view, proposal in zip(views, proposals, strict=True))])
        stand = metrics.stand_columns(joint, prediction)
        shared = stand.shape[1]
        nuisances = np.hstack([stand, metrics.system_columns(joint, first.point)])
        seen = np.asarray(nuisances[: old.size].any(axis=0))
        known = [self._known(fit, nuisances[: old.size, seen]) for fit in self.fits]
        start = old.size
        for proposal, view in zip(proposals, views, strict=True):
            self.space.watch.advance(self.space.watch.share)
            stop = start + proposal.run.channels.size
            # Columns that act on the old data, and those of the test. Other units of the machine
            # have small errors of their own; the test stand has the same.
            own = nuisances[start:stop]
            start, stays = stop, seen & (np.arange(seen.size) < shared)
            stays = stays if proposal.is_other_place else seen
            again, anew = np.where(stays[seen], own[:, seen], 0.0), own[:, ~stays]
            readings = ((0, len(proposal.readings)), (0, 0))
            whiten = _whitener(metric, proposal)
            again, anew = (whiten(np.pad(part, readings))
                           for part in (again, anew[:, anew.any(axis=0)]))
            anew *= np.minimum(MAX_ANEW / np.linalg.norm(anew, axis=0), 1.0)
            forecasts = []  # whitened, by each model: mean (m,) and spread (m, k)
            for (mean, root), (values, slopes) in zip(known, view, strict=True):
                white = whiten(np.column_stack([values, slopes]))
                inner = np.hstack([white[:, 1:], again])
                spread = np.hstack([solve_triangular(root, inner.T, lower=True).T, anew])
                forecasts.append((white[:, 0] + inner @ mean, spread))
            # Whitened results (m, draws) of the test with each model as the truth.
            results = np.hstack([
                mean[:, None] + random.standard_normal((mean.size, DRAWS))
                + spread @ random.standard_normal((spread.shape[1], DRAWS))
                for mean, spread in (forecasts[place] for place in self.own)])
            misfits = []
            for fit, (mean, spread) in zip(self.fits, forecasts, strict=True):
                away = results - mean[:, None]
                root = cholesky(np.eye(spread.shape[1]) + spread.T @ spread, lower=True)
                along = solve_triangular(root, spread.T @ away, lower=True)
                growth = (away**2).sum(axis=0) - (along**2).sum(axis=0)
                misfits.append(fit.misfit + growth)
            yield proposal, np.split(np.array(misfits), len(self.own), axis=1)

    def _known(self, fit: Fit, nuisances: Array) -> tuple[Array, Array]:
        """What the old data know of parameters and nuisance parameters: mean (k,), root (k, k).

        mean: offset from the fit; root: lower factor of the inverse of their covariance.
        """
        metric = self.space.metric
        columns = metric.whiten_noise(np.hstack([self.space.tangent_of(fit).plain, nuisances]))
        left = metric.whiten_noise(metric.problem.measured - fit.prediction)
        root = cholesky(columns.T @ columns + np.eye(columns.shape[1]), lower=True)
        return cho_solve((root, True), columns.T @ left), root


Whiten = Callable[[Array], Array]


def _seen_by(problem: Problem, proposal: systems.Proposal,
             fits: Sequence[Fit]) -> list[tuple[Array, Array]]:
    """Values (m,) of a test by each fit, its direct readings last, and sensitivities (m, p)."""
    asked = [around(fit, problem.system.base_parameters) for fit in fits]
    made = [points for points, _ in asked]
    if proposal.as_made is not None:
        made = [[proposal.as_made(point) for point in group] for group in made]
    if isinstance(problem.system, systems.SystemWithTangents):
        answers = problem.system.neighbourhood(made)(proposal.run)
    else:
        answers = [problem.simulate(proposal.run, group) for group in made]
    views = []
    for fit, (group, steps), answer in zip(fits, asked, answers, strict=True):
        # A direct reading shows the size of an effect minus its neutral size.
        direct = np.zeros((len(group), len(proposal.readings)))
        for column, reading in enumerate(proposal.readings):
            for effect, _ in fit.candidate.effects:
                if effect.id == reading.effect:
                    direct[:, column] = [point.effects[effect.id][effect.size.name]
                                         - effect.neutral for point in group]
        rows = np.hstack([np.asarray(answer).reshape(len(group), -1), direct])
        views.append((rows[0], ((rows[1:] - rows[0]) / np.array(steps)[:, None]).T))
    return views


def _whitener(metric: metrics.Metric, proposal: systems.Proposal) -> Whiten:
    """Columns (m, B) divided by the expected noise of the test."""
    run, alike, lowers = proposal.run, metric.alike(proposal.run), []
    for channel in range(run.channels.shape[0]):
        matrix = metric.noise[alike.name, channel].covariance(run.time, run.width, run.hold)
        jitter = 1e-9 * float(np.diag(matrix).max()) * np.eye(run.time.size)
        lowers.append(cholesky(matrix + jitter, lower=True))
    deviations = np.array([reading.std for reading in proposal.readings])

    def whiten(columns: Array) -> Array:
        *channels, direct = np.split(columns, run.time.size * np.arange(1, len(lowers) + 1))
        parts = [solve_triangular(lower, part, lower=True)
                 for lower, part in zip(lowers, channels, strict=True)]
        return np.vstack([*parts, direct / deviations[:, None]])

    return whiten
