"""One large cause among many small errors, where nothing of a machine is exact.

A cause is an outlier of the common spread of all errors, and the logarithm of the likelihood,
marginalised over them, compares its model with those of other causes.
"""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from saddlering_ros.discrepancy.problem.fits import Fit, Key, PRIOR
from saddlering_ros.discrepancy.problem.metric import Metric, nuisance_columns
from saddlering_ros.discrepancy.problem.system import Array, Effect
from saddlering_ros.discrepancy.search import ranking
from saddlering_ros.discrepancy.search.selection import in_metric, Search, stopped_sizes
from saddlering_ros.discrepancy.search.small_errors import Model, SmallErrors, SPREADS
from saddlering_ros.discrepancy.search.space import fit_each, ModelSpace, refit_full_jacobian
from saddlering_ros.estimation.least_squares import covariance
from saddlering_ros.quantities import WIDTH_95

MIN_TIMES, MIN_MARGIN = 40.0, 10.0
"""Size over the spread of the small errors, and logarithm of the likelihood over that of every
other model, from which a cause stands out. On dirty rings of development true main causes had 35
to 408 times and a logarithm of 17 and more, but for two with 7 and 10; stand-ins for laws that
were taken out had 61 to 109 times and a logarithm of 6 and less, but for one with 41. One error
that is much larger than most raises the common spread, so that the spread beside it counts, which
is a fifth smaller where no error is. Right names of ten rings had 55 times beside it and more, and
an arc for the waviness of a raceway 35."""

MAX_COMPARED = 8
"""Models that are compared with larger errors, at most."""

MAX_CAUSES, MAX_OF_MANY, MANY = 3, 4, 20
"""Effects of a model at most, and of one among so many effects that are listed. Each further one
fits what is left of a cause that is not listed, and the spread is learnt from those that remain:
of seven small errors, four would leave none. With three effects, three errors of a ring that are
larger than usual kept its main cause out."""

MAX_LOST = 0.15
"""Share of the logarithm of the likelihood, over that without both, that a law may lose in the
place of one that contains it. On four dirty rings with friction in the radial row it was 0.2 to
11 %."""

MAX_OTHERS = 2
"""Other causes in the group of a main cause, at most."""

MAX_TRIED = 4
"""Effects that are refitted in a place of a model: the best to first order."""

MAX_PAIRS = 16
"""Effects beside the most likely one whose evidence is computed: those that promise most. In three
searches on two rings, the eight most likely of some 38 were among the first 16."""

MAX_STEPS = 4
"""Models from which other ones are tried at most; each step costs some ten refits."""

MAX_LEARNT, LEARNT_AGAIN = 2, 0.5
"""Searches at most, and the share to which the spread must fall for a second one: errors that are
too large hide secondary causes."""


@dataclass(frozen=True)
class Among:
    """The best model among small errors, and every other one that was tried beside it.

    space: the space in whose metric they are fitted; errors: the small errors there.
    """

    space: ModelSpace
    best: Model
    others: Sequence[Model]
    errors: SmallErrors

    @property
    def likely(self) -> list[Model]:
        """The best model and all others that are nearly as likely, whose effects do not cancel."""
        least = self.best.evidence - MIN_MARGIN
        return [self.best, *(other for other in self.others
                             if other.evidence > least and other.is_acceptable)]

    def closest_without(self, *names: str) -> tuple[Model, float]:
        """The best model without effects, and the logarithm of the likelihood over that of it.

        A law that contains such an effect, or that it contains, is no other cause. Other errors
        may be larger than the common spread in both models.
        """
        effects = {effect.id: effect for model in (self.best, *self.others)
                   for effect, _ in model.fit.candidate.effects}
        alike = {*names, *(part for name in names for part in effects[name].contains)}
        others = sorted((other for other in self.others if not any(
            effect.id in alike or {*names} & {*effect.contains}
            for effect, _ in other.fit.candidate.effects)), key=lambda other: -other.evidence)
        evidences = [(self.errors.with_larger(self.space, other.fit, alike).evidence, number)
                     for number, other in enumerate(others[:MAX_COMPARED])]
        evidence, number = max(evidences)
        best = self.errors.with_larger(self.space, self.best.fit, ())
        return others[number], best.evidence - evidence

    def group_of(self, name: str) -> tuple[dict[str, Model], Model, float]:
        """Other causes that explain as well as an effect of the best model, each in its model.

        With them the best model without all of them, and the logarithm of the likelihood over
        that of it. Each stands out as the effect does. What explains better is no equal. A law
        that contains what moves more than its own part is one group with it.
        """
        group = self._contained_in(name)
        while True:
            other, margin = self.closest_without(name, *group)
            more = {own: size for own, size in other.visible.items()
                    if own not in self.best.visible}
            cause = max(more, default='', key=lambda own: more[own])
            if (abs(margin) >= MIN_MARGIN or len(group) == MAX_OTHERS or not cause
                    or self.times(cause, other) < MIN_TIMES):
                return group, other, margin
            group[cause] = other

    def _contained_in(self, name: str) -> dict[str, Model]:
        """Laws that an effect of the best model contains, if they move more than its own part."""
        space, fit = self.space, self.best.fit
        effect = next(effect for effect, _ in fit.candidate.effects if effect.id == name)
        if not effect.contains:
            return {}
        own, change = next(
            (_own_part(space, fit, effect, part), change) for (law, _, part), change
            in zip(fit.parts, space.changes_of(fit).T, strict=True) if law is effect)
        if _size(space, change - own) <= _size(space, own):
            return {}
        return {law: max(there, key=lambda model: model.evidence) for law in effect.contains
                if (there := [model for model in self.others if law in model.visible])}

    def beside_larger_errors(self, rounds: int) -> Fit:
        """The best model refitted beside errors of unequal size; of its main cause small ones."""
        fit, space = self.best.fit, self.space
        main = max(self.best.visible, key=lambda name: self.best.visible[name])
        metric = _beside(space.metric, fit, self.errors.larger_columns(space, fit, {main}))
        [refitted] = refit_full_jacobian(metric, [fit], rounds)
        return refitted

    def times(self, name: str, model: Model | None = None) -> float:
        """Size of an effect of a model (the best one) over the spread beside one larger error."""
        model = model or self.best
        return model.visible[name] / self.errors.with_larger(self.space, model.fit, ()).beside_one

    def margin(self, name: str) -> float:
        """Logarithm of the likelihood over that of the best model without an effect."""
        return self.closest_without(name)[1]

    def stands_out(self, name: str, least: float = MIN_TIMES) -> bool:
        """Whether an effect is an outlier: at least so many times the small errors, and sure."""
        return self.times(name) >= least and self.margin(name) >= MIN_MARGIN


def search_among_small_errors(search: Search) -> Among | None:
    """The model with the largest evidence that replacing, adding and removing effects leads to.

    None if what the search left is too large for small errors.
    """
    alone, fit = search.space, search.fit
    errors = SmallErrors(alone)
    spread = errors.model_of_fit(alone, fit).spread
    if spread == SPREADS[-1]:
        return None
    # Effects that cancel each other can leave more than none of them.
    spread = min(spread, errors.model_of_fit(alone, alone.base).spread)
    for _ in range(MAX_LEARNT):
        space, fit = in_metric(alone, _beside(alone.metric, fit, spread * errors.columns), fit)
        among = _climb(space, errors, fit)
        fit = among.best.fit
        if among.best.spread > LEARNT_AGAIN * spread:
            break
        spread = among.best.spread
    return among


def _beside(metric: Metric, fit: Fit, errors: Array) -> Metric:
    """The metric beside errors (n, c), with every nuisance parameter at a fit."""
    return metric.marginalise(np.hstack([
        nuisance_columns(metric.problem, fit.point, fit.prediction), errors]))


def _climb(space: ModelSpace, errors: SmallErrors, fit: Fit) -> Among:
    """Models about the best one so far, until none is better."""
    models: dict[Key, Model] = {}
    completed: set[Key] = set()

    def add(fits: Sequence[Fit]) -> None:
        for one in fits:
            if one.candidate.key not in models and not stopped_sizes(one):
                models[one.candidate.key] = errors.model_of_fit(space, one)
        _complete(space, errors, models, completed)

    add([space.base, fit, *_with_another(space, space.base, MAX_TRIED)])
    # A cause shows beside another one that hides it, and then its first-order gain is no guide.
    singles = [model for model in models.values() if len(model.visible) == 1]
    if singles:
        pairs = _with_another(space, max(singles, key=lambda model: model.evidence).fit)
        add(sorted(pairs, key=space.foreseen)[:MAX_PAIRS])
    done: set[Key] = set()
    most = MAX_CAUSES if len(space.problem.system.effects) < MANY else MAX_OF_MANY
    for _ in range(MAX_STEPS):
        space.watch.check()
        # Effects that cancel each other are no model, but what takes the place of one may be.
        likely = max(models.values(), key=lambda model: model.evidence)
        steps = [model.fit for model in (_best(models.values()), likely)
                 if model.fit.candidate.key not in done]
        if not steps:
            break
        for own in steps:
            done.add(own.candidate.key)
            names = own.candidate.ids
            if len(names) < most:
                add(_with_another(space, own, MAX_TRIED))
            for name in names:
                less = space.without(own, name)
                add([less, *_with_another(space, less, MAX_TRIED, names)])
    best = _with_contained_law(space, models.values())
    others = [model for model in models.values() if model is not best]
    return Among(space, best, others, errors)


def _complete(space: ModelSpace, errors: SmallErrors, models: dict[Key, Model],
              completed: set[Key]) -> None:
    """Finish the fits whose slopes promise to be nearly as likely as the best one, each once.

    The evidence of an unfinished fit is no evidence against its model: the true one of a ring was
    less likely than the best one by 156 with a misfit of 5 702, and more likely by 35 with 4 981.
    """
    def promised(model: Model) -> float:
        return model.evidence + 0.5 * (space.penalised(model.fit) - space.foreseen(model.fit))

    while True:
        least = max(model.evidence for model in models.values()) - MIN_MARGIN
        wanted = {key: model.fit for key, model in models.items() if not model.fit.converged
                  and key not in completed and promised(model) > least}
        if not wanted:
            return
        completed.update(wanted)
        for fit in refit_full_jacobian(
                space.metric, list(wanted.values()), space.settings.max_rounds):
            models[fit.candidate.key] = errors.model_of_fit(space, space.keep(fit))


def _with_contained_law(space: ModelSpace, models: Collection[Model]) -> Model:
    """The best model, or one with a law that a law of the best one contains.

    A law that contains others gives way to one of them that is nearly as likely if its own size
    may be zero. If its own part is a small error it gives way to one that stands out and takes
    most of what it does: a ring with large friction in one row has some in the others.
    """
    best = _best(models)
    half = WIDTH_95 * np.sqrt(np.diag(covariance(space.tangent_of(best.fit).white, PRIOR)))
    chosen = []
    for effect, _, part in best.fit.parts:
        if not effect.contains:
            continue
        least, size = np.inf, float(best.fit.theta_unit[part.start])
        if abs(effect.size.to_unit(effect.neutral) - size) <= half[part.start]:
            least = best.evidence - MIN_MARGIN
        elif _size(space, _own_part(space, best.fit, effect, part)) < MIN_TIMES * best.spread:
            alike = {effect.id, *effect.contains}
            without = max(model.evidence for model in models if not alike & {*model.visible})
            least = best.evidence - MAX_LOST * (best.evidence - without)
        chosen += [model for model in models if model.is_acceptable and model.evidence > least
                   and any(model.visible.get(name, 0.0) >= MIN_TIMES * model.spread
                           for name in effect.contains)]
    return _best(chosen or [best])


def _own_part(space: ModelSpace, fit: Fit, effect: Effect, part: slice) -> Array:
    """Change (n,) by an effect of a fit without what laws that it contains do."""
    point = fit.theta_unit.copy()
    point[part.start] = effect.size.to_unit(effect.neutral)
    base = space.problem.system.base_parameters
    return fit.prediction - space.problem.predict([fit.candidate.point(base, point)])[:, 0]


def _size(space: ModelSpace, change: Array) -> float:
    """Share of range by which a change (n,) moves the view and run that it moves most."""
    return float(space.scale.sizes(change[:, None]).max())


def _with_another(space: ModelSpace, fit: Fit, most: int | None = None,
                  excluded: Sequence[str] = ()) -> list[Fit]:
    """The model of `fit` plus each of the best effects to first order; without `most`, of all."""
    scores = ranking.rank(fit, space.tangent_of(fit).white, space.shown, excluded)
    return fit_each(space, fit, ranking.best_of_each(scores)[:most])


def _best(models: Iterable[Model]) -> Model:
    """The most likely model whose effects move more than a small error, and do not cancel."""
    return max((model for model in models if model.is_acceptable),
               key=lambda model: model.evidence)
