"""The conclusion: the verdict on the selected model, and the published numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from saddlering_ros.discrepancy.candidate import Fit
from saddlering_ros.discrepancy.consistency import consistency_tests
from saddlering_ros.discrepancy.criteria import (
    alternative_floor,
    crowded,
    real_and_material,
    too_many,
)
from saddlering_ros.discrepancy.gain import (
    fitted_gain,
    Gain,
    held_out_gain,
    left_out_gain,
    plain_fits,
)
from saddlering_ros.discrepancy.lack_of_fit import ShapeTest
from saddlering_ros.discrepancy.metric import Metric
from saddlering_ros.discrepancy.model_space import AT_BOUND, ModelSpace, refit_full_jacobian
from saddlering_ros.discrepancy.nuisances import offset_columns
from saddlering_ros.discrepancy.refit import PRIOR, Tangent
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
from saddlering_ros.discrepancy.system import Array, Effect, Parameter, RunBlocks, System
from saddlering_ros.estimation.least_squares import covariance
from saddlering_ros.quantities import percent, quantity


@dataclass(frozen=True)
class Judgement:
    """The verdict on the selected model, with warnings for the reader."""

    verdict: Verdict
    explained: float
    warnings: tuple[str, ...]


def residual_of(space: ModelSpace, fit: Fit) -> Residual:
    """The residual of a fit; with consistency tests if laws are assumed to be exact."""
    sensitivities, slow = space.tangent_of(fit), space.slow_residual(fit)
    shapes = space.tests.shapes(fit, sensitivities.white)
    consistency: list[ShapeTest] = []
    if space.metric.experiment.assumptions.form_error == 0.0:
        consistency = consistency_tests(
            space.metric, fit, sensitivities, slow, space.known.max_pairs)
    return Residual(slow, space.tests.fast(fit), tuple(shapes), tuple(consistency))


def judge(
    space: ModelSpace,
    fit: Fit,
    alternatives: Alternatives,
    before: Residual,
    after: Residual,
) -> Judgement:
    """The verdict: whether the causes have alternatives, and whether they explain the misfit."""
    settings = space.settings
    share = explained_share_of(before, after) if fit.candidate.effects else 0.0
    left = _is_left(space, after)
    warnings: list[str] = []
    verdict: Verdict = 'none'
    if fit.candidate.effects:
        open_members = [name for name in fit.candidate.ids if alternatives.get(name)]
        doubts = _doubts(space, fit, after, share)
        if open_members and too_many(len(fit.candidate.effects)):
            doubts.append(_too_many_words(len(fit.candidate.effects), open_members))
        verdict = 'unknown' if doubts else 'ambiguous' if open_members else 'named'
        warnings += doubts
        if real_and_material(after.slow, settings) and not doubts:
            warnings.append(
                f'{100 * (1 - share):.0f} % of the misfit remains with the extension, most of it '
                f'in {after.slow.where}: the law of the cause has another form, which explains it'
            )
    elif left:
        verdict = 'unknown'
    if real_and_material(after.fast, settings):
        fast = after.fast
        warnings.append(
            f'{fast.view} oscillates at about {quantity(fast.frequency, "Hz", digits=2)} in '
            f'{fast.run} ({percent(fast.visible)} of range), which no cause explains'
        )
    return Judgement(verdict, share, tuple(warnings))


def _too_many_words(effects: int, open_members: Sequence[str]) -> str:
    return (
        f'{effects} effects were needed, and other effects can replace '
        f'{" and ".join(open_members)}: so many models can fit any misfit, and none of them is '
        'certain'
    )


def _is_left(space: ModelSpace, after: Residual) -> bool:
    """Whether a real and material residual remains, in all or in one channel of one run."""
    settings = space.settings
    if real_and_material(after.slow, settings) or real_and_material(after.fast, settings):
        return True
    return bool(_unexplained(space, after))


def _unexplained(space: ModelSpace, after: Residual) -> list[str]:
    """Channels and runs whose residual exceeds the noise and the declared model error."""
    experiment = space.metric.experiment
    if experiment.assumptions.form_error > 0.0:
        return []  # Judged in each view, against the form error of the effects.
    found = [
        f'{channel} in {run}'
        for (channel, run), chance in after.slow.chances.items()
        if chance < space.settings.error_rate
        and after.slow.sizes[channel][_number(experiment.runs, run)] >= space.settings.materiality
    ]
    found += [
        f'{item.view} along {item.coordinate}'
        for item in (*after.consistency, *after.shapes)
        if item.p_value < space.settings.error_rate and item.visible >= space.settings.materiality
    ]
    return found


def _number(runs: Sequence[RunBlocks], name: str) -> int:
    return next(number for number, run in enumerate(runs) if run.name == name)


def _doubts(space: ModelSpace, fit: Fit, after: Residual, share: float) -> list[str]:
    """Reasons why real causes are not named, one sentence each."""
    settings, assumptions = space.settings, space.metric.experiment.assumptions
    doubts = []
    if _is_left(space, after):
        where = ', '.join(_unexplained(space, after)) or after.slow.where or after.fast.view
        is_exact = assumptions.form_error == 0.0
        if share < settings.min_total or is_exact or _exceeds_forms(space, fit):
            doubts.append(
                f'{100 * (1 - share):.0f} % of the misfit remains, which is more than noise and '
                f'model error in {where}: {" and ".join(fit.candidate.ids)} can only be a part '
                'of the cause'
            )
    members = [space.explained(space.without(fit, name), fit) for name in fit.candidate.ids]
    if crowded(members, settings):
        doubts.append(
            f'{len(fit.candidate.effects)} effects were needed for one channel: so many effects '
            'can fit any misfit, and none of them is certain'
        )
    return [*doubts, *_shapes_at_bounds(space, fit)]


def _exceeds_forms(space: ModelSpace, fit: Fit) -> bool:
    """Whether more remains than any form of the laws of a fit explains."""
    remaining = space.tests.slow(space.with_forms(fit, fit))
    return real_and_material(remaining, space.settings)


def _shapes_at_bounds(space: ModelSpace, fit: Fit) -> list[str]:
    """A sentence for every shape of a cause that is stopped by its bound.

    A shape is stopped if the misfit beyond the bound would fall by more than noise and the
    form error of the effect explain. A shape at its neutral value or at its start is not
    stopped.
    """
    experiment, settings = space.metric.experiment, space.settings
    white = space.tangent_of(fit).white
    variances = np.diag(covariance(white, PRIOR))
    slopes = white.T @ fit.whitened
    floor = alternative_floor(space.known.pairs, settings)
    taken = max(space.base.misfit - fit.misfit, 0.0)
    sentences = []
    for effect, _, part in fit.candidate.slices(len(experiment.system.base_parameters)):
        shapes = zip(
            effect.ordered, fit.theta_unit[part], slopes[part], variances[part], strict=True
        )
        for item, theta_unit, slope, variance in list(shapes)[1:]:
            outward = slope if theta_unit < 0.5 else -slope
            beyond = max(float(outward), 0.0) ** 2 * variance
            allowed = max(floor, experiment.assumptions.form_error * taken)
            if beyond > allowed and _is_at_bound(item, float(theta_unit)):
                sentences.append(
                    f'{effect.id}: its {item.name} is at the bound of '
                    f'{quantity(item.from_unit(float(theta_unit)), item.unit)}: the cause has '
                    'another shape than the bounds allow, so that it is not named'
                )
    return sentences


def _is_at_bound(shape: Parameter, theta_unit: float) -> bool:
    """Whether a shape is at a bound that is neither its neutral value nor its start."""
    if shape.periodic or min(theta_unit, 1.0 - theta_unit) >= AT_BOUND:
        return False
    bound = shape.high if theta_unit > 0.5 else shape.low
    return bound not in (shape.neutral, shape.start)


def explained_share_of(before: Residual, after: Residual) -> float:
    """Share of the misfit beyond noise that is explained, 0 to 1.

    A small cause can be certain although all structures together are no more than noise.
    """
    remaining = max(after.slow.excess, 0.0) + after.fast.excess
    found = max(before.slow.excess, 0.0) + before.fast.excess
    return 1.0 - min(1.0, remaining / max(found, 1e-9))


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
        self.metric: Metric = space.metric.marginalise(offset_columns(experiment))
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
