"""Selection of the causes: one effect after another, pruned, checked against alternatives.

`forward` adds effects while the next one is real, material and larger than form errors. `prune`
removes members that explain too little. `simpler` searches one effect that explains the part of
several. `masked_pair` and `fit_silent` search effects that the search of one effect after another
cannot find. `check_alternatives` compares every member with the other effects.

Two effects can mask each other. A lower row that is softer and a probe that reads too much move
the same channel in opposite directions. Each effect alone leaves almost the whole misfit. All
pairs of signatures are therefore compared to first order, which costs no simulation, and the best
pairs are refitted if their gain could exceed that of the model found.

The base fit can conceal an effect. A threshold that it never reaches has no signature there,
although the data may show it: a tank that the fit takes for half full does not overflow.
Similarly, an oscillation that is fitted with one turn too many lies in a minimum of its own, in
which its missing effect explains nothing. Such effects are tried from starts over the whole range
of the base.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from saddlering_ros.discrepancy.problem.fits import (
    Candidate,
    COARSE_BASE,
    Fit,
    MAX_BASE_STARTS,
    refit,
    run_refits,
    spread_starts,
)
from saddlering_ros.discrepancy.problem.system import Array, Effect, SystemWithInputs
from saddlering_ros.discrepancy.search.comparison import (
    alternative_floor,
    Comparison,
    explained_share,
    indistinguishable,
    likelihood_ratio_test,
    SearchLog,
)
from saddlering_ros.discrepancy.search.signatures import (
    best_of_each,
    effect_starts,
    measure_signatures,
    MIN_LENGTH,
    reach_of,
    shapes_tried,
    shortlist,
    Signature,
)
from saddlering_ros.discrepancy.search.space import CLOSE_SHARE, fit_each, fit_race, ModelSpace

MAX_SILENT = 2
"""Largest number of immaterial effects in the model while others are searched. Each takes part of
the misfit of a later cause."""

MIN_GAIN, MIN_GAIN_SHARE = 4.0, 1.0 / 3.0
"""First-order gain below which an effect is not refitted, and the same as a share of the gain at
which an effect with one parameter is real. With this share and SCREENED_SHARE the refits of the
shipped bags need 400 evaluations instead of 512."""

MAX_CHECKS = 3
"""Largest number of rounds of alternatives; a round follows each replaced member, and a model has
at most three."""

Alternatives = Mapping[str, tuple[Fit, ...]]
"""Models that these data cannot tell from the best, by the member that they replace."""


def with_inputs(space: ModelSpace) -> ModelSpace:
    """The space with errors of the simulator's inputs, if the base alone leaves misfit.

    Where nothing is wrong to first order, no input is accused.
    """
    system = space.problem.system
    if not isinstance(system, SystemWithInputs):
        return space
    gains = [score.gain for score in space.scores(space.base)]
    if max(gains, default=0.0) < space.real_gain and not space.leaves_misfit(space.base):
        return space
    tangents = space.tangent_of(space.base)
    inputs = measure_signatures(space.metric, space.base, tangents, space.scale, system.inputs)
    return ModelSpace(
        metric=space.metric, base=space.base, base_tangent=tangents,
        signatures=space.signatures, scale=space.scale,
        trials=space.trials + shapes_tried(inputs), inputs=inputs)


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
    if not space.leaves_misfit(fit):
        return fit
    singles = fit_silent(space)
    best = min([fit, *singles], key=space.penalised)
    if space.problem.assumptions.many_valleys and _is_mostly_left(space, best):
        singles += fit_in_other_valleys(space)
    log.candidates += [Comparison(space, space.base, single).evidence(1) for single in singles]
    return min([fit, *singles], key=space.penalised)


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
        tried = [Comparison(space, current, fit) for fit in refitted(space, current)]
        log.candidates += [comparison.evidence(step + 1) for comparison in tried]
        real = [comparison for comparison in tried if comparison.is_real]
        named = len(current.candidate.effects) - len(silent)
        wanted = not named or space.slow_residual(current).is_real_and_material(settings)
        best = next((one for one in real if one.is_another_cause(wanted)), None)
        if best is None or named == settings.max_causes:
            log.immaterial += [comparison.evidence(step + 1) for comparison in real[:3]]
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
    if not (space.conceals_effects(current)
            or any(Comparison(space, current, tried).is_real for tried in first)):
        return first
    others = [score for score in scores if all(score is not tried for tried in listed)]
    return fit_race(space, current, first, others)


def prune(space: ModelSpace, fit: Fit, log: SearchLog) -> Fit:
    """Remove members that explain too little of the misfit without them.

    The judgement uses the view in which a member explains most: the form error of another
    effect in one channel is no argument against a cause that shows in another channel.
    """
    settings = space.settings
    while len(fit.candidate.effects) > 1:
        members = [Comparison(space, space.without(fit, name), fit) for name in fit.candidate.ids]
        share, weakest = min(
            ((member.share_of_member, member) for member in members), key=lambda pair: pair[0])
        if share >= settings.min_partial:
            break
        if weakest.is_real:
            log.immaterial.append(weakest.evidence())
        fit = weakest.less
    return fit


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
    singles = space.fit_best(space.base, untried)
    log.candidates += [Comparison(space, space.base, single).evidence(1) for single in singles]
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
                other for other in fits if _is_indistinguishable(space, other, fit, less))
            material = [fit for fit in fits if Comparison(space, less, fit).is_material]
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
    for other in fit_each(space, less, listed, [fit]):
        if name in other.candidate.ids:
            continue
        comparison = Comparison(space, less, other)
        if comparison.is_separate_cause or comparison.closes_misfit:
            answers.append(other)
    return answers


def _competitors(less: Fit, log: SearchLog) -> set[str]:
    """Effects that were almost as good as the best one beside those of `less`."""
    members = set(less.candidate.ids)
    tried = [candidate for candidate in log.candidates if set(candidate.effects[:-1]) == members]
    least = CLOSE_SHARE * max((candidate.delta_bic for candidate in tried), default=0.0)
    return {candidate.effects[-1] for candidate in tried if candidate.delta_bic > least}


def _is_indistinguishable(space: ModelSpace, other: Fit, best: Fit, less: Fit) -> bool:
    """Whether these data leave `other` open beside `best`; `less`: the common model."""
    return indistinguishable(
        distance=other.misfit - best.misfit,
        taken=less.misfit - best.misfit,
        excess=max(space.slow_residual(best).excess, 0.0),
        fewer=best.theta_unit.size - other.theta_unit.size,
        floor=alternative_floor(space.pairs, space.settings),
        settings=space.settings,
    )


MAX_PAIRS = 4
"""Largest number of pairs that are refitted. Chosen for cost."""


@dataclass(frozen=True)
class _Pair:
    """Two signatures, their factors, and the fall of the misfit to first order."""

    signatures: tuple[Signature, Signature]
    factors: tuple[float, float]
    gain: float


def masked_pair(space: ModelSpace, fit: Fit, log: SearchLog) -> Fit:
    """Two effects that explain surely more than a `fit` of at most one effect; else `fit`."""
    if len(fit.candidate.effects) > 1:
        return fit
    least = space.base.misfit - fit.misfit + space.real_gain * (2 - len(fit.candidate.effects))
    pairs = [pair for pair in _best_pairs(space) if pair.gain > least]
    if not pairs:
        return fit
    refits = run_refits(
        space.metric,
        [
            refit(space.metric, candidate, start, rounds=space.settings.rounds,
                  full_jacobian=True)
            for candidate, start in (_start(space.base, pair) for pair in pairs)
        ],
    )
    log.candidates += [Comparison(space, space.base, pair_fit).evidence(1) for pair_fit in refits]
    best = min(refits, key=space.penalised)
    return space.keep(best) if _is_better(space, fit, best) else fit


def _is_better(space: ModelSpace, fit: Fit, pair: Fit) -> bool:
    """Whether a pair is real beside a `fit` of at most one effect, with all pairs counted."""
    extra = max(1, pair.theta_unit.size - fit.theta_unit.size)
    trials = space.trials if fit.candidate.effects else space.trials**2 // 2
    p_value = likelihood_ratio_test(
        fit.misfit - pair.misfit, extra, space.pairs, trials)
    return p_value < space.settings.error_rate and space.penalised(pair) < space.penalised(fit)


def _start(base: Fit, pair: _Pair) -> tuple[Candidate, Array]:
    """The model of a pair, and the parameters at which its refit begins."""
    candidate, parts = Candidate(), [base.theta_unit]
    for signature, factor in zip(pair.signatures, pair.factors, strict=True):
        candidate = candidate.plus(signature.effect, signature.variant)
        size = signature.effect.size.to_unit(signature.effect.neutral + factor * signature.size)
        parts.append(np.array([np.clip(size, 1e-3, 1.0 - 1e-3), *signature.theta_unit[1:]]))
    return candidate, np.concatenate(parts)


def _best_pairs(space: ModelSpace) -> list[_Pair]:
    """The best pair of shapes of each pair of effects, those with the largest gain."""
    signatures = _one_of_each_shape(space.usable)
    if not signatures:
        return []
    reaches = np.array([reach_of(signature) for signature in signatures])
    stack = np.column_stack([signature.white for signature in signatures])
    gains, first, second = _pair_gains(
        stack, -(stack.T @ space.base.whitened), reaches)
    names = np.array([signature.effect.id for signature in signatures])
    gains[names[:, None] == names] = -np.inf
    pairs: dict[frozenset[str], _Pair] = {}
    for flat in np.argsort(-gains, axis=None):
        row, column = divmod(int(flat), len(signatures))
        if len(pairs) == MAX_PAIRS or not np.isfinite(gains[row, column]):
            break
        pair = _Pair(
            (signatures[row], signatures[column]),
            (float(first[row, column]), float(second[row, column])),
            float(gains[row, column]),
        )
        pairs.setdefault(frozenset((names[row], names[column])), pair)
    return list(pairs.values())


def _one_of_each_shape(signatures: Sequence[Signature]) -> list[Signature]:
    """Signatures with one size of every straight effect, and all sizes of the others."""
    kept: dict[tuple[object, ...], Signature] = {}
    for signature in signatures:
        if signature.length > 1e-9 and signature.size != 0.0:
            key = signature.shape
            if signature.amplitude_dependent:
                key = (*key, signature.size)
            kept.setdefault(key, signature)
    return list(kept.values())


def _pair_gains(stack: Array, products: Array, reach: Array) -> tuple[Array, Array, Array]:
    """Fall of the misfit by every pair of columns (K, K), and the factors of both columns.

    products (K,): columns times the residual; reach (K, 2): bounds of the factor of a column. The
    best factors are free, or one of them is at a bound and the other is the best beside it.
    """
    gram = stack.T @ stack
    own = np.maximum(np.diag(gram), 1e-300)[:, None]
    aim = products[:, None]
    low, high = (np.broadcast_to(bound[:, None], gram.shape) for bound in reach.T)

    def best_beside(factor: Array) -> Array:
        """The best factor of the column of a row, beside factors of the other column."""
        return np.asarray(np.clip((aim - gram * factor) / own, low, high))

    determinant = np.maximum(own * own.T - gram**2, 1e-9 * own * own.T)
    free = np.clip((aim * own.T - gram * aim.T) / determinant, low, high)
    firsts = [free, low, high, best_beside(low.T), best_beside(high.T)]
    pairs = [(first, best_beside(first.T).T) for first in firsts]
    gains = np.stack([
        2.0 * first * aim - first**2 * own + 2.0 * second * aim.T - second**2 * own.T
        - 2.0 * first * second * gram
        for first, second in pairs
    ])
    best = gains.argmax(axis=0)[None]
    first, second = (np.stack(factors) for factors in zip(*pairs, strict=True))
    return (
        np.take_along_axis(gains, best, 0)[0],
        np.take_along_axis(first, best, 0)[0],
        np.take_along_axis(second, best, 0)[0],
    )


MAX_STARTS = 3
"""Number of first guesses of a silent effect for each start of the base: the sizes on one side of
an effect without starts of its own."""


def silent_effects(signatures: Sequence[Signature]) -> list[tuple[Effect, int]]:
    """Effects and variants whose starts change the prediction by less than the noise hides."""
    loudest: dict[tuple[str, int], float] = {}
    effects: dict[tuple[str, int], Effect] = {}
    for signature in signatures:
        effects[signature.key] = signature.effect
        change = signature.length / signature.share if signature.share > 0.0 else 0.0
        loudest[signature.key] = max(loudest.get(signature.key, 0.0), change)
    return [(effects[key], key[1]) for key, change in loudest.items() if change < MIN_LENGTH]


def fit_silent(space: ModelSpace) -> list[Fit]:
    """The base and each silent effect alone, from starts with influence; the best first."""
    return _fit_from_all_over(space, silent_effects(space.signatures), MAX_STARTS)


def fit_in_other_valleys(space: ModelSpace) -> list[Fit]:
    """The base and each effect alone, fitted from starts over the whole range of the base.

    Without its effect the base can be in a minimum from which no path leads to the true one.
    """
    effects = {one.key: (one.effect, one.variant) for one in space.signatures}
    return _fit_from_all_over(space, list(effects.values()), starts=1)


def _fit_from_all_over(
    space: ModelSpace, effects: Sequence[tuple[Effect, int]], starts: int
) -> list[Fit]:
    """The base and each effect alone, the best of several starts; the best first.

    starts: first guesses of an effect for each start of the base.
    """
    single_fits = []
    for effect, variant in effects:
        fits = _coarse(space, Candidate(((effect, variant),)), effect, starts)
        if fits:
            best = min(fits, key=lambda fit: fit.misfit)
            single_fits += [space.keep(fit) for fit in space.refine([best])]
    return sorted(single_fits, key=space.penalised)


def _coarse(space: ModelSpace, candidate: Candidate, effect: Effect, count: int) -> list[Fit]:
    """A few rounds from those starts of base and effect at which the effect has influence."""
    metric = space.metric
    base = metric.problem.system.base_parameters
    thetas = spread_starts(base, space.settings.seed)
    alone = metric.problem.predict([Candidate().point(base, theta) for theta in thetas])
    trials: list[tuple[float, Array]] = []
    for start in effect_starts(effect)[:count]:
        whole = [np.concatenate([theta, start]) for theta in thetas]
        space.watch.check()
        seen = metric.problem.predict([candidate.point(base, theta_unit) for theta_unit in whole])
        change = np.linalg.norm(metric.whiten(seen - alone), axis=0)
        left = metric.whiten(seen - metric.problem.measured[:, None])
        misfit = (left**2).sum(axis=0)
        acts = np.isfinite(misfit) & (change > MIN_LENGTH)
        trials += [(float(misfit[number]), whole[number]) for number in np.flatnonzero(acts)]
    trials.sort(key=lambda trial: trial[0])
    return run_refits(
        metric,
        [
            refit(metric, candidate, theta_unit, rounds=COARSE_BASE, full_jacobian=True)
            for _, theta_unit in trials[:MAX_BASE_STARTS]
        ],
    )
