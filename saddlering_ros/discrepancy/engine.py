"""The diagnosis itself, step by step: fit, noise, screen, refit, gate, doubt, gain.

Of any simulator that follows `System` it says where measurement and simulation part, which cause
explains it, what it cannot tell apart, and what is left that no known cause explains.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
import time as clock
from typing import Literal

import numpy as np
from scipy.stats import f as fisher

from saddlering_ros.discrepancy.gain import fitted_gain, Gain, held_out_gain, left_out_gain
from saddlering_ros.discrepancy.lack_of_fit import Battery, Ripple, ShapeTest, Structure
from saddlering_ros.discrepancy.likelihood import (
    Allowance,
    allowance_columns,
    build_likelihood,
    disturbance_columns,
    instant_columns,
    Likelihood,
    offset_columns,
    view_ranges,
)
from saddlering_ros.discrepancy.lines import find_line, line_gain
from saddlering_ros.discrepancy.next_test import choose_next, Proposal
from saddlering_ros.discrepancy.refit import (
    Candidate,
    declared_place,
    Fit,
    fit_base,
    refit,
    run_refits,
    Tangent,
    tangent,
)
from saddlering_ros.discrepancy.screen import (
    angle_matrix,
    best_of_each,
    Detectability,
    detectability,
    measure_signatures,
    PlainScale,
    rank,
    Score,
    shapes_tried,
    Signature,
    testable,
    visible_gains,
    whitened_anew,
)
from saddlering_ros.discrepancy.system import (
    Array,
    DiscrepancyError,
    Effect,
    Parameter,
    Run,
    System,
)
from saddlering_ros.errors import Cancelled
from saddlering_ros.threads import one_blas_thread

LEAST_PAIRS = 12
"""However short the stretches at rest, their many samples tell the level this well."""

SCOUTING = 4
"""Rounds of a refit from each of several starts, before the best goes on alone."""

BASE_ROUNDS = 25
"""Rounds of the fit of the base parameters alone, on which everything rests."""

POLISHED = 2
"""So many of the best refits of a step are carried on with every sensitivity taken afresh."""

ALIKE = 1e-4
"""Variants of one effect whose promises are this close are one in these data."""

MOST_IN_ONE_VIEW = 2
"""More effects than this in one view are a fit, not an explanation."""

GROWN = 4.0
"""Small unknowns so many times their usual size are a form of the effect, not another effect."""

AT_BOUND = 1e-3
"""A size this close to a bound, as a share of its range, was stopped by it."""

WIDE = 10.0
"""Spread that leaves a parameter free, in shares of its range."""

MOST_SILENT = 2
"""Immaterial effects kept in the model at most while others are looked for."""

Verdict = Literal['none', 'named', 'ambiguous', 'unknown']


@dataclass(frozen=True)
class Settings:
    """How strict to be. The figures were chosen beforehand; blind trials check, not set, them.

    error_rate: chance of any false cause on clean data; materiality: share of a view's range under
    which a finding is listed only; most: causes at most; refits: candidates refitted at each step;
    least_partial: share of the remaining misfit that a member of a model must explain, in all or
    in one view;
    least_total: share of the misfit that the whole model must explain to be named;
    rival_rate: chance that noise alone makes a rival fit as much worse as those left out of a
    group do; rival_share: a rival stays in the group while its misfit is within this share of
    what is left; form_error: share of the misfit an effect explains by which its idealised form
    may err: rivals as close as that stay in its group, and a further cause smaller than that in
    the same view is no cause.
    """

    error_rate: float = 0.01
    materiality: float = 1e-3
    most: int = 3
    refits: int = 6
    least_partial: float = 0.5
    least_total: float = 0.85
    rival_rate: float = 1e-4
    rival_share: float = 0.33
    form_error: float = 0.1
    allowance: Allowance = field(default_factory=Allowance)
    seed: int = 0


@dataclass(frozen=True)
class Estimate:
    """A fitted number with its standard deviation."""

    value: float
    std: float
    unit: str


@dataclass(frozen=True)
class Cause:
    """One cause found: what it is, what it cannot be told from, how sure, what it is worth."""

    effect: Effect
    variant: int
    group: tuple[str, ...]
    estimates: Mapping[str, Estimate]
    p_value: float
    delta_bic: float
    visible: float
    gain: Gain


@dataclass(frozen=True)
class Evidence:
    """One candidate as it was refitted: for the report's table."""

    step: int
    effects: tuple[str, ...]
    variants: tuple[int, ...]
    misfit: float
    delta_bic: float
    p_value: float
    visible: float
    values: Mapping[str, Mapping[str, float]]


@dataclass(frozen=True)
class RunResidual:
    """Predictions for one run, (C, N) each, offsets not taken out."""

    run: Run
    before: Array
    after: Array


@dataclass(frozen=True)
class Diagnosis:
    """Everything found, as numbers and arrays, for console, JSON and report alike."""

    verdict: Verdict
    causes: tuple[Cause, ...]
    base_before: Mapping[str, Estimate]
    base_after: Mapping[str, Estimate]
    base_covariance: Array
    before: Fit
    after: Fit
    runs: tuple[RunResidual, ...]
    structure_before: Structure
    structure_after: Structure
    ripple_after: Ripple
    shapes_before: tuple[ShapeTest, ...]
    shapes_after: tuple[ShapeTest, ...]
    detectability: tuple[Detectability, ...]
    angle_labels: tuple[str, ...]
    angles: Array
    evidence: tuple[Evidence, ...]
    immaterial: tuple[Evidence, ...]
    explained: float
    next_test: str | None
    notes: tuple[str, ...]
    likelihood: Likelihood
    ranges: Mapping[str, float]
    total_gain: Gain
    simulations: int
    seconds: float


Progress = Callable[[str, float], None]


class _Session:
    """One diagnosis under way: the likelihood and everything computed once."""

    def __init__(
        self,
        system: System,
        runs: Sequence[Run],
        settings: Settings,
        start: Array | None,
        progress: Progress,
        check: Callable[[], None],
    ) -> None:
        self.settings, self.check, self.progress = settings, check, progress
        self.runs = [run for run in runs if not run.held_out]
        if not self.runs:
            raise DiscrepancyError('diagnose: every run is held out; leave at least one to fit')
        self.system = system
        progress('noise', 0.0)
        self.likelihood = build_likelihood(system, self.runs)
        self.ranges = view_ranges(system, self.runs)
        progress('base', 0.05)
        rough = fit_base(self.likelihood, start, settings.seed, check)
        self.likelihood.relearn(rough.prediction)
        # The level of slow noise is as sure as the run that saw most of it makes it.
        known = [item.pairs for item in self.likelihood.noise.values()]
        self.pairs = max(LEAST_PAIRS, min(known))
        self.most_pairs = max(LEAST_PAIRS, max(known))
        self.allow_for_unknowns(rough)
        # A large misfit makes several valleys, and the metric has changed: start from both sides.
        starts = [rough.place, declared_place(system.base_parameters)]
        fits = run_refits(
            self.likelihood,
            [
                refit(self.likelihood, Candidate(), place, rounds=BASE_ROUNDS, full=True)
                for place in starts
            ],
            check,
        )
        self.base = min(fits, key=lambda fit: fit.misfit)
        self.base_tangent = tangent(self.likelihood, self.base)
        progress('screen', 0.25)
        check()
        self.scale = PlainScale(self.likelihood, self.ranges, self.base_tangent.plain)
        self.signatures: list[Signature] = measure_signatures(
            self.likelihood, self.base, self.base_tangent, self.scale
        )
        self.usable = testable(self.signatures)
        lines = sum(bool(effect.line) for effect in system.effects)
        self.trials = max(1, shapes_tried(self.signatures) + lines)
        self.battery = Battery(self.likelihood, self.ranges, self.most_pairs)
        self.cache: dict[tuple[tuple[str, int], ...], Fit] = {}
        self.evidence: list[Evidence] = []
        self.immaterial: list[Evidence] = []
        self.tangents: dict[int, Tangent] = {id(self.base): self.base_tangent}
        self.grown: dict[int, float] = {}

    # ---- the metric

    def allow_for_unknowns(self, fit: Fit) -> None:
        """The metric with every small unknown in it, as it shows at `fit`."""
        likelihood, allowance = self.likelihood, self.settings.allowance
        likelihood.free_of(
            np.hstack(
                [
                    offset_columns(likelihood),
                    allowance_columns(likelihood, allowance),
                    instant_columns(likelihood, allowance, fit.prediction),
                    disturbance_columns(likelihood, fit.point),
                ]
            )
        )

    def move_to(self, fit: Fit) -> Fit:
        """Small unknowns as they show with the effects found, and everything fitted anew.

        A load that is wrong by some percent moves the place where rollers begin to touch, and
        with it what unequal rollers do: seen from the model without it, that is evidence.
        """
        likelihood = self.likelihood
        self.allow_for_unknowns(fit)
        self.cache.clear()
        self.tangents.clear()
        self.grown.clear()
        self.base, fit = self.polished([self.base, fit])
        self.base_tangent = self.tangent_of(self.base)
        self.signatures = whitened_anew(likelihood, self.signatures, self.base_tangent)
        self.usable = testable(self.signatures)
        self.battery = Battery(likelihood, self.ranges, self.most_pairs)
        self.cache[_key(fit.candidate)] = fit
        return fit

    # ---- models

    def tangent_of(self, fit: Fit) -> Tangent:
        if id(fit) not in self.tangents:
            self.tangents[id(fit)] = tangent(self.likelihood, fit)
        return self.tangents[id(fit)]

    def scores(self, fit: Fit, skip: Sequence[str] = ()) -> list[Score]:
        return rank(fit, self.tangent_of(fit).white, self.usable, [*fit.candidate.ids, *skip])

    def fit_with(self, fit: Fit, scores: Sequence[Score]) -> list[Fit]:
        """`fit`'s model plus each scored candidate, refitted side by side, the best first."""
        keys = [_key(fit.candidate.plus(score.effect, score.variant)) for score in scores]
        wanted = [score for key, score in zip(keys, scores, strict=True) if key not in self.cache]
        for found in self.carried_on(self.scouted(fit, wanted)):
            self.cache[_key(found.candidate)] = found
        return sorted((self.cache[key] for key in dict.fromkeys(keys)), key=self.penalised)

    def scouted(self, fit: Fit, scores: Sequence[Score]) -> list[Fit]:
        """`fit`'s model plus each scored candidate after a few rounds, from its best start."""
        count = len(self.system.base_parameters)
        stopped = self.stopped(fit)
        freed = fit.place.copy()
        freed[:count][stopped] = declared_place(self.system.base_parameters)[stopped]
        wanted = []
        for number, score in enumerate(scores):
            candidate = fit.candidate.plus(score.effect, score.variant)
            starts = [score.start, *score.others]
            if number < 2 and not score.others:
                second = score.start.copy()
                second[0] = score.effect.size.to_unit(
                    0.4 * score.effect.size.from_unit(float(second[0]))
                )
                starts.append(second)
            wanted += [
                refit(
                    self.likelihood,
                    candidate,
                    np.concatenate([fit.place, place]),
                    self.tangent_of(fit).white[:, :count],
                    rounds=SCOUTING,
                    afresh=score.bent,
                )
                for place in starts
            ]
            if stopped.any():
                wanted += [
                    refit(
                        self.likelihood,
                        candidate,
                        np.concatenate([freed, place]),
                        rounds=SCOUTING,
                        full=True,
                    )
                    for place in starts
                ]
        best: dict[tuple[tuple[str, int], ...], Fit] = {}
        for found in run_refits(self.likelihood, wanted, self.check):
            key = _key(found.candidate)
            if key not in best or found.misfit < best[key].misfit:
                best[key] = found
        return list(best.values())

    def stopped(self, fit: Fit) -> Array:
        """Which base parameters (B,) a bound stopped: they may have given way to an effect.

        From there the way back to where the effect would show can be long.
        """
        place = fit.place[: len(self.system.base_parameters)]
        return np.asarray(np.minimum(place, 1.0 - place) < AT_BOUND)

    def tried(self, current: Fit) -> list[Fit]:
        """`current`'s model plus the effects that promise most, refitted, the best first.

        Where a bound stopped base parameters promises are worth little, and every effect is tried.
        """
        scores = self.scores(current)
        shortlist = self.shortlist(scores, 4.0, self.settings.refits)
        if current.candidate.effects or not self.stopped(current).any():
            return self.fit_with(current, shortlist)
        listed = {score.effect.id for score in shortlist}
        others = [score for score in best_of_each(scores) if score.effect.id not in listed]
        return self.best_with(current, [*shortlist, *others])

    def best_with(self, fit: Fit, scores: Sequence[Score]) -> list[Fit]:
        """`fit`'s model plus each scored candidate, scouted; the best refitted and kept."""
        scouted = sorted(self.scouted(fit, scores), key=self.penalised)
        found = self.carried_on(scouted[: self.settings.refits])
        self.cache.update({_key(item.candidate): item for item in found})
        return sorted(found, key=self.penalised)

    def carried_on(self, fits: Sequence[Fit]) -> list[Fit]:
        """The same fits brought to their end, the best with every sensitivity taken afresh."""
        count = len(self.system.base_parameters)
        usual = run_refits(
            self.likelihood,
            [
                refit(self.likelihood, fit.candidate, fit.place, fit.jacobian[:, :count])
                for fit in fits
            ],
            self.check,
        )
        best = sorted(range(len(usual)), key=lambda item: self.penalised(usual[item]))[:POLISHED]
        for number, fit in zip(best, self.polished([usual[item] for item in best]), strict=True):
            usual[number] = fit
        return usual

    def polished(self, fits: Sequence[Fit]) -> list[Fit]:
        """The same fits carried on with every sensitivity taken afresh."""
        return run_refits(
            self.likelihood,
            [refit(self.likelihood, fit.candidate, fit.place, full=True) for fit in fits],
            self.check,
        )

    def penalised(self, fit: Fit) -> float:
        return fit.misfit + fit.place.size * self.log_size

    @property
    def rival_floor(self) -> float:
        """Misfit by which noise may set the better model back: more where its level is less sure.

        Of two models the wrong one is d ahead of the true one with a chance of at most that of a
        normal number beyond sqrt(d), however far apart the two are.
        """
        return float(fisher.isf(self.settings.rival_rate, 1, self.pairs))

    @property
    def log_size(self) -> float:
        return float(np.log(self.likelihood.free_count))

    def without(self, fit: Fit, effect_id: str) -> Fit:
        """The model less one effect, refitted."""
        candidate = fit.candidate.without(effect_id)
        if not candidate.effects:
            return self.base
        key = _key(candidate)
        if key not in self.cache:
            count = len(self.system.base_parameters)
            place = [fit.place[:count]]
            for effect, _, part in fit.candidate.slices(count):
                if effect.id != effect_id:
                    place.append(fit.place[part])
            self.cache[key] = run_refits(
                self.likelihood,
                [
                    refit(
                        self.likelihood,
                        candidate,
                        np.concatenate(place),
                        self.base_tangent.white,
                    )
                ],
                self.check,
            )[0]
        return self.cache[key]

    def weigh(self, fit: Fit, less: Fit, step: int) -> Evidence:
        """What the last effect of `fit` brings beside `less`."""
        extra = max(1, fit.place.size - less.place.size)
        gain = less.misfit - fit.misfit
        p_value = min(
            1.0, self.trials * float(fisher.sf(max(gain, 0.0) / extra, extra, self.pairs))
        )
        visible = self.visible(fit, less)
        return Evidence(
            step,
            fit.candidate.ids,
            tuple(variant for _, variant in fit.candidate.effects),
            fit.misfit,
            gain - extra * self.log_size,
            p_value,
            visible,
            fit.point.effects,
        )

    # ---- steps

    def shortlist(self, scores: Sequence[Score], least: float, count: int) -> list[Score]:
        """The best of the best `count` effects, two variants of each at most."""
        if not scores:
            return []
        chosen: list[Score] = []
        per_effect: dict[str, int] = {}
        promised: dict[str, float] = {}
        for score in scores:
            if score.gain < least or (
                len(per_effect) >= count and score.effect.id not in per_effect
            ):
                continue
            used = per_effect.get(score.effect.id, 0)
            if used >= 2 or (used and score.gain < 0.6 * scores[0].gain):
                continue
            if used and score.gain > (1.0 - ALIKE) * promised[score.effect.id]:
                continue
            promised[score.effect.id] = score.gain
            per_effect[score.effect.id] = used + 1
            chosen.append(score)
        return chosen

    def simpler(self, fit: Fit) -> Fit:
        """The one effect that fits better than the several of `fit` do, if there is any.

        Found one after the other, two can share between them what one did that was not on the
        first shortlist. So every effect is tried.
        """
        if len(fit.candidate.effects) < 2:
            return fit
        untried = [
            score
            for score in best_of_each(self.scores(self.base))
            if _key(Candidate().plus(score.effect, score.variant)) not in self.cache
        ]
        found = self.best_with(self.base, untried)
        self.evidence += [self.weigh(item, self.base, 1) for item in found]
        alone = [item for item in self.cache.values() if len(item.candidate.effects) == 1]
        return min([fit, *alone], key=self.penalised)

    def forward(self, current: Fit) -> Fit:
        """Effects one after another while the next is real, material, and something is left.

        What is real but immaterial stays in the model while the search goes on, or a worse name
        would be found for it, and is left out of the answer.
        """
        silent: list[str] = []
        for step in range(self.settings.most + MOST_SILENT):
            self.check()
            self.progress('name', 0.35 + 0.4 * step / (self.settings.most + MOST_SILENT))
            structure = self.battery.structure(current)
            weighed = [(self.weigh(fit, current, step + 1), fit) for fit in self.tried(current)]
            self.evidence += [evidence for evidence, _ in weighed]
            real = [pair for pair in weighed if pair[0].p_value < self.settings.error_rate]
            named = len(current.candidate.effects) - len(silent)
            left = not named or self.worth(structure)
            beyond = [
                (evidence, fit)
                for evidence, fit in real
                if self.finishes(evidence, fit, current)
                or (self.beyond_form(current, fit) if left else self.apart(evidence, fit, current))
            ]
            if not beyond or named == self.settings.most:
                self.immaterial += [evidence for evidence, _ in real[:3]]
                break
            evidence, best = beyond[0]
            if evidence.visible < self.settings.materiality:
                self.immaterial.append(evidence)
                if len(silent) == MOST_SILENT:
                    break
                silent.append(best.candidate.ids[-1])
            current = best
        for name in silent:
            current = self.without(current, name)
        return current

    def finishes(self, evidence: Evidence, fit: Fit, less: Fit) -> bool:
        """Whether what `fit` adds is beyond doubt and explains all but all that was left.

        What an inexact form leaves is no such thing: it takes more than one other effect, or
        looks like small unknowns grown large, as rollers do whose clearances differ.
        """
        gain = less.misfit - fit.misfit
        left = max(self.battery.structure(fit).excess, 0.0)
        sure = evidence.p_value < self.settings.error_rate**3
        if not sure or gain < self.settings.least_total * (gain + left):
            return False
        return gain * self.settings.least_partial > less.misfit - self.unsound(less)

    def unsound(self, fit: Fit) -> float:
        """Misfit of `fit` if every small unknown were `GROWN` times larger than usual."""
        if not fit.candidate.effects:
            return fit.misfit
        if id(fit) not in self.grown:
            residual = fit.prediction - self.likelihood.measured()
            columns = self.likelihood.grown(GROWN, WIDE * self.tangent_of(fit).plain)
            white = self.likelihood.whiten_plain(residual)
            inner = columns.T @ white
            gram = np.eye(inner.size) + columns.T @ columns
            self.grown[id(fit)] = float(white @ white - inner @ np.linalg.solve(gram, inner))
        return self.grown[id(fit)]

    def beyond_form(self, less: Fit, fit: Fit) -> bool:
        """Whether what `fit` adds is more than the inexact form of what `less` has could leave.

        Judged in every view of every run. A form leaves `form_error` of the misfit it explains
        where it acts, and by way of the base parameters, which give way to it, that share of this
        in the other runs; in a view where it has no part, what is immaterial.
        """
        if not less.candidate.effects:
            return True
        share = self.settings.form_error
        known = self.explained(self.base, less)
        return any(
            np.any(
                size
                > np.maximum(
                    np.sqrt(share * (known[view] ** 2 + share * known[view].max() ** 2)),
                    self.settings.materiality,
                )
            )
            for view, size in self.explained(less, fit).items()
        )

    def apart(self, evidence: Evidence, fit: Fit, less: Fit) -> bool:
        """Whether `fit` surely adds what shows in a view where nothing that `less` has shows.

        Surely (the error rate squared), for an inexact form can reach a little into a view in
        which the catalogue's has no part.
        """
        if evidence.p_value >= self.settings.error_rate**2:
            return False
        least = self.settings.materiality
        known = self.explained(self.base, less)
        return any(
            known[view].max() < least < size.max()
            for view, size in self.explained(less, fit).items()
        )

    def explained(self, less: Fit, more: Fit) -> dict[str, Array]:
        """Rms share of range that `more` explains beside `less`, per view one number per run.

        No more than what it changes: where much is left, a shift of base parameters that
        changes little makes the residual fall as much as an effect would.
        """
        falls = visible_gains(self.likelihood, less.prediction, more.prediction, self.ranges)
        changes = self.scale.by_run(more.prediction - less.prediction)
        return {view: np.minimum(fall, changes[view]) for view, fall in falls.items()}

    def material(self, fit: Fit, less: Fit) -> bool:
        """Whether what `fit` adds to `less` changes a view enough to matter."""
        return self.visible(fit, less) >= self.settings.materiality

    def visible(self, fit: Fit, less: Fit) -> float:
        """Largest rms of what `fit` adds to `less` and base parameters cannot imitate."""
        return self.scale.beyond_base(fit.prediction - less.prediction)

    def crowded(self, fit: Fit) -> bool:
        """Whether one view took more effects than can be told from a cause no one thought of."""
        crowd: Counter[str] = Counter()
        for name in fit.candidate.ids:
            less = self.without(fit, name)
            crowd.update(
                view
                for view, size in self.explained(less, fit).items()
                if size.max() >= self.settings.materiality
            )
        return max(crowd.values(), default=0) > MOST_IN_ONE_VIEW

    def worth(self, structure: Structure | Ripple) -> bool:
        """Whether what is left is both real and material."""
        return (
            structure.p_value < self.settings.error_rate
            and structure.visible >= self.settings.materiality
        )

    def prune(self, fit: Fit) -> Fit:
        """Drop members that explain too little of what is left without them.

        Judged in the view where a member explains most: what another's inexact form leaves in one
        channel is no reason to doubt a cause that shows in another.
        """
        while len(fit.candidate.effects) > 1:
            left = self.battery.structure(fit)
            partial: list[tuple[float, str, Evidence]] = []
            for name in fit.candidate.ids:
                less = self.without(fit, name)
                evidence = self.weigh(fit, less, 0)
                share = self.explained_share(self.battery.structure(less), left)
                if evidence.p_value >= self.settings.error_rate:
                    share = 0.0
                if evidence.visible < self.settings.materiality:
                    share = 0.0
                elif self.finishes(evidence, fit, less):
                    share = max(share, self.settings.least_partial)
                elif not self.beyond_form(less, fit):
                    share = 0.0
                partial.append((share, name, evidence))
            share, name, evidence = min(partial, key=lambda item: item[0])
            if share >= self.settings.least_partial:
                break
            if evidence.p_value < self.settings.error_rate:
                self.immaterial.append(evidence)
            fit = self.without(fit, name)
        return fit

    def explained_share(self, before: Structure, after: Structure) -> float:
        """Share of the misfit `before` that is gone `after`: in all, or in one material view."""
        shares = [1.0 - max(after.excess, 0.0) / max(before.excess, 1e-9)]
        shares += [
            1.0 - after.powers[view] / power
            for view, power in before.powers.items()
            if power >= self.settings.materiality**2
        ]
        return max(shares)

    def doubt(self, fit: Fit) -> tuple[Fit, dict[str, tuple[Fit, ...]]]:
        """Rivals of every member; a rival that fits better takes its place."""
        for _ in range(3):
            rivals: dict[str, tuple[Fit, ...]] = {}
            better: Fit | None = None
            for name in fit.candidate.ids:
                self.check()
                less = self.without(fit, name)
                scores = self.scores(less, [name])
                taken = less.misfit - fit.misfit
                shortlist = self.shortlist(scores, 0.1 * taken, self.settings.refits)
                fits = [
                    item
                    for item in self.fit_with(less, shortlist)
                    if name not in item.candidate.ids
                ]
                fits = [
                    item
                    for item in fits
                    if self.beyond_form(less, item)
                    or self.finishes(self.weigh(item, less, 0), item, less)
                ]
                rivals[name] = tuple(item for item in fits if self.indistinct(item, fit, taken))
                fits = [item for item in fits if self.material(item, less)]
                if fits and self.penalised(fits[0]) < self.penalised(fit) - 1.0:
                    better = (
                        fits[0] if better is None else min(better, fits[0], key=self.penalised)
                    )
            if better is None:
                break
            fit = self.prune(better)
        return fit, rivals

    def indistinct(self, rival: Fit, best: Fit, taken: float) -> bool:
        """Whether these data leave the rival open: misfit left over makes the judgement milder.

        So does the misfit `taken`, since no effect's form is exact; and a rival of fewer
        parameters is given that much for each, for it cannot bend to a form as the best could.
        """
        excess = max(self.battery.structure(best).excess, 0.0)
        distance = rival.misfit - best.misfit
        margin = self.rival_floor + self.settings.rival_share * min(excess, taken)
        stiffer = max(0, best.place.size - rival.place.size)
        return distance <= max(margin, self.settings.form_error * (1 + stiffer) * taken)

    def parameters_alone(self, fits: Sequence[Fit]) -> list[Fit]:
        """The same models fitted with no other freedom than the runs' offsets.

        Naming shares a misfit between parameters and nuisances; a parameter file has parameters
        only. What is published, predicted and measured as gain is therefore this fit. The metric
        stays without nuisances from here on.
        """
        self.likelihood.free_of(offset_columns(self.likelihood))
        self.tangents.clear()
        return run_refits(
            self.likelihood,
            [refit(self.likelihood, fit.candidate, fit.place, full=True) for fit in fits],
            self.check,
        )


def _key(candidate: Candidate) -> tuple[tuple[str, int], ...]:
    return tuple(sorted((effect.id, variant) for effect, variant in candidate.effects))


@one_blas_thread()
def diagnose(
    system: System,
    runs: Sequence[Run],
    settings: Settings | None = None,
    *,
    start: Mapping[str, float] | None = None,
    proposals: Sequence[Proposal] = (),
    on_progress: Progress | None = None,
    is_cancelled: Callable[[], bool] | None = None,
) -> Diagnosis:
    """Where `system` and `runs` part, and why. `start` are first guesses of base parameters."""
    settings = settings or Settings()
    began = clock.monotonic()

    def check() -> None:
        if is_cancelled is not None and is_cancelled():
            raise Cancelled('diagnose: cancelled')

    progress = on_progress or (lambda stage, share: None)
    place = None
    if start is not None:
        place = np.array(
            [
                item.to_unit(start[item.name]) if item.name in start else 0.5
                for item in system.base_parameters
            ]
        )
    session = _Session(system, runs, settings, place, progress, check)
    return _conclude(session, list(runs), list(proposals), began)


def _conclude(
    session: _Session, runs: list[Run], proposals: list[Proposal], began: float
) -> Diagnosis:
    settings, likelihood = session.settings, session.likelihood
    limits = detectability(
        session.signatures, settings.error_rate, settings.materiality, session.pairs
    )
    labels, angles = angle_matrix(session.signatures)
    fit = session.prune(session.forward(session.base))
    simpler = session.simpler(fit)
    if simpler is not fit:
        fit = session.prune(session.forward(simpler))
    session.progress('doubt', 0.75)
    rivals: dict[str, tuple[Fit, ...]] = {}
    if fit.candidate.effects:
        fit, rivals = session.doubt(session.prune(session.move_to(fit)))
    base = session.base
    structure_before = session.battery.structure(base)
    structure_after = session.battery.structure(fit)
    swift_before, swift_after = session.battery.ripple(base), session.battery.ripple(fit)
    explained = 0.0
    if fit.candidate.effects:
        remaining = max(structure_after.excess, 0.0) + swift_after.excess
        explained = 1.0 - remaining / max(structure_before.excess + swift_before.excess, 1e-9)
    notes: list[str] = []
    left = session.worth(structure_after) or session.worth(swift_after)
    verdict: Verdict = 'none'
    if fit.candidate.effects:
        ambiguous = any(rivals.get(name) for name in fit.candidate.ids)
        verdict = 'ambiguous' if ambiguous else 'named'
        if left and explained < settings.least_total:
            verdict = 'unknown'
        elif session.crowded(fit):
            verdict = 'unknown'
            notes.append(
                f'{len(fit.candidate.effects)} effects were needed for one channel: so many bend '
                'to anything, and none of them is sure'
            )
        elif left:
            notes.append(
                f'{100 * (1 - explained):.0f} % of the misfit is left after the extension, most '
                f'of it in {structure_after.where}: its form may differ, or something small is '
                'beside it'
            )
    elif left:
        verdict = 'unknown'
    if session.worth(swift_after):
        notes.append(
            f'{swift_after.view} swings about {swift_after.frequency:.2g} Hz in '
            f'{swift_after.run}, {100 * swift_after.visible:.2f} % of range, unexplained'
        )
    session.progress('gain', 0.85)
    shapes_before = session.battery.shapes(base, session.base_tangent.white)
    final = session.tangent_of(fit)
    shapes_after = session.battery.shapes(fit, final.white)
    inflation = 1.0 + max(structure_after.excess, 0.0) / structure_after.dimensions
    covariance = _covariance(final, inflation)
    lesses = {name: session.without(fit, name) for name in fit.candidate.ids}
    weights = {name: session.weigh(fit, less, 0) for name, less in lesses.items()}
    count = len(system_parameters(session))
    sentence = None
    if verdict == 'ambiguous':
        pairs = [(fit, rival) for others in rivals.values() for rival in others]
        sentence = choose_next(likelihood, final, pairs, proposals)
    line_causes, line_limits = _line_causes(session, runs)
    limits += line_limits
    if line_causes and verdict == 'none':
        verdict = 'named'
    before_covariance = _covariance(
        session.base_tangent, 1.0 + max(structure_before.excess, 0.0) / structure_before.dimensions
    )
    judged = base, fit
    base, fit, *others = session.parameters_alone([base, fit, *lesses.values()])
    # What the small unknowns would have taken is part of what the published values are unsure of.
    before_covariance = before_covariance + np.diag((base.place - judged[0].place) ** 2)
    covariance = covariance + np.diag((fit.place - judged[1].place) ** 2)
    lesses = dict(zip(lesses, others, strict=True))
    notes += _sizes_at_bounds(session, fit)
    causes = tuple(
        _cause(session, fit, lesses[name], weights[name], rivals.get(name, ()), covariance, runs)
        for name in lesses
    )
    causes = tuple(sorted([*causes, *line_causes], key=lambda cause: -cause.visible))
    predicted = _predictions(session.system, runs, base, fit)
    return Diagnosis(
        verdict,
        causes,
        _base_estimates(session, base, before_covariance),
        _base_estimates(session, fit, covariance),
        _physical(system_parameters(session), fit.place, covariance)[:count, :count],
        base,
        fit,
        predicted,
        structure_before,
        structure_after,
        swift_after,
        tuple(shapes_before),
        tuple(shapes_after),
        tuple(limits),
        tuple(labels),
        angles,
        tuple(session.evidence),
        tuple(session.immaterial),
        explained,
        sentence,
        tuple(notes),
        likelihood,
        session.ranges,
        _gain(session, base, fit, runs),
        likelihood.simulations,
        clock.monotonic() - began,
    )


def system_parameters(session: _Session) -> tuple[Parameter, ...]:
    """Base parameters of the system under diagnosis."""
    return session.system.base_parameters


def _covariance(sensitivities: Tangent, inflation: float) -> Array:
    gram = sensitivities.white.T @ sensitivities.white
    return np.asarray(np.linalg.inv(gram + np.eye(gram.shape[0])) * inflation)


def _physical(parameters: Sequence[Parameter], place: Array, covariance: Array) -> Array:
    count = len(parameters)
    slopes = np.array([item.slope(float(u)) for item, u in zip(parameters, place, strict=False)])
    return np.asarray(covariance[:count, :count] * np.outer(slopes, slopes))


def _base_estimates(session: _Session, fit: Fit, covariance: Array) -> dict[str, Estimate]:
    parameters = system_parameters(session)
    deviations = np.sqrt(np.diag(_physical(parameters, fit.place, covariance)))
    return {
        item.name: Estimate(item.from_unit(float(u)), float(std), item.unit)
        for item, u, std in zip(parameters, fit.place, deviations, strict=False)
    }


def _sizes_at_bounds(session: _Session, fit: Fit) -> list[str]:
    """A sentence for every effect as large as its bounds allow."""
    sentences = []
    for effect, _, part in fit.candidate.slices(len(system_parameters(session))):
        size, place = effect.size, float(fit.place[part.start])
        value = size.from_unit(place)
        present = abs(value - effect.neutral) / (size.high - size.low)
        if min(place, 1.0 - place) < AT_BOUND < present:
            sentences.append(
                f'{effect.id}: its {size.name} stands at the bound of {value:.3g} {size.unit}: it '
                'is larger than was thought possible, or something else is mixed with it'
            )
    return sentences


def _cause(
    session: _Session,
    fit: Fit,
    less: Fit,
    evidence: Evidence,
    rivals: tuple[Fit, ...],
    covariance: Array,
    runs: list[Run],
) -> Cause:
    name = next(item for item in fit.candidate.ids if item not in less.candidate.ids)
    effect, variant, part = next(
        item
        for item in fit.candidate.slices(len(system_parameters(session)))
        if item[0].id == name
    )
    deviations = np.sqrt(np.diag(covariance)[part])
    estimates = {}
    for item, u, deviation in zip(effect.parameters, fit.place[part], deviations, strict=True):
        place = float(u)
        value = item.from_unit(place)
        std = float(deviation) * item.slope(place)
        if item is effect.size:
            std = float(np.hypot(std, effect.form * (value - effect.neutral)))
        estimates[item.name] = Estimate(value, std, item.unit)
    for key, value in effect.variants[variant].items():
        estimates[key] = Estimate(float(value), 0.0, '')
    others = {
        other
        for rival in rivals
        for other in rival.candidate.ids
        if other not in fit.candidate.ids
    }
    return Cause(
        effect,
        variant,
        (name, *sorted(others)),
        estimates,
        evidence.p_value,
        evidence.delta_bic,
        evidence.visible,
        _gain(session, less, fit, runs),
    )


def _line_causes(session: _Session, runs: list[Run]) -> tuple[list[Cause], list[Detectability]]:
    """Steady lines at rest, for the effects that are lines; and what could have been seen."""
    causes: list[Cause] = []
    limits: list[Detectability] = []
    settings = session.settings
    rest = [segment for run in session.runs for segment in run.rest]
    sealed = [segment for run in runs if run.held_out for segment in run.rest]
    views = session.system.views
    for effect in session.system.effects:
        if not effect.line:
            continue
        search = find_line(rest, settings.error_rate / session.trials)
        widest = max(
            float(np.abs(weights).max()) / session.ranges[view] for view, weights in views.items()
        )
        material = settings.materiality * np.sqrt(2.0) / widest
        seen = bool(np.isfinite(search.limit))
        limits.append(
            Detectability(
                effect.id,
                float(seen),
                search.limit,
                search.limit,
                material,
                effect.size.unit,
                seen,
            )
        )
        line = search.line
        if line is None:
            continue
        hit = tuple(int(channel) for channel in np.flatnonzero(line.own))
        variant = min(range(len(effect.line)), key=lambda item: len({*effect.line[item]} ^ {*hit}))
        channels = np.zeros(line.amplitude.size)
        channels[list(effect.line[variant])] = 1.0
        visible = max(
            float(np.abs(weights) @ (line.amplitude * line.own)) / session.ranges[view]
            for view, weights in views.items()
        ) / np.sqrt(2.0)
        amplitude = float(channels @ line.amplitude / channels.sum())
        deviation = float(np.sqrt(channels @ line.deviation**2) / channels.sum())
        # Channels brought to common instants by straight lines have lost up to this of a swing.
        lost = (2.0 * np.pi * line.frequency * line.step) ** 2 / 8.0
        deviation = float(np.hypot(deviation, lost * amplitude))
        cosine, sine, frequency = effect.parameters
        estimates = {
            cosine.name: Estimate(amplitude, deviation, cosine.unit),
            sine.name: Estimate(0.0, deviation, sine.unit),
            frequency.name: Estimate(line.frequency, 0.0, frequency.unit),
            **{
                key: Estimate(float(value), 0.0, '')
                for key, value in effect.variants[variant].items()
            },
        }
        if visible < settings.materiality:
            values = {effect.id: {name: item.value for name, item in estimates.items()}}
            session.immaterial.append(
                Evidence(
                    0, (effect.id,), (variant,), 0.0, line.delta_bic, line.p_value, visible, values
                )
            )
            continue
        gain = Gain(
            line_gain(rest, line.frequency, line.amplitude * line.own),
            line_gain(sealed, line.frequency, line.amplitude * line.own) if sealed else None,
            'at rest, its phase free',
        )
        causes.append(
            Cause(
                effect,
                variant,
                (effect.id,),
                estimates,
                line.p_value,
                line.delta_bic,
                float(visible),
                gain,
            )
        )
    return causes, limits


def _gain(session: _Session, less: Fit, fit: Fit, runs: list[Run]) -> Gain:
    """Gain on the fitted runs, and on runs held out or left out in turn."""
    fitted = fitted_gain(session.likelihood, session.ranges, less, fit)
    if less is fit:
        return Gain(0.0, 0.0, 'none')
    held = [run for run in runs if run.held_out]
    if held:
        return Gain(
            fitted, held_out_gain(session.system, held, session.ranges, less, fit), 'held out'
        )
    if len(session.runs) < 2:
        return Gain(fitted, None, 'one run only')
    value = left_out_gain(
        session.likelihood,
        session.ranges,
        (less, session.tangent_of(less)),
        (fit, session.tangent_of(fit)),
    )
    return Gain(fitted, value, 'left out in turn')


def _predictions(
    system: System, runs: Sequence[Run], before: Fit, after: Fit
) -> tuple[RunResidual, ...]:
    answers = []
    for run in runs:
        both = system.predict_many(run, [before.point, after.point])
        answers.append(RunResidual(run, both[0], both[1]))
    return tuple(answers)


def strict(settings: Settings, error_rate: float) -> Settings:
    """The same settings with another family-wise error rate."""
    return replace(settings, error_rate=error_rate)
