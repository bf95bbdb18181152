"""The diagnosis step by step: noise, base fit, signatures, selection, alternatives, gain.

For any simulator that follows `System` it finds where measurement and simulation differ, which
cause explains it, which causes cannot be told apart, and what no known cause explains.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import time as clock

from saddlering_ros.discrepancy.assumptions import Assumptions
from saddlering_ros.discrepancy.candidate import Fit
from saddlering_ros.discrepancy.conclusion import (
    judge,
    Judgement,
    Publication,
    residual_of,
)
from saddlering_ros.discrepancy.experiment import Experiment, refuse_repeats
from saddlering_ros.discrepancy.model_space import ModelSpace
from saddlering_ros.discrepancy.next_test import separate_open_models
from saddlering_ros.discrepancy.preparation import (
    better_base,
    first_guess,
    moved_to,
    observed,
    prepare,
    space_about,
)
from saddlering_ros.discrepancy.proposal import LawProposal, Proposer
from saddlering_ros.discrepancy.results import Cause, Diagnosis, SearchLog
from saddlering_ros.discrepancy.selection import (
    Alternatives,
    check_alternatives,
    forward,
    prune,
    select,
)
from saddlering_ros.discrepancy.separation import Proposal, Separation
from saddlering_ros.discrepancy.settings import Settings
from saddlering_ros.discrepancy.steady_lines import find_steady_lines, find_swings
from saddlering_ros.discrepancy.system import Array, RunBlocks, System
from saddlering_ros.progress import IsCancelled, one_blas_thread, OnProgress, Watch

PARTIAL_SUBJECT = 0.5
"""A law is proposed beside partial causes that explain this share of the misfit, else alone."""


MAX_BASES = 3
"""Number of times that the search begins again about a better fit of the base."""


@dataclass(frozen=True)
class Subject:
    """Runs without slow steady lines, their experiment and space, and the lines."""

    runs: Sequence[RunBlocks]
    experiment: Experiment
    space: ModelSpace
    lines: tuple[Cause, ...]


@dataclass(frozen=True)
class Search:
    """The model at the end of a search, its alternatives, and two spaces.

    begun: the space about the base fit; space: the one in which the model is judged.
    """

    begun: ModelSpace
    space: ModelSpace
    fit: Fit
    alternatives: Alternatives
    log: SearchLog


@one_blas_thread()
def diagnose_system(
    system: System,
    runs: Sequence[RunBlocks],
    settings: Settings | None = None,
    *,
    assumptions: Assumptions | None = None,
    start: Mapping[str, float] | None = None,
    proposals: Sequence[Proposal] = (),
    on_progress: OnProgress | None = None,
    is_cancelled: IsCancelled | None = None,
) -> Diagnosis:
    """Differences between `system` and `runs`, and their causes. `start`: guesses of the base."""
    settings, watch = settings or Settings(), Watch('diagnose', on_progress, is_cancelled)
    began = clock.monotonic()
    refuse_repeats(runs)
    subject = _prepared(Experiment(system, _fitted(runs), assumptions), runs,
                        first_guess(system, start), settings, watch)
    experiment, runs = subject.experiment, subject.runs
    search = _searched(subject)
    observability = observed(search.begun)
    space, fit, alternatives, log = search.space, search.fit, search.alternatives, search.log
    before = residual_of(space, space.base)
    after = residual_of(space, fit) if fit.candidate.effects else before
    judgement = judge(space, fit, alternatives, before, after)
    lines = find_steady_lines(experiment, runs, settings, space.trials)
    log.immaterial += lines.immaterial

    watch.progress('misfit reduction', 0.85)
    evidence = {
        name: space.compare(space.without(fit, name), fit).evidence() for name in fit.candidate.ids
    }
    separations: tuple[Separation, ...] = ()
    if judgement.verdict == 'ambiguous':
        watch.progress('next test', 0.88)
        separations = separate_open_models(space, fit, alternatives, proposals)
    published = Publication(space, fit, before, after, runs)
    law = None
    if judgement.verdict == 'unknown' and experiment.assumptions.proposes_law:
        watch.progress('search for a law', 0.9)
        law = _law(space, judgement, published)
    steady = (*lines.causes, *subject.lines)
    verdict = 'named' if steady and judgement.verdict == 'none' else judgement.verdict
    causes = [replace(cause, partial=verdict == 'unknown')
              for cause in (*published.causes(evidence, alternatives), *steady)]
    return Diagnosis(
        verdict=verdict,
        causes=tuple(sorted(causes, key=lambda cause: -cause.visible)),
        base=published.base_with_causes(),
        base_alone=published.base_alone(),
        gain=published.gain(),
        explained=judgement.explained,
        next_test=separations[0].proposal.sentence if separations else None,
        separations=separations,
        warnings=(*judgement.warnings, *published.sizes_at_bounds()),
        converged=space.base.converged and fit.converged and published.converged,
        runs=published.predictions(),
        fits=published.fits(),
        law=law,
        residual_before=before,
        residual_after=after,
        observability=replace(observability, limits=(*observability.limits, *lines.limits)),
        search=log,
        simulations=experiment.simulations,
        seconds=clock.monotonic() - began,
    )


def _fitted(runs: Sequence[RunBlocks]) -> list[RunBlocks]:
    return [run for run in runs if not run.held_out]


def _prepared(
    experiment: Experiment, runs: Sequence[RunBlocks], start: Array | None, settings: Settings,
    watch: Watch,
) -> Subject:
    """Noise, base fit and signatures, of runs without the slow steady lines that they have."""
    space = prepare(experiment, start, settings, watch)
    swings = find_swings(space.metric, space.base, runs, settings, space.trials)
    if swings is None:
        return Subject(runs, experiment, space, ())
    without = Experiment(experiment.system, _fitted(swings.runs), experiment.assumptions)
    return Subject(swings.runs, without, prepare(without, start, settings, watch), swings.causes)


def _searched(subject: Subject) -> Search:
    """The search, begun again while the model that it found leads to a better base."""
    search = _search(subject.space)
    for _ in range(MAX_BASES):
        deeper = better_base(search.space, search.fit)
        if deeper is None:
            break
        space = subject.space
        search = _search(space_about(subject.experiment, deeper, space.settings, space.watch))
    return search


def _search(begun: ModelSpace) -> Search:
    """Select effects, adapt the nuisance parameters to them, check the alternatives."""
    space, log = begun, SearchLog()
    fit = select(space, log)
    alternatives: Alternatives = {}
    space.watch.progress('check of alternatives', 0.75)
    if fit.candidate.effects:
        space, fit = moved_to(space, fit)
        if space.metric.experiment.assumptions.relearns:  # With less noise, more effects may show.
            fit = forward(space, fit, log)
        fit = prune(space, fit, log)
        fit, alternatives = check_alternatives(space, fit, log)
    return Search(begun, space, fit, alternatives, log)


def _law(space: ModelSpace, judgement: Judgement, published: Publication) -> LawProposal | None:
    """A law for the misfit that remains beside partial causes, or for all of it.

    The law is looked for in the fits of the misfit reduction: where nuisance parameters take a
    share of the misfit, it would predict only the remainder.
    """
    fits, settings = published.fits(), space.settings
    proposer = Proposer(space.metric, published.runs, space.known.max_pairs, settings.error_rate,
                        settings.max_rounds, space.watch)
    is_partial = judgement.explained >= PARTIAL_SUBJECT
    return proposer.law_for(fits.after if is_partial else fits.before)
