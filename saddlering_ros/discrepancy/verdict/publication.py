"""The published numbers: the selected models refitted without nuisance parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from saddlering_ros.discrepancy.problem.fits import Fit, Gain, gain_of, plain_fits, PRIOR, Tangent
from saddlering_ros.discrepancy.problem.problem import Problem
from saddlering_ros.discrepancy.problem.system import Array, Effect, Parameter
from saddlering_ros.discrepancy.search.comparison import Comparison
from saddlering_ros.discrepancy.search.selection import Alternatives
from saddlering_ros.discrepancy.search.space import AT_BOUND, ModelSpace, refit_full_jacobian
from saddlering_ros.discrepancy.verdict.results import (
    Cause,
    Estimate,
    PublishedFits,
    Residual,
    RunPrediction,
)
from saddlering_ros.estimation.least_squares import covariance
from saddlering_ros.quantities import quantity


@dataclass(frozen=True)
class Publication:
    """Numbers for the reader, of the selected model and of the base alone.

    warnings: sentences on sizes at their bounds; converged: whether all fits converged.
    """

    causes: tuple[Cause, ...]
    base: Mapping[str, Estimate]
    base_alone: Mapping[str, Estimate]
    gain: Gain
    runs: tuple[RunPrediction, ...]
    fits: PublishedFits
    warnings: tuple[str, ...]
    converged: bool


def publish(
    space: ModelSpace, fit: Fit, alternatives: Alternatives, before: Residual, after: Residual
) -> Publication:
    """Refit the selected models with no other freedom than the offsets of the runs.

    During naming, parameters and nuisance parameters share a misfit, but a parameter file
    holds parameters only. This fit therefore gives the published values, predictions and
    gains. The part that nuisance parameters would have explained adds to the uncertainty of
    the published values.
    """
    problem, rate = space.problem, space.settings.error_rate
    parameters = problem.system.base_parameters
    is_persistent = problem.assumptions.is_persistent
    metric = space.metric if is_persistent else space.metric.with_offsets()
    less = {name: space.without(fit, name) for name in fit.candidate.ids}
    judged = [space.base, fit, *less.values()]
    base, model, *others = refit_full_jacobian(metric, judged, space.settings.max_rounds)
    base_covariance = _covariance(
        space.tangent_of(space.base), before, base.theta_unit - space.base.theta_unit, rate)
    covariance = _covariance(
        space.tangent_of(fit), after, model.theta_unit - fit.theta_unit, rate)
    refitted = {refit.candidate.key: refit for refit in (base, model, *others)}
    plain = dict(zip(refitted, plain_fits(problem, list(refitted.values())), strict=True))

    def gain_over(other: Fit) -> Gain:
        return gain_of(problem, plain[other.candidate.key], plain[model.candidate.key])

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
        runs=_predictions(problem, base, model),
        fits=PublishedFits(
            metric, base, model, _in_units(parameters, model.theta_unit, covariance)),
        warnings=tuple(_sizes_at_bounds(model, len(parameters))),
        converged=all(refit.converged for refit in [*refitted.values(), *plain.values()]),
    )


def _sizes_at_bounds(fit: Fit, base_parameters: int) -> list[str]:
    """A sentence for every effect whose size is at its bound."""
    sentences = []
    for effect, _, part in fit.candidate.slices(base_parameters):
        size, theta_unit = effect.size, float(fit.theta_unit[part.start])
        value = size.from_unit(theta_unit)
        present = abs(value - effect.neutral) / (size.high - size.low)
        if min(theta_unit, 1.0 - theta_unit) < AT_BOUND < present:
            sentences.append(
                f'{effect.id}: its {size.name} is at the bound of '
                f'{quantity(value, size.unit)}: the size exceeds the expected range, or '
                'another cause contributes')
    return sentences


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


def _predictions(problem: Problem, before: Fit, after: Fit) -> tuple[RunPrediction, ...]:
    """Predictions of base and model for every run, held out or not."""
    answers = []
    for run in problem.all_runs:
        both = problem.system.predict_many(run, [before.point, after.point])
        answers.append(RunPrediction(run, both[0], both[1]))
    return tuple(answers)
