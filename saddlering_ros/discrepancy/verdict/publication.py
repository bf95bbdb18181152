"""The published numbers: the selected models refitted without nuisance parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from saddlering_ros.discrepancy.problem.fits import Fit, Gain, gain_of, plain_fits, PRIOR, Tangent
from saddlering_ros.discrepancy.problem.system import Array, Effect, Parameter
from saddlering_ros.discrepancy.search.comparison import Comparison
from saddlering_ros.discrepancy.search.selection import Alternatives
from saddlering_ros.discrepancy.search.space import ModelSpace, refit_full_jacobian
from saddlering_ros.discrepancy.verdict.established import Prediction, Shares, sizes_at_bounds
from saddlering_ros.discrepancy.verdict.results import (
    Cause,
    Estimate,
    PublishedFits,
    Residual,
    RunPrediction,
)
from saddlering_ros.estimation.least_squares import covariance
from saddlering_ros.quantities import percent

RUNS = ('runs held out in turn', 'held-out runs')


@dataclass(frozen=True)
class Publication:
    """Numbers for the reader, of the selected model and of the base alone.

    shares: what all causes together take of the misfit, None without causes; member_shares: what
    each of several takes of the misfit without it; doubts: sentences on sizes at their bounds and
    on runs that are predicted worse; converged: whether all fits converged.
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
    converged: bool


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
    problem, rate = space.problem, space.settings.error_rate
    parameters = problem.system.base_parameters
    is_persistent = problem.assumptions.is_persistent
    metric = space.metric if is_persistent else space.metric.with_offsets(process)
    less = {name: space.without(fit, name) for name in fit.candidate.ids}
    judged = [space.base, fit, *less.values()]
    base, model, *others = refit_full_jacobian(metric, judged, space.settings.max_rounds)
    base_covariance = _covariance(
        space.tangent_of(space.base), before, base.theta_unit - space.base.theta_unit, rate)
    covariance = _covariance(
        space.tangent_of(fit), after, model.theta_unit - fit.theta_unit, rate)
    refitted = {refit.candidate.key: refit for refit in (base, model, *others)}
    plain = dict(zip(refitted, plain_fits(problem, list(refitted.values())), strict=True))

    prediction = Prediction(problem, space.metric.noise)
    taken = {
        key: prediction.shares(other, plain[model.candidate.key])
        for key, other in plain.items() if key != model.candidate.key
    }

    def gain_over(other: Fit) -> Gain:
        key = other.candidate.key
        gain = gain_of(problem, plain[key], plain[model.candidate.key])
        known = gain.held_out is not None and key in taken
        return replace(gain, interval=taken[key].interval) if known else gain

    causes = []
    for effect, variant, part in model.candidate.slices(len(parameters)):
        evidence = Comparison(space, less[effect.id], fit).evidence()
        others_named = {
            other
            for alternative in alternatives.get(effect.id, ())
            for other in alternative.candidate.ids
            if other not in model.candidate.ids
        }
        deviations = np.sqrt(np.diag(covariance)[part])
        causes.append(Cause(
            effect=effect.id, definition=effect, variant=variant,
            group=(effect.id, *sorted(others_named)),
            parameters=_effect_estimates(effect, variant, model.theta_unit[part], deviations),
            p_value=evidence.p_value, delta_bic=evidence.delta_bic, visible=evidence.visible,
            gain=gain_over(less[effect.id])))
    return Publication(
        causes=tuple(causes),
        base=_base_estimates(parameters, model, covariance),
        base_alone=_base_estimates(parameters, base, base_covariance),
        gain=gain_over(base),
        runs=tuple(
            RunPrediction(run, *problem.system.predict_many(run, [base.point, model.point]))
            for run in problem.all_runs),
        fits=PublishedFits(
            metric, base, model, _in_units(parameters, model.theta_unit, covariance)),
        shares=taken.get(base.candidate.key),
        member_shares={} if len(less) < 2 else {
            name: taken[other.candidate.key] for name, other in less.items()},
        doubts=(*sizes_at_bounds(problem, model), *_failed_predictions(gain_over(base), causes)),
        converged=all(refit.converged for refit in [*refitted.values(), *plain.values()]),
    )


def _failed_predictions(whole: Gain, causes: Sequence[Cause]) -> list[str]:
    """A sentence if the causes predict other runs worse than the base, or one surely does."""
    gains = {' and '.join(cause.effect for cause in causes): whole}
    gains.update({
        cause.effect: cause.gain for cause in causes
        if cause.gain.interval is not None and cause.gain.interval[1] < 0.0})
    return [
        f'{name} predicts {RUNS[gain.how == "held out"]} worse: the misfit there rises by '
        f'{percent(-gain.held_out)}, so that it is not named'
        for name, gain in gains.items() if gain.held_out is not None and gain.held_out < 0.0
    ][:1]


def _covariance(
    sensitivities: Tangent, residual: Residual, moved: Array, error_rate: float
) -> Array:
    """Covariance in bound-scaled coordinates, widened by misfit and nuisance parameters."""
    fitted = covariance(sensitivities.white, PRIOR) * residual.inflation(error_rate)
    return np.asarray(fitted + np.diag(moved**2))


def _in_units(parameters: Sequence[Parameter], theta_unit: Array, covariance: Array) -> Array:
    """Covariance (B, B) of the base parameters in their units."""
    count = len(parameters)
    slopes = np.array([parameter.slope(float(u)) for parameter, u in
                       zip(parameters, theta_unit[:count], strict=True)])
    return np.asarray(covariance[:count, :count] * np.outer(slopes, slopes))


def _base_estimates(
    parameters: Sequence[Parameter], fit: Fit, covariance: Array
) -> dict[str, Estimate]:
    deviations = np.sqrt(np.diag(_in_units(parameters, fit.theta_unit, covariance)))
    base = fit.theta_unit[: len(parameters)]
    return {
        parameter.name: Estimate(parameter.from_unit(float(u)), float(std), parameter.unit)
        for parameter, u, std in zip(parameters, base, deviations, strict=True)
    }


def _effect_estimates(
    effect: Effect, variant: int, theta_unit: Array, deviations: Array
) -> dict[str, Estimate]:
    """An effect's parameters, and the fixed values of its variant."""
    estimates = {}
    for parameter, u, deviation in zip(effect.ordered, theta_unit, deviations, strict=True):
        value = parameter.from_unit(float(u))
        std = float(deviation) * parameter.slope(float(u))
        if parameter is effect.size:
            std = float(np.hypot(std, effect.form * (value - effect.neutral)))
        estimates[parameter.name] = Estimate(value, std, parameter.unit)
    for key, value in effect.variants[variant].items():
        estimates[key] = Estimate(float(value), 0.0, '')
    return estimates
