"""The search: effects selected one after another, pruned, checked against alternatives.

`search_about` is the whole procedure. `forward` adds effects while the next one is real, material
and larger than form errors. `prune` removes members that explain too little. `simpler` searches
one effect that explains the part of several. `masked_pair` and `_concealed` search effects that
the search of one effect after another cannot find. `check_alternatives` compares every member with
the other effects.

Two effects can mask each other: a softer lower row and a probe that reads too much move a channel
in opposite directions, and each alone leaves almost the whole misfit.

The base fit can conceal an effect: a tank that it takes for half full does not overflow, and an
oscillation fitted with one turn too many lies in a minimum of its own. Such effects are tried from
starts over the whole range of the base.

What the best model leaves is model error, a process that any run could show again. Beside it the
evidence for a cause is as sure as the machine is reproducible (`search_beside_error`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from saddlering_ros.discrepancy.problem import fits as fitting
from saddlering_ros.discrepancy.problem import metric as metrics
from saddlering_ros.discrepancy.problem.fits import Candidate, Fit, Key, refit, run_refits
from saddlering_ros.discrepancy.problem.system import Array, Effect
from saddlering_ros.discrepancy.search import evidence, ranking, valleys
from saddlering_ros.discrepancy.search import signatures as shown_by
from saddlering_ros.discrepancy.search import space as spaces
from saddlering_ros.discrepancy.search.evidence import Comparison, SearchLog
from saddlering_ros.discrepancy.search.lack_of_fit import half_waves
from saddlering_ros.discrepancy.search.space import ModelSpace, refit_full_jacobian
from saddlering_ros.estimation.least_squares import AT_BOUND

MAX_BASES = 3
"""Searches begun again about a better base. Chosen for cost: each is a whole search."""

MIN_DEEPER, MIN_DEEPER_SHARE = 10.0, 0.01
"""Fall of the misfit, and its share, from which a minimum is deeper: a likelihood ratio of ten
cannot come from an unfinished refit."""

MAX_SILENT = 2
"""Immaterial effects in the model during a search: each takes part of a later cause's."""

MAX_CHECKS = 3
"""Members replaced at most: a round of alternatives follows each of them."""

MAINLY = 0.5
"""Half of the power of a misfit: where a cause mainly acts it moves as much, each of several equal
causes takes as much as the best of them or more, and no cause beside the main one exceeds it."""

MIN_LIKE = 0.1
"""Share of what a member takes that another effect must take to first order to be refitted."""

Alternatives = Mapping[str, tuple[Fit, ...]]
"""Models that these data cannot tell from the best, by the member that they replace."""


@dataclass(frozen=True)
class Search:
    """The model at the end of a search, its alternatives, and two spaces.

    begun: the space about the base fit; space: the one in which the model is judged; covered:
    factor of the declared model error from which on it covers the misfit of the base.
    """

    begun: ModelSpace
    space: ModelSpace
    fit: Fit
    alternatives: Alternatives
    log: SearchLog
    covered: float = np.inf


def search_about(start: ModelSpace) -> Search:
    """The search, begun again while the model that it found leads to a better base."""
    search = _search(start)
    for _ in range(MAX_BASES):
        deeper = better_base(search.space, search.fit)
        if deeper is None:
            break
        search = _search(spaces.space_about(start.problem, deeper))
    return search


def better_base(space: ModelSpace, fit: Fit) -> Fit | None:
    """The base refitted from its parameters in the model with effects, if that minimum is deeper.

    Otherwise an effect without influence could be named because it leads the fit to another
    minimum.
    """
    if not fit.candidate.effects:
        return None
    count = space.base.theta_unit.size
    begun = refit(space.metric, Candidate(), fit.theta_unit[:count], rounds=space.settings.rounds)
    other_base = run_refits(space.metric, [begun])[0]
    gain = space.base.misfit - other_base.misfit
    return other_base if gain > max(MIN_DEEPER, MIN_DEEPER_SHARE * other_base.misfit) else None


def _search(begun: ModelSpace) -> Search:
    """Select effects, adapt the nuisance parameters to them, check the alternatives."""
    space, log = begun, SearchLog()
    # Where nothing is wrong to first order, no input of the simulator is accused.
    if getattr(space.problem.system, 'inputs', ()) and (space.leaves_misfit(space.base) or any(
            score.gain >= space.real_gain() for score in space.scores(space.base))):
        space = space.with_inputs()
    fit = select(space, log)
    alternatives: Alternatives = {}
    space.watch.progress('check of alternatives', 0.75)
    if fit.candidate.effects:
        # A load that is wrong by some percent moves the point at which rollers begin to touch, and
        # with it the contribution of unequal rollers. Seen from the model without the effects,
        # this difference is evidence.
        metric, problem = space.metric, space.problem
        if problem.assumptions.relearns:
            metric = metrics.noise_metric(problem, fit.prediction)
        space, fit = in_metric(space, metric.with_nuisances(fit.point, fit.prediction), fit)
        if problem.assumptions.relearns:  # With less noise, more effects may show.
            fit = forward(space, fit, log)
        fit = prune(space, fit, log)
        fit, alternatives = check_alternatives(space, fit, log)
    return Search(begun, space, fit, alternatives, log)


def in_metric(space: ModelSpace, metric: metrics.Metric, fit: Fit) -> tuple[ModelSpace, Fit]:
    """The space in another metric, with its base and a fit refitted there."""
    base, fit = refit_full_jacobian(metric, [space.base, fit], space.settings.max_rounds)
    sensitivities = fitting.tangent(metric, base)
    signatures, inputs = (shown_by.whitened_by(metric, changes, sensitivities)
                          for changes in (space.signatures, space.inputs))
    moved = replace(space, metric=metric, base=base, base_tangent=sensitivities,
                    signatures=signatures, inputs=inputs)
    return moved, moved.keep(fit)


def select(space: ModelSpace, log: SearchLog) -> Fit:
    """The model that explains the misfit with the fewest effects."""
    fit = prune(space, forward(space, space.base, log), log)
    single = simpler(space, fit, log)
    if single is not fit:
        fit = prune(space, forward(space, single, log), log)
    other = _concealed(space, fit, log)
    if other is not fit:
        fit = prune(space, forward(space, other, log), log)
    pair = masked_pair(space, fit, log)
    if pair is fit or prune(space, pair, log) is not pair:  # Each of a pair needs the other.
        return fit
    return min(fit, prune(space, forward(space, pair, log), log), key=space.penalised)


def _concealed(space: ModelSpace, fit: Fit, log: SearchLog) -> Fit:
    """An effect that the base fit conceals and that fits better than a `fit` with misfit.

    Told and silent effects are tried. If the base may have several minima and `fit` leaves more of
    its misfit than an established cause may, all effects are tried: the base alone can be in a
    minimum from which no path leads to the true one.
    """
    if not space.leaves_misfit(fit):
        return fit
    silent = valleys.silent_effects(space.signatures)
    singles = valleys.fit_at_told_sizes(space) + valleys.fit_from_all_over(space, silent)
    best = min([fit, *singles], key=space.penalised)
    left, whole = (space.slow_residual(one).excess for one in (best, space.base))
    is_far = space.problem.assumptions.many_valleys and left > valleys.MAX_LEFT * whole
    if is_far:
        effects = {one.key: (one.effect, one.variant) for one in space.signatures}
        singles += valleys.fit_over_growing_time(space, list(effects.values()))
    log.candidates += [Comparison(space, space.base, single).evidence(1) for single in singles]
    return min([fit, *singles], key=space.penalised)


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
        named = len(current.candidate.effects) - len(silent)
        # Of 21 rings, those whose third effect was kept had 0.87 or more explained by two, and
        # those with less than a half had one partial cause in the end.
        if named == settings.max_causes or (
                len(current.candidate.effects) > 1 and evidence.explained_share(
                    space.slow_residual(space.base), space.slow_residual(current), settings,
                ) < settings.min_partial):
            break
        tried = [Comparison(space, current, fit) for fit in spaces.refitted(space, current)]
        log.candidates += [comparison.evidence(step + 1) for comparison in tried]
        real = [comparison for comparison in tried if comparison.is_real]
        wanted = not named or space.slow_residual(current).is_real_and_material(settings)
        best = next((one for one in real if one.is_another_cause(wanted)), None)
        if best is None:
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
    first shortlist. Every effect is therefore tried by coarse fits, and the best are refined.
    """
    if len(fit.candidate.effects) < 2:
        return fit
    untried = [score for score in ranking.best_of_each(space.scores(space.base))
               if Candidate().plus(score.effect, score.variant).key not in space.fits]
    begun = spaces.raced_from(
        space, space.base, ranking.starts_of_each(untried), (), spaces.COARSE_ROUNDS)
    coarse = sorted(spaces.best_fit_of_each(begun), key=space.penalised)
    refined = space.refine(coarse[: space.settings.refits])
    singles = sorted(map(space.keep, refined), key=space.penalised)
    log.candidates += [Comparison(space, space.base, single).evidence(1) for single in singles]
    return min([fit, *space.single_effect_fits()], key=space.penalised)


def check_alternatives(space: ModelSpace, fit: Fit, log: SearchLog) -> tuple[Fit, Alternatives]:
    """Alternatives to every member; a better alternative replaces the member."""
    alternatives, settings = dict[str, tuple[Fit, ...]](), space.settings
    for further in reversed(range(MAX_CHECKS + 1)):
        alternatives, better = {}, []
        for name in fit.candidate.ids:
            space.watch.check()
            less = space.without(fit, name)
            taken, members = less.misfit - fit.misfit, set(less.candidate.ids)
            # An effect that base parameters almost imitate is not searched, but may be the cause.
            scores = ranking.rank(less, space.tangent_of(less).white, space.shown, [name])
            listed = ranking.shortlist(scores, MIN_LIKE * taken, settings.refits)
            # Effects that were almost as good as the best one beside those of `less` are tried.
            tried = [trial for trial in log.candidates if set(trial.effects[:-1]) == members]
            least = spaces.CLOSE_SHARE * max((trial.delta_bic for trial in tried), default=0.0)
            names = {trial.effects[-1] for trial in tried if trial.delta_bic > least}
            names -= {score.effect.id for score in listed}
            listed += [score for score in ranking.best_of_each(scores) if score.effect.id in names]
            listed = [score for score in listed if name not in score.effect.contains]
            fits = [
                other for other in spaces.fit_each(space, less, listed, [fit])
                if name not in other.candidate.ids and not stopped_sizes(other)
                and Comparison(space, less, other).is_another_cause()]
            as_good = _as_good(space, fit, less, fits)
            material = [other for other in fits if Comparison(space, less, other).is_material]
            likely = [other for other in material[:1]
                      if space.penalised(other) < space.penalised(fit) - 1.0]
            taken_by = _taken(space, less, [fit, *as_good, *likely])
            own = taken_by[fit.candidate.key]
            alternatives[name] = tuple(
                other for other in as_good if taken_by[other.candidate.key] >= MAINLY * own)
            better += [other for other in as_good if MAINLY * taken_by[other.candidate.key] > own]
            better += [other for other in likely if taken_by[other.candidate.key] >= MAINLY * own]
        if not (better and further):
            break
        fit = prune(space, min(better, key=space.penalised), log)
    return fit, alternatives


def other_places(space: ModelSpace, fit: Fit, name: str) -> tuple[Fit, ...]:
    """Models that these data cannot tell from `fit` in which a member acts at another place.

    A place is a variant of an effect: a probe, a row. A gain of probe 1 acts as one of the other
    sign of probe 3 beside another stiffness.
    """
    less = space.without(fit, name)
    own, variant = next(pair for pair in fit.candidate.effects if pair[0].id == name)
    least = MIN_LIKE * (less.misfit - fit.misfit)
    scores = [score for score in ranking.rank(
        less, space.tangent_of(less).white, space.shown)
        if score.effect is own and score.variant != variant and score.gain > least]
    return _as_good(space, fit, less, spaces.fit_each(space, less, scores, [fit]))


def _as_good(space: ModelSpace, fit: Fit, less: Fit, others: Sequence[Fit]) -> tuple[Fit, ...]:
    """Models in place of `fit` that these data leave open; less: `fit` without the member."""
    excess = max(space.slow_residual(fit).excess, 0.0) if others else 0.0
    return tuple(other for other in others if other.misfit - fit.misfit <= evidence.open_distance(
        taken=less.misfit - fit.misfit, excess=excess,
        floor=evidence.alternative_floor(space.pairs, space.settings), settings=space.settings))


def _taken(space: ModelSpace, less: Fit, fits: Sequence[Fit]) -> Mapping[Key, float]:
    """Mean square over range that each fit takes of what `less` leaves, in the metric of the gain.

    0 for rings, on which nuisance parameters take a share. Learnt model error can leave the level
    of a channel open: causes of 27 and 1 % of the misfit of a ball screw were equally likely.
    """
    models = {fit.candidate.key: fit for fit in fits}
    if len(models) < 2 or not space.problem.assumptions.exact_laws:
        return dict.fromkeys(models, 0.0)
    return {key: _left_by(space, less) - _left_by(space, fit) for key, fit in models.items()}


def _left_by(space: ModelSpace, fit: Fit) -> float:
    """Mean square over range that a model leaves where it is fitted in the metric of the gain."""
    def left() -> float:
        [plain] = fitting.plain_fits(space.problem, [fit])
        seen = space.problem.in_views(plain.prediction - space.problem.measured)
        return float(seen @ seen)

    return space.once('left in the metric of the gain', fit, left)


def stopped_sizes(fit: Fit) -> list[tuple[Effect, float]]:
    """Effects of a fit whose size is at a bound that is not neutral nor whole, and that size."""
    stopped = []
    for effect, _, part in fit.parts:
        size, theta_unit = effect.size, float(fit.theta_unit[part.start])
        value = size.from_unit(theta_unit)
        present = abs(value - effect.neutral) / (size.high - size.low)
        if present > AT_BOUND and spaces.bound_reached(size, theta_unit) not in (None, size.whole):
            stopped.append((effect, value))
    return stopped


def masked_pair(space: ModelSpace, fit: Fit, log: SearchLog) -> Fit:
    """Two effects that explain surely more than a `fit` of at most one effect; else `fit`."""
    count = len(fit.candidate.effects)
    if count > 1:
        return fit
    least = space.base.misfit - fit.misfit + space.real_gain() * (2 - count)
    pairs = ranking.best_pairs(space.base, space.usable, least)
    if not pairs:
        return fit
    refits = run_refits(space.metric, [
        refit(space.metric, candidate, start, rounds=space.settings.rounds)
        for candidate, start in pairs])
    log.candidates += [Comparison(space, space.base, pair_fit).evidence(1) for pair_fit in refits]
    best = min(refits, key=space.penalised)
    stored = space.fits.get(best.candidate.key)
    if stored is not None and stored.misfit < best.misfit + fitting.QUIET_GAIN:
        best = stored  # What is beside it has been refitted.
    p_value = space.likelihood_ratio_test(
        fit.misfit - best.misfit, best.theta_unit.size - fit.theta_unit.size,
        trials=space.trials if count else space.trials**2 // 2)
    is_real = p_value < space.settings.error_rate
    return space.keep(best) if is_real and space.penalised(best) < space.penalised(fit) else fit


ERROR_WAVES = 60
"""Half waves of the process in a run; what is faster is learnt as noise."""

MAX_COLUMNS = 600
"""Largest number of cosines of all runs and channels."""

SMOOTHED_SHARE, MIN_SMOOTHED = 0.3, 3
"""Lines on each side over which a spread is averaged: share of the frequency, and at least."""

MAX_LEARNT = 3
"""Number of times that model error is learnt from the model that it led to."""

MIN_DEGREES = 4
"""Smallest number of degrees of freedom of the level of the process."""


def search_beside_error(search: Search) -> Search:
    """The causes that stand out against model error as large as what they leave."""
    space, fit, log = search.space, search.fit, SearchLog()
    for _ in range(MAX_LEARNT):
        learnt_from = fit.candidate.key
        space, fit = space_beside_error(space, fit)
        fit = prune(space, select(space, log), log)
        if fit.candidate.key == learnt_from:
            break
    fit, alternatives = check_alternatives(space, fit, log)
    return Search(search.begun, space, fit, alternatives, log)


def learnt_without(alone: ModelSpace, search: Search, name: str, dropped: list[Array]) -> Search:
    """The search without one cause, whose change is added to `dropped` and is model error.

    alone: the space without learnt model error. With cosines alone, the sharp part of what a
    secondary cause changes would be evidence, and a sharp law would replace the main cause.
    """
    fit = search.fit
    dropped.append(search.space.changes_of(fit)[:, fit.candidate.ids.index(name)])
    space, fit = space_beside_error(alone, search.space.without(fit, name), dropped)
    fit, alternatives = check_alternatives(space, fit, search.log)
    return replace(search, space=space, fit=fit, alternatives=alternatives)


def space_beside_error(space: ModelSpace, fit: Fit,
                       dropped: Sequence[Array] = ()) -> tuple[ModelSpace, Fit]:
    """A space in whose metric the residual of `fit` is model error, and the fit.

    dropped: changes (n,) that are model error of one standard deviation each, too.
    """
    problem = space.problem
    process, degrees = error_process(space.metric, fit)
    process = np.column_stack([process, *dropped])
    nuisances = metrics.nuisance_columns(problem, fit.point, fit.prediction)
    metric = space.metric.marginalise(np.hstack([nuisances, process]))
    beside, fit = in_metric(space, metric, fit)
    beside.pairs = min(space.pairs, degrees)
    beside.max_pairs = min(space.max_pairs, degrees)
    return beside, fit


def error_process(metric: metrics.Metric, fit: Fit) -> tuple[Array, int]:
    """Columns (n, k) of one standard deviation each, and the degrees of freedom of their level.

    The runs of a channel share one spectrum. What noise alone would leave in a line is no model
    error.
    """
    problem = metric.problem
    residual = metric.without_nuisances(fit.prediction - problem.measured)
    columns: list[Array] = []
    degrees = []
    most = min(ERROR_WAVES, MAX_COLUMNS // len(problem.slices))
    for channel in range(len(problem.system.channel_names)):
        slots = [slot for slot in problem.slices if slot[1] == channel]
        times = [problem.runs[index].time for index, _, _ in slots]
        shapes = [half_waves(time, min(most, time.size // 4)) for time in times]
        power = np.full((len(slots), ERROR_WAVES + 1), np.nan)
        for row, waves, (index, _, part) in zip(power, shapes, slots, strict=True):
            run = problem.runs[index]
            present = 1.0 if run.present is None else run.present[channel]
            weight = np.sqrt(run.width * present)
            weighted = waves * weight[:, None]
            sizes = np.linalg.lstsq(weighted, weight * residual[part], rcond=1e-6)[0]
            row[: sizes.size] = sizes**2
        # The mean over the runs and the lines about each line.
        smooth = np.zeros(ERROR_WAVES + 1)
        for line in range(smooth.size):
            half = max(MIN_SMOOTHED, round(SMOOTHED_SHARE * line))
            around = power[:, max(0, line - half) : line + half + 1]
            if np.isfinite(around).any():
                smooth[line] = np.nanmean(around)
        spread = np.sqrt(smooth)
        degrees.append(len(slots) * float((spread**2).sum() ** 2 / max((spread**4).sum(), 1e-300)))
        for waves, (_, _, part) in zip(shapes, slots, strict=True):
            block = np.zeros((problem.size, waves.shape[1]))
            block[part] = waves * spread[: waves.shape[1]]
            columns.append(block)
    return np.hstack(columns), max(MIN_DEGREES, int(min(degrees)))
