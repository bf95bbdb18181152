"""The diagnosis step by step: noise, base fit, signatures, selection, alternatives, gain.

For any simulator that follows `System` it finds where measurement and simulation differ, which
cause explains it, which causes cannot be told apart, and what no cause of the catalogue explains.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
import time as clock

import numpy as np

from saddlering_ros.discrepancy.law.of_residual import law_for
from saddlering_ros.discrepancy.law.proposal import LawProposal
from saddlering_ros.discrepancy.next_step import open_models
from saddlering_ros.discrepancy.problem import fits as fitting
from saddlering_ros.discrepancy.problem.fits import Fit, Tangent
from saddlering_ros.discrepancy.problem.problem import Problem
from saddlering_ros.discrepancy.problem.system import Array, RunBlocks
from saddlering_ros.discrepancy.search import selection
from saddlering_ros.discrepancy.search.among import search_among_small_errors
from saddlering_ros.discrepancy.search.evidence import with_forms
from saddlering_ros.discrepancy.search.lack_of_fit import consistency_tests
from saddlering_ros.discrepancy.search.selection import Search
from saddlering_ros.discrepancy.search.signatures import observed
from saddlering_ros.discrepancy.search.space import ModelSpace, prepare
from saddlering_ros.discrepancy.verdict import established, parts, results, wording, wrong_law
from saddlering_ros.discrepancy.verdict import published as publishing
from saddlering_ros.discrepancy.verdict.parts import cause_of_some_runs, stability_of
from saddlering_ros.discrepancy.verdict.published import Publication, publish
from saddlering_ros.discrepancy.verdict.steady_lines import find_slow_lines, find_steady_lines
from saddlering_ros.progress import one_blas_thread
from saddlering_ros.quantities import allowed_misfit

PARTIAL_SUBJECT = 0.5
"""A law is proposed beside partial causes that explain this share of the misfit, else alone: with
less than half explained, the causes describe the misfit worse than the law might."""

MUCH_LESS = 0.5
"""Share of what a fit beside nuisance parameters leaves, below which the published model leaves
less. A base far off left sixteen times as much; laws of another form 1.7 times."""

Rest = tuple[RunBlocks, str, float, str]
"""Run, view, share of range and coordinate of a rest."""


@one_blas_thread()
def diagnose_system(problem: Problem) -> results.Diagnosis:
    """Differences between the system and the runs of a problem, and their causes."""
    began, watch = clock.monotonic(), problem.watch
    start = prepare(problem)
    slow_lines, runs = find_slow_lines(start.metric, start.base, start.trials)
    search = selection.search_about(prepare(problem.with_runs(runs)) if slow_lines else start)
    # What two sessions could show of a rig that differs between them.
    observability = observed(search.begun.with_inputs()
                             if problem.assumptions.is_persistent else search.begun)
    watch.progress('misfit reduction', 0.8)
    answer, (refits, near_limit, influence), is_other = _tested(search, _judged(search))
    space, fit, log = answer.search.space, answer.search.fit, search.log
    lines, immaterial, limits = find_steady_lines(space.problem, space.trials)
    log.immaterial += immaterial
    published = answer.published
    separations: tuple[results.Separation, ...] = ()
    by_held_out: tuple[results.HeldOutEvidence, ...] = ()
    if (answer.verdict != 'unknown' or answer.explained >= results.PARTED) and (
            models := open_models(answer.search)):
        separations = models.separations()
        # By noise alone, a held-out run excluded true causes beside small errors of other kinds.
        if not (answer.remainder and space.problem.assumptions.has_small_errors and (
                answer.is_beside_error or answer.verdict == 'unknown')):
            by_held_out = models.judged_by_held_out(is_beside_error=answer.is_beside_error)
    steady = (*lines, *slow_lines)
    verdict: results.Verdict = 'named' if steady and answer.verdict == 'none' else answer.verdict
    causes = _causes_of(answer, steady, is_partial=verdict == 'unknown')
    taken = answer.taken if published.causes else float(bool(steady))  # A steady line's is whole.
    # A misfit that noise and small errors of a sound machine explain is no sign of a cause.
    nothing = None if _left_in(search.space, search.space.base, answer.before) else float(
        np.mean([refit.first is None for refit in refits]))
    # Of established causes beside a remainder that is larger, none may be the main one.
    rest = max((one.share_of_range for one in answer.remainder), default=0.0)
    moved = max((cause.visible for cause in causes), default=0.0)
    listed = min(1.0, moved / max(rest, 1e-300)) ** 2
    return results.Diagnosis(
        verdict=verdict,
        causes=tuple(causes),
        base=published.base,
        base_alone=published.base_alone,
        gain=published.gain,
        explained=answer.explained,
        next_test=' '.join(filter(None, (
            wording.free_test_words(by_held_out),
            separations[0].proposal.sentence if separations else ''))) or None,
        separations=separations,
        warnings=answer.warnings if verdict == 'unknown' else (
            *answer.warnings, *parts.hidden_causes(space, published.fits, published.causes)),
        converged=space.base.converged and fit.converged and published.converged,
        runs=published.runs,
        fits=published.fits,
        law=_law_of(answer),
        residual_before=answer.before,
        residual_after=answer.after,
        observability=replace(observability, limits=(*observability.limits, *limits)),
        search=log,
        simulations=space.problem.simulations,
        seconds=clock.monotonic() - began,
        complete=not answer.remainder and verdict != 'unknown',
        remainder=answer.remainder,
        probabilities=results.probabilities_of(
            verdict, causes, 0.0 if is_other else taken, nothing, listed),
        refits=refits,
        near_limit=near_limit,
        influence=influence,
        held_out_evidence=by_held_out,
    ).unpredicted(_remainder_of(space, [*_unpredicted(space, fit)]) if verdict == 'named' or (
        verdict != 'ambiguous' and space.problem.assumptions.exact_laws) else ())


@dataclass(frozen=True)
class Answer:
    """A search, its verdict with warnings for the reader, and its published numbers.

    before, after: residuals in the metric without learnt model error; explained: share of
    the misfit that the causes explain; taken: share of the misfit's power that they take in their
    best view; is_beside_error: whether the causes are judged beside learnt error of the model.
    """

    search: Search
    verdict: results.Verdict
    warnings: tuple[str, ...]
    before: results.Residual
    after: results.Residual
    published: Publication
    remainder: tuple[results.Remainder, ...]
    explained: float
    taken: float
    is_beside_error: bool = False

    def doubted(self, doubts: Sequence[str]) -> 'Answer':
        """The same with reasons, if there are any, why no cause is established."""
        if not doubts:
            return self
        return replace(self, verdict='unknown', warnings=(*self.warnings, *doubts))

    def noted(self, *sentences: str) -> 'Answer':
        """The same with sentences for the reader, each once."""
        return replace(self, warnings=(*dict.fromkeys((*self.warnings, *sentences)),))


def _judged(search: Search) -> Answer:
    """The verdict by noise alone, or if it is open by the rest as error of model or machine.

    A ring that leaves more than its laws may err is open by noise alone, whatever its numbers are.
    """
    space, fit, assumptions = search.space, search.fit, search.space.problem.assumptions
    is_first = assumptions.has_small_errors and bool(fit.candidate.effects) and all(
        left.is_real_and_material(space.settings) for left in (
            space.slow_residual(fit), space.tests.slow(with_forms(space, fit, fit))))
    found, doubts = _among_small_errors(search) if is_first else (None, [])
    if found is not None:
        return found
    answer = _answer(search)
    effects = space.problem.system.effects
    if answer.verdict != 'unknown' or not effects or assumptions.is_persistent:
        return answer
    if assumptions.exact_laws:
        space.watch.progress('causes beside model error', 0.83)
        return _beside_error(answer)
    if not is_first:
        found, doubts = _among_small_errors(answer.search)
    return found or answer.doubted(doubts)


def _tested(strict: Search, answer: Answer) -> tuple[Answer, parts.Stability, bool]:
    """An answer after refits and a look at each run, by noise alone (strict).

    With it its stability, and whether a law that is not in it does as well or better. Beside
    learnt error a cause of some runs can be error.
    """
    stability = stability_of(answer.search, answer.taken if answer.is_beside_error else None,
                             answer.published.causes)
    is_established = answer.verdict in ('named', 'ambiguous')
    unshared = established.unshared(
        stability[0], strict.space.problem.titles) if is_established else []
    answer = answer.doubted(unshared)
    confined = None if answer.verdict == 'none' else cause_of_some_runs(strict.space, strict.fit)
    causes, is_better = answer.published.causes, False
    if confined is not None:
        name, sentence = confined
        is_better = not answer.is_beside_error and not any(name in cause.group for cause in causes)
        # Small errors can hide where a main cause fits: a worn arc, of 22 % at one elevation and
        # 1 % at the other one, had a name for a load offset that was not listed.
        is_unlike = (strict.space.problem.assumptions.has_small_errors and answer.is_beside_error
                     and bool(causes) and answer.published.main.effect == name)
        answer = answer.doubted([sentence]) if is_better or is_unlike else answer.noted(sentence)
    elif answer.verdict == 'unknown' and (run := parts.odd_run(
            (strict.space.base, strict.fit), strict.space.problem)):
        answer = answer.noted(wording.ODD_RUN.format(run))
    answer, changed = _of_one_size(answer)
    if answer.verdict == 'unknown':  # Learnt model error takes what a bound leaves.
        answer = answer.noted(*publishing.base_at_bounds(strict.space.problem, strict.fit))
    return answer, stability, answer.verdict == 'unknown' and bool(
        unshared or changed or is_better or established.other_laws(answer.search))


def _of_one_size(answer: Answer) -> tuple[Answer, list[str]]:
    """An answer whose established causes keep their size, and sentences on those that do not."""
    space, fit = answer.search.space, answer.search.fit
    if answer.verdict not in ('named', 'ambiguous') or not space.problem.assumptions.exact_laws:
        return answer, []
    # Another member of a group may keep its size.
    alone = [cause for cause in answer.published.causes if len(cause.group) == 1]
    unlike = [] if answer.is_beside_error else parts.unsteady_sizes_alone(space, fit, alone)
    answer = answer.doubted(unlike)
    changed, is_doubt = parts.changed_sizes(space, answer.published, answer.remainder)
    answer = answer.doubted(changed) if is_doubt else answer.noted(*changed)
    return answer, [*unlike, *changed]


def _causes_of(answer: Answer, steady: Sequence[results.Cause], *,
               is_partial: bool) -> list[results.Cause]:
    """Published causes with other places, and steady lines: first the largest, as far as sure."""
    space, fit = answer.search.space, answer.search.fit
    places = {name: selection.other_places(space, fit, name) for name in fit.candidate.ids
              if answer.verdict in ('named', 'ambiguous')}
    return sorted(
        (replace(cause, partial=is_partial, elsewhere=tuple(
            other.point.effects[cause.effect] for other in places.get(cause.effect, ())))
         for cause in (*answer.published.causes, *steady)),
        key=lambda cause: -(cause.visible if is_partial else cause.sure))


def _law_of(answer: Answer) -> LawProposal | None:
    """The law that is proposed for an open misfit.

    Beside partial causes that explain much, else for all of the misfit. The published fits hold
    no nuisance parameters, which would take a share of the misfit from the law.
    """
    problem = answer.search.space.problem
    if answer.verdict != 'unknown' or not problem.assumptions.proposes_law:
        return None
    problem.watch.progress('search for a law', 0.9)
    fits = answer.published.fits
    return law_for(answer.search.space,
                   fits.after if answer.explained >= PARTIAL_SUBJECT else fits.before)


def _answer(search: Search) -> Answer:
    """The verdict in the metric of noise, nuisance parameters and declared model error."""
    space, fit = search.space, search.fit
    before = _residual_of(space, space.base)
    is_declared = any(space.problem.assumptions.allowed_error or ())
    if is_declared and not _left(space, space.base, before):
        search, fit = replace(search, fit=space.base, alternatives={}, covered=(
            1.0 if _left(space, space.base, before, parts.HALF) else parts.HALF)), space.base
    after = _residual_of(space, fit) if fit.candidate.effects else before
    published = publish(search, before, after)
    weak = _weakest(published.member_shares) or established.under_declared_error(space, fit)
    if is_declared and weak is not None and len(fit.candidate.effects) > 1:
        less, alternatives = selection.check_alternatives(
            space, space.without(fit, weak), search.log)
        return _answer(replace(search, fit=less, alternatives=alternatives))
    taken = 0.0 if published.shares is None else published.shares.best
    fit, after = _leaving_less(space, fit, after, published)
    warnings, is_established = established.judge_alone(
        search, before, after, _left_in(space, fit, after), published)
    if not published.causes and not is_established:
        warnings = [*warnings, *published.doubts]
    return Answer(
        search, _verdict(is_established, published), tuple(warnings), before, after, published,
        _remainder_of(space, _left(space, fit, after)),
        before.explained_by(after) if published.causes else 0.0, taken)


def _leaving_less(space: ModelSpace, fit: Fit, after: results.Residual,
                  published: Publication) -> tuple[Fit, results.Residual]:
    """A fit of a ring with its residual, or the published one if that leaves much less.

    Beside nuisance parameters, which take most of what it leaves, the base of a fit can lie far
    from measured data that the published model meets.
    """
    if (space.problem.assumptions.exact_laws or not published.causes
            or not after.slow.is_real_and_material(space.settings)):
        return fit, after
    residual = _residual_of(space, seen := _seen_in(space, published.fits.after))
    leaves_less = residual.slow.visible < MUCH_LESS * after.slow.visible
    return (seen, residual) if leaves_less else (fit, after)


def _verdict(is_established: bool, published: Publication) -> results.Verdict:
    """The verdict on causes, or on a model without any."""
    if not is_established:
        return 'unknown'
    if not published.causes:
        return 'none'
    return 'ambiguous' if any(len(cause.group) > 1 for cause in published.causes) else 'named'


def _among_small_errors(strict: Search) -> tuple[Answer | None, list[str]]:
    """The verdict on a ring if what remains is small errors of all that its catalogue lists.

    Without a verdict, the reasons for that.
    """
    alone = strict.space
    alone.watch.progress('causes beside model error', 0.83)
    among = search_among_small_errors(strict)
    if among is None:
        return None, [wording.NO_SMALL_ERRORS]
    if not among.best.visible:
        return None, []
    before, after = (_residual_of(among.space, fit) for fit in (among.space.base, among.best.fit))
    search, published, main, doubts = established.judge_among(strict, among, before, after)
    if doubts:
        return None, [wording.suspect_words(alone.problem.titles[main], doubts)]
    # What the small errors could take of the main cause is left.
    return _answer_beside(alone, _residual_of(alone, alone.base), search, published, [
        wording.OUTLIER.format(alone.problem.titles[name], among.times(name))
        for name in search.fit.candidate.ids],
        1.0 - 1.0 / among.times(main), is_established=True), []


def _beside_error(strict: Answer) -> Answer:
    """The verdict on a machine if what remains is error of the model.

    A secondary cause that takes too little of what remains without it is left out, and what it
    took becomes model error. So is the smallest of causes that are not established together, or
    of which it has alternatives, because the main one may be established without it. If it is
    not, those that are established together are named, and if none are, all are told.
    """
    noise_alone = strict.search.space
    search = selection.search_beside_error(strict.search)
    answers: dict[results.Verdict, Answer] = {}
    dropped: list[Array] = []
    powers: dict[str, float] = {}
    while search.fit.candidate.effects:
        space, fit = search.space, search.fit
        before, after = _residual_of(space, space.base), _residual_of(space, fit)
        # Model error can take what base parameters imitate, so that these would be open.
        published = publish(search, before, after)
        causes = {cause.effect: cause for cause in published.causes}
        weak = _weakest({name: shares for name, shares in published.member_shares.items()
                         if name != published.main.effect})
        if weak is None:
            narrow, bent = wrong_law.narrow_laws(noise_alone, published.plain)
            published = replace(published, causes=tuple(
                replace(cause, another_law=narrow.get(cause.effect))
                for cause in published.causes))
            doubts, taken = established.doubts_beside_error(
                strict.search, search, published, powers)
            answer = _answer_beside(
                noise_alone, strict.before, search, published,
                doubts or [wording.REST_IS_ERROR, *bent], taken, is_established=not doubts)
            if not doubts and (answer.verdict == 'named' or len(causes) == 1):
                return answer
            answers.setdefault(answer.verdict, answer)
            if len(causes) == 1:
                break
            weak = min(published.causes, key=lambda cause: cause.visible).effect
        powers[weak] = published.power_of(causes[weak])
        search = selection.learnt_without(noise_alone, search, weak, dropped)
    return answers.get('ambiguous') or answers.get('unknown') or strict


def _answer_beside(alone: ModelSpace, before: results.Residual, search: Search,
                   published: Publication, warnings: Sequence[str], taken: float, *,
                   is_established: bool) -> Answer:
    """The answer on causes beside learnt error, with what they leave in the metric without it."""
    seen = _seen_in(alone, published.fits.after)
    left = _residual_of(alone, seen)
    rests = _remainder_of(alone, _left(alone, seen, left))
    told = tuple(one for one in warnings if rests or one != wording.REST_IS_ERROR)
    return Answer(search, _verdict(is_established, published), told, before, left, published,
                  rests, before.explained_by(left), taken, is_beside_error=True)


def _residual_of(space: ModelSpace, fit: Fit) -> results.Residual:
    """The residual of a fit; with consistency tests if laws are assumed to be exact."""
    sensitivities, slow = space.tangent_of(fit), space.slow_residual(fit)
    consistency = consistency_tests(
        space.metric, fit, sensitivities, slow, space.max_pairs,
    ) if space.problem.assumptions.exact_laws else []
    shapes = space.tests.shapes(fit, sensitivities)
    return results.Residual(slow, space.tests.fast(fit), tuple(shapes), tuple(consistency))


def _remainder_of(space: ModelSpace, left: Sequence[Rest]) -> tuple[results.Remainder, ...]:
    """Rests in words and in units, largest first."""
    problem, remainder = space.problem, []
    units = getattr(problem.system, 'units', {})
    for run, view, share, along in sorted(left, key=lambda place: -place[2]):
        noise = space.metric.noise_power(run, view) ** 0.5
        size = share * problem.view_ranges[view]
        remainder.append(results.Remainder(run.name, view, share, size / max(noise, 1e-300), along,
                                           size, units.get(view, '')))
    return tuple(remainder)


def _unpredicted(space: ModelSpace, model: Fit) -> Iterator[Rest]:
    """What a model leaves of held-out runs, fitted to them too, beyond what others keep."""
    problem = space.problem
    for run, joint, fit in fitting.refits_to_held_out(problem, model):
        for view, scale in problem.view_ranges.items():
            share = float(joint.view_sizes(fit.prediction - joint.measured, view)[-1])
            share *= joint.view_ranges[view] / scale
            usual = problem.view_sizes(model.prediction - problem.measured, view).max()
            noise = space.metric.noise_power(run, view) ** 0.5 / scale
            declared = max(space.settings.materiality, problem.allowed_sizes[view])
            if share > allowed_misfit(max(usual, noise), material=declared):
                yield run, view, share, ''


def _left(
    space: ModelSpace, fit: Fit, residual: results.Residual, factor: float = 1.0) -> list[Rest]:
    """Run, view, share of range and coordinate of each rest beyond noise and declared error.

    A declared error may have any smooth shape. A rest is therefore left if noise and declared
    error together are not as large by chance, and if its size beyond the noise alone exceeds the
    declared one. factor: of the declared sizes.
    """
    problem, settings = space.problem, space.settings
    slow, fast, names = residual.slow, residual.fast, problem.system.channel_names
    allowed = {view: factor * size for view, size in problem.allowed_sizes.items()}
    least = {view: max(settings.materiality, size) for view, size in allowed.items()}
    sized = residual
    if any(allowed.values()):  # beside the noise alone, without declared model error
        sensors = space.once(
            'sensors', space.base, lambda: replace(space, metric=space.metric.of_sensors()))
        plain, seen = space.tangent_of(fit).plain, _seen_in(sensors, fit)
        sensors.once('tangent', seen, lambda: Tangent(plain, sensors.metric.whiten(plain)))
        sized = _residual_of(sensors, seen)
    left: list[Rest] = []
    everywhere = slow.is_real_and_material(settings)
    for view, weights in problem.system.views.items():
        along = min(((test.p_value, test.coordinate) for test in residual.shapes
                     if test.view == view), default=(1.0, 'time'))[1]
        for number, run in enumerate(problem.runs):
            chance = min(slow.chances.get((names[channel], run.name), 1.0)
                         for channel in np.flatnonzero(weights))
            is_slow = everywhere or chance < settings.error_rate
            size = float(sized.slow.sizes[view][number]) if is_slow else 0.0
            if allowed[view] and (view, run.name) in fast.powers:
                size = float(np.hypot(size, sized.fast.powers.get((view, run.name), 0.0) ** 0.5))
            if size >= least[view]:
                left.append((run, view, size, along))
    is_fast = fast.is_real_and_material(settings) and allowed.get(fast.view) == 0.0
    if is_fast and (fast.run, fast.view) not in [(run.name, view) for run, view, *_ in left]:
        run = next(run for run in problem.runs if run.name == fast.run)
        left.append((run, fast.view, fast.visible, 'time'))
    told = {view for _, view, _, _ in left}
    # The form error of a ring's laws has shapes, too.
    shapes = residual.shapes if problem.assumptions.exact_laws else ()
    sizes = {(test.view, test.coordinate): test.beyond_noise for test in sized.shapes}
    for test in (*residual.consistency, *shapes):
        size = test.visible
        if allowed[test.view]:
            size = sizes.get((test.view, test.coordinate), size)
        is_real = test.p_value < settings.error_rate and size >= least[test.view]
        if is_real and test.view not in told:
            left.append((problem.runs[test.run], test.view, size, test.coordinate))
            told.add(test.view)
    return left


def _seen_in(space: ModelSpace, fit: Fit) -> Fit:
    """A fit with its misfit in the metric of another space."""
    whitened = space.metric.whiten(fit.prediction - space.problem.measured)
    return replace(fit, whitened=whitened, misfit=float(whitened @ whitened))


def _left_in(space: ModelSpace, fit: Fit, after: results.Residual) -> str:
    """Where a real and material residual remains, in all or in one channel of one run; or ''."""
    # The laws of a ring are judged in each view, against the form error of the effects.
    if space.problem.assumptions.exact_laws:
        return ', '.join(f'{view} in {run.name} along {along}'
                         for run, view, _, along in _left(space, fit, after))
    is_left = any(part.is_real_and_material(space.settings) for part in (after.slow, after.fast))
    return (after.slow.where or after.fast.view) if is_left else ''


def _weakest(shares: Mapping[str, results.Shares]) -> str | None:
    """The cause that takes least, if it is too little to be established."""
    weak = [name for name, taken in shares.items() if taken.best < taken.required]
    return min(weak, key=lambda name: shares[name].best, default=None)
