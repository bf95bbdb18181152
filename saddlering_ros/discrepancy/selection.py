"""Selection of the causes: one effect after another, pruned, checked against alternatives.

`forward` adds effects while the next one is real, material and larger than form errors. `prune`
removes members that explain too little. `simpler` searches one effect that explains the part of
several. `check_alternatives` compares every member with the other effects.
"""

from __future__ import annotations

from collections.abc import Mapping

from saddlering_ros.discrepancy.candidate import Candidate, Fit
from saddlering_ros.discrepancy.criteria import (
    alternative_floor,
    explained_share,
    indistinguishable,
    real_and_material,
)
from saddlering_ros.discrepancy.masked_pairs import masked_pair
from saddlering_ros.discrepancy.model_space import Comparison, ModelSpace
from saddlering_ros.discrepancy.race import CLOSE_SHARE, fit_each, fit_race
from saddlering_ros.discrepancy.ranking import best_of_each, shortlist
from saddlering_ros.discrepancy.results import SearchLog
from saddlering_ros.discrepancy.silent_effects import fit_in_other_valleys, fit_silent

MAX_SILENT = 2
"""Largest number of immaterial effects in the model while others are searched."""

MIN_GAIN, MIN_GAIN_SHARE = 4.0, 1.0 / 3.0
"""First-order gain below which an effect is not refitted, and the same as a share of the gain at
which an effect with one parameter is real."""

MAX_CHECKS = 3
"""Largest number of rounds of alternatives; a round follows each replaced member."""

Alternatives = Mapping[str, tuple[Fit, ...]]
"""Models that these data cannot tell from the best, by the member that they replace."""


def select(space: ModelSpace, log: SearchLog) -> Fit:
    """The model that explains the misfit with the fewest effects."""
    fit = prune(space, forward(space, space.base, log), log)
    one = simpler(space, fit, log)
    if one is not fit:
        fit = prune(space, forward(space, one, log), log)
    other = _concealed(space, fit, log)
    if other is not fit:
        fit = prune(space, forward(space, other, log), log)
    pair = masked_pair(space, fit, log)
    if pair is fit:
        return fit
    return min(fit, prune(space, forward(space, pair, log), log), key=space.penalised)


def _concealed(space: ModelSpace, fit: Fit, log: SearchLog) -> Fit:
    """An effect that the base fit conceals and that fits better than a `fit` with misfit.

    Silent effects are tried. All effects are tried if `fit` leaves most of the misfit and the
    base may have several minima.
    """
    if not _leaves_misfit(space, fit):
        return fit
    found = fit_silent(space)
    best = min([fit, *found], key=space.penalised)
    if space.metric.experiment.assumptions.many_valleys and _is_mostly_left(space, best):
        found += fit_in_other_valleys(space)
    log.candidates += [space.compare(space.base, item).evidence(1) for item in found]
    return min([fit, *found], key=space.penalised)


def _is_mostly_left(space: ModelSpace, fit: Fit) -> bool:
    """Whether a fit leaves more of the base's misfit than a member of a model may leave."""
    share = explained_share(
        space.slow_residual(space.base), space.slow_residual(fit), space.settings)
    return share < space.settings.min_partial


def forward(space: ModelSpace, current: Fit, log: SearchLog) -> Fit:
    """Effects one after another while the next is real and material and misfit remains.

    A real but immaterial effect stays in the model during the search, because otherwise a
    wrong effect would take its place. It is not part of the answer.
    """
    settings = space.settings
    silent: list[str] = []
    steps = settings.max_causes + MAX_SILENT
    for step in range(steps):
        space.watch.check()
        space.watch.progress('selection of causes', 0.35 + 0.4 * step / steps)
        tried = [space.compare(current, fit) for fit in refitted(space, current)]
        log.candidates += [item.evidence(step + 1) for item in tried]
        real = [item for item in tried if item.is_real]
        named = len(current.candidate.effects) - len(silent)
        wanted = not named or real_and_material(space.slow_residual(current), settings)
        best = next((item for item in real if _is_another_cause(item, wanted)), None)
        if best is None or named == settings.max_causes:
            log.immaterial += [item.evidence(step + 1) for item in real[:3]]
            break
        if not best.is_material:
            log.immaterial.append(best.evidence(step + 1))
            if len(silent) == MAX_SILENT:
                break
            silent.append(best.more.candidate.ids[-1])
        current = best.more
    for name in silent:
        current = space.without(current, name)
    return current


def _is_another_cause(item: Comparison, wanted: bool) -> bool:
    """Whether an effect is a cause beside the found ones; `wanted`: a real residual remains."""
    if item.closes_misfit or item.exceeds_forms:
        return True
    return item.exceeds_form_error if wanted else item.adds_new_channel


def refitted(space: ModelSpace, current: Fit) -> list[Fit]:
    """The model of `current` plus every effect that the residual could show, the best first.

    Effects with the largest first-order gains are refitted first. If one of them is real, or
    the residual exceeds the noise, every variant of every other effect is refitted too. An
    effect at its detection limit is then found, and no cause is named before all others were
    tried.
    """
    scores = space.scores(current)
    least = max(MIN_GAIN, MIN_GAIN_SHARE * space.real_gain)
    listed = shortlist(scores, least, space.settings.refits)
    first = fit_each(space, current, listed)
    if not (_is_much_left(space, current)
            or any(space.compare(current, item).is_real for item in first)):
        return first
    others = [score for score in scores if all(score is not item for item in listed)]
    return fit_race(space, current, first, others)


def _is_much_left(space: ModelSpace, fit: Fit) -> bool:
    """Whether base parameters could conceal effects beside `fit`."""
    if space.stopped_base(fit).any() and not fit.candidate.effects:
        return True
    return _leaves_misfit(space, fit)


def _leaves_misfit(space: ModelSpace, fit: Fit) -> bool:
    """Whether a fit leaves more than noise, and enough to matter."""
    slow, fast = space.slow_residual(fit), space.fast_residual(fit)
    return any(real_and_material(left, space.settings) for left in (slow, fast))


def prune(space: ModelSpace, fit: Fit, log: SearchLog) -> Fit:
    """Remove members that explain too little of the misfit without them.

    The judgement uses the view in which a member explains most: the form error of another
    effect in one channel is no argument against a cause that shows in another channel.
    """
    settings = space.settings
    while len(fit.candidate.effects) > 1:
        members = [space.compare(space.without(fit, name), fit) for name in fit.candidate.ids]
        share, weakest = min(
            ((_share_of_member(item), item) for item in members), key=lambda pair: pair[0]
        )
        if share >= settings.min_partial:
            break
        if weakest.is_real:
            log.immaterial.append(weakest.evidence())
        fit = weakest.less
    return fit


def _share_of_member(item: Comparison) -> float:
    """Share of the misfit that a member explains; 0 if the member is no cause by itself."""
    space, settings = item.space, item.space.settings
    if not item.is_real or not item.is_material:
        return 0.0
    share = explained_share(
        space.slow_residual(item.less), space.slow_residual(item.more), settings
    )
    if item.closes_misfit or item.exceeds_forms:
        return max(share, settings.min_partial)
    return share if item.exceeds_form_error else 0.0


def simpler(space: ModelSpace, fit: Fit, log: SearchLog) -> Fit:
    """The single effect that fits better than the several of `fit`, if there is one.

    Two effects that were found in turn can share the part of one effect that was not on the
    first shortlist. Every effect is therefore tried.
    """
    if len(fit.candidate.effects) < 2:
        return fit
    untried = [
        score
        for score in best_of_each(space.scores(space.base))
        if not space.is_fitted(Candidate().plus(score.effect, score.variant))
    ]
    found = space.fit_best(space.base, untried)
    log.candidates += [space.compare(space.base, item).evidence(1) for item in found]
    return min([fit, *space.single_effect_fits()], key=space.penalised)


def check_alternatives(space: ModelSpace, fit: Fit, log: SearchLog) -> tuple[Fit, Alternatives]:
    """Alternatives to every member; a better alternative replaces the member."""
    alternatives: dict[str, tuple[Fit, ...]] = {}
    for _ in range(MAX_CHECKS):
        alternatives, better = {}, []
        for name in fit.candidate.ids:
            space.watch.check()
            less = space.without(fit, name)
            fits = _alternatives_to(space, name, less, fit, log)
            alternatives[name] = tuple(
                item for item in fits if _is_indistinguishable(space, item, fit, less)
            )
            material = [item for item in fits if space.compare(less, item).is_material]
            if material and space.penalised(material[0]) < space.penalised(fit) - 1.0:
                better.append(material[0])
        if not better:
            break
        fit = prune(space, min(better, key=space.penalised), log)
    return fit, alternatives


def _alternatives_to(
    space: ModelSpace, name: str, less: Fit, fit: Fit, log: SearchLog
) -> list[Fit]:
    """`less` with another effect in place of `name`, if that effect is a cause by itself."""
    taken = less.misfit - fit.misfit
    scores = space.scores(less, [name])
    listed = shortlist(scores, 0.1 * taken, space.settings.refits)
    names = _competitors(less, log) - {score.effect.id for score in listed}
    listed += [score for score in best_of_each(scores) if score.effect.id in names]
    listed = [score for score in listed if name not in score.effect.contains]
    answers = []
    for item in fit_each(space, less, listed, [fit]):
        if name in item.candidate.ids:
            continue
        comparison = space.compare(less, item)
        if comparison.is_cause_of_its_own or comparison.closes_misfit:
            answers.append(item)
    return answers


def _competitors(less: Fit, log: SearchLog) -> set[str]:
    """Effects that were almost as good as the best one beside those of `less`."""
    known = set(less.candidate.ids)
    tried = [item for item in log.candidates if set(item.effects[:-1]) == known]
    least = CLOSE_SHARE * max((item.delta_bic for item in tried), default=0.0)
    return {item.effects[-1] for item in tried if item.delta_bic > least}


def _is_indistinguishable(space: ModelSpace, other: Fit, best: Fit, less: Fit) -> bool:
    """Whether these data leave `other` open beside `best`; `less`: the common model."""
    return indistinguishable(
        distance=other.misfit - best.misfit,
        taken=less.misfit - best.misfit,
        excess=max(space.slow_residual(best).excess, 0.0),
        fewer=best.theta_unit.size - other.theta_unit.size,
        floor=alternative_floor(space.known.pairs, space.settings),
        settings=space.settings,
    )
