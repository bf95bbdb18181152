"""The published numbers, whether causes are established, and what they leave.

The selected models are refitted without nuisance parameters. A stand-in for a law that is in no
catalogue explains a part of the misfit too, which no likelihood ratio tells. What does is how much
of the misfit beyond noise a cause takes in a view, on fitted runs and on runs that it predicts.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import compress

import numpy as np

from saddlering_ros.discrepancy.problem.fits import (
    Fit,
    Gain,
    gain_of,
    plain_fits,
    predicted_residuals,
    PRIOR,
)
from saddlering_ros.discrepancy.problem.problem import NoiseByRun, Problem
from saddlering_ros.discrepancy.problem.system import Array, Estimate, Parameter, RunBlocks
from saddlering_ros.discrepancy.search.evidence import Comparison, crowded
from saddlering_ros.discrepancy.search.selection import Alternatives, stopped_sizes
from saddlering_ros.discrepancy.search.signatures import orthonormal
from saddlering_ros.discrepancy.search.space import ModelSpace, refit_full_jacobian
from saddlering_ros.discrepancy.verdict import wording
from saddlering_ros.discrepancy.verdict.naming import allowed_sizes, shapes_at_bounds, STRETCHES
from saddlering_ros.discrepancy.verdict.results import (
    Cause,
    MIN_TAKEN,
    PublishedFits,
    Remainder,
    Residual,
    RunPrediction,
)
from saddlering_ros.estimation.least_squares import covariance

MIN_TAKEN_BESIDE = 1.0 - 0.5 * (1.0 - MIN_TAKEN)
"""The same of a main cause beside one with alternatives, which can take part of what a wrong main
cause leaves: half as much is left."""

MIN_BEYOND_SOUND = 0.3
"""Share of what the other effects leave beyond noise and the errors of a sound ring that a cause
of a ring takes. On dirty rings a stand-in that took 96 % of the misfit alone took 23 % of this,
and true causes 33 to 99 %."""

MAX_ALIKE = 0.9
"""Share of the power of what a cause changes beyond the base from which another listed effect
acts as it does: on development draws, such effects had 94 to 99 % of that of stand-ins, and up to
88 % of that of true laws, but for one of 96 %."""

MAINLY = 0.5
"""Share of the power of a view's misfit that a cause moves where it mainly acts, and share of the
power of the main cause that no cause beside it exceeds: half."""

MAX_ONE_FAMILY = 0.7
"""Share of the remainder that one family of shapes may take: errors of a machine lie along
several coordinates."""

DRAWS = 400
"""Draws of stretches for the interval of a reduction."""


@dataclass(frozen=True)
class Shares:
    """Shares of the misfit's power beyond noise that a model takes beside another, by view.

    fitted: of views with no small misfit beside that of the worst; worst_run: share of all
    misfit in the run with the least; worst_view: view and share of the least where the model
    moves more than half of the misfit; interval: 95 % of the reduction on predicted runs.
    """

    fitted: Mapping[str, float]
    predicted: Mapping[str, float]
    worst_run: float
    worst_view: tuple[str, float]
    interval: tuple[float, float] | None

    @property
    def best(self) -> float:
        """Share in the view in which the model takes most, where it is fitted and predicts.

        A view without misfit on the predicted runs shows nothing, if others have some.
        """
        return max(
            (min(share, self.predicted.get(view, 0.0)) if self.predicted else share
             for view, share in self.fitted.items()), default=0.0)


def shares_of(
    problem: Problem, noise: NoiseByRun, less: Fit, more: Fit, left: Sequence[Sequence[Array]],
) -> Shares:
    """What a plain fit `more` takes of the misfit of `less`; left: predicted residuals of both."""
    floor = np.array([
        np.mean([noise_power(noise, run, weights) for run in problem.runs])
        / problem.view_ranges[view] ** 2 for view, weights in problem.system.views.items()])
    fitted = _Powers.of(problem, floor, problem.runs, [
        problem.by_run(fit.prediction - problem.measured) for fit in (less, more)])
    touched, interval, taken = fitted.touched(), None, {}
    if left[0] and all(np.isfinite(run).all() for residuals in left for run in residuals):
        predicted = _Powers.of(problem, floor, problem.held_out or problem.runs, left)
        touched += predicted.touched()
        interval, taken = predicted.interval(), predicted.taken()
    by_run = fitted.more.sum(axis=(1, 2)) / np.maximum(fitted.less.sum(axis=(1, 2)), 1e-300)
    return Shares(
        # What a cause may leave of the worst view is a small misfit in another one.
        fitted.taken(1.0 - MIN_TAKEN), taken, 1.0 - float(by_run.max()),
        min(touched, key=lambda item: item[1], default=('', 1.0)), interval)


def noise_power(noise: NoiseByRun, run: RunBlocks, weights: Array) -> float:
    """Mean square of the noise of a view in a run."""
    return sum(
        float(weight) ** 2 * float(np.mean(noise[run.name, channel].variances(run.width)))
        for channel, weight in enumerate(weights) if weight)


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
        models = [*left, [one - other for one, other in zip(*left, strict=True)]]
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
        before, after = (item.mean(axis=1).ravel() for item in (self.less, self.more))
        draw = np.random.default_rng(0).integers(0, before.size, (DRAWS, before.size))
        ratios = after[draw].mean(axis=1) / np.maximum(before[draw].mean(axis=1), 1e-300)
        low, high = np.quantile(1.0 - np.sqrt(ratios), [0.025, 0.975])
        return float(low), float(high)


def doubts_of(space: ModelSpace, fit: Fit, published: Publication,
              alternatives: Alternatives) -> list[str]:
    """Reasons why the effects of a fit beside model error are not established."""
    doubts, whole = other_laws(space, fit, alternatives), published.shares
    assert whole is not None
    main = published.main.effect if published.member_shares else ''
    if alternatives.get(main):
        doubts.append(wording.replaced_words(main))
    for name, own in {' and '.join(fit.candidate.ids): whole, **published.member_shares}.items():
        is_beside = name == main and any(alternatives.values())
        required = MIN_TAKEN_BESIDE if is_beside else MIN_TAKEN
        if own.best < required:
            doubts.append(wording.weak_words(name, own.best, required))
    doubts += _unlike(whole)
    explained = [Comparison(space, space.without(fit, name), fit) for name in fit.candidate.ids]
    if not all(item.is_real for item in explained):
        doubts.append(wording.BY_CHANCE)
    if crowded([item.added for item in explained], space.settings):
        doubts.append(wording.THREE_EFFECTS)
    return doubts


def doubts_on_main(space: ModelSpace, fit: Fit, published: Publication) -> list[str]:
    """Reasons why the main one of several effects is not established beside the others.

    What the others take is no misfit of the main one. If other effects can replace it, some pair
    of effects fits even a cause that is in no catalogue.
    """
    main = published.main
    own = published.member_shares[main.effect]
    doubts = _unlike(own)
    if main.group != (main.effect,):
        doubts.append(wording.replaced_words(main.effect))
    if own.best < MIN_TAKEN:
        doubts.append(wording.weak_words(main.effect, own.best, MIN_TAKEN))
    if not Comparison(space, space.without(fit, main.effect), fit).is_real:
        doubts.append(wording.BY_CHANCE)
    return doubts


def _unlike(shares: Shares) -> list[str]:
    """Sentences on views and runs in which the misfit falls by too little."""
    view, least = shares.worst_view
    doubts = [] if least >= 0.0 else [wording.worse_view_words(view)]
    if shares.interval is None:
        doubts.append(wording.ONE_RUN)
    elif shares.interval[0] <= 0.0:
        doubts.append(wording.uncertain_gain_words(*shares.interval))
    return doubts if shares.worst_run >= 0.0 else [*doubts, wording.WORSE_RUN]


def like_sound_errors(alone: ModelSpace, strict: Fit, fit: Fit, names: Iterable[str]) -> list[str]:
    """A sentence for every effect that errors of a sound machine could replace.

    alone: the space in which only what such errors leave is misfit; strict: the model found there.
    """
    sentences = []
    for name in names:
        whole = strict if name in strict.candidate.ids else refit_full_jacobian(
            alone.metric, [fit], alone.settings.rounds)[0]
        left = alone.without(whole, name).misfit
        share = (left - whole.misfit) / max(left - alone.metric.free_count, 1e-9)
        if share < MIN_BEYOND_SOUND:
            sentences.append(wording.sound_error_words(name, share, MIN_BEYOND_SOUND))
    return sentences


def under_declared_error(space: ModelSpace, fit: Fit) -> list[str]:
    """Effects of a fit whose part is no larger than the declared model error anywhere."""
    allowed = allowed_sizes(space)
    return [
        name for name in fit.candidate.ids
        if all(float(size.max()) <= allowed[view] for view, size in
               Comparison(space, space.without(fit, name), fit).added.items())]


def one_shape_left(alone: ModelSpace, fit: Fit) -> list[str]:
    """A sentence if one family of shapes takes most or all of what the effects of a fit leave.

    A law that is not listed leaves a rest along one coordinate, if the effects take its other
    part. alone: the space in which only what errors of a sound machine leave is misfit.
    """
    whole, rate = refit_full_jacobian(
        alone.metric, [fit], alone.settings.rounds)[0], alone.settings.error_rate
    white = alone.tangent_of(whole).white
    beyond = orthonormal(white)
    least = (1.0 - MAX_ONE_FAMILY) * alone.slow_residual(whole).excess
    for test in alone.tests.shapes(whole, white):
        if test.shape is not None and test.p_value < rate:
            taken = alone.metric.whiten(test.shape)
            left = whole.whitened - taken + beyond @ (beyond.T @ taken)
            after = alone.tests.slow(replace(whole, whitened=left))
            if after.p_value >= rate or after.excess < least:
                return [wording.shape_words(
                    fit.candidate.ids, f'{test.view} along {test.coordinate}')]
    return []


def other_laws(space: ModelSpace, fit: Fit, alternatives: Alternatives) -> list[str]:
    """Signs that the law is another than that of the causes, whatever they take of the misfit."""
    stopped = [*shapes_at_bounds(space, fit), *sizes_at_bounds(space.problem, fit)]
    is_exact = space.problem.assumptions.exact_laws
    return stopped + shared_directions(space, fit, alternatives) if is_exact else stopped


def shared_directions(space: ModelSpace, fit: Fit, alternatives: Alternatives) -> list[str]:
    """A sentence for a cause if another effect, of any size and sign, would act beside it alike.

    Where these data show one direction beyond the base, an effect that is in no catalogue acts
    along it too. Alternatives and laws that contain each other are one cause.
    """
    problem, white = space.problem, space.tangent_of(fit).white
    base = problem.system.base_parameters
    beyond = orthonormal(white[:, : len(base)])
    sentences = []
    for effect, _, part in fit.candidate.slices(len(base)):
        same = {*fit.candidate.ids, *effect.contains}
        same.update(*(other.candidate.ids for other in alternatives.get(effect.id, ())))
        others = [one for one in problem.system.effects
                  if one.id not in same and effect.id not in one.contains]
        asked = [(one, fit.candidate.plus(one, variant), start) for one in others
                 for variant in range(len(one.variants)) for start in one.first_guesses]
        if not asked:
            continue
        changes = problem.predict([
            candidate.point(base, np.concatenate([fit.theta_unit, start]))
            for _, candidate, start in asked]) - fit.prediction[:, None]
        left = np.column_stack([white[:, part.start], space.metric.whiten(
            np.where(np.isfinite(changes).all(axis=0), changes, 0.0))])
        left -= beyond @ (beyond.T @ left)
        left /= np.maximum(np.linalg.norm(left, axis=0), 1e-9)
        shares = (left[:, 0] @ left[:, 1:]) ** 2
        share = float(shares.max())
        if share > MAX_ALIKE:
            other = asked[int(shares.argmax())][0]
            sentences.append(wording.shared_direction_words(effect.id, other.id, share))
    return sentences


def sizes_at_bounds(problem: Problem, fit: Fit) -> list[str]:
    """A sentence for every effect whose size is at its bound, which is no name."""
    return [wording.size_at_bound_words(effect.id, effect.size, value)
            for effect, value in stopped_sizes(problem, fit)]


def remainder_of(space: ModelSpace, fit: Fit, residual: Residual) -> tuple[Remainder, ...]:
    """What a fit leaves beyond noise and declared model error, by run and view, largest first."""
    problem, settings = space.problem, space.settings
    slow, allowed, names = residual.slow, allowed_sizes(space), problem.system.channel_names
    left: list[tuple[RunBlocks, str, float, str]] = []
    everywhere = slow.is_real_and_material(settings)
    for view, weights in problem.system.views.items():
        along = min(((item.p_value, item.coordinate) for item in residual.shapes
                     if item.view == view), default=(1.0, 'time'))[1]
        for number, run in enumerate(problem.runs):
            size = float(slow.sizes[view][number])
            chance = min(slow.chances.get((names[channel], run.name), 1.0)
                         for channel in np.flatnonzero(weights))
            is_real = everywhere or chance < settings.error_rate
            if size >= max(settings.materiality, allowed[view]) and is_real:
                left.append((run, view, size, along))
    fast = residual.fast
    if fast.is_real_and_material(settings) and fast.visible >= allowed.get(fast.view, np.inf):
        run = next(run for run in problem.runs if run.name == fast.run)
        left.append((run, fast.view, fast.visible, 'time'))
    told = {view for _, view, _, _ in left}
    for test in (*residual.consistency, *residual.shapes):
        # A declared error may have any smooth shape: only its size counts, which is judged above.
        is_free = problem.assumptions.exact_laws and allowed[test.view] == 0.0
        is_real = test.p_value < settings.error_rate and test.visible >= settings.materiality
        if is_free and is_real and test.view not in told:
            run = problem.runs[int(np.argmax(slow.sizes[test.view]))]
            left.append((run, test.view, test.visible, test.coordinate))
            told.add(test.view)
    remainder = []
    for run, view, size, along in sorted(left, key=lambda item: -item[2]):
        noise = noise_power(space.metric.noise, run, problem.system.views[view]) ** 0.5
        times = size * problem.view_ranges[view] / max(noise, 1e-300)
        remainder.append(Remainder(run.name, view, size, float(np.hypot(1.0, times)), along))
    return tuple(remainder)


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
    runs: tuple[RunPrediction, ...]
    fits: PublishedFits
    shares: Shares | None
    member_shares: Mapping[str, Shares]
    doubts: tuple[str, ...]
    plain: Fit
    converged: bool

    @property
    def main(self) -> Cause:
        """The cause that moves most."""
        return max(self.causes, key=lambda cause: cause.visible)


def publish(
    space: ModelSpace, fit: Fit, alternatives: Alternatives, before: Residual, after: Residual,
    process: Array | None = None,
) -> Publication:
    """Refit the selected models with no other freedom than the offsets of the runs.

    During naming, parameters and nuisance parameters share a misfit, but a parameter file
    holds parameters only. This fit therefore gives the published values, predictions and
    gains. The part that nuisance parameters would have explained adds to the uncertainty of
    the published values. process: model error in the metric of the fits, if it was learnt.
    """
    problem, parameters = space.problem, space.problem.system.base_parameters
    is_persistent = problem.assumptions.is_persistent
    metric = space.metric if is_persistent else space.metric.with_offsets(process)
    less = {name: space.without(fit, name) for name in fit.candidate.ids}
    base, model, *others = refit_full_jacobian(
        metric, [space.base, fit, *less.values()], space.settings.max_rounds)
    covariance = _covariance(space, fit, model, after)
    refitted = {refit.candidate.key: refit for refit in (base, model, *others)}
    plain = dict(zip(refitted, plain_fits(problem, list(refitted.values())), strict=True))
    whole_key = model.candidate.key
    left = {key: predicted_residuals(problem, one) if fit.candidate.effects else []
            for key, one in plain.items()}
    taken = {key: shares_of(problem, space.metric.noise, other, plain[whole_key],
                            (left[key], left[whole_key]))
             for key, other in plain.items() if key != whole_key}

    def gain_over(other: Fit) -> Gain:
        key = other.candidate.key
        gain = gain_of(problem, plain[key], plain[whole_key], (left[key], left[whole_key]))
        known = gain.held_out is not None and key in taken
        return replace(gain, interval=taken[key].interval) if known else gain

    causes = []
    for effect, variant, part in model.candidate.slices(len(parameters)):
        evidence = Comparison(space, less[effect.id], fit).evidence()
        others_named = {other for alternative in alternatives.get(effect.id, ())
                        for other in alternative.candidate.ids} - {*model.candidate.ids}
        own = _estimates(effect.ordered, model.theta_unit[part], covariance[part, part])
        size = own[effect.size.name]
        own[effect.size.name] = replace(
            size, std=float(np.hypot(size.std, effect.form * (size.value - effect.neutral))))
        own.update({key: Estimate(float(value), 0.0, '')
                    for key, value in effect.variants[variant].items()})
        causes.append(Cause(
            effect=effect.id, definition=effect, variant=variant,
            group=(effect.id, *sorted(others_named)),
            parameters=own, p_value=evidence.p_value, delta_bic=evidence.delta_bic,
            visible=evidence.visible, gain=gain_over(less[effect.id])))
    # The causes predict other runs worse than the base, or one of them surely does.
    whole = gain_over(base)
    gains = {' and '.join(cause.effect for cause in causes): whole}
    gains.update({cause.effect: cause.gain for cause in causes
                  if cause.gain.interval is not None and cause.gain.interval[1] < 0.0})
    failed = [
        wording.worse_prediction_words(name, -gain.held_out, is_held_out=gain.how == 'held out')
        for name, gain in gains.items() if gain.held_out is not None and gain.held_out < 0.0]
    count = len(parameters)
    slopes = [parameter.slope(float(u)) for parameter, u in
              zip(parameters, model.theta_unit[:count], strict=True)]
    return Publication(
        causes=tuple(causes),
        base=_estimates(parameters, model.theta_unit, covariance),
        base_alone=_estimates(
            parameters, base.theta_unit, _covariance(space, space.base, base, before)),
        gain=whole,
        runs=tuple(
            RunPrediction(run, *problem.system.predict_many(run, [base.point, model.point]))
            for run in problem.all_runs),
        fits=PublishedFits(
            metric, base, model, covariance[:count, :count] * np.outer(slopes, slopes)),
        shares=taken.get(base.candidate.key),
        member_shares={} if len(less) < 2 else {
            name: taken[other.candidate.key] for name, other in less.items()},
        doubts=(*sizes_at_bounds(problem, model), *failed[:1]), plain=plain[model.candidate.key],
        converged=all(refit.converged for refit in [*refitted.values(), *plain.values()]))


def _covariance(space: ModelSpace, fit: Fit, published: Fit, residual: Residual) -> Array:
    """Covariance in bound-scaled coordinates, widened by misfit and nuisance parameters."""
    fitted = covariance(space.tangent_of(fit).white, PRIOR)
    widened = fitted * residual.inflation(space.settings.error_rate)
    return np.asarray(widened + np.diag((published.theta_unit - fit.theta_unit) ** 2))


def _estimates(
    parameters: Sequence[Parameter], theta_unit: Array, covariance: Array
) -> dict[str, Estimate]:
    """The first parameters of a fit in their units."""
    return {
        parameter.name: Estimate(
            parameter.from_unit(float(u)), float(std) * parameter.slope(float(u)), parameter.unit)
        for parameter, u, std in zip(
            parameters, theta_unit, np.sqrt(np.diag(covariance)), strict=False)}
