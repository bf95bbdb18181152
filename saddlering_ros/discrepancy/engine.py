"""The diagnosis step by step: noise, base fit, signatures, selection, alternatives, gain.

For any simulator that follows `System` it finds where measurement and simulation differ, which
cause explains it, which causes cannot be told apart, and what no cause of the catalogue explains.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
import time as clock

from saddlering_ros.discrepancy.next_step import law_for, next_test_of
from saddlering_ros.discrepancy.problem.problem import Problem
from saddlering_ros.discrepancy.problem.system import Array
from saddlering_ros.discrepancy.search.selection import (
    check_alternatives,
    learnt_without,
    Search,
    search_about,
    search_beside_error,
)
from saddlering_ros.discrepancy.search.signatures import observed
from saddlering_ros.discrepancy.search.space import prepare
from saddlering_ros.discrepancy.verdict import established, results, wording
from saddlering_ros.discrepancy.verdict.established import Publication, publish, remainder_of
from saddlering_ros.discrepancy.verdict.freed_law import narrow_laws
from saddlering_ros.discrepancy.verdict.naming import (
    exceeds_declared_error,
    explained_share_of,
    judge,
    Judgement,
    residual_of,
    stability_of,
    uncertain_size,
    unshared,
    unsteady_sizes,
    wrong_inputs,
)
from saddlering_ros.discrepancy.verdict.results import Diagnosis, Residual, Verdict
from saddlering_ros.discrepancy.verdict.steady_lines import find_slow_lines, find_steady_lines
from saddlering_ros.progress import one_blas_thread

PARTIAL_SUBJECT = 0.5
"""A law is proposed beside partial causes that explain this share of the misfit, else alone: with
less than half explained, the causes describe the misfit worse than the law might."""


@one_blas_thread()
def diagnose_system(problem: Problem) -> Diagnosis:
    """Differences between the system and the runs of a problem, and their causes."""
    began, watch = clock.monotonic(), problem.watch
    start = prepare(problem)
    slow_lines, runs = find_slow_lines(start.metric, start.base, start.trials)
    search = search_about(prepare(problem.with_runs(runs)) if slow_lines else start)
    observability = observed(search.begun)
    watch.progress('misfit reduction', 0.8)
    answer = _answer(search)
    is_open = answer.judgement.verdict == 'unknown' and bool(problem.system.effects)
    if is_open and not problem.assumptions.is_persistent:
        watch.progress('causes beside model error', 0.83)
        answer = _beside_error(answer)
    space, fit, alternatives = answer.search.space, answer.search.fit, answer.search.alternatives
    judgement, published, log = answer.judgement, answer.published, search.log
    lines, immaterial, limits = find_steady_lines(space.problem, space.trials)
    log.immaterial += immaterial

    refits, near_limit, influence = stability_of(
        space, fit, alternatives, None if answer.process is None else answer.taken)
    doubts = unshared(refits) if judgement.verdict in ('named', 'ambiguous') else []
    judgement = judgement.doubted(doubts)
    is_ambiguous = judgement.verdict == 'ambiguous'
    if is_ambiguous:
        watch.progress('next test', 0.85)
    separations, by_held_out = next_test_of(space, fit, alternatives if is_ambiguous else {})
    law = None
    if judgement.verdict == 'unknown' and problem.assumptions.proposes_law:
        watch.progress('search for a law', 0.9)
        # Beside partial causes that explain much, else for all of the misfit. The published fits
        # hold no nuisance parameters, which would take a share of the misfit from the law.
        is_partial = judgement.explained >= PARTIAL_SUBJECT
        subject = published.fits.after if is_partial else published.fits.before
        law = law_for(search.space, subject)
    steady = (*lines, *slow_lines)
    verdict: Verdict = 'named' if steady and judgement.verdict == 'none' else judgement.verdict
    causes = sorted(
        (replace(cause, partial=verdict == 'unknown') for cause in (*published.causes, *steady)),
        key=lambda cause: -cause.visible)
    # A steady line that is found takes itself whole.
    taken = answer.taken if published.causes else float(bool(steady))
    is_other = verdict == 'unknown' and bool(
        doubts or established.other_laws(space, fit, alternatives))
    return Diagnosis(
        verdict=verdict,
        causes=tuple(causes),
        base=published.base,
        base_alone=published.base_alone,
        gain=published.gain,
        explained=judgement.explained,
        next_test=' '.join(filter(None, (
            wording.free_test_words(by_held_out),
            separations[0].proposal.sentence if separations else ''))) or None,
        separations=separations,
        warnings=judgement.warnings,
        converged=space.base.converged and fit.converged and published.converged,
        runs=published.runs,
        fits=published.fits,
        law=law,
        residual_before=answer.before,
        residual_after=answer.after,
        observability=replace(observability, limits=(*observability.limits, *limits)),
        search=log,
        simulations=space.problem.simulations,
        seconds=clock.monotonic() - began,
        complete=not answer.remainder and verdict != 'unknown',
        remainder=answer.remainder,
        probabilities=results.probabilities_of(verdict, causes, 0.0 if is_other else taken),
        refits=refits,
        near_limit=near_limit,
        influence=influence,
        held_out_evidence=by_held_out,
    )


HOPELESS = 0.5
"""Share of the misfit's power below which causes are not tried beside model error on a ring. No
cause that was established beside it, on declared machines and dirty rings, took less than 0.88
before."""


@dataclass(frozen=True)
class Answer:
    """A search, its verdict and its published numbers.

    before, after: residuals in the metric without learnt model error; process: that error, if it
    was learnt; taken: share of the misfit's power that the causes take in their best view.
    """

    search: Search
    judgement: Judgement
    before: Residual
    after: Residual
    published: Publication
    remainder: tuple[results.Remainder, ...]
    taken: float
    process: Array | None = None


def _answer(search: Search) -> Answer:
    """The verdict in the metric of noise, nuisance parameters and declared model error."""
    space, fit = search.space, search.fit
    before = residual_of(space, space.base)
    is_declared = any(space.problem.assumptions.allowed_error or ())
    if is_declared and not exceeds_declared_error(space, before):
        search, fit = replace(search, fit=space.base, alternatives={}), space.base
    after = residual_of(space, fit) if fit.candidate.effects else before
    published = publish(space, fit, search.alternatives, before, after)
    weak = _weakest(published.member_shares) or next(
        iter(established.under_declared_error(space, fit)), None)
    if is_declared and weak is not None and len(fit.candidate.effects) > 1:
        less, alternatives = check_alternatives(space, space.without(fit, weak), search.log)
        return _answer(replace(search, fit=less, alternatives=alternatives))
    judgement = judge(space, fit, search.alternatives, before, after)
    taken = 0.0 if published.shares is None else published.shares.best
    doubts = list(published.doubts)
    if is_declared and published.shares is not None and taken < results.MIN_TAKEN:
        doubts.append(wording.weak_words(
            ' and '.join(fit.candidate.ids), taken, results.MIN_TAKEN))
    if is_declared:
        doubts += established.shared_directions(space, fit, search.alternatives)
    doubts += uncertain_size(space, published.causes)
    return Answer(search, judgement.doubted(doubts), before, after, published,
                  remainder_of(space, fit, after), taken)


def _beside_error(strict: Answer) -> Answer:
    """The verdict if what remains is error of the model: whether causes are established beside it.

    A secondary cause that takes too little of what remains without it is left out, and what it
    took becomes model error. So is the smallest of causes that are not established together, or
    of which it has alternatives, because the main one may be established without it. If it is
    not, those that are established together are named, and if none are, all are told. On a ring,
    the main one is established by what it takes beside those that are left out, too.
    """
    noise_alone = strict.search.space
    has_forms = not noise_alone.problem.assumptions.exact_laws
    if has_forms and strict.taken < HOPELESS:
        return strict
    search, process = search_beside_error(strict.search)
    together: Answer | None = None
    unknown: Answer | None = None
    dropped: list[Array] = []
    most_dropped = 0.0
    proven: dict[str, Publication] = {}
    while search.fit.candidate.effects:
        space, fit = search.space, search.fit
        before, after = residual_of(space, space.base), residual_of(space, fit)
        published = publish(space, fit, search.alternatives, before, after, process)
        sizes = {cause.effect: cause.visible for cause in published.causes}
        main = published.main.effect
        weak = _weakest({name: own for name, own in published.member_shares.items()
                         if name != main})
        if has_forms and len(sizes) > 1 and not established.doubts_on_main(space, fit, published):
            proven.setdefault(main, published)
        if weak is None:
            answer = _answer_beside(strict, search, published, process, most_dropped, proven)
            if answer.judgement.verdict == 'unknown' and has_forms:
                unknown = replace(strict, judgement=strict.judgement.doubted([
                    wording.suspect_words(fit.candidate.ids, answer.judgement.warnings)]))
            elif answer.judgement.verdict == 'unknown':
                unknown = unknown or answer
            elif answer.judgement.verdict == 'named' or len(sizes) == 1:
                return answer
            else:
                together = together or answer
            if len(sizes) == 1:
                return together or unknown or strict
            weak = min(sizes, key=lambda name: sizes[name])
        most_dropped = max(most_dropped, sizes[weak])
        search, process = learnt_without(noise_alone, search, weak, dropped)
    return together or unknown or strict


def _answer_beside(
    strict: Answer, search: Search, published: Publication, process: Array, most_dropped: float,
    proven: Mapping[str, Publication],
) -> Answer:
    """The verdict on causes beside model error; most_dropped: visible size of what is left out.

    proven: models in which a main cause is established beside others, by its id.
    """
    noise_alone, fit = strict.search.space, search.fit
    whitened = noise_alone.metric.whiten(
        published.fits.after.prediction - noise_alone.problem.measured)
    seen = replace(published.fits.after, whitened=whitened, misfit=float(whitened @ whitened))
    left = residual_of(noise_alone, seen)
    assert published.shares is not None
    main, taken, told = published.main, published.shares.best, [wording.REST_IS_ERROR]
    # Of several laws beside another cause, some pair fits a cause that is in no catalogue.
    is_sure = main.group == (main.effect,)
    beside = proven.get(main.effect) if len(published.causes) == 1 and is_sure else None
    if beside is not None:
        doubts = established.other_laws(search.space, fit, search.alternatives)
        taken = beside.member_shares[main.effect].best
        told.append(wording.beside_words(main.effect, taken, [
            cause.effect for cause in beside.causes if cause.effect != main.effect]))
    else:
        doubts = established.doubts_of(search.space, fit, published, search.alternatives)
    if noise_alone.problem.assumptions.exact_laws:
        doubts += unsteady_sizes(search.space, fit, published.causes)
        narrow = narrow_laws(noise_alone, published.plain)
        # The law is another one, whatever this one takes.
        doubts, taken = doubts + narrow, 0.0 if narrow else taken
    else:
        doubts += established.like_sound_errors(
            noise_alone, strict.search.fit, fit, fit.candidate.ids)
        doubts += wrong_inputs(noise_alone, fit)
        if not doubts and not most_dropped:  # What is left out may be one shape.
            doubts += established.one_shape_left(noise_alone, fit)
    doubts += uncertain_size(search.space, published.causes)
    most = established.MAINLY if is_sure else 1.0 - results.MIN_TAKEN
    if most_dropped**2 > most * main.visible**2:
        doubts.append(wording.AS_LARGE)
    is_open = any(len(cause.group) > 1 for cause in published.causes)
    verdict: Verdict = 'unknown' if doubts else 'ambiguous' if is_open else 'named'
    judgement = Judgement(verdict, explained_share_of(strict.before, left), tuple(doubts or told))
    return Answer(search, judgement, strict.before, left, published,
                  remainder_of(noise_alone, seen, left), taken, process)


def _weakest(shares: Mapping[str, established.Shares]) -> str | None:
    """The cause that takes least, if it is too little to be established."""
    weak = [name for name, own in shares.items() if own.best < results.MIN_TAKEN]
    return min(weak, key=lambda name: shares[name].best, default=None)
