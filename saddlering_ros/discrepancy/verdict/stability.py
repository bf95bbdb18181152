"""How far a verdict hangs on runs, on model error and on chance.

All models that were fitted are refitted to first order: without each run, with half and twice the
model error, and with stretches drawn again. The refits need no simulation, because fits keep their
residuals and sensitivities.
"""

import numpy as np

from saddlering_ros.discrepancy.problem.fits import Fit, stepped_misfit
from saddlering_ros.discrepancy.problem.system import Array, FREE_STRENGTH
from saddlering_ros.discrepancy.search.evidence import Comparison
from saddlering_ros.discrepancy.search.selection import Search
from saddlering_ros.discrepancy.search.space import ModelSpace
from saddlering_ros.discrepancy.verdict import results, wording
from saddlering_ros.discrepancy.verdict.published import STRETCHES
from saddlering_ros.discrepancy.verdict.results import MIN_TAKEN, Refit
from saddlering_ros.quantities import percent

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


def stability_of(search: Search, taken: float | None) -> Stability:
    """How far the verdict on a model hangs on runs, on model error and on chance.

    taken: share of the misfit that causes beside model error take.
    """
    space, fit, refits = search.space, search.fit, _refits(search)
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
    for name in fit.candidate.ids:
        gain = space.without(fit, name).misfit - fit.misfit
        if gain < NEAR * space.real_gain():
            near.append(wording.BARELY_REAL.format(titles[name], gain / space.real_gain()))
    if taken is not None and MIN_TAKEN <= taken < 0.5 * (1.0 + MIN_TAKEN):
        near.append(wording.BARELY_TAKEN.format(percent(taken), percent(MIN_TAKEN)))
    falls = space.base.whitened**2 - fit.whitened**2
    influence = tuple(
        results.Influence(run.name, float(run.time[part[0]]), float(run.time[part[-1]]),
                          float(fall[:, part].sum()))
        for run, fall in zip(space.problem.runs, space.problem.by_run(falls), strict=True)
        for part in np.array_split(np.arange(run.time.size), STRETCHES) if part.size)
    return refits, tuple(near), influence


def _refits(search: Search) -> tuple[Refit, ...]:
    """Refits of all models to first order, each with the first cause that it ends in.

    A refit ends in the same first cause if its best model shares an effect with the model found
    or with an alternative to it, or has a law that contains such an effect or is contained in it.
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
            name not in wanted))
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
