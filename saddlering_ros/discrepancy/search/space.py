"""Models fitted in one metric: each fit is stored under its candidate.

Candidates are refitted together; candidates far behind the best one stop after a few rounds.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, TypeVar

import numpy as np

from saddlering_ros.discrepancy.problem import fits as fitting
from saddlering_ros.discrepancy.problem.fits import Candidate, Fit, refit, run_refits, tangent
from saddlering_ros.discrepancy.problem.metric import Metric, noise_metric
from saddlering_ros.discrepancy.problem.problem import Problem
from saddlering_ros.discrepancy.problem.system import Array, Effect, Parameter, SystemWithTangents
from saddlering_ros.discrepancy.search import signatures as shown_by
from saddlering_ros.discrepancy.search.lack_of_fit import LackOfFitTests, SlowResidual
from saddlering_ros.discrepancy.search.ranking import rank, Score, shortlist, starts_of_each, Trial
from saddlering_ros.discrepancy.search.signatures import ChangeScale, shapes_tried, Signature
from saddlering_ros.estimation.least_squares import AT_BOUND
from saddlering_ros.estimation.process import fisher_chance, fisher_limit

COARSE_ROUNDS = 4
"""Rounds of a refit from each of several starts: half of a refinement's on a ring."""

FULL_JACOBIANS = 2
"""Best refits of a step with a full Jacobian: the decision is between these two."""

LEAPS, MAX_LEAPS = tuple(0.25 * 0.5**number for number in range(10)), 4
"""Shares of its range by which a shape leaps either way, and the largest number of leaps."""

MAX_RISE = 9.0
"""Rise of the misfit up to which it tells of an interval: three standard deviations."""

MIN_PAIRS = 12
"""Smallest number of degrees of freedom of the level, whatever the length of the stretches. With
fewer, one short stretch at rest would leave nothing certain."""

MINOR = 0.1
"""Movement of a view, as a share of range and of the most that an effect moves, that is a side
effect of its law: 1 % of its power, which errors of its form can leave."""

FREE_SPREAD = 10.0
"""Spread, in shares of the range, of a parameter that counts as free."""

BASE_ROUNDS = 25
"""Rounds of the fit of the base alone, which ends earlier if its gain is negligible."""

MIN_GAIN, MIN_GAIN_SHARE = 4.0, 1.0 / 3.0
"""First-order gain below which an effect is not refitted, and the same as a share of the gain at
which an effect with one parameter is real. With this share and SCREENED_SHARE the refits of the
shipped bags need 400 evaluations instead of 512."""

Result = TypeVar('Result')


def bound_reached(parameter: Parameter, theta_unit: float) -> float | None:
    """The bound at which a bound-scaled value of a parameter lies, or None."""
    if parameter.periodic or min(theta_unit, 1.0 - theta_unit) >= AT_BOUND:
        return None
    return parameter.high if theta_unit > 0.5 else parameter.low


@dataclass(eq=False)
class ModelSpace:
    """Every model fitted in one metric. A new metric has a new space.

    inputs: signatures of errors of the simulator's inputs, which are no effects of the catalogue.
    pairs, max_pairs: numbers of independent differences from which the noise of the poorest and
    of the richest run is known. fits: the fits so far, by the key of their candidate.
    """

    metric: Metric
    base: Fit
    base_tangent: fitting.Tangent
    signatures: Sequence[Signature]
    scale: ChangeScale
    trials: int
    inputs: Sequence[Signature] = ()

    def __post_init__(self) -> None:
        self.problem = self.metric.problem
        self.settings, self.watch = self.problem.settings, self.problem.watch
        known_from = [noise.pairs for noise in self.metric.noise.values()]
        self.pairs = max(MIN_PAIRS, min(known_from))
        self.max_pairs = max(MIN_PAIRS, max(known_from))
        self.shown = [*self.signatures, *self.inputs]
        self.usable = shown_by.testable(self.shown)
        self.tests = LackOfFitTests(self.metric, self.max_pairs)
        # Of the dimensions beside the nuisance parameters.
        self.log_size = float(np.log(self.problem.size - self.metric.shared.dimensions))
        self.fits: dict[fitting.Key, Fit] = {}
        self._begun: dict[tuple[fitting.Key, bytes], Fit] = {}  # Starts beside the base.
        self._results: dict[tuple[str, fitting.Key], tuple[Fit, Any]] = {}
        self.once('tangent', self.base, lambda: self.base_tangent)

    def keep(self, fit: Fit) -> Fit:
        """Store a fit under its candidate."""
        self.fits[fit.candidate.key] = fit
        return fit

    def titles_of(self, fit: Fit) -> list[str]:
        """Titles of the effects of a fit, as in a sentence."""
        return [self.problem.titles[name] for name in fit.candidate.ids]

    def title_at(self, effect: Effect, variant: int) -> str:
        """Title of an effect with its place, such as a probe, if the system has words for it."""
        words = getattr(self.problem.system, 'variant_words', lambda *_: '')(
            effect.id, effect.variants[variant])
        title = self.problem.titles[effect.id]
        return f'{title} ({words})' if words else title

    def single_effect_fits(self) -> list[Fit]:
        """Fits of one effect beside the base."""
        return [fit for fit in self.fits.values() if len(fit.candidate.effects) == 1]

    def once(self, kind: str, fit: Fit, compute: Callable[[], Result]) -> Result:
        """A result of a fit, computed at the first call and stored under its kind."""
        stored = self._results.get((kind, fit.candidate.key))
        if stored is None or stored[0] is not fit:
            stored = self._results[kind, fit.candidate.key] = fit, compute()
        return stored[1]

    def tangent_of(self, fit: Fit) -> fitting.Tangent:
        """All sensitivities of a fit, computed once."""
        return self.once('tangent', fit, lambda: tangent(self.metric, fit))

    def slopes_of(self, fit: Fit) -> Array:
        """Whitened sensitivities (n, p) for intervals: central, or as the system has them."""
        white = self.tangent_of(fit).white
        has_own = isinstance(self.problem.system, SystemWithTangents)
        return white if has_own else fitting.centred(self.metric, fit, white)

    def changes_of(self, fit: Fit) -> Array:
        """Change (n, E) of the prediction of a fit by each of its effects, computed once."""
        return self.once('changes', fit, lambda: self.problem.changes_of_effects(
            fit.point, fit.prediction))

    def confined(self, fit: Fit, name: str, least: float) -> Iterator[tuple[str, Array, Array]]:
        """Each view, sensitivities (n, k) and prediction (n,) if an effect acted there alone.

        To first order. Nothing for an effect that moves other views by `least` of range at most,
        or by MINOR of what it moves most: its law is one of one view.
        """
        problem, tangent = self.problem, self.tangent_of(fit).plain
        change, own = next((moved, part) for (effect, _, part), moved in zip(
            fit.parts, self.changes_of(fit).T, strict=True) if effect.id == name)
        moves = {view: float(problem.view_sizes(change, view).max())
                 for view in problem.system.views}
        least = max(least, MINOR * max(moves.values()))
        seen = [view for view, move in moves.items() if move > least]
        for view in seen if len(seen) > 1 else ():
            confined = tangent.copy()
            confined[:, own] = problem.in_one_view(tangent[:, own], view)
            yield view, confined, fit.prediction - change + problem.in_one_view(change, view)

    def slow_residual(self, fit: Fit) -> SlowResidual:
        """The slow structure of the residual of a fit."""
        return self.once('slow', fit, lambda: self.tests.slow(fit))

    def leaves_misfit(self, fit: Fit) -> bool:
        """Whether a fit leaves more than noise, and enough to matter."""
        return any(residual.is_real_and_material(self.settings)
                   for residual in (self.slow_residual(fit), self.tests.fast(fit)))

    def scores(self, fit: Fit) -> list[Score]:
        """First-order gains beside `fit` of all testable effects that are not in it."""
        return self.once('scores', fit, lambda: rank(
            fit, self.tangent_of(fit).white, self.usable))

    def real_gain(self, extra: int = 1) -> float:
        """Fall of the misfit at which an effect with so many parameters is real."""
        rate = self.settings.error_rate / max(self.trials, 1)
        return float(extra * fisher_limit(rate, extra, self.pairs))

    def likelihood_ratio_test(self, gain: float, extra: int, trials: int | None = None) -> float:
        """p-value of a fall `gain` of the misfit by `extra` parameters.

        It counts the trials of the space, or the given number of `trials`.
        """
        count, extra = self.trials if trials is None else trials, max(1, extra)
        return min(1.0, count * float(fisher_chance(max(gain, 0.0) / extra, extra, self.pairs)))

    def penalised(self, fit: Fit) -> float:
        """Misfit plus the penalty of its parameters (BIC)."""
        return fit.misfit + fit.theta_unit.size * self.log_size

    def continued(self, fits: Sequence[Fit], rounds: int,
                  begun_at: Fit | None = None) -> list[Fit]:
        """The same fits after further rounds.

        A fit whose base is not that of `begun_at` began at the declared start, which is far from
        where it leads: there all columns are differenced.
        """
        count = len(self.problem.system.base_parameters)
        far = [begun_at is not None and not np.array_equal(
            fit.theta_unit[:count], begun_at.theta_unit[:count]) for fit in fits]
        return run_refits(self.metric, [
            refit(self.metric, fit.candidate, fit.theta_unit,
                  None if is_far else fit.jacobian[:, :count], rounds=rounds,
                  known_start=None if is_far else fit)
            for fit, is_far in zip(fits, far, strict=True)])

    def foreseen(self, fit: Fit) -> float:
        """Penalised misfit that the slopes of an unfinished fit lead to inside its bounds."""
        return self.penalised(fit) - fit.misfit + fitting.linear_misfit(
            fit, self.problem.system.base_parameters)

    def started(self, fit: Fit, trials: Sequence[Trial]) -> list[Fit]:
        """The model of `fit` plus each candidate at each of its starts, not refitted.

        Beside stopped base parameters it begins also from their declared starts, unless the way
        from there leads back to a larger misfit. Columns of what is in the model are not needed.
        """
        places = [(fit.theta_unit, self.tangent_of(fit).white)] if trials else []
        stopped = self.stopped_base(fit)
        if stopped.any() and trials:
            base, freed = self.problem.system.base_parameters, fit.theta_unit.copy()
            freed[: len(base)][stopped] = fitting.declared_start(base)[stopped]
            [one] = run_refits(self.metric, [refit(self.metric, fit.candidate, freed, rounds=0)])
            if self.foreseen(one) < self.penalised(fit):
                places.append((freed, one.jacobian))
        begun = self._begun if fit is self.base else {}  # Those beside the base return.
        keys, wanted = [], dict[tuple[fitting.Key, bytes], fitting.Asking]()
        for (score, starts), (theta, columns) in product(trials, places):
            candidate = fit.candidate.plus(score.effect, score.variant)
            for start in (np.concatenate([theta, own]) for own in starts):
                keys.append((candidate.key, start.tobytes()))
                if keys[-1] not in begun:
                    wanted[keys[-1]] = refit(self.metric, candidate, start, columns, rounds=0,
                                             fresh_base=score.amplitude_dependent)
        begun.update(zip(wanted, run_refits(self.metric, list(wanted.values())), strict=True))
        return [begun[key] for key in keys if np.isfinite(begun[key].misfit)]

    def stopped_base(self, fit: Fit) -> Array:
        """Mask (B,) of base parameters at a bound, which may imitate an effect.

        The way from there to the place where the effect shows can be long.
        """
        theta_unit = fit.theta_unit[: len(self.problem.system.base_parameters)]
        return np.asarray(np.minimum(theta_unit, 1.0 - theta_unit) < AT_BOUND)

    def refine(self, fits: Sequence[Fit]) -> list[Fit]:
        """The same fits completed, the best of them with a full Jacobian."""
        refined = self.continued(fits, self.settings.rounds)
        order = sorted(range(len(refined)), key=lambda index: self.penalised(refined[index]))
        best = order[:FULL_JACOBIANS]
        refitted_fully = refit_full_jacobian(
            self.metric, [refined[index] for index in best], self.settings.rounds)
        for number, fit in zip(best, refitted_fully, strict=True):
            refined[number] = self._leapt(fit)
        return refined

    def _leapt(self, fit: Fit) -> Fit:
        """The same fit, or a better one that begins at another value of one of its shapes.

        Of a switch, such as the time of a step, slopes tell what the next samples do. What another
        value leaves can be within the declared error, and another law then takes as much.
        """
        for _ in range(MAX_LEAPS):
            places, misfits = self.leaps(fit)
            if misfits.min(initial=np.inf) > fit.misfit - self.real_gain():
                break
            [fit] = run_refits(self.metric, [refit(
                self.metric, fit.candidate, places[int(misfits.argmin())],
                rounds=self.settings.rounds)])
        return fit

    def leaps(self, fit: Fit) -> tuple[list[Array], Array]:
        """Places (p,) at which one shape of a declared effect has another value; their misfits."""
        problem, base = self.problem, self.problem.system.base_parameters
        parameters = fit.candidate.parameters(base)
        places = [
            fit.theta_unit + move * (np.arange(fit.theta_unit.size) == index)
            for _, _, part in fit.parts for index in range(part.start + 1, part.stop)
            if problem.assumptions.many_valleys and not parameters[index].periodic
            for leap in LEAPS for move in (leap, -leap)
            if 0.0 < fit.theta_unit[index] + move < 1.0]
        if not places:
            return [], np.zeros(0)
        seen = problem.predict([fit.candidate.point(base, place) for place in places])
        white = self.metric.whiten(seen - problem.measured[:, None])
        return places, np.nan_to_num((white**2).sum(axis=0), nan=np.inf)

    def spread_of_shapes(self, fit: Fit) -> Array:
        """Standard deviations (p,) by the misfit at other values; 0 for what is no shape."""
        spread = np.zeros(fit.theta_unit.size)
        for place, misfit in zip(*self.leaps(fit), strict=True):
            move, rise = np.abs(place - fit.theta_unit), max(float(misfit) - fit.misfit, 1.0)
            spread = np.maximum(spread, move / rise**0.5 if rise < MAX_RISE else np.minimum(
                move, LEAPS[-1]))
        return spread

    def with_inputs(self) -> 'ModelSpace':
        """The space with the errors of the simulator's inputs as possible causes."""
        inputs = shown_by.measure_signatures(
            self.metric, self.base, self.base_tangent, self.scale,
            getattr(self.problem.system, 'inputs', ()))
        return replace(self, trials=self.trials + shapes_tried(inputs), inputs=inputs)

    def without(self, fit: Fit, effect_id: str) -> Fit:
        """The model without one effect, refitted where its own fit is worse than the way to it."""
        candidate = fit.candidate.without(effect_id)
        if not candidate.effects:
            return self.base
        base = self.problem.system.base_parameters
        count, kept = len(base), self.fits.get(candidate.key)
        start = np.concatenate([fit.theta_unit[:count], *(
            fit.theta_unit[part] for effect, _, part in fit.parts if effect.id != effect_id)])

        def misfit_at_start() -> float:
            begun = self.problem.predict([candidate.point(base, start)])[:, 0]
            white = self.metric.whiten(begun - self.problem.measured)
            return float(white @ white)

        # A fit of its own can end in another valley, such as that of a wrong phase.
        if kept is None or self.once(f'without {effect_id}', fit, misfit_at_start) < kept.misfit:
            # Where the simulator fails without the effect, the others begin from nothing.
            nothing = np.concatenate([self.base.theta_unit, start[count:]])
            for effect, _, part in candidate.slices(count):
                nothing[part.start] = effect.size.to_unit(effect.neutral)
            for theta in (start, nothing):
                begun = refit(self.metric, candidate, theta, self.tangent_of(self.base).white,
                              rounds=self.settings.rounds)
                if np.isfinite(self.keep(run_refits(self.metric, [begun])[0]).misfit):
                    break
        return self.fits[candidate.key]


def refit_full_jacobian(metric: Metric, fits: Sequence[Fit], rounds: int) -> list[Fit]:
    """Fits continued in a metric, with every sensitivity differenced at every step."""
    return run_refits(metric, [
        refit(metric, fit.candidate, fit.theta_unit, rounds=rounds,
              known_start=fitting.begun_in(metric, fit)) for fit in fits])


def best_fit_of_each(fits: Sequence[Fit]) -> list[Fit]:
    """The best fit of each candidate."""
    worst_first = sorted(fits, key=lambda fit: -fit.misfit)
    return list({fit.candidate.key: fit for fit in worst_first}.values())


RACE_ROUNDS = 2
"""Rounds of a refit that every candidate receives while much misfit remains. After them, the
slopes of the residual state where the refit leads."""

SCREENED_SHARE = 0.1
"""Smallest expected share of the gain of the best candidate for a candidate to receive these
rounds. The expectation is the first-order gain of all its parameters together, at its start. The
value is a fifth of CLOSE_SHARE."""

MAX_RACED = 12
"""Largest number of starts that receive these rounds: an unfinished refit promises a gain with any
effect. In 33 races on three outside rings, effects refined later were among the best ten."""

CLOSE_SHARE = 0.5
"""Smallest expected share of the gain of the best refit for a refit to continue after these
rounds. By the limits of Settings, alternatives that stay open explain more."""


def fit_each(space: ModelSpace, fit: Fit, scores: Sequence[Score],
             beside: Sequence[Fit] = ()) -> list[Fit]:
    """The model of `fit` plus each scored candidate, refitted together, the best first.

    A candidate far behind the best one, or far behind the fits `beside`, stops after a few rounds.
    """
    candidates = [fit.candidate.plus(score.effect, score.variant) for score in scores]
    wanted = [score for candidate, score in zip(candidates, scores, strict=True)
              if candidate.key not in space.fits]
    raced = raced_from(space, fit, starts_of_each(wanted), beside, RACE_ROUNDS)
    going, behind = _split(space, fit, raced, list(map(space.foreseen, raced)),
                           map(space.penalised, [*raced, *beside]), CLOSE_SHARE)
    going = best_fit_of_each(space.continued(going, COARSE_ROUNDS - RACE_ROUNDS))
    followed = {one.candidate.key for one in going}
    stopped = [one for one in best_fit_of_each(behind) if one.candidate.key not in followed]
    for one in [*space.refine(going), *stopped]:
        space.keep(one)
    keys = dict.fromkeys(candidate.key for candidate in candidates)
    fits = [space.fits[key] for key in keys if key in space.fits]
    return sorted(fits, key=space.penalised)


def raced_from(space: ModelSpace, fit: Fit, trials: Sequence[Trial], beside: Sequence[Fit],
               rounds: int) -> list[Fit]:
    """The model of `fit` plus each candidate from each start, after these rounds or none."""
    screened = space.started(fit, trials)
    promised = list(map(space.foreseen, screened))
    going, resting = _split(space, fit, screened, promised, [
        *promised, *map(space.foreseen, beside)], SCREENED_SHARE)
    raced = space.continued(going[:MAX_RACED], rounds, begun_at=fit)
    return [*resting, *going[MAX_RACED:], *raced]


def _split(space: ModelSpace, fit: Fit, fits: Sequence[Fit], promised: Sequence[float],
           reached: Iterable[float], share: float) -> tuple[list[Fit], list[Fit]]:
    """Fits that promise this share of the gain that is `reached`, the best first, and others."""
    begun = space.penalised(fit)
    highest = begun - share * (begun - min(reached, default=np.inf))
    order = sorted(range(len(fits)), key=promised.__getitem__)
    count = sum(one < highest for one in promised)
    return [fits[place] for place in order[:count]], [fits[place] for place in order[count:]]


def refitted(space: ModelSpace, current: Fit) -> list[Fit]:
    """The model of `current` plus every effect that the residual could show, the best first.

    If the residual exceeds the noise, or an effect with one of the largest first-order gains is
    real, every variant of every effect is tried. An effect at its detection limit is then found,
    and no cause is named before all others were tried.
    """
    def refits() -> list[Fit]:
        scores = space.scores(current)
        least = max(MIN_GAIN, MIN_GAIN_SHARE * space.real_gain())
        listed = shortlist(scores, least, space.settings.refits)
        # Base parameters at their bounds could conceal effects.
        is_stopped = not current.candidate.effects and space.stopped_base(current).any()
        first: list[Fit] = []
        if not (is_stopped or space.leaves_misfit(current)):
            first = fit_each(space, current, listed)
            if not any(space.likelihood_ratio_test(
                    current.misfit - tried.misfit, tried.theta_unit.size - current.theta_unit.size
            ) < space.settings.error_rate for tried in first):
                return first
        # All receive a few rounds with free base parameters, because a first-order gain is a poor
        # guide to an effect that the base fit imitates. Those are refined of which the slopes of
        # the residual promise a good share of the gain of the best one.
        # A model that was fitted before is not fitted again, but tried.
        keys = [current.candidate.plus(score.effect, score.variant).key for score in scores]
        known = [space.fits[key] for key in keys if key in space.fits]
        names = {current.candidate.plus(score.effect, score.variant).key for score in listed}
        others = [(score, [score.start]) for score in scores
                  if all(score is not tried for tried in listed)]
        raced = raced_from(space, current, [
            (score, starts) for score, starts in [*starts_of_each(listed), *others]
            if current.candidate.plus(score.effect, score.variant).key not in space.fits
        ], first, RACE_ROUNDS)
        going, _ = _split(space, current, raced, list(map(space.foreseen, raced)),
                          map(space.penalised, [*raced, *first]), CLOSE_SHARE)
        further: dict[str, Fit] = {}
        for one in going:
            if one.candidate.key not in names:
                further.setdefault(one.candidate.ids[-1], one)
        refined = space.refine([
            *best_fit_of_each([one for one in going if one.candidate.key in names]),
            *list(further.values())[: space.settings.refits]])
        stopped = best_fit_of_each([one for one in raced if one.candidate.key in names])
        # A refined fit replaces what the race left of it.
        kept = {one.candidate.key: space.keep(one) for one in [*stopped, *refined]}.values()
        return sorted([*known, *kept], key=space.penalised)

    return space.once('refitted', current, refits)


def prepare(problem: Problem) -> ModelSpace:
    """Learn the noise, marginalise nuisance parameters, fit the base, compute signatures."""
    problem.watch.progress('noise of the channels', 0.0)
    metric = noise_metric(problem).with_offsets()
    problem.watch.progress('fit without effects', 0.05)
    return space_about(problem, fitting.fit_base(metric))


def space_about(problem: Problem, rough: Fit) -> ModelSpace:
    """Learn the noise from the residual of a rough fit, fit the base, compute signatures."""
    metric = noise_metric(problem, rough.prediction)
    metric = metric.with_nuisances(rough.point, rough.prediction)
    # A large misfit has several minima.
    starts = [rough.theta_unit, fitting.declared_start(problem.system.base_parameters)]
    wanted = [refit(metric, Candidate(), start, rounds=BASE_ROUNDS) for start in starts]
    base = min(run_refits(metric, wanted), key=lambda fit: fit.misfit)
    problem.watch.progress('sensitivity to each effect', 0.25)
    problem.watch.check()
    sensitivities = tangent(metric, base)
    scale = ChangeScale(problem, sensitivities.plain)
    effects = problem.system.effects
    signatures = shown_by.measure_signatures(metric, base, sensitivities, scale, effects)
    trials = shapes_tried(signatures) + sum(bool(effect.line) for effect in effects)
    return ModelSpace(metric, base, sensitivities, signatures, scale, max(1, trials))
