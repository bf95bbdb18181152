"""The diagnosis step by step: noise, base fit, signatures, selection, alternatives, gain.

For any simulator that follows `System` it finds where measurement and simulation differ, which
cause explains it, which causes cannot be told apart, and what no cause of the catalogue explains.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import time as clock

import numpy as np

from saddlering_ros.discrepancy.law.proposal import LawProposal, Proposer
from saddlering_ros.discrepancy.next_test import Proposal, separate_open_models, Separation
from saddlering_ros.discrepancy.problem.experiment import (
    Assumptions,
    Experiment,
    Metric,
    noise_metric,
    nuisance_columns,
    offset_columns,
    refuse_repeats,
)
from saddlering_ros.discrepancy.problem.fits import (
    Candidate,
    declared_start,
    Fit,
    fit_base,
    refit,
    run_refits,
    tangent,
)
from saddlering_ros.discrepancy.problem.system import (
    Array,
    DiscrepancyError,
    RunBlocks,
    Settings,
    System,
)
from saddlering_ros.discrepancy.search.comparison import Comparison, SearchLog
from saddlering_ros.discrepancy.search.limits import observed
from saddlering_ros.discrepancy.search.selection import (
    Alternatives,
    check_alternatives,
    forward,
    prune,
    select,
)
from saddlering_ros.discrepancy.search.signatures import (
    ChangeScale,
    measure_signatures,
    shapes_tried,
    whitened_by,
)
from saddlering_ros.discrepancy.search.space import ModelSpace, refit_full_jacobian
from saddlering_ros.discrepancy.verdict.judgement import judge, Judgement, residual_of
from saddlering_ros.discrepancy.verdict.publication import Publication
from saddlering_ros.discrepancy.verdict.results import Cause, Diagnosis
from saddlering_ros.discrepancy.verdict.steady_lines import find_steady_lines, find_swings
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
    evidence = {name: Comparison(space, space.without(fit, name), fit).evidence()
                for name in fit.candidate.ids}
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
    proposer = Proposer(space.metric, published.runs, space.max_pairs, settings.error_rate,
                        settings.max_rounds, space.watch)
    is_partial = judgement.explained >= PARTIAL_SUBJECT
    return proposer.law_for(fits.after if is_partial else fits.before)


MIN_PAIRS = 12
"""Smallest number of degrees of freedom of the level, whatever the length of the stretches."""

BASE_ROUNDS = 25
"""Rounds of the fit of the base parameters alone."""

MIN_DEEPER, MIN_DEEPER_SHARE = 10.0, 0.01
"""A minimum is deeper if its misfit is smaller by more than this, and by more than this share."""


def prepare(
    experiment: Experiment, start: Array | None, settings: Settings, watch: Watch
) -> ModelSpace:
    """Learn the noise, marginalise nuisance parameters, fit the base, compute signatures."""
    watch.progress('noise of the channels', 0.0)
    metric = noise_metric(experiment, experiment.assumptions.learn_noise(experiment.runs, None))
    metric = metric.marginalise(offset_columns(experiment))
    watch.progress('fit without effects', 0.05)
    rough = fit_base(metric, start, settings.seed, watch.check)
    return space_about(experiment, rough, settings, watch)


def space_about(
    experiment: Experiment, rough: Fit, settings: Settings, watch: Watch
) -> ModelSpace:
    """Learn the noise from the residual of a rough fit, fit the base, compute signatures."""
    residual = experiment.by_run(rough.prediction - experiment.measured)
    metric = noise_metric(
        experiment, experiment.assumptions.learn_noise(experiment.runs, residual)
    )
    metric = _with_nuisances(metric, rough)
    base = _fit_base_again(metric, rough, watch)
    watch.progress('sensitivity to each effect', 0.25)
    watch.check()
    sensitivities = tangent(metric, base)
    scale = ChangeScale(experiment, sensitivities.plain)
    signatures = measure_signatures(metric, base, sensitivities, scale)
    lines = sum(bool(effect.line) for effect in experiment.system.effects)
    trials = max(1, shapes_tried(signatures) + lines)
    return ModelSpace(
        metric=metric, base=base, base_tangent=sensitivities, signatures=signatures, scale=scale,
        trials=trials, settings=settings, watch=watch)


def better_base(space: ModelSpace, fit: Fit) -> Fit | None:
    """The base refitted from its parameters in the model with effects, if that minimum is deeper.

    Otherwise an effect without influence could be named because it leads the fit to another
    minimum.
    """
    if not fit.candidate.effects:
        return None
    count = space.base.theta_unit.size
    wanted = [
        refit(
            space.metric,
            Candidate(),
            fit.theta_unit[:count],
            rounds=space.settings.rounds,
            full_jacobian=True,
        )
    ]
    found = run_refits(space.metric, wanted, space.watch.check)[0]
    gain = space.base.misfit - found.misfit
    return found if gain > max(MIN_DEEPER, MIN_DEEPER_SHARE * found.misfit) else None


def moved_to(space: ModelSpace, fit: Fit) -> tuple[ModelSpace, Fit]:
    """Nuisance columns evaluated with the found effects, and base and model refitted.

    A load that is wrong by some percent moves the point at which rollers begin to touch, and
    with it the contribution of unequal rollers. Seen from the model without the effects, this
    difference is evidence.
    """
    metric = _with_nuisances(_relearnt(space.metric, fit), fit)
    base, fit = refit_full_jacobian(
        metric, [space.base, fit], space.settings.max_rounds, space.watch
    )
    sensitivities = tangent(metric, base)
    signatures = whitened_by(metric, space.signatures, sensitivities)
    moved = ModelSpace(
        metric=metric, base=base, base_tangent=sensitivities, signatures=signatures,
        scale=space.scale, trials=space.trials,
        settings=space.settings, watch=space.watch)
    return moved, moved.keep(fit)


def _with_nuisances(metric: Metric, fit: Fit) -> Metric:
    """The metric with every nuisance parameter marginalised, evaluated at `fit`."""
    return metric.marginalise(nuisance_columns(metric.experiment, fit.point, fit.prediction))


def _relearnt(metric: Metric, fit: Fit) -> Metric:
    """The noise, learnt again from the residual of a fit if its source is residuals."""
    experiment = metric.experiment
    if not experiment.assumptions.relearns:
        return metric
    residual = experiment.by_run(fit.prediction - experiment.measured)
    return noise_metric(experiment, experiment.assumptions.learn_noise(experiment.runs, residual))


def _fit_base_again(metric: Metric, rough: Fit, watch: Watch) -> Fit:
    """The base refitted in a new metric, from the rough fit and from the declared start.

    A large misfit has several minima.
    """
    starts = [
        rough.theta_unit,
        declared_start(metric.experiment.system.base_parameters),
    ]
    wanted = [
        refit(metric, Candidate(), start, rounds=BASE_ROUNDS, full_jacobian=True)
        for start in starts
    ]
    return min(run_refits(metric, wanted, watch.check), key=lambda fit: fit.misfit)


def first_guess(system: System, start: Mapping[str, float] | None) -> Array | None:
    """First guesses of base parameters, bound-scaled; declared ones where none are given."""
    if start is None:
        return None
    known = {item.name: item for item in system.base_parameters}
    for name, value in start.items():
        if name not in known:
            raise DiscrepancyError(
                f'start: there is no base parameter {name!r}; there are {", ".join(known)}')
        item = known[name]
        if not (np.isfinite(value) and (item.periodic or item.low <= value <= item.high)):
            raise DiscrepancyError(
                f'start: {name} = {value:g} is outside {item.low:g} to {item.high:g}')
    return np.array(
        [
            item.to_unit(start[name]) if name in start else item.first_guess
            for name, item in known.items()
        ]
    )


