"""The conclusion: from the selected model to the verdict and the numbers that are published."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from saddlering_ros.discrepancy.candidate import Fit
from saddlering_ros.discrepancy.criteria import crowded, real_and_material
from saddlering_ros.discrepancy.gain import fitted_gain, Gain, held_out_gain, left_out_gain
from saddlering_ros.discrepancy.metric import Metric
from saddlering_ros.discrepancy.model_space import AT_BOUND, ModelSpace, refit_full_jacobian
from saddlering_ros.discrepancy.nuisances import offset_columns
from saddlering_ros.discrepancy.refit import Tangent, tangent
from saddlering_ros.discrepancy.results import (
    Cause,
    Estimate,
    Evidence,
    PublishedFits,
    Residual,
    RunPrediction,
    Verdict,
)
from saddlering_ros.discrepancy.selection import Alternatives
from saddlering_ros.discrepancy.system import Array, Effect, Parameter, Run, System


@dataclass(frozen=True)
class Judgement:
    """The verdict on the selected model, and what a reader should know beside it."""

    verdict: Verdict
    explained: float
    warnings: tuple[str, ...]


def residual_of(space: ModelSpace, fit: Fit) -> Residual:
    """What a fit leaves."""
    shapes = space.tests.shapes(fit, space.tangent_of(fit).white)
    return Residual(space.slow_residual(fit), space.tests.fast(fit), tuple(shapes))


def judge(
    space: ModelSpace,
    fit: Fit,
    alternatives: Alternatives,
    before: Residual,
    after: Residual,
) -> Judgement:
    """The verdict: whether the causes stand alone, and whether they explain what is wrong."""
    settings = space.settings
    share = explained_share_of(before, after) if fit.candidate.effects else 0.0
    left = real_and_material(after.slow, settings) or real_and_material(after.fast, settings)
    warnings: list[str] = []
    verdict: Verdict = 'none'
    if fit.candidate.effects:
        ambiguous = any(alternatives.get(name) for name in fit.candidate.ids)
        verdict = 'ambiguous' if ambiguous else 'named'
        members = (space.explained(space.without(fit, name), fit) for name in fit.candidate.ids)
        if left and share < settings.min_total:
            verdict = 'unknown'
        elif crowded(members, settings):
            verdict = 'unknown'
            warnings.append(
                f'{len(fit.candidate.effects)} effects were needed for one channel: so many bend '
                'to anything, and none of them is sure'
            )
        elif left:
            warnings.append(
                f'{100 * (1 - share):.0f} % of the misfit is left after the extension, most '
                f'of it in {after.slow.where}: its form may differ, or something small is '
                'beside it'
            )
    elif left:
        verdict = 'unknown'
    if real_and_material(after.fast, settings):
        fast = after.fast
        warnings.append(
            f'{fast.view} swings about {fast.frequency:.2g} Hz in '
            f'{fast.run}, {100 * fast.visible:.2f} % of range, unexplained'
        )
    return Judgement(verdict, share, tuple(warnings))


def explained_share_of(before: Residual, after: Residual) -> float:
    """Share of the misfit beyond noise that is gone."""
    remaining = max(after.slow.excess, 0.0) + after.fast.excess
    return 1.0 - remaining / max(before.slow.excess + before.fast.excess, 1e-9)


class Publication:
    """The selected models fitted with no other freedom than the runs' offsets.

    Naming shares a misfit between parameters and nuisance parameters; a parameter file has
    parameters only. What is published, predicted and measured as gain is therefore this fit. What
    the nuisances would have taken is part of what the published values are unsure of.
    """

    def __init__(
        self, space: ModelSpace, fit: Fit, before: Residual, after: Residual, runs: Sequence[Run]
    ) -> None:
        experiment = space.metric.experiment
        self.experiment, self.runs = experiment, list(runs)
        self.metric: Metric = space.metric.marginalise(offset_columns(experiment))
        less = {name: space.without(fit, name) for name in fit.candidate.ids}
        judged = [space.base, fit, *less.values()]
        self.base, self.fit, *others = refit_full_jacobian(self.metric, judged, space.watch)
        self.less = dict(zip(less, others, strict=True))
        self.base_covariance = _covariance(
            space.tangent_of(space.base), before, self.base.theta_unit - space.base.theta_unit
        )
        self.covariance = _covariance(
            space.tangent_of(fit), after, self.fit.theta_unit - fit.theta_unit
        )
        self._tangents: dict[str, Tangent] = {}

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
        """The fitted causes, as the selected model has them."""
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
        """Gain over `less` on the fitted runs, and on runs held out or left out in turn."""
        if less is self.fit:
            return Gain(0.0, 0.0, 'none')
        ranges = self.experiment.view_ranges
        fitted = fitted_gain(self.metric, ranges, less, self.fit)
        held = [run for run in self.runs if run.held_out]
        if held:
            value = held_out_gain(self.experiment.system, held, ranges, less, self.fit)
            return Gain(fitted, value, 'held out')
        if len(self.experiment.runs) < 2:
            return Gain(fitted, None, 'one run only')
        value = left_out_gain(
            self.metric, ranges, (less, self._tangent(less)), (self.fit, self._tangent(self.fit))
        )
        return Gain(fitted, value, 'left out in turn')

    def _tangent(self, fit: Fit) -> Tangent:
        name = ' '.join(fit.candidate.ids)
        if name not in self._tangents:
            self._tangents[name] = tangent(self.metric, fit)
        return self._tangents[name]

    def sizes_at_bounds(self) -> list[str]:
        """A sentence for every effect as large as its bounds allow."""
        sentences = []
        for effect, _, part in self.fit.candidate.slices(len(self.parameters)):
            size, theta_unit = effect.size, float(self.fit.theta_unit[part.start])
            value = size.from_unit(theta_unit)
            present = abs(value - effect.neutral) / (size.high - size.low)
            if min(theta_unit, 1.0 - theta_unit) < AT_BOUND < present:
                sentences.append(
                    f'{effect.id}: its {size.name} stands at the bound of {value:.3g} '
                    f'{size.unit}: it is larger than was thought possible, or something else is '
                    'mixed with it'
                )
        return sentences

    def predictions(self) -> tuple[RunPrediction, ...]:
        """What base and model predict for every run, held out or not."""
        return _predictions(self.experiment.system, self.runs, self.base, self.fit)


def _covariance(sensitivities: Tangent, residual: Residual, moved: Array) -> Array:
    """Covariance in bound-scaled coordinates, widened by the misfit and what nuisances took."""
    inflation = 1.0 + max(residual.slow.excess, 0.0) / residual.slow.dimensions
    gram = sensitivities.white.T @ sensitivities.white
    covariance = np.linalg.inv(gram + np.eye(gram.shape[0])) * inflation
    return np.asarray(covariance + np.diag(moved**2))


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
    for item, u, deviation in zip(effect.parameters, theta_unit, deviations, strict=True):
        value = item.from_unit(float(u))
        std = float(deviation) * item.slope(float(u))
        if item is effect.size:
            std = float(np.hypot(std, effect.form * (value - effect.neutral)))
        estimates[item.name] = Estimate(value, std, item.unit)
    for key, value in effect.variants[variant].items():
        estimates[key] = Estimate(float(value), 0.0, '')
    return estimates


def _predictions(
    system: System, runs: Sequence[Run], before: Fit, after: Fit
) -> tuple[RunPrediction, ...]:
    answers = []
    for run in runs:
        both = system.predict_many(run, [before.point, after.point])
        answers.append(RunPrediction(run, both[0], both[1]))
    return tuple(answers)
