"""A diagnosis as numbers and arrays, for console, JSON and report."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
import math
from pathlib import Path
from typing import Any, Literal, TypedDict

import numpy as np

from saddlering_ros.discrepancy.law.proposal import LawProposal
from saddlering_ros.discrepancy.problem.fits import Fit, Gain
from saddlering_ros.discrepancy.problem.metric import Metric
from saddlering_ros.discrepancy.problem.system import Array, Effect, Estimate, Proposal, RunBlocks
from saddlering_ros.discrepancy.search.evidence import SearchLog
from saddlering_ros.discrepancy.search.lack_of_fit import FastResidual, ShapeTest, SlowResidual
from saddlering_ros.discrepancy.search.signatures import Observability
from saddlering_ros.quantities import WIDTH_95

Verdict = Literal['none', 'named', 'ambiguous', 'unknown']

PARTED = 0.25
"""Share of the misfit that partial causes explain from which on simulated tests and held-out runs
part their alternatives: with less, the cause is likely to be another one. Chosen."""


class SizeEntry(TypedDict):
    """A parameter of a cause in SI units, with its 95 % interval.

    std 0 and interval None: a chosen parameter, which is not fitted.
    """

    value: float
    std: float
    interval: list[float] | None
    unit: str


class ReductionEntry(TypedDict):
    """Shares by which the misfit falls; held_out None without held-out runs."""

    fit: float
    held_out: float | None


class AnotherLaw(TypedDict):
    """A law of another shape: its coordinate, and the share of the residual that it predicts.

    The residual is that of the listed law in held-out runs.
    """

    along: str
    predicts: float


class _CausePartial(TypedDict, total=False):
    partial: bool
    may_be_absent: bool
    another_law: AnotherLaw
    elsewhere: list[dict[str, float]]
    title: str
    titles: list[str]
    share_of_range: float


class CauseEntry(_CausePartial):
    """A cause, of a ring and of a declared model alike, as JSON has it.

    group: every id that these data cannot separate from the effect; titles: of each, for a ring.
    partial: the cause is real, and something else is wrong besides. may_be_absent: it explains
    little, and the 95 % interval of its size includes the size at which it does nothing.
    another_law: a law of another shape predicts the residual of this one. times_needed: evidence
    over the least that a cause needs.
    """

    effect: str
    group: list[str]
    parameters: dict[str, SizeEntry]
    evidence: dict[str, float | None]
    gain: ReductionEntry


@dataclass(frozen=True)
class Cause:
    """A found cause: the id of its effect, its alternatives, its evidence and its gain.

    partial: the cause is real, and something else is wrong besides. elsewhere: the parameters at
    every other place, such as another probe, that explains these data equally well.
    another_law: a law of another shape predicts the residual of this one.
    """

    effect: str
    definition: Effect
    variant: int
    group: tuple[str, ...]
    parameters: Mapping[str, Estimate]
    p_value: float
    delta_bic: float
    visible: float
    gain: Gain
    partial: bool = False
    elsewhere: tuple[Mapping[str, float], ...] = ()
    another_law: AnotherLaw | None = None
    times_needed: float = math.inf

    @property
    def may_be_absent(self) -> bool:
        """Whether the 95 % intervals of its size and its other amplitudes hold neutral values."""
        size, *others = self.definition.ordered
        low, high = self.parameters[size.name].interval or (np.inf, np.inf)
        return low <= self.definition.neutral <= high and all(
            one.neutral is None or one.name not in self.parameters
            or (interval := self.parameters[one.name].interval) is None
            or interval[0] <= one.neutral <= interval[1] for one in others)

    @property
    def sure(self) -> float:
        """`visible` over one plus the relative deviation of its surest amplitude."""
        size, *others = self.definition.ordered
        amplitudes = [(size.name, self.definition.neutral), *(
            (one.name, one.neutral) for one in others if one.neutral is not None)]
        deviations = [one.std / max(abs(one.value - neutral), 1e-300) for name, neutral in
                      amplitudes if (one := self.parameters.get(name)) is not None]
        return self.visible / (1.0 + min(deviations, default=0.0))

    def entry(self) -> CauseEntry:
        """The cause as JSON has it."""
        parameters: dict[str, SizeEntry] = {
            name: {'value': size.value, 'std': size.std,
                   'interval': None if size.interval is None else list(size.interval),
                   'unit': size.unit}
            for name, size in self.parameters.items()}
        entry: CauseEntry = {
            'effect': self.effect, 'group': list(self.group), 'parameters': parameters,
            'evidence': {'p_value': self.p_value, 'delta_bic': self.delta_bic},
            'gain': {'fit': self.gain.fit, 'held_out': self.gain.held_out},
            'share_of_range': self.visible, 'title': self.definition.title}
        if self.partial:
            entry['partial'] = True
            # A size that shapes replace has a wide interval, whatever the cause explains.
            if self.gain.fit < PARTED and self.may_be_absent:
                entry['may_be_absent'] = True
        if self.another_law:
            entry['another_law'] = self.another_law
        if self.elsewhere:
            entry['elsewhere'] = [dict(values) for values in self.elsewhere]
        return entry


@dataclass(frozen=True)
class RunPrediction:
    """Predictions for one run, (C, N) each: without and with the causes."""

    run: RunBlocks
    before: Array
    after: Array


@dataclass(frozen=True)
class Residual:
    """The residual of a model: slow and fast structure, and tests on shapes in each coordinate.

    consistency: tests whether parameters and laws fit everywhere alike, for declared models.
    """

    slow: SlowResidual
    fast: FastResidual
    shapes: tuple[ShapeTest, ...]
    consistency: tuple[ShapeTest, ...] = ()

    def explained_by(self, after: 'Residual') -> float:
        """Share of this misfit beyond noise that a model with the residual `after` explains.

        A small cause can be certain although all structures together are no more than noise.
        """
        remaining = max(after.slow.excess, 0.0) + after.fast.excess
        misfit = max(self.slow.excess, 0.0) + self.fast.excess
        return 1.0 - min(1.0, remaining / max(misfit, 1e-9))

    def inflation(self, error_rate: float) -> float:
        """Factor of the variances for a remaining misfit, even one too small to matter.

        Misfit with the shapes of the parameters changes the parameters.
        """
        return max(1.0, 1.0 + self.slow.excess / self.slow.dimensions, *(
            test.statistic / test.dimensions for test in self.consistency
            if test.p_value < error_rate))


@dataclass(frozen=True)
class Remainder:
    """What is left beyond noise in a channel of a run.

    share_of_range, times_noise: its rms over the range and over the rms noise of the channel;
    along: the coordinate that it follows most; size: the rms itself [unit].
    """

    run: str
    channel: str
    share_of_range: float
    times_noise: float
    along: str
    size: float
    unit: str


@dataclass(frozen=True)
class Influence:
    """What a stretch of a run [s] adds to the evidence for the causes, in misfit."""

    run: str
    start: float
    end: float
    evidence: float


@dataclass(frozen=True)
class Refit:
    """A refit with other data or assumptions: what changes, and the first cause it ends in."""

    change: str
    first: str | None
    is_same: bool


@dataclass(frozen=True)
class PublishedFits:
    """The published fits of the base, and of base and causes, by parameters alone.

    base_covariance: of the base parameters beside the causes, in their units.
    """

    metric: Metric
    before: Fit
    after: Fit
    base_covariance: Array


@dataclass(frozen=True)
class HeldOutEvidence:
    """An open alternative judged by held-out runs.

    distance: misfit beyond that of the best, fitted to all runs; share: of the probability of all
    alternatives, of which the rule of groups takes as much as an inexact law or unsure noise may
    explain; remains: whether this rule keeps it.
    """

    effect: str
    title: str
    runs: tuple[str, ...]
    distance: float
    share: float
    remains: bool


@dataclass(frozen=True)
class Separation:
    """Result of a proposed test in simulated draws.

    draws: over all truths; alone: draws that leave only the true cause; kept: draws that leave
    its model at all; by_truth: share of the draws that leave only the true cause, for each truth;
    together: the open models by their effects, those that the test does not part as one; refitted:
    whether the models were refitted to the test, and not only forecast to first order.
    """

    proposal: Proposal
    draws: int
    alone: int
    kept: int
    by_truth: Mapping[tuple[str, ...], float]
    together: tuple[tuple[tuple[str, ...], ...], ...] = ()
    refitted: bool = False

    @property
    def share(self) -> float:
        """Share of the draws that leave only the true cause."""
        return self.alone / self.draws

    @property
    def caveat(self) -> str:
        """What its share is not, in words; '' after refits, and of a quantity read directly."""
        is_sure = self.refitted or self.proposal.readings
        return '' if is_sure else '; a linear forecast, which can promise too much'

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the share (E. B. Wilson, J. Am. Stat. Assoc. 22 (1927) 209)."""
        z, count = WIDTH_95, self.draws
        middle = (self.share + z * z / (2 * count)) / (1 + z * z / count)
        half = math.sqrt(self.share * (1 - self.share) / count + z * z / (4 * count**2))
        half *= z / (1 + z * z / count)
        return max(0.0, middle - half), min(1.0, middle + half)


@dataclass(frozen=True)
class Shares:
    """Shares of the misfit's power beyond noise that a model takes beside another, by view.

    fitted: of views with no small misfit beside that of the worst; worst_run: the run in which it
    takes least, and its share of all misfit there; worst_view: view and share of the least where
    the model moves more than half of the misfit, worst_fitted of those of `fitted`; interval: 95 %
    of the reduction on predicted runs, held out and, among small errors, held out in turn;
    held_out: of the former alone.
    """

    fitted: Mapping[str, float]
    predicted: Mapping[str, float]
    worst_run: tuple[str, float]
    worst_view: tuple[str, float]
    worst_fitted: tuple[str, float]
    interval: tuple[float, float] | None
    held_out: tuple[float, float] | None = None

    @property
    def best(self) -> float:
        """Share in the view in which the model takes most, where it is fitted and predicts.

        A view without misfit on the predicted runs shows nothing, if others have some.
        """
        return max(
            (min(share, self.predicted.get(view, 0.0)) if self.predicted else share
             for view, share in self.fitted.items()), default=0.0)

    @property
    def required(self) -> float:
        """Share that an established cause takes: less where it takes nearly all of fitted runs."""
        predicted = [self.predicted.get(view, 0.0)
                     for view, share in self.fitted.items() if share >= NEARLY_ALL]
        is_nearly_all = max(predicted, default=-np.inf) >= min(MIN_PREDICTED, self.best)
        return MIN_PREDICTED if is_nearly_all else MIN_TAKEN


@dataclass(frozen=True)
class Diagnosis:
    """The whole result: the verdict, and the fits and tests behind it.

    base: base parameters beside the causes; base_alone: without causes; explained: share of
    the misfit; warnings: reasons for a reader's doubt; converged: whether every fit behind the
    verdict converged. law: a proposed law, with `unknown` only. separations: proposed tests,
    the best first, with their separation of an `ambiguous` group. complete: whether no more than
    noise and declared model error is left; remainder: what is. probabilities: of each cause or
    group ('a or b'), of 'none' and of 'unknown'. refits: without each run, with another model
    error, with stretches drawn again; near_limit: why the verdict is near its limit; influence:
    what each stretch adds; held_out_evidence: open alternatives judged by held-out runs.
    """

    verdict: Verdict
    causes: tuple[Cause, ...]
    base: Mapping[str, Estimate]
    base_alone: Mapping[str, Estimate]
    gain: Gain
    explained: float
    next_test: str | None
    warnings: tuple[str, ...]
    converged: bool
    runs: tuple[RunPrediction, ...]
    fits: PublishedFits
    law: LawProposal | None
    residual_before: Residual
    residual_after: Residual
    observability: Observability
    search: SearchLog
    simulations: int
    seconds: float
    separations: tuple[Separation, ...] = ()
    complete: bool = True
    remainder: tuple[Remainder, ...] = ()
    probabilities: Mapping[str, float] = field(default_factory=dict)
    refits: tuple[Refit, ...] = ()
    near_limit: tuple[str, ...] = ()
    influence: tuple[Influence, ...] = ()
    held_out_evidence: tuple[HeldOutEvidence, ...] = ()

    @property
    def stability(self) -> float:
        """Share of the refits that end in the same first cause; 1 without refits."""
        return float(np.mean([refit.is_same for refit in self.refits] or [True]))

    def certainty(self) -> dict[str, Any]:
        """What is left, and how certain the verdict is, as JSON has it."""
        return {
            'complete': self.complete,
            'remainder': [vars(rest) for rest in self.remainder],
            'probabilities': self.probabilities,
            'stability': self.stability,
            'refits': [vars(refit) for refit in self.refits],
            'near_limit': list(self.near_limit),
            'influence': [vars(stretch) for stretch in self.influence],
            'held_out_evidence': [vars(one) for one in self.held_out_evidence]}

    def as_none(self) -> 'Diagnosis':
        """The same data with the verdict `none`: what is left is no fault of the machine."""
        return replace(self, verdict='none', causes=(), complete=True, remainder=(), refits=(),
                       near_limit=(), influence=(), probabilities=probabilities_of('none'))

    def in_doubt(self) -> 'Diagnosis':
        """The same data if more than their causes differs: no cause is established."""
        partial = tuple(replace(cause, partial=True) for cause in self.causes)
        return replace(self, verdict='unknown', causes=partial, complete=False,
                       probabilities=probabilities_of('unknown', partial))

    def title_of(self, group: str) -> str:
        """Titles of the effects of 'first_id or second_id'; another outcome as it is."""
        return ' or '.join(self.fits.metric.problem.titles.get(name, name)
                           for name in group.split(' or '))

    def unpredicted(self, rests: Sequence[Remainder]) -> 'Diagnosis':
        """The same data with what held-out runs keep, and with `unknown` for `none` then.

        Of open alternatives another one may predict them, which `held_out_evidence` tells.
        """
        from saddlering_ros.discrepancy.verdict.wording import unpredicted_words

        if self.verdict == 'ambiguous' or not rests:
            return self
        is_none, largest = self.verdict == 'none', max(rests, key=lambda rest: rest.share_of_range)
        ordered = sorted((*self.remainder, *rests), key=lambda rest: -rest.share_of_range)
        changed = replace(self, complete=False, remainder=tuple(ordered), warnings=(
            *self.warnings, unpredicted_words(largest, has_causes=bool(self.causes))))
        return changed.in_doubt() if is_none else changed

    @property
    def headline(self) -> str:
        """The verdict in one sentence."""
        from saddlering_ros.discrepancy.verdict.wording import headline_of

        return headline_of(self)

    def summary(self) -> str:
        """The verdict in plain lines."""
        from saddlering_ros.discrepancy.verdict.page import summary_text

        return summary_text(self)

    def write_report(self, path: Path | str) -> None:
        """One HTML page that loads nothing from elsewhere."""
        from saddlering_ros.discrepancy.verdict.page import write_page

        write_page(self, Path(path))


MIN_TAKEN = 0.85
"""Share of the power of a view's misfit beyond noise that an established cause takes, both where
it is fitted and where it predicts. Stand-ins took up to 0.80 on the development seeds of
docs/benchmarks."""

NEARLY_ALL, MIN_PREDICTED = 0.97, 0.6
"""Share of fitted runs from which on a smaller one of predicted runs is enough, and this share. A
held-out run is one draw of what the simulator lacks. Of 159 true causes over their limit seven had
no name by this share alone, with 0.97 and more of fitted runs and 0.64 to 0.84 of predicted ones;
of 178 draws without the true law none."""

SUREST, HALF_LEFT, STEEPNESS = 0.975, 0.38, 2.3
"""How often a first cause that leaves nothing is right, the share of the misfit's power beyond
noise that it leaves when it is half as often right, and the power of that share with which its
chance falls. Maximum likelihood on 571 draws of docs/benchmarks (0.975, 0.384 and 2.26), of which
a quarter has the true law taken out."""

MIN_RIGHT, SHARE_RIGHT = 0.1, 0.54
"""How often causes that are not established hold the true one if they take nothing, and how much
more often if they take all of the misfit. Maximum likelihood on 462 such verdicts of the draws of
docs/benchmarks (0.11 and 0.52 on the older half, 0.09 and 0.57 on the other). What they take tells
less than of established causes: on an imperfect machine a true cause often takes little, on a
perfect one a stand-in takes most of the misfit."""

ESTABLISHED_EXPONENT, OPEN_EXPONENT = 6, 1
"""Exponents of the visible size of causes that share a probability. Of 65 dirty rings with several
established causes the largest was the hidden one in 63. On those up to 575 the logarithm of the
likelihood is -12.9 with 2, -8.3 with 6 and -7.7 at best; on the 22 newer ones -3.6 and -1.0. Of
causes that are not established the largest is less often the main one."""

NOTHING = 0.97
"""How often nothing was there if no misfit beyond noise was found in draws: 138 of 143."""


def probabilities_of(verdict: Verdict, causes: Sequence[Cause] = (), taken: float = 0.0,
                     nothing: float | None = None, listed: float = 1.0) -> dict[str, float]:
    """Probability of each cause or group, of none, and of a cause not listed; they sum to 1.

    The chance of established causes falls with a power of the share of the misfit that they leave
    (1 less `taken`), of at most what they may leave beside model error: if they leave noise alone,
    the held-out runs may have none. That of others is smaller and rises in proportion to `taken`,
    which is 0 where their law may be another. Several share it by a power of their visible sizes,
    of established ones as far as these are sure. listed: how often the main cause is listed.
    nothing: share of the refits that find no cause, of a misfit which a sound machine can have:
    the chance of none is in proportion, and the causes of an `unknown` count in the others only.
    """
    sound = nothing if nothing is not None else float(verdict == 'none')
    none = NOTHING * sound if verdict in ('none', 'unknown') else 0.0
    left = float(np.clip(1.0 - taken, 0.0, 1.0 - MIN_TAKEN))
    chance = listed * SUREST / (1.0 + (left / HALF_LEFT) ** STEEPNESS)
    if verdict == 'unknown':
        chance = (MIN_RIGHT + SHARE_RIGHT * min(max(taken, 0.0), 1.0)) * (1.0 - sound)
    weights = [cause.visible**OPEN_EXPONENT if verdict == 'unknown' else
               cause.sure**ESTABLISHED_EXPONENT for cause in causes]
    answer: dict[str, float] = {}
    for cause, weight in zip(causes, weights, strict=True):
        name = ' or '.join(cause.group)
        answer[name] = answer.get(name, 0.0) + chance * weight / max(sum(weights), 1e-300)
    return {**answer, 'none': none, 'unknown': 1.0 - none - sum(answer.values())}
