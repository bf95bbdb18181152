"""The published numbers: values and intervals, misfit reduction, remainder.

The selected models are refitted without nuisance parameters. A stand-in for a law that is in no
catalogue explains a part of the misfit too, which no likelihood ratio tells. What does is how much
of the misfit beyond noise a cause takes in a view, on fitted runs and on runs that it predicts.

The metric of the gain is the root of the mean, over runs and views, of the squared residual over
the range of the view, without constants that have no meaning. Gain = 1 - metric with / metric
without, each fitted in this metric on the fitted runs alone; negative if the extension is worse.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import compress

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from saddlering_ros.discrepancy.problem import fits as fitting
from saddlering_ros.discrepancy.problem.fits import Fit, Gain, GainMetric, plain_fits, PRIOR
from saddlering_ros.discrepancy.problem.metric import Metric
from saddlering_ros.discrepancy.problem.problem import Problem
from saddlering_ros.discrepancy.problem.system import Array, Effect, Estimate, Parameter, RunBlocks
from saddlering_ros.discrepancy.search.evidence import Comparison
from saddlering_ros.discrepancy.search.selection import MAINLY, Search, stopped_sizes
from saddlering_ros.discrepancy.search.space import LEAPS, ModelSpace, refit_full_jacobian
from saddlering_ros.discrepancy.verdict import results, wording
from saddlering_ros.discrepancy.verdict.results import Cause, MIN_TAKEN, Residual, Shares
from saddlering_ros.estimation.least_squares import AT_BOUND, covariance
from saddlering_ros.quantities import quantity, WIDTH_95

DRAWS = 400
"""Draws of stretches for the interval of a reduction."""

STRETCHES = 4
"""Stretches of a run whose part of the evidence is told, and which are drawn again."""

SIZE_ERROR = 0.05
"""Share of a size by which small errors of a ring bend it, and which no likelihood tells: a wave
of 0.7 um round an axial raceway made a moment arm 10 % smaller in every metric. On rings 486 to
530 of `benchmarks/dirty_ring.py` 29 of 38 intervals held the true size without this share."""


@dataclass(frozen=True)
class Publication:
    """Numbers for the reader, of the selected model and of the base alone.

    shares: what all causes together take of the misfit, None without causes; member_shares: what
    each of several takes of the misfit without it; doubts: sentences on sizes at their bounds and
    on runs that are predicted worse; plain: the model fitted in the metric of the gain; converged:
    whether all fits converged.
    """

    causes: tuple[Cause, ...]
    base: Mapping[str, Estimate]
    base_alone: Mapping[str, Estimate]
    gain: Gain
    runs: tuple[results.RunPrediction, ...]
    fits: results.PublishedFits
    shares: Shares | None
    member_shares: Mapping[str, Shares]
    doubts: tuple[str, ...]
    plain: Fit
    converged: bool

    @property
    def main(self) -> Cause:
        """The cause that moves most."""
        return max(self.causes, key=lambda cause: cause.visible)

    def power_of(self, cause: Cause) -> float:
        """What the misfit rises by without a cause, as a share of the mean square of the base."""
        rise = max(1.0 - cause.gain.fit, 1e-12) ** -2 - 1.0
        return (1.0 - self.gain.fit) ** 2 * rise


@dataclass(frozen=True)
class _Model:
    """A fit without nuisance parameters and, `plain`, in the metric of the gain.

    left: its residuals (C, N) of predicted runs; turned: those of fitted runs, each
    predicted from the others, where there are held-out runs beside.
    """

    fit: Fit
    plain: Fit
    left: Sequence[Array]
    turned: Sequence[Array] = ()


def publish(search: Search, before: Residual, after: Residual) -> Publication:
    """Refit the selected model and its base with no other freedom than the offsets of the runs.

    During naming, parameters and nuisance parameters share a misfit, but a parameter file
    holds parameters only. This fit therefore gives the published values, predictions and
    gains. The part that nuisance parameters would have explained adds to the uncertainty of
    the published values. before, after: residuals of the base and of the model. What model
    error was learnt is in none of these fits.
    """
    problem, rounds = search.space.problem, search.space.settings.max_rounds
    fits = refit_full_jacobian(_metric_of(search.space), _wanted(search), rounds)
    plain, effects = plain_fits(problem, fits), search.fit.candidate.effects
    # Several causes at once on a ring are a sign of small errors.
    is_dirty = problem.assumptions.has_small_errors and len(effects) > 1
    otherwise = [fit for fit in plain if is_dirty and fit.candidate.effects == effects]
    return _publication(search, [search.fit], before, after, [
        _Model(fit, own, predicted_residuals(problem, own) if effects else [])
        for fit, own in zip(fits, plain, strict=True)], otherwise)


def publish_settled(search: Search, sources: Sequence[Fit], otherwise: Sequence[Fit],
                    before: Residual, after: Residual) -> Publication:
    """Publish causes of the size that a fit beside small errors gives them.

    With noise alone they would take what belongs to the small errors. The base is refitted beside
    them, because a parameter file holds no small errors. sources: the fit, which can have more
    effects, and others that are nearly as likely; otherwise: the fit by other measures; before,
    after: residuals of the base and of this fit.
    """
    space, rounds, models = search.space, search.space.settings.max_rounds, []
    problem = space.problem
    for own in _wanted(search):
        names = own.candidate.ids
        fit = fitting.refit_base(_metric_of(space), own, names, rounds)
        plain = fitting.refit_base(
            GainMetric.about(problem, fit), fit, names, rounds) if names else plain_fits(
                problem, [fit])[0]
        moves = _moves_without_runs(space, own)
        models.append(_Model(fit, plain, predicted_residuals(problem, plain, moves), (
            predicted_residuals(problem.with_runs(problem.runs), plain, moves)
            if problem.held_out else ())))
    alike = [each for each in sources if {*search.fit.candidate.key} <= {*each.candidate.key}]
    return _publication(search, alike, before, after, models, otherwise)


def _wanted(search: Search) -> list[Fit]:
    """The base, the model, and the model without each of its causes."""
    fit, space = search.fit, search.space
    less = [space.without(fit, name) for name in fit.candidate.ids]
    return list({each.candidate.key: each for each in (space.base, fit, *less)}.values())


def _metric_of(space: ModelSpace) -> Metric:
    """The metric of published fits: without nuisance parameters but for offsets."""
    return space.metric if space.problem.assumptions.is_persistent else space.metric.with_offsets()


def _gain(problem: Problem, less: _Model, more: _Model,
          interval: tuple[float, float] | None) -> Gain:
    """Gain of a model over another one, on fitted and on predicted runs; interval: of these."""
    fitted = ratio(*(
        problem.squared_misfit(
            problem.runs, problem.by_run(each.plain.prediction - problem.measured))
        for each in (less, more)))
    if not less.left:
        return Gain(fitted, None, 'one run only')
    predicted = ratio(*(problem.squared_misfit(problem.held_out or problem.runs, each.left)
                        for each in (less, more)))
    if problem.held_out and not np.isfinite(predicted):
        return Gain(fitted, None, 'the simulator failed on a held-out run')
    return Gain(fitted, predicted, 'held out' if problem.held_out else 'held out in turn',
                interval)


def _publication(search: Search, sources: Sequence[Fit], before: Residual, after: Residual,
                 refitted: Sequence[_Model], otherwise: Sequence[Fit] = ()) -> Publication:
    """The numbers of models that were fitted without nuisance parameters, those of `_wanted`."""
    space, fit, problem = search.space, search.fit, search.space.problem
    parameters, count = problem.system.base_parameters, len(problem.system.base_parameters)
    less = {name: space.without(fit, name) for name in fit.candidate.ids}
    models = {each.fit.candidate.key: each for each in refitted}
    chosen = models[fit.candidate.key]
    model, base = chosen.fit, models[space.base.candidate.key].fit
    taken = {key: shares_of(space.metric, each, chosen)
             for key, each in models.items() if each is not chosen}
    gains = {key: _gain(problem, models[key], chosen, shares.held_out)
             for key, shares in taken.items()}
    covariance = _covariance(space, sources, model, after, otherwise)
    size_error = SIZE_ERROR if otherwise else 0.0
    causes = []
    for effect, variant, indices in model.parts:
        compared = Comparison(space, less[effect.id], fit)
        evidence = compared.evidence()
        others_named = {other for alternative in search.alternatives.get(effect.id, ())
                        for other in alternative.candidate.ids} - {*model.candidate.ids}
        sizes = with_form_error(effect, _estimates(
            effect.ordered, model.theta_unit[indices], covariance[indices, indices]), size_error)
        sizes.update({key: Estimate(float(value), 0.0, '')
                      for key, value in effect.variants[variant].items()})
        causes.append(Cause(
            effect=effect.id, definition=effect, variant=variant,
            group=(effect.id, *sorted(others_named)),
            parameters=sizes, p_value=evidence.p_value, delta_bic=evidence.delta_bic,
            visible=evidence.visible, gain=gains[less[effect.id].candidate.key],
            times_needed=compared.gain / space.real_gain()))
    whole = gains.get(base.candidate.key, Gain(0.0, 0.0, 'none'))
    # Where all causes together, or one surely, predict worse.
    titles = [problem.titles[cause.effect] for cause in causes]
    judged = {wording.joined(titles): whole} if causes else {}
    judged.update({title: cause.gain for title, cause in zip(titles, causes, strict=True)
                   if cause.gain.is_surely_worse})
    failed = [wording.worse_prediction_words(title, -gain.held_out, gain.how)
              for title, gain in judged.items() if gain.held_out and gain.held_out < 0.0]
    slopes = [parameter.slope(float(u)) for parameter, u in
              zip(parameters, model.theta_unit[:count], strict=True)]
    return Publication(
        causes=tuple(causes),
        base=_estimates(parameters, model.theta_unit, covariance),
        base_alone=_estimates(
            parameters, base.theta_unit, _covariance(space, [space.base], base, before)),
        gain=whole,
        runs=tuple(
            results.RunPrediction(
                run, *problem.simulate(run, [base.point, model.point]))
            for run in problem.all_runs),
        fits=results.PublishedFits(
            _metric_of(space), base, model, covariance[:count, :count] * np.outer(slopes, slopes)),
        shares=taken.get(base.candidate.key),
        member_shares={} if len(less) < 2 else {
            name: taken[other.candidate.key] for name, other in less.items()},
        doubts=(*sizes_at_bounds(problem, model), *failed[:1]), plain=chosen.plain,
        converged=all(each.fit.converged and each.plain.converged for each in refitted))


def with_form_error(effect: Effect, sizes: Mapping[str, Estimate],
                    size_error: float = 0.0) -> dict[str, Estimate]:
    """Parameters of an effect, with its form error in the deviation of every amplitude.

    size_error: share by which other errors of the machine bend it, or bend a logarithmic size.
    """
    sizes = dict(sizes)
    for one in effect.ordered:
        neutral, size = effect.neutral if one is effect.size else one.neutral, sizes[one.name]
        if neutral is not None:
            error = np.hypot(effect.form, size_error) * (
                size.value - (0.0 if one.scale == 'log' else neutral))
            sizes[one.name] = replace(size, std=float(np.hypot(size.std, error)))
    return sizes


def causes_at_bounds(problem: Problem, fit: Fit) -> list[str]:
    """A sentence for every effect whose size is at its bound."""
    return [wording.SIZE_AT_BOUND.format(
                problem.titles[effect.id], effect.size.name, quantity(value, effect.size.unit))
            for effect, value in stopped_sizes(fit)]


def sizes_at_bounds(problem: Problem, fit: Fit) -> list[str]:
    """A sentence for every effect whose size is at its bound, and one on bounds of the base."""
    return [*causes_at_bounds(problem, fit), *base_at_bounds(problem, fit)]


MIN_STOPPED = 0.05
"""Share of the misfit that a base parameter would take beyond its bound, from which on the bound
decides the verdict. One that the data leave open rests at a bound, too, and takes far less."""


def base_at_bounds(problem: Problem, fit: Fit) -> list[str]:
    """A sentence on bounds that keep base parameters from a misfit which is surely smaller.

    A cause can stand in for such a parameter.
    """
    slope, place = fit.jacobian.T @ fit.whitened, fit.theta_unit
    low, high = place < AT_BOUND, place > 1.0 - AT_BOUND
    outwards = low & (slope > 0.0) | high & (slope < 0.0)
    free = ~(low | high) | outwards
    gram = fit.jacobian[:, free].T @ fit.jacobian[:, free] + PRIOR**2 * np.eye(free.sum())
    gain = slope[free] @ np.linalg.solve(gram, slope[free])
    least = max(MIN_STOPPED * fit.misfit, float(chdtri(1, problem.settings.error_rate)))
    stopped = [f'{one.name} = {quantity(one.from_unit(float(u)), one.unit)}'
               for one, u, is_stopped in zip(
                   problem.system.base_parameters, place, outwards, strict=False)
               if is_stopped and not one.periodic and gain > least]
    return [wording.BASE_AT_BOUND.format(wording.joined(stopped))] if stopped else []


def _covariance(space: ModelSpace, sources: Sequence[Fit], published: Fit, residual: Residual,
                otherwise: Sequence[Fit] = ()) -> Array:
    """Covariance in bound-scaled coordinates, widened by misfit and nuisance parameters.

    sources: fits in the space with the effects of the published one and perhaps more. The first
    gives the covariance; the others, which are nearly as likely, widen it by their distance.
    otherwise: the first one in the metric of the gain, where structure that is small by range has
    little weight, and beside errors of unequal size; a 95 % interval reaches as far. An interval
    of a switch, whose slopes tell of the next samples alone, is as wide as its misfit is flat.
    """
    base = space.problem.system.base_parameters

    def places_in(fit: Fit) -> NDArray[np.intp]:
        own = {effect.id: part for effect, _, part in fit.parts}
        return np.concatenate([np.arange(len(base)), *(
            np.arange(own[name].start, own[name].stop) for name in published.candidate.ids)])

    first = places_in(sources[0])
    points = np.array([fit.theta_unit[places_in(fit)] for fit in (*sources, *otherwise)])
    apart = np.abs(points - points[0])
    periodic = [parameter.periodic for parameter in published.candidate.parameters(base)]
    apart = np.where(periodic, np.minimum(apart, 1.0 - apart), apart)
    apart[len(sources):] /= WIDTH_95
    fitted = covariance(space.slopes_of(sources[0]), PRIOR)[np.ix_(first, first)]
    widened = fitted * residual.inflation(space.settings.error_rate)
    spread, slopes = space.spread_of_shapes(sources[0]), space.tangent_of(sources[0]).white
    is_switch = (spread > 0.0) & (spread < LEAPS[0]) & ~slopes.any(axis=0)
    diagonal = np.einsum('ii->i', widened)  # a view
    diagonal[:] = np.where(is_switch[first], 0.0, diagonal)
    diagonal[:] = np.maximum(diagonal, spread[first] ** 2)
    return np.asarray(widened + np.diag(
        apart.max(axis=0) ** 2 + (published.theta_unit - points[0]) ** 2))


def _estimates(parameters: Sequence[Parameter], theta_unit: Array,
               covariance: Array) -> dict[str, Estimate]:
    """The first parameters of a fit in their units."""
    return {
        parameter.name: Estimate(
            parameter.from_unit(float(u)), float(std) * parameter.slope(float(u)), parameter.unit)
        for parameter, u, std in zip(
            parameters, theta_unit, np.sqrt(np.diag(covariance)), strict=False)}


def shares_of(metric: Metric, less: _Model, more: _Model) -> Shares:
    """What the plain fit of `more` takes of the misfit of `less`."""
    problem = metric.problem
    floor = np.array([
        np.mean([metric.noise_power(run, view) for run in problem.runs])
        / problem.view_ranges[view] ** 2 + allowed**2
        for view, allowed in problem.allowed_sizes.items()])
    fitted = _Powers.of(problem, floor, problem.runs, [
        problem.by_run(model.plain.prediction - problem.measured) for model in (less, more)])
    touched = moved = fitted.touched()
    interval, held_out, taken = None, None, {}
    left = less.left, more.left
    if left[0] and all(np.isfinite(run).all() for residuals in left for run in residuals):
        predicted = _Powers.of(problem, floor, problem.held_out or problem.runs, left)
        touched = moved + predicted.touched()
        interval = held_out = predicted.interval()
        taken = predicted.taken()
        if less.turned:
            interval = _Powers.of(problem, floor, [*problem.held_out, *problem.runs], [
                [*model.left, *model.turned] for model in (less, more)]).interval()
    by_run = fitted.more.sum(axis=(1, 2)) / np.maximum(fitted.less.sum(axis=(1, 2)), 1e-300)
    # What a cause may leave of the worst view is a small misfit in another one.
    counted = fitted.taken(1.0 - MIN_TAKEN)
    return Shares(
        counted, taken, _worst_of([(run.name, 1.0 - float(left)) for run, left in
                                   zip(problem.runs, by_run, strict=True)]), _worst_of(touched),
        _worst_of([view for view in moved if view[0] in counted]), interval, held_out)


def _worst_of(views: Sequence[tuple[str, float]]) -> tuple[str, float]:
    """The view with the least share, and its share."""
    return min(views, key=lambda view: view[1], default=('', 1.0))


@dataclass(frozen=True)
class _Powers:
    """Mean squares (R, V, S) of the residuals of two models and of their difference.

    By run, view and stretch, as shares of the squared range. floor: that of noise (V,).
    """

    views: Sequence[str]
    floor: Array
    less: Array
    more: Array
    change: Array

    @classmethod
    def of(cls, problem: Problem, floor: Array, runs: Sequence[RunBlocks],
           left: Sequence[Sequence[Array]]) -> _Powers:
        """Of residuals (C, N) by run of both models."""
        squares = np.zeros((3, len(runs), floor.size, STRETCHES))
        models = [*left, [less - more for less, more in zip(*left, strict=True)]]
        for model, residuals in zip(squares, models, strict=True):
            for row, run, residual in zip(model, runs, residuals, strict=True):
                for place, (view, weights) in enumerate(problem.system.views.items()):
                    seen = problem.freed(weights @ residual, run, view) / problem.view_ranges[view]
                    there = np.flatnonzero(problem.sample_weights(run, view) > 0.0)
                    row[place] = [float(np.mean(seen[part] ** 2)) if part.size else 0.0
                                  for part in np.array_split(there, STRETCHES)]
        return cls(tuple(problem.system.views), floor, *squares)

    def taken(self, least: float = 0.0) -> dict[str, float]:
        """Share of the power beyond noise in `less` that `more` has not, by view.

        least: smallest share of the power of the worst view for a view to count.
        """
        before = self.less.mean(axis=(0, 2)) - self.floor
        after = np.maximum(self.more.mean(axis=(0, 2)) - self.floor, 0.0)
        return {view: 1.0 - float(left / whole)
                for view, whole, left in zip(self.views, before, after, strict=True)
                if whole > max(least * before.max(), 0.0)}

    def touched(self) -> list[tuple[str, float]]:
        """Shares in the views in which the change is more than half of the misfit."""
        moved = self.change.mean(axis=(0, 2)) > MAINLY * self.less.mean(axis=(0, 2))
        shares = self.taken()
        return [(view, shares[view]) for view in compress(self.views, moved) if view in shares]

    def interval(self) -> tuple[float, float]:
        """95 % interval of the reduction of the rms, from draws of stretches."""
        before, after = (squares.mean(axis=1).ravel() for squares in (self.less, self.more))
        draw = np.random.default_rng(0).integers(0, before.size, (DRAWS, before.size))
        ratios = after[draw].mean(axis=1) / np.maximum(before[draw].mean(axis=1), 1e-300)
        low, high = np.quantile(1.0 - np.sqrt(ratios), [0.025, 0.975])
        return float(low), float(high)


def ratio(before: float, after: float) -> float:
    """Gain from two mean squares; negative if the second is larger."""
    if before <= 0.0:
        return 0.0 if after <= 0.0 else -np.inf
    return 1.0 - float(np.sqrt(after / before))


MIN_KNOWN = 0.01
"""Share of what is known of a base parameter that runs tell which determine it: 0.44 of K and n in
a pair of a static and a dynamic run, and below 0.0006 of D in the static one."""


def predicted_residuals(problem: Problem, fit: Fit,
                        moves: Sequence[Array] | None = None) -> list[Array]:
    """Residuals (C, N) of the held-out runs; without any, of each run but for a single one.

    Such a run is predicted from the others by one Gauss-Newton step. What these leave open of the
    base keeps its value, because a guess of it tells nothing of an effect. moves: those of the
    last parameters without each run, where these are settled elsewhere.
    """
    if problem.held_out:
        return [problem.simulate(run, [fit.point])[0] - run.channels for run in problem.held_out]
    if len(problem.runs) < 2:
        return []
    metric = GainMetric.about(problem, fit)
    residual = metric.whiten(fit.prediction - problem.measured)
    sensitivities = fitting.tangent(metric, fit)
    sizes = [run.time.size for run in problem.runs]
    is_base = np.arange(fit.theta_unit.size) < len(problem.system.base_parameters)
    known = np.diag(covariance(sensitivities.white, PRIOR))
    owners = np.tile(np.repeat(np.arange(len(sizes)), sizes), len(problem.system.views))
    residuals, first = [], 0
    for number, run in enumerate(problem.runs):
        last = np.zeros(0) if moves is None else moves[number]
        count = fit.theta_unit.size - last.size
        move = np.concatenate([np.zeros(count), last])
        others = owners != number
        white = sensitivities.white[others]
        left = known / np.diag(covariance(white, PRIOR))
        free = np.flatnonzero(~is_base[:count] | (left[:count] > MIN_KNOWN))
        move[free] = _step(white[:, free], residual[others] + white @ move, fit.theta_unit[free])
        move = np.clip(fit.theta_unit + move, 0.0, 1.0) - fit.theta_unit
        part = slice(first, first + run.channels.size)
        first = part.stop
        moved = fit.prediction[part] + sensitivities.plain[part] @ move
        residuals.append(moved.reshape(run.channels.shape) - run.channels)
    return residuals


def _moves_without_runs(space: ModelSpace, fit: Fit) -> list[Array]:
    """Moves (k,) of the parameters of a fit's effects, to first order, without each run."""
    white, count = space.tangent_of(fit).white, len(space.problem.system.base_parameters)
    owners = np.concatenate([np.full(run.channels.size, number)
                             for number, run in enumerate(space.problem.runs)])
    # A fit beside effects that are left out is not where it would be without these.
    own, *steps = (_step(white[used], fit.whitened[used], fit.theta_unit)
                   for used in [owners >= 0, *(owners != run for run in np.unique(owners))])
    return [(step - own)[count:] for step in steps]


def _step(white: Array, residual: Array, theta_unit: Array) -> Array:
    """The Gauss-Newton step (p,) from a point, bound-scaled, with the prior of every fit."""
    gram = white.T @ white + PRIOR**2 * np.eye(white.shape[1])
    return -np.linalg.solve(gram, white.T @ residual + PRIOR**2 * (theta_unit - 0.5))
