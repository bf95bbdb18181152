"""The diagnosis step by step: noise, base fit, signatures, selection, alternatives, gain.

For any simulator that follows `System` it finds where measurement and simulation differ, which
cause explains it, which causes cannot be told apart, and what no cause of the catalogue explains.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import time as clock

from saddlering_ros.discrepancy.law.proposal import Proposer
from saddlering_ros.discrepancy.next_test import separate_open_models, Separation
from saddlering_ros.discrepancy.problem.fits import Fit
from saddlering_ros.discrepancy.problem.problem import Assumptions, Problem
from saddlering_ros.discrepancy.problem.system import (
    Proposal,
    refuse_repeats,
    RunBlocks,
    Settings,
    System,
)
from saddlering_ros.discrepancy.search.comparison import SearchLog
from saddlering_ros.discrepancy.search.limits import observed
from saddlering_ros.discrepancy.search.selection import (
    Alternatives,
    check_alternatives,
    forward,
    prune,
    select,
)
from saddlering_ros.discrepancy.search.space import (
    better_base,
    ModelSpace,
    moved_to,
    prepare,
    space_about,
)
from saddlering_ros.discrepancy.verdict.judgement import judge, residual_of
from saddlering_ros.discrepancy.verdict.publication import publish
from saddlering_ros.discrepancy.verdict.results import Cause, Diagnosis
from saddlering_ros.discrepancy.verdict.steady_lines import find_steady_lines, find_swings
from saddlering_ros.progress import IsCancelled, one_blas_thread, OnProgress, Watch

PARTIAL_SUBJECT = 0.5
"""A law is proposed beside partial causes that explain this share of the misfit, else alone: with
less than half explained, the causes describe the misfit worse than the law might."""


MAX_BASES = 3
"""Number of times that the search begins again about a better fit of the base. Chosen for cost:
each time is a whole search."""


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
    """Differences between `system` and `runs`, and their causes. The arguments: see `Problem`."""
    return diagnose_problem(Problem(
        system, runs, settings or Settings(), assumptions or Assumptions(), start, proposals,
        Watch('diagnose', on_progress, is_cancelled)))


@one_blas_thread()
def diagnose_problem(problem: Problem) -> Diagnosis:
    """Differences between the system and the runs of a problem, and their causes."""
    began, watch = clock.monotonic(), problem.watch
    refuse_repeats(problem.all_runs)
    start, slow_lines = _without_slow_lines(prepare(problem))
    search = _searched(start)
    space, fit, alternatives, log = search.space, search.fit, search.alternatives, search.log
    observability = observed(search.begun)
    before = residual_of(space, space.base)
    after = residual_of(space, fit) if fit.candidate.effects else before
    judgement = judge(space, fit, alternatives, before, after)
    lines = find_steady_lines(space.problem, space.trials)
    log.immaterial += lines.immaterial

    separations: tuple[Separation, ...] = ()
    if judgement.verdict == 'ambiguous':
        watch.progress('next test', 0.85)
        separations = separate_open_models(space, fit, alternatives)
    watch.progress('misfit reduction', 0.88)
    published = publish(space, fit, alternatives, before, after)
    law = None
    if judgement.verdict == 'unknown' and problem.assumptions.proposes_law:
        watch.progress('search for a law', 0.9)
        # Beside partial causes that explain much, else for all of the misfit. The published fits
        # hold no nuisance parameters, which would take a share of the misfit from the law.
        is_partial = judgement.explained >= PARTIAL_SUBJECT
        subject = published.fits.after if is_partial else published.fits.before
        proposer = Proposer(space.metric, space.max_pairs)
        law = proposer.law_for(subject)
    steady = (*lines.causes, *slow_lines)
    verdict = 'named' if steady and judgement.verdict == 'none' else judgement.verdict
    causes = [replace(cause, partial=verdict == 'unknown')
              for cause in (*published.causes, *steady)]
    return Diagnosis(
        verdict=verdict,
        causes=tuple(sorted(causes, key=lambda cause: -cause.visible)),
        base=published.base,
        base_alone=published.base_alone,
        gain=published.gain,
        explained=judgement.explained,
        next_test=separations[0].proposal.sentence if separations else None,
        separations=separations,
        warnings=(*judgement.warnings, *published.warnings),
        converged=space.base.converged and fit.converged and published.converged,
        runs=published.runs,
        fits=published.fits,
        law=law,
        residual_before=before,
        residual_after=after,
        observability=replace(observability, limits=(*observability.limits, *lines.limits)),
        search=log,
        simulations=space.problem.simulations,
        seconds=clock.monotonic() - began,
    )


def _without_slow_lines(space: ModelSpace) -> tuple[ModelSpace, tuple[Cause, ...]]:
    """The space about runs without their slow steady lines, and these lines."""
    swings = find_swings(space.metric, space.base, space.trials)
    if swings is None:
        return space, ()
    return prepare(space.problem.with_runs(swings.runs)), swings.causes


def _searched(start: ModelSpace) -> Search:
    """The search, begun again while the model that it found leads to a better base."""
    search = _search(start)
    for _ in range(MAX_BASES):
        deeper = better_base(search.space, search.fit)
        if deeper is None:
            break
        search = _search(space_about(start.problem, deeper))
    return search


def _search(begun: ModelSpace) -> Search:
    """Select effects, adapt the nuisance parameters to them, check the alternatives."""
    space, log = begun, SearchLog()
    fit = select(space, log)
    alternatives: Alternatives = {}
    space.watch.progress('check of alternatives', 0.75)
    if fit.candidate.effects:
        space, fit = moved_to(space, fit)
        if space.problem.assumptions.relearns:  # With less noise, more effects may show.
            fit = forward(space, fit, log)
        fit = prune(space, fit, log)
        fit, alternatives = check_alternatives(space, fit, log)
    return Search(begun, space, fit, alternatives, log)
