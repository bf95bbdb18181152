"""The published numbers: the selected models refitted without nuisance parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from saddlering_ros.discrepancy.problem.experiment import Metric, offset_columns
from saddlering_ros.discrepancy.problem.fits import (
    Fit,
    fitted_gain,
    Gain,
    held_out_gain,
    left_out_gain,
    plain_fits,
    PRIOR,
    Tangent,
)
from saddlering_ros.discrepancy.problem.system import Array, Effect, Parameter, RunBlocks, System
from saddlering_ros.discrepancy.search.comparison import Evidence
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


class Publication:
    """The selected models, refitted with no other freedom than the offsets of the runs.

    During naming, parameters and nuisance parameters share a misfit, but a parameter file
    holds parameters only. This fit therefore gives the published values, predictions and
    gains. The part that nuisance parameters would have explained adds to the uncertainty of
    the published values.
    """

    def __init__(
        self,
        space: ModelSpace,
        fit: Fit,
        before: Residual,
        after: Residual,
        runs: Sequence[RunBlocks],
    ) -> None:
        experiment = space.metric.experiment
        self.experiment, self.runs = experiment, list(runs)
        self.metric: Metric = (
            space.metric if experiment.assumptions.is_persistent
            else space.metric.marginalise(offset_columns(experiment)))
        less = {name: space.without(fit, name) for name in fit.candidate.ids}
        judged = [space.base, fit, *less.values()]
        self.base, self.fit, *others = refit_full_jacobian(
            self.metric, judged, space.settings.max_rounds, space.watch
        )
        self.less = dict(zip(less, others, strict=True))
        self.base_covariance = _covariance(
            space.tangent_of(space.base), before, self.base.theta_unit - space.base.theta_unit,
            space.settings.error_rate,
        )
        self.covariance = _covariance(
            space.tangent_of(fit), after, self.fit.theta_unit - fit.theta_unit,
            space.settings.error_rate,
        )
        fitted = {item.candidate.key: item for item in (self.base, self.fit, *others)}
        plain = plain_fits(
            experiment, list(fitted.values()), space.settings.max_rounds, space.watch
        )
        self._plain = dict(zip(fitted, plain, strict=True))
        self.converged = all(item.converged for item in [*fitted.values(), *plain])

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Base parameters."""
        return self.experiment.system.base_parameters

    def fits(self) -> PublishedFits:
        """Base and model, with the covariance of the base parameters in their units."""
        covariance = _in_units(self.parameters, self.fit.theta_unit, self.covariance)
        return PublishedFits(self.metric, self.base, self.fit, covariance)

    def base_alone(self) -> dict[str, Estimate]:
        """Base parameters without the causes."""
        return _base_estimates(self.parameters, self.base, self.base_covariance)

    def base_with_causes(self) -> dict[str, Estimate]:
        """Base parameters with the causes in."""
        return _base_estimates(self.parameters, self.fit, self.covariance)

    def gain(self) -> Gain:
        """Gain of all causes together."""
        return self._gain(self.base)

    def causes(
        self, evidence: Mapping[str, Evidence], alternatives: Alternatives
    ) -> tuple[Cause, ...]:
        """The fitted causes of the selected model."""
        return tuple(
            self._cause(effect, variant, part, evidence[effect.id], alternatives)
            for effect, variant, part in self.fit.candidate.slices(len(self.parameters))
        )

    def _cause(
        self,
        effect: Effect,
        variant: int,
        part: slice,
        evidence: Evidence,
        alternatives: Alternatives,
    ) -> Cause:
        others = {
            other
            for alternative in alternatives.get(effect.id, ())
            for other in alternative.candidate.ids
            if other not in self.fit.candidate.ids
        }
        deviations = np.sqrt(np.diag(self.covariance)[part])
        return Cause(
            effect=effect.id,
            definition=effect,
            variant=variant,
            group=(effect.id, *sorted(others)),
            parameters=_effect_estimates(effect, variant, self.fit.theta_unit[part], deviations),
            p_value=evidence.p_value,
            delta_bic=evidence.delta_bic,
            visible=evidence.visible,
            gain=self._gain(self.less[effect.id]),
        )

    def _gain(self, less: Fit) -> Gain:
        """Gain over `less` on the fitted runs, and on runs held out."""
        if less is self.fit or not self.fit.candidate.effects:
            return Gain(0.0, 0.0, 'none')
        before, after = self._plain[less.candidate.key], self._plain[self.fit.candidate.key]
        fitted = fitted_gain(self.experiment, before, after)
        held = [run for run in self.runs if run.held_out]
        if held:
            value = held_out_gain(self.experiment, held, before, after)
            if not np.isfinite(value):
                return Gain(fitted, None, 'the simulator failed on a held-out run')
            return Gain(fitted, value, 'held out')
        if len(self.experiment.runs) < 2:
            return Gain(fitted, None, 'one run only')
        return Gain(fitted, left_out_gain(self.experiment, before, after), 'held out in turn')

    def sizes_at_bounds(self) -> list[str]:
        """A sentence for every effect whose size is at its bound."""
        sentences = []
        for effect, _, part in self.fit.candidate.slices(len(self.parameters)):
            size, theta_unit = effect.size, float(self.fit.theta_unit[part.start])
            value = size.from_unit(theta_unit)
            present = abs(value - effect.neutral) / (size.high - size.low)
            if min(theta_unit, 1.0 - theta_unit) < AT_BOUND < present:
                sentences.append(
                    f'{effect.id}: its {size.name} is at the bound of '
                    f'{quantity(value, size.unit)}: the size exceeds the expected range, or '
                    'another cause contributes'
                )
        return sentences

    def predictions(self) -> tuple[RunPrediction, ...]:
        """Predictions of base and model for every run, held out or not."""
        return _predictions(self.experiment.system, self.runs, self.base, self.fit)


def _covariance(
    sensitivities: Tangent, residual: Residual, moved: Array, error_rate: float
) -> Array:
    """Covariance in bound-scaled coordinates, widened by misfit and nuisance parameters."""
    own = covariance(sensitivities.white, PRIOR) * residual.inflation(error_rate)
    return np.asarray(own + np.diag(moved**2))


def _in_units(parameters: Sequence[Parameter], theta_unit: Array, covariance: Array) -> Array:
    """Covariance (B, B) of the base parameters in their units."""
    count = len(parameters)
    slopes = np.array(
        [item.slope(float(u)) for item, u in zip(parameters, theta_unit[:count], strict=True)]
    )
    return np.asarray(covariance[:count, :count] * np.outer(slopes, slopes))


def _base_estimates(
    parameters: Sequence[Parameter], fit: Fit, covariance: Array
) -> dict[str, Estimate]:
    deviations = np.sqrt(np.diag(_in_units(parameters, fit.theta_unit, covariance)))
    base = fit.theta_unit[: len(parameters)]
    return {
        item.name: Estimate(item.from_unit(float(u)), float(std), item.unit)
        for item, u, std in zip(parameters, base, deviations, strict=True)
    }


def _effect_estimates(
    effect: Effect, variant: int, theta_unit: Array, deviations: Array
) -> dict[str, Estimate]:
    """An effect's parameters, and the fixed values of its variant."""
    estimates = {}
    for item, u, deviation in zip(effect.ordered, theta_unit, deviations, strict=True):
        value = item.from_unit(float(u))
        std = float(deviation) * item.slope(float(u))
        if item is effect.size:
            std = float(np.hypot(std, effect.form * (value - effect.neutral)))
        estimates[item.name] = Estimate(value, std, item.unit)
    for key, value in effect.variants[variant].items():
        estimates[key] = Estimate(float(value), 0.0, '')
    return estimates


def _predictions(
    system: System, runs: Sequence[RunBlocks], before: Fit, after: Fit
) -> tuple[RunPrediction, ...]:
    answers = []
    for run in runs:
        both = system.predict_many(run, [before.point, after.point])
        answers.append(RunPrediction(run, both[0], both[1]))
    return tuple(answers)
