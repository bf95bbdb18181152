"""Models fitted in one metric; each fit is stored under its candidate and compared in pairs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from saddlering_ros.discrepancy import criteria
from saddlering_ros.discrepancy.candidate import Candidate, Fit, Key
from saddlering_ros.discrepancy.change_scale import ChangeScale, visible_falls
from saddlering_ros.discrepancy.lack_of_fit import FastResidual, LackOfFitTests, SlowResidual
from saddlering_ros.discrepancy.law_forms import form_columns
from saddlering_ros.discrepancy.metric import Metric
from saddlering_ros.discrepancy.ranking import rank, Score
from saddlering_ros.discrepancy.refit import (
    Asking,
    declared_start,
    refit,
    run_refits,
    Tangent,
    tangent,
)
from saddlering_ros.discrepancy.results import Evidence
from saddlering_ros.discrepancy.settings import Settings
from saddlering_ros.discrepancy.signatures import Signature, testable
from saddlering_ros.discrepancy.system import Array
from saddlering_ros.progress import Watch

COARSE_ROUNDS = 4
"""Rounds of a refit from each of several starts, before the best one is refined."""

FULL_JACOBIANS = 2
"""Number of the best refits of a step that are repeated with a full Jacobian."""

AT_BOUND = 1e-3
"""Distance from a bound, as a share of the range, within which a parameter is at the bound."""

INFLATION = 4.0
"""Factor by which nuisance parameters are inflated to compare them with an effect."""

FREE_SPREAD = 10.0
"""Spread, in shares of the range, of a parameter that counts as free."""


Trial = tuple[Score, Sequence[Array]]
"""A candidate and its starts."""


@dataclass(frozen=True)
class NoiseKnowledge:
    """Numbers of independent differences that the noise is known from: poorest and richest run."""

    pairs: int
    max_pairs: int


class ModelSpace:
    """Every model fitted in one metric. A new metric has a new space."""

    def __init__(
        self,
        *,
        metric: Metric,
        base: Fit,
        base_tangent: Tangent,
        signatures: Sequence[Signature],
        scale: ChangeScale,
        trials: int,
        known: NoiseKnowledge,
        settings: Settings,
        watch: Watch,
    ) -> None:
        self.metric, self.base, self.signatures, self.scale = metric, base, signatures, scale
        self.trials, self.known, self.settings, self.watch = trials, known, settings, watch
        self.usable = testable(signatures)
        self.tests = LackOfFitTests(metric, known.max_pairs)
        self.log_size = float(np.log(metric.free_count))
        self._fits: dict[Key, Fit] = {}
        self._tangents = {base.candidate.key: (base, base_tangent)}
        self._slow: dict[Key, tuple[Fit, SlowResidual]] = {}
        self._inflated: dict[Key, tuple[Fit, float]] = {}
        self._forms: dict[Key, tuple[Fit, Array, Array]] = {}

    # ---- fits

    def keep(self, fit: Fit) -> Fit:
        """Store a fit under its candidate."""
        self._fits[fit.candidate.key] = fit
        return fit

    def is_fitted(self, candidate: Candidate) -> bool:
        """Whether the candidate has a fit already."""
        return candidate.key in self._fits

    def fit_of(self, candidate: Candidate) -> Fit:
        """The fit of a candidate that is fitted."""
        return self._fits[candidate.key]

    def single_effect_fits(self) -> list[Fit]:
        """Fits of one effect beside the base."""
        return [fit for fit in self._fits.values() if len(fit.candidate.effects) == 1]

    def tangent_of(self, fit: Fit) -> Tangent:
        """All sensitivities of a fit, computed once."""
        known = self._tangents.get(fit.candidate.key)
        if known is None or known[0] is not fit:
            known = self._tangents[fit.candidate.key] = fit, tangent(self.metric, fit)
        return known[1]

    def slow_residual(self, fit: Fit) -> SlowResidual:
        """The slow structure of the residual of a fit."""
        known = self._slow.get(fit.candidate.key)
        if known is None or known[0] is not fit:
            known = self._slow[fit.candidate.key] = fit, self.tests.slow(fit)
        return known[1]

    def fast_residual(self, fit: Fit) -> FastResidual:
        """The structure of the residual of a fit that is too fast for `slow_residual`."""
        return self.tests.fast(fit)

    def scores(self, fit: Fit, skip: Sequence[str] = ()) -> list[Score]:
        """First-order gains beside `fit` of all testable effects that are not in it."""
        skipped = [*fit.candidate.ids, *skip]
        return rank(fit, self.tangent_of(fit).white, self.usable, skipped)

    @property
    def real_gain(self) -> float:
        """Fall of the misfit at which an effect with one parameter is real."""
        return criteria.real_gain(self.known.pairs, self.trials, self.settings)

    def penalised(self, fit: Fit) -> float:
        """Misfit plus the penalty of its parameters (BIC)."""
        return fit.misfit + fit.theta_unit.size * self.log_size

    def fit_best(self, fit: Fit, scores: Sequence[Score]) -> list[Fit]:
        """The model of `fit` plus each scored candidate by coarse fits; the best is refined."""
        coarse = sorted(self.coarse_fit(fit, starts_of_each(scores)), key=self.penalised)
        found = self.refine(coarse[: self.settings.refits])
        return sorted((self.keep(item) for item in found), key=self.penalised)

    def continued(self, fits: Sequence[Fit], rounds: int) -> list[Fit]:
        """The same fits after further rounds."""
        count = len(self.metric.experiment.system.base_parameters)
        return self._run([
            refit(self.metric, item.candidate, item.theta_unit, item.jacobian[:, :count],
                  rounds=rounds, known_start=item)
            for item in fits
        ])

    def foreseen(self, fit: Fit) -> float:
        """Penalised misfit that the slopes of an unfinished fit lead to."""
        slope = fit.jacobian.T @ fit.whitened
        gram = fit.jacobian.T @ fit.jacobian + np.eye(slope.size)
        return self.penalised(fit) - float(slope @ np.linalg.solve(gram, slope))

    def coarse_fit(self, fit: Fit, trials: Sequence[Trial]) -> list[Fit]:
        """The model of `fit` plus each candidate after a few rounds from its best start."""
        return best_of_each(self.started(fit, trials, COARSE_ROUNDS))

    def started(self, fit: Fit, trials: Sequence[Trial], rounds: int) -> list[Fit]:
        """The model of `fit` plus each candidate after so many rounds, from each of its starts."""
        base = self.metric.experiment.system.base_parameters
        stopped = self.stopped_base(fit)
        freed = fit.theta_unit.copy()
        freed[: len(base)][stopped] = declared_start(base)[stopped]
        columns = self.tangent_of(fit).white[:, : len(base)] if trials else None
        wanted: list[Asking] = []
        for score, starts in trials:
            candidate = fit.candidate.plus(score.effect, score.variant)
            wanted += [
                refit(
                    self.metric,
                    candidate,
                    np.concatenate([fit.theta_unit, start]),
                    columns,
                    rounds=rounds,
                    fresh_base=score.amplitude_dependent,
                )
                for start in starts
            ]
            if stopped.any():
                wanted += [
                    refit(
                        self.metric,
                        candidate,
                        np.concatenate([freed, start]),
                        rounds=rounds,
                        full_jacobian=True,
                    )
                    for start in starts
                ]
        return [found for found in self._run(wanted) if np.isfinite(found.misfit)]

    def stopped_base(self, fit: Fit) -> Array:
        """Mask (B,) of base parameters at a bound, which may imitate an effect.

        The way from there to the place where the effect shows can be long.
        """
        theta_unit = fit.theta_unit[: len(self.metric.experiment.system.base_parameters)]
        return np.asarray(np.minimum(theta_unit, 1.0 - theta_unit) < AT_BOUND)

    def refine(self, fits: Sequence[Fit]) -> list[Fit]:
        """The same fits completed, the best of them with a full Jacobian."""
        refined = self.continued(fits, self.settings.rounds)
        order = sorted(range(len(refined)), key=lambda item: self.penalised(refined[item]))
        best = order[:FULL_JACOBIANS]
        refitted_fully = self.refit_full_jacobian([refined[item] for item in best])
        for number, fit in zip(best, refitted_fully, strict=True):
            refined[number] = fit
        return refined

    def refit_full_jacobian(self, fits: Sequence[Fit]) -> list[Fit]:
        """The same fits continued, with every sensitivity differenced at every step."""
        return refit_full_jacobian(self.metric, fits, self.settings.rounds, self.watch)

    def without(self, fit: Fit, effect_id: str) -> Fit:
        """The model without one effect, refitted."""
        candidate = fit.candidate.without(effect_id)
        if not candidate.effects:
            return self.base
        if not self.is_fitted(candidate):
            count = len(self.metric.experiment.system.base_parameters)
            kept = [fit.theta_unit[:count]]
            kept += [
                fit.theta_unit[part]
                for effect, _, part in fit.candidate.slices(count)
                if effect.id != effect_id
            ]
            columns = self.tangent_of(self.base).white
            start = np.concatenate(kept)
            self.keep(
                self._run(
                    [refit(self.metric, candidate, start, columns, rounds=self.settings.rounds)]
                )[0]
            )
        return self._fits[candidate.key]

    def _run(self, refits: Sequence[Asking]) -> list[Fit]:
        return run_refits(self.metric, refits, self.watch.check)

    # ---- comparison

    def compare(self, less: Fit, more: Fit) -> Comparison:
        """What `more` explains beside `less`."""
        return Comparison(self, less, more)

    def misfit_with_inflated_nuisances(self, fit: Fit) -> float:
        """Misfit of `fit` if every nuisance parameter had `INFLATION` times its usual size."""
        if not fit.candidate.effects:
            return fit.misfit
        known = self._inflated.get(fit.candidate.key)
        if known is None or known[0] is not fit:
            residual = fit.prediction - self.metric.experiment.measured
            columns = self.metric.inflated(INFLATION, FREE_SPREAD * self.tangent_of(fit).plain)
            misfit = self._misfit_beside(residual, columns)
            known = self._inflated[fit.candidate.key] = fit, misfit
        return known[1]

    def with_forms(self, fit: Fit, about: Fit) -> Fit:
        """`fit` with the most likely forms of the laws in `about`, and its parameters beside them.

        The prediction is that of the simulator to first order. The misfit counts the forms and
        the moved parameters by their prior spreads.
        """
        known = self._forms.get(about.candidate.key)
        if known is None or known[0] is not about:
            forms = form_columns(self.metric.experiment, about, self.settings.form_error)
            known = self._forms[about.candidate.key] = about, forms, self.metric.whiten(forms)
        tangents = self.tangent_of(fit)
        plain = np.hstack([FREE_SPREAD * tangents.plain, known[1]])
        white = np.hstack([FREE_SPREAD * tangents.white, known[2]])
        gram = np.eye(white.shape[1]) + white.T @ white
        steps = -np.linalg.solve(gram, white.T @ fit.whitened)
        whitened = fit.whitened + white @ steps
        return replace(
            fit, prediction=fit.prediction + plain @ steps, whitened=whitened,
            misfit=float(whitened @ whitened + steps @ steps))

    def _misfit_beside(self, residual: Array, columns: Array) -> float:
        """Misfit of a plain residual minus the part of whitened columns with unit spread."""
        white = self.metric.whiten_noise(residual)
        inner = columns.T @ white
        gram = np.eye(inner.size) + columns.T @ columns
        return float(white @ white - inner @ np.linalg.solve(gram, inner))

    def explained(self, less: Fit, more: Fit) -> criteria.Sizes:
        """Rms share of range that `more` explains beside `less`, per view one number per run.

        It is at most the size of its change. If the residual is large, a small shift of
        base parameters reduces it as much as an effect would.
        """
        falls = visible_falls(self.metric, less.prediction, more.prediction)
        changes = self.scale.by_run(more.prediction - less.prediction)
        return {view: np.minimum(fall, changes[view]) for view, fall in falls.items()}


@dataclass(frozen=True)
class Comparison:
    """Two fits of one space, of which `more` has further effects, compared by the criteria."""

    space: ModelSpace
    less: Fit
    more: Fit

    @property
    def gain(self) -> float:
        """Fall of the misfit."""
        return self.less.misfit - self.more.misfit

    @cached_property
    def p_value(self) -> float:
        """p-value of the likelihood ratio test, with all shapes of the candidate counted."""
        known = self.space.known
        return criteria.likelihood_ratio_test(
            self.gain, self._extra, known.pairs, self.space.trials
        )

    @cached_property
    def visible(self) -> float:
        """Largest rms of the change that base parameters cannot imitate, as a share of range."""
        return self.space.scale.beyond_base(self.more.prediction - self.less.prediction)

    @property
    def is_real(self) -> bool:
        return self.p_value < self.space.settings.error_rate

    @property
    def is_material(self) -> bool:
        return self.visible >= self.space.settings.materiality

    @cached_property
    def added(self) -> criteria.Sizes:
        """What `more` explains beside `less`."""
        return self.space.explained(self.less, self.more)

    @cached_property
    def known(self) -> criteria.Sizes:
        """Size that `less` explains beside the base."""
        return self.space.explained(self.space.base, self.less)

    @property
    def closes_misfit(self) -> bool:
        """Whether the cause is certain and explains almost all of the misfit."""
        space = self.space
        left = max(space.slow_residual(self.more).excess, 0.0)
        inflated = self.less.misfit - space.misfit_with_inflated_nuisances(self.less)
        return criteria.closes_misfit(self.p_value, self.gain, left, inflated, space.settings)

    @property
    def exceeds_form_error(self) -> bool:
        """Whether the cause exceeds the form error of the effects in `less`."""
        if not self.less.candidate.effects:
            return True
        settings = self.space.settings
        return bool(
            criteria.exceeds_form_error(
                self.added, self.known, settings.form_error, settings.materiality
            )
        )

    @cached_property
    def with_forms(self) -> tuple[Fit, Fit]:
        """Both fits with the most likely forms of the laws in `less`."""
        return self.space.with_forms(self.less, self.less), self.space.with_forms(
            self.more, self.less)

    @cached_property
    def exceeds_forms(self) -> bool:
        """Whether the cause explains most of the residual, and other forms of the laws cannot."""
        space = self.space
        if not self.less.candidate.effects or not self.is_real:
            return False
        less, more = self.with_forms
        gain = less.misfit - more.misfit
        p_value = criteria.likelihood_ratio_test(
            gain, self._extra, space.known.pairs, space.trials)
        left = max(space.tests.slow(more).excess, 0.0)
        return criteria.exceeds_forms(p_value, gain, self.gain, left, space.settings)

    @property
    def is_cause_of_its_own(self) -> bool:
        """Whether the cause differs from those in `less`, for any form of their laws."""
        return self.exceeds_form_error or self.exceeds_forms

    @property
    def adds_new_channel(self) -> bool:
        """Whether the cause shows in a view in which no effect of `less` shows."""
        if self.p_value >= self.space.settings.error_rate**2:
            return False
        return criteria.adds_new_channel(self.p_value, self.added, self.known, self.space.settings)

    def evidence(self, step: int = 0) -> Evidence:
        """The likelihood ratio test as a line of the table in the report."""
        more = self.more
        return Evidence(
            step=step,
            effects=more.candidate.ids,
            variants=tuple(variant for _, variant in more.candidate.effects),
            misfit=more.misfit,
            delta_bic=self.gain - self._extra * self.space.log_size,
            p_value=self.p_value,
            visible=self.visible,
            values=more.point.effects,
        )

    @property
    def _extra(self) -> int:
        return max(1, self.more.theta_unit.size - self.less.theta_unit.size)


def refit_full_jacobian(
    metric: Metric, fits: Sequence[Fit], rounds: int, watch: Watch
) -> list[Fit]:
    """Fits continued in a metric, with every sensitivity differenced at every step."""
    wanted = [
        refit(metric, fit.candidate, fit.theta_unit, rounds=rounds, full_jacobian=True)
        for fit in fits
    ]
    return run_refits(metric, wanted, watch.check)


def best_of_each(fits: Sequence[Fit]) -> list[Fit]:
    """The best fit of each candidate, in their order."""
    best: dict[Key, Fit] = {}
    for found in fits:
        key = found.candidate.key
        if key not in best or found.misfit < best[key].misfit:
            best[key] = found
    return list(best.values())


def starts_of_each(scores: Sequence[Score]) -> list[Trial]:
    """All starts of each candidate; of the first two a smaller size too."""
    return [
        (score, _starts_of(score, tries_smaller=number < 2)) for number, score in enumerate(scores)
    ]


def _starts_of(score: Score, tries_smaller: bool) -> list[Array]:
    """Starts of a candidate: those of other shapes, or a smaller size of the same shape."""
    starts = [score.start, *score.others]
    if tries_smaller and not score.others:
        size = score.effect.size
        second = score.start.copy()
        second[0] = size.to_unit(0.4 * size.from_unit(float(second[0])))
        starts.append(second)
    return starts
