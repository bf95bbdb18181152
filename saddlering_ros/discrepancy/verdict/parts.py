"""What to first order changes a verdict, a cause or a size: runs, channels, model error, chance.

Whether a cause has one size and acts everywhere, whether one run differs from the others, how much
a cause that would not be found changes the size of another one, and how far a verdict hangs on
runs, on model error and on chance: all models that were fitted are refitted without each run,
with half and twice the model error, and with stretches drawn again. No refit needs a simulation,
because fits keep their residuals and sensitivities.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import math

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.discrepancy.noise import MAX_CHANCE
from saddlering_ros.discrepancy.problem.fits import Fit, PRIOR, stepped_misfit, tangent
from saddlering_ros.discrepancy.problem.metric import Metric, noise_metric
from saddlering_ros.discrepancy.problem.problem import Problem
from saddlering_ros.discrepancy.problem.system import Array, FREE_STRENGTH
from saddlering_ros.discrepancy.search.evidence import Comparison
from saddlering_ros.discrepancy.search.selection import MAINLY, Search
from saddlering_ros.discrepancy.search.signatures import length_needed, SMALLER
from saddlering_ros.discrepancy.search.space import FREE_SPREAD, MIN_PAIRS, ModelSpace
from saddlering_ros.discrepancy.verdict import results, wording
from saddlering_ros.discrepancy.verdict.published import Publication, STRETCHES
from saddlering_ros.discrepancy.verdict.results import Cause, MIN_TAKEN, PublishedFits, Refit
from saddlering_ros.estimation.least_squares import covariance
from saddlering_ros.estimation.process import fisher_chance
from saddlering_ros.quantities import GOOD, percent, quantity, signed_percent, WIDTH_95

STRAIGHT_SHARE = 0.1
"""Share of an effect beside the base parameters from which its influence on a size is told: below
it, the curvature of the base parameters counts. A worn arc with a share of 0.03 was said to change
a friction of 5 kN by 4 kN."""

SAME_SIZE = 0.02
"""Share by which the sizes of one law may differ from run to run and from channel to channel: no
machine keeps its size better. Without it, a true law of 94 to 103 % was refused. Up to 0.03 all
stand-ins of development, which differ by 40 to 60 %, are refused; with 0.05 one of four is not."""

PRESENT, ABSENT = 0.5, 0.25
"""Shares of the largest size of a cause by run: from the first on the cause is present in a run,
and up to the second it is absent, if two standard deviations do not reach the other one. Chosen,
with a gap between them for sizes that follow the conditions of the runs."""

ODD, OTHER = 1.0 / 3.0, 2.0 / 3.0
"""Shares of the misfit beyond noise: no more than the first is left without a run that differs,
and at least the second without any other one. Chosen: on four tests of a ring with a zero of the
load cell that is 2.5 and 5 kN wrong in one, 0.31 and 0.03 are left, and 0.75 and 0.98."""

AGREED = 0.25
"""Share of the change of a size in a held-out run within which two fitted runs agree on a size, so
that the machine has changed: chosen."""

MAX_FREED = 8
"""Models whose cause receives a size for each run: the best ones. Chosen for cost."""


@dataclass(frozen=True)
class _Parts:
    """Sizes (k,) of a cause in each part, as shares of its common size, and their covariance.

    shown: numbers of the parts in which these data show the cause; fall: of the misfit.
    """

    shown: NDArray[np.intp]
    sizes: Array
    errors: Array
    fall: float

    @classmethod
    def by(cls, place: int, metric: Metric, white: Array, fit: Fit, index: int,
           change: Array) -> '_Parts':
        """By run (place 0) or by channel (1): size and change (n,) of the parameter `index`.

        white (n, p): sensitivities of the fit.
        """
        slots = metric.problem.slices
        owners = [(run, channel)[place] for run, channel, _ in slots]
        columns = np.zeros((change.size, 1 + max(owners)))
        for (_, _, rows), owner in zip(slots, owners, strict=True):
            columns[rows, owner] = change[rows]
        others = np.delete(white, index, axis=1)
        jacobian = np.hstack([metric.whiten(columns), others])
        errors = covariance(jacobian, 1.0 / FREE_SPREAD)
        slope = jacobian.T @ fit.whitened
        beyond = -(errors @ slope)[: columns.shape[1]]
        shown = np.flatnonzero(np.diag(errors)[: beyond.size] < 1.0).astype(np.intp)
        return cls(shown, 1.0 + beyond[shown], errors[np.ix_(shown, shown)],
                   float(slope @ errors @ slope))

    def acts_in(self) -> NDArray[np.bool_] | None:
        """Mask (k,) of the parts with the cause if the others are without it, else None."""
        largest = self.sizes[np.argmax(np.abs(self.sizes))]
        shares, deviations = self.sizes / largest, np.sqrt(np.diag(self.errors)) / abs(largest)
        present = (shares > PRESENT) & (shares - 2.0 * deviations > ABSENT)
        absent = (np.abs(shares) < ABSENT) & (np.abs(shares) + 2.0 * deviations < PRESENT)
        return present if absent.any() and bool((present | absent).all()) else None

    def fall_confined_to(self, present: NDArray[np.bool_]) -> float:
        """Fall of the misfit if the cause has one size in these parts and none in the others."""
        weights = np.linalg.inv(self.errors)
        size = (weights @ self.sizes)[present].sum() / weights[np.ix_(present, present)].sum()
        apart = self.sizes - size * present
        return self.fall - float(apart @ weights @ apart)

    def mean(self, chosen: NDArray[np.bool_]) -> tuple[float, float]:
        """Mean size of some parts and its standard deviation."""
        weights = np.linalg.inv(self.errors[np.ix_(chosen, chosen)])
        return (float((weights @ self.sizes[chosen]).sum() / weights.sum()),
                float(weights.sum() ** -0.5))


def unsteady_sizes(space: ModelSpace, fit: Fit, causes: Sequence[Cause]) -> list[str]:
    """A sentence for every cause, beside learnt model error, that needs unlike sizes.

    Sizes may differ by the stated interval, too: the error that is learnt depends on the cause.
    """
    stated = {}
    for cause in causes:
        size = cause.parameters[cause.definition.size.name]
        # A published size of zero allows any.
        stated[cause.effect] = size.std / max(
            abs(size.value - cause.definition.neutral), 1e-6 * size.std, 1e-300)
    return _unlike_sizes(space, fit, stated, trials=1)


def unsteady_sizes_alone(space: ModelSpace, fit: Fit, causes: Sequence[Cause]) -> list[str]:
    """The same of causes beside noise alone, whose intervals are in the sizes of each part."""
    return _unlike_sizes(
        space, fit, {cause.effect: 0.0 for cause in causes}, trials=2 * len(causes))


def _unlike_sizes(space: ModelSpace, fit: Fit, intervals: Mapping[str, float],
                  trials: int) -> list[str]:
    """A sentence for every cause that needs another size in each run, or in each channel.

    A law has one size wherever it acts. The size of a stand-in follows the conditions. Sizes that
    differ by more than model error and the interval of the cause, a share of its size, explain are
    those of another law. trials: chances by which one of these tests is wrong.
    """
    sentences, titles = [], space.problem.titles
    for (effect, _, indices), change in zip(fit.parts, space.changes_of(fit).T, strict=True):
        if (interval := intervals.get(effect.id)) is None:
            continue
        for place, kind in enumerate(('run', 'channel')):
            parts = _Parts.by(
                place, space.metric, space.tangent_of(fit).white, fit, indices.start, change)
            allowed = interval**2 + SAME_SIZE**2
            weights = np.linalg.inv(parts.errors + allowed * np.eye(parts.sizes.size))
            apart = parts.sizes - (weights @ parts.sizes).sum() / max(weights.sum(), 1e-300)
            freedom = max(parts.sizes.size - 1, 1)
            ratio = float(apart @ weights @ apart) / freedom
            if fisher_chance(ratio, freedom, space.pairs) < space.settings.error_rate / trials:
                sentences.append(wording.UNSTEADY_SIZE.format(
                    titles[effect.id], kind, percent(parts.sizes.min()),
                    percent(parts.sizes.max())))
    return sentences


def changed_sizes(space: ModelSpace, published: Publication,
                  remainder: Sequence[results.Remainder]) -> tuple[list[str], bool]:
    """A sentence for every cause with another size in a held-out run, and whether that is a doubt.

    A stand-in takes its size from the conditions of the fitted runs. To first order about the
    published fit, the size is freed in the held-out run alone, beside what the fitted runs leave
    open of all parameters. What remains or is declared can be error of the model along the cause.
    Where fitted runs agree on a size that is surely another one, the machine has changed.
    """
    problem, fit = space.problem, published.fits.after
    slopes = tangent(published.fits.metric, fit).white
    known = slopes.T @ slopes + PRIOR**2 * np.eye(fit.theta_unit.size)
    errors = {view: max(declared, *(rest.share_of_range for rest in remainder
                                    if rest.channel == view), 0.0)
              for view, declared in problem.allowed_sizes.items()}
    sentences, is_doubt = [], False
    for run in problem.held_out:
        alone = problem.with_runs([replace(run, held_out=False)])
        prediction = alone.predict([fit.point])[:, 0]
        if not np.isfinite(prediction).all():
            continue
        metric, seen = noise_metric(alone, prediction).with_offsets(), replace(
            fit, prediction=prediction, plain=None)
        changes, base = alone.changes_of_effects(fit.point, prediction), tangent(metric, seen)
        white, left = metric.whiten(changes), metric.whiten(prediction - alone.measured)
        beside = base.white.T @ base.white + known
        columns, count = np.hstack([white, base.white]), changes.shape[1]
        gram = columns.T @ columns
        gram[count:, count:] += known
        gram[np.diag_indices(count)] += FREE_SPREAD**-2
        moves, variances = -np.linalg.solve(gram, columns.T @ left), np.diag(np.linalg.inv(gram))
        beyond = changes - base.plain @ np.linalg.solve(beside, base.white.T @ white)
        pairs = max(MIN_PAIRS, min(noise.pairs for noise in metric.noise.values()))
        for number, (cause, (effect, _, indices)) in enumerate(
                zip(published.causes, fit.parts, strict=True)):
            sizes = {view: float(alone.view_sizes(beyond[:, number], view)[0])
                     * alone.view_ranges[view] / scale
                     for view, scale in problem.view_ranges.items()}
            view = max(sizes, key=lambda name: sizes[name])
            error = np.hypot(SAME_SIZE, errors[view] / max(sizes[view], 1e-300))
            move, spread = float(moves[number]), float(np.hypot(variances[number]**0.5, error))
            if len(cause.group) > 1 or abs(move) * sizes[view] < space.settings.materiality or (
                    fisher_chance((move / spread) ** 2, 1, pairs) > MAX_CHANCE):
                continue
            sentences.append(wording.CHANGED_SIZE.format(
                problem.titles[effect.id], run.name,
                signed_percent(1.0 + move, spread, is_signed=False)))
            whole = problem.changes_of_effects(fit.point, fit.prediction)[:, number]
            parts = _Parts.by(0, published.fits.metric, slopes, fit, indices.start, whole)
            near = np.abs(parts.sizes - 1.0) + 2.0 * np.sqrt(np.diag(parts.errors))
            is_doubt |= bool(np.count_nonzero(near < AGREED * abs(move)) < 2)
    return sentences, is_doubt


def uneven_rest(fits: PublishedFits) -> list[str]:
    """A sentence if one run keeps much more than each other, though the causes act there.

    What a right law leaves is error of one model, in each run about as large. Counted beyond noise
    in the view that the causes change most, of its range and as a share of the misfit. A run of
    which they take enough to be established shows nothing.
    """
    problem = fits.metric.problem
    before, after = (fit.prediction - problem.measured for fit in (fits.before, fits.after))
    changes = {view: problem.view_sizes(before - after, view) for view in problem.view_ranges}
    view = max(changes, key=lambda name: float(changes[name] @ changes[name]))
    whole, left = (problem.view_sizes(residual, view) for residual in (before, after))
    noise = np.array([fits.metric.noise_power(run, view) for run in problem.runs])
    beyond = np.sqrt(np.maximum(left**2 - noise / problem.view_ranges[view] ** 2, 0.0))
    acting = (changes[view]**2 > MAINLY * whole**2) & (
        beyond**2 > (1.0 - MIN_TAKEN) * whole**2) & (whole.size > 1)
    return [
        wording.UNEVEN_RUN.format(problem.runs[run].name, percent(left[run]), view)
        for run in np.flatnonzero(acting) if all(
            beyond[run] / part[run] > GOOD * np.delete(left / part, run).max()
            for part in (np.ones_like(whole), whole))]


def cause_of_some_runs(space: ModelSpace, selected: Fit) -> tuple[str, str] | None:
    """The cause and a sentence if the best model has one that acts in some runs only, else None.

    Such a cause leaves much of the misfit, so that another one can be selected. Every model with
    one effect that is better than the base is therefore tried beside the `selected` one, with a
    size for each run, or with one size in some of them. The best must be better than the selected
    one, surely and by more than its sizes or the choice of the runs cost.
    """
    problem, found, count = space.problem, None, len(space.problem.runs)
    if count < 2:
        return None
    least = space.penalised(selected) - space.real_gain()
    singles = sorted((fit for fit in space.single_effect_fits() if fit.misfit < space.base.misfit),
                     key=space.penalised)
    tried = {fit.candidate.key: fit for fit in (*singles[:MAX_FREED], selected)}
    for fit in tried.values():
        for (effect, variant, indices), change in zip(
                fit.parts, space.changes_of(fit).T, strict=True):
            if not change.any():
                continue
            parts = _Parts.by(
                0, space.metric, space.tangent_of(fit).white, fit, indices.start, change)
            if parts.sizes.size < 2:
                continue
            present, worth = parts.acts_in(), parts.fall - (count - 1) * space.log_size
            if present is not None:
                worth = max(worth, parts.fall_confined_to(present) - 2.0 * count * np.log(2.0))
            if space.penalised(fit) - worth > least:
                continue
            least, found = space.penalised(fit) - worth, None
            if present is not None:
                common = fit.point.effects[effect.id][effect.size.name] - effect.neutral
                (mean, std), (left, error) = parts.mean(present), parts.mean(~present)
                found = effect.id, wording.some_runs_words(
                    space.title_at(effect, variant),
                    [problem.runs[run].name for run in parts.shown[present]],
                    effect.size, (effect.neutral + common * mean, abs(common) * std),
                    (left / mean, error / abs(mean)))
    return found


def odd_run(fits: Sequence[Fit], problem: Problem) -> str:
    """The name of the run without which each of these fits the others, if one differs, else ''.

    fits: the base, and a model whose causes can explain why a run differs.
    """
    names = set()
    for fit in fits:
        blocks = [block.reshape(-1, fit.theta_unit.size + 1) for block in problem.by_run(
            np.column_stack([fit.jacobian, fit.whitened]))]
        products = np.array([block.T @ block for block in blocks])
        # Products and numbers of samples of all runs, and without each of them.
        sums = [products.sum(axis=0), *(products.sum(axis=0) - products)]
        counts = np.array([np.count_nonzero(block[:, -1]) for block in blocks])
        whole, *left = [stepped_misfit(total) - count for total, count in zip(
            sums, [counts.sum(), *(counts.sum() - counts)], strict=True)]
        places = np.argsort(left)
        is_odd = len(left) > 2 and whole > WIDTH_95 * math.sqrt(2.0 * counts.sum()) and (
            left[places[0]] < ODD * whole and left[places[1]] > OTHER * whole)
        names.add(problem.runs[places[0]].name if is_odd else '')
    return names.pop() if len(names) == 1 else ''


def hidden_causes(space: ModelSpace, fits: PublishedFits, causes: Sequence[Cause]) -> list[str]:
    """A sentence for every cause whose size another one, too small to show, changes surely.

    To first order about the published fit: the other one has the largest size within its bounds
    that would not be found beside it nine times in ten, or not matter.
    """
    metric, fit, sentences = fits.metric, fits.after, []
    columns, others = tangent(metric, fit).white, []
    # With the prior of every fit, without which scales that only have a ratio would move freely.
    gram = columns.T @ columns + PRIOR**2 * np.eye(fit.theta_unit.size)
    for signature in space.signatures:
        if signature.share >= STRAIGHT_SHARE:
            white = metric.whiten(signature.plain)
            moves = np.linalg.solve(gram, columns.T @ white)
            others.append((signature, moves, float(np.linalg.norm(white - columns @ moves))))
    by_effect = {cause.effect: cause for cause in causes}
    for effect, _, indices in fit.parts:
        cause, index = by_effect[effect.id], indices.start
        size = cause.parameters[effect.size.name]
        slope = effect.size.slope(float(fit.theta_unit[index]))
        largest = (WIDTH_95 * size.std, '')  # a change within the interval is none
        for signature, moves, shown in others:
            if signature.effect.id in (*fit.candidate.ids, *cause.group):
                continue
            law = signature.effect
            reach = max(abs(law.size.low - law.neutral), abs(law.size.high - law.neutral))
            times = min(
                max(length_needed(space, law) / max(shown, 1e-300),
                    space.settings.materiality / max(signature.visible, 1e-300)),
                reach / max(abs(signature.size), 1e-300))
            if signature.amplitude_dependent and times > 1.0 / SMALLER:
                continue  # It has another shape at such a size.
            shift = abs(float(moves[index])) * times * slope
            largest = max(largest, (shift, wording.HIDDEN.format(
                space.problem.titles[effect.id], space.title_at(law, signature.variant),
                quantity(abs(signature.size) * times, law.size.unit, digits=2),
                quantity(shift, effect.size.unit, digits=2))))
        sentences += [largest[1]] if largest[1] else []
    return sentences


SEEDS = 6
"""Number of draws of stretches: with the runs left out, about ten refits of usual data."""

MIN_STABLE = 0.8
"""Share of refits with the same first cause below which a verdict is near its limit."""

HALF, TWICE = 0.5, 2.0
"""Factors of the model error in refits."""

WITHOUT = 'without '
"""Begin of the change of a refit that leaves out a run."""

NEAR = 2.0
"""Factor of the gain at which an effect is real within which a verdict is near its limit."""

Stability = tuple[tuple[Refit, ...], tuple[str, ...], tuple[results.Influence, ...]]
"""Refits of all models, why the verdict is near its limit, and what each stretch adds."""


def stability_of(
        search: Search, taken: float | None, causes: Sequence[results.Cause]) -> Stability:
    """How far the verdict on a model with its causes hangs on runs, on model error and on chance.

    taken: share of the misfit that causes beside model error take.
    """
    order = {name: place for place, cause in enumerate(sorted(
        causes, key=lambda cause: -cause.visible)) for name in cause.group}
    space, fit, refits = search.space, search.fit, _refits(search, order)
    titles = {'': 'none', **space.problem.titles}
    others = [refit for refit in refits if not refit.is_same]
    near = [wording.OTHER_WITHOUT_RUN.format(refit.change, titles[refit.first or ''])
            for refit in others if refit.change.startswith(WITHOUT)]
    if len(others) > (1.0 - MIN_STABLE) * len(refits):
        near.append(wording.UNSTABLE.format(len(others), len(refits), '; '.join(
            f'{refit.change}: {titles[refit.first or ""]}' for refit in others[:3])))
    if not fit.candidate.effects and not np.isfinite(search.covered):
        singles = [Comparison(space, space.base, single) for single in space.single_effect_fits()]
        share, name, visible = max(((
            one.gain / space.real_gain(one.extra), one.more.candidate.ids[0], one.visible)
            for one in singles), default=(0.0, '', 0.0))
        if share > 1.0 / NEAR:
            near.append(wording.almost_a_cause_words(titles[name], share, visible))
    near += [wording.BARELY_REAL.format(titles[cause.effect], cause.times_needed)
             for cause in causes if cause.times_needed < NEAR]
    if taken is not None and MIN_TAKEN <= taken < 0.5 * (1.0 + MIN_TAKEN):
        near.append(wording.BARELY_TAKEN.format(percent(taken), percent(MIN_TAKEN)))
    falls = space.base.whitened**2 - fit.whitened**2
    influence = tuple(
        results.Influence(run.name, float(run.time[part[0]]), float(run.time[part[-1]]),
                          float(fall[:, part].sum()))
        for run, fall in zip(space.problem.runs, space.problem.by_run(falls), strict=True)
        for part in np.array_split(np.arange(run.time.size), STRETCHES) if part.size)
    return refits, tuple(near), influence


def _refits(search: Search, order: Mapping[str, int]) -> tuple[Refit, ...]:
    """Refits of all models to first order, each with the first cause that it ends in.

    order: place of the cause of each effect. A refit ends in the same first cause if its best
    model shares an effect with the model found or with an alternative to it, or has a law that
    contains such an effect or is contained in it.
    Bounds do not stop a step: where an effect of the other sign fits as well, so may another law.
    """
    space = search.space
    group = [search.fit, *(other for fits in search.alternatives.values() for other in fits)]
    # A verdict without causes stays the same if a refit ends in one that is too small to matter.
    # A fit that leaves more than the base is unfinished, and its size says nothing.
    others = [fit for fit in space.fits.values() if search.fit.candidate.effects or (
        fit.misfit < space.base.misfit and Comparison(space, space.base, fit).is_material)]
    models = {fit.candidate.key: fit for fit in (space.base, *others, *group)}
    answers = []
    wanted = {name for fit in group for name in fit.candidate.ids}
    narrower = {name for fit in group for effect, _ in fit.candidate.effects
                for name in effect.contains}
    # What changes, the factor of the model error, and weights (R, S) of the stretches.
    runs = space.problem.runs
    plain = np.ones((len(runs), STRETCHES))
    cases = [(WITHOUT + run.name, 1.0, plain - row[:, None])
             for run, row in zip(runs, np.eye(len(runs)), strict=True) if len(runs) > 1]
    random = np.random.default_rng(space.settings.seed)
    for number in range(SEEDS):
        drawn = random.integers(0, plain.size, plain.size)
        cases.append((f'stretches drawn again, {number + 1}', 1.0,
                      np.bincount(drawn, minlength=plain.size).astype(float)))
    cases += [('half the model error', HALF, plain), ('twice the model error', TWICE, plain)]
    sums = [_Sums(space, model) for model in models.values()]
    for change, factor, weights in cases:
        # What declared error covers needs no cause: the base comes first.
        tried = sums if factor < search.covered else sums[:1]
        best = min(tried, key=lambda model: model.penalised(factor, weights.ravel()))
        effects = [effect for effect, _ in best.fit.candidate.effects]
        is_same = any(effect.id in wanted | narrower or wanted & set(effect.contains)
                      for effect in effects) if effects else not wanted
        first = min((effect.id for effect in effects), default=None, key=lambda name: (
            name not in wanted, order.get(name, len(order))))
        answers.append(Refit(change, first, is_same))
    return tuple(answers)


class _Sums:
    """Products of residual and sensitivities of a fit: by stretch, and along the model error."""

    def __init__(self, space: ModelSpace, fit: Fit) -> None:
        self.fit, self._space = fit, space
        columns = np.column_stack([fit.jacobian, fit.whitened])
        parts = [
            block[:, part].reshape(-1, columns.shape[1])
            for block in space.problem.by_run(columns)
            for part in np.array_split(np.arange(block.shape[1]), STRETCHES)]
        self._products = np.array([part.T @ part for part in parts])
        self._along = space.metric.shared.directions.T @ columns

    def penalised(self, factor: float, weights: Array) -> float:
        """Misfit after one step, plus the price of its parameters and of its first effect.

        factor: of the model error and other nuisance parameters with a spread. Stretches have
        weights with a factor of one only.
        """
        price = self._space.log_size * self.fit.theta_unit.size
        if self.fit.candidate.effects:
            price += max(self._space.real_gain() - self._space.log_size, 0.0)
        products = np.tensordot(weights, self._products, axes=1)
        if factor != 1.0:
            strength = self._space.metric.shared.strength
            other = np.where(strength < FREE_STRENGTH, factor * strength, strength)
            more = (strength**2 - other**2) / (1.0 + other**2)
            products += (self._along.T * more) @ self._along
        return stepped_misfit(products) + price
