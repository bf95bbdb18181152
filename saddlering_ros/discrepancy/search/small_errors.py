"""One large cause among many small errors, where nothing of a machine is exact.

Load cell, probes, raceways and joints of a real ring each err a little, all at once, so that no
single effect leaves noise alone. Here every listed effect and every smooth shape of a view is an
error with a mean of zero and one common spread, a share of the range of the view that it moves
most. The spread is learnt: it is the most likely one beside the effects of a model (empirical
Bayes). A cause is an outlier of this spread, and the logarithm of the likelihood, marginalised
over all small errors, compares its model with those of other causes. What a stand-in leaves needs
a larger spread than what the true cause leaves. A few errors of a real machine are much larger
than most. Where causes are compared, errors of any kind can therefore be larger than the common
spread, at a price each (automatic relevance determination), but for the cause in question.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from saddlering_ros.discrepancy.problem.fits import Fit, PRIOR
from saddlering_ros.discrepancy.problem.metric import nuisance_columns
from saddlering_ros.discrepancy.problem.problem import Problem
from saddlering_ros.discrepancy.problem.system import Array, Point
from saddlering_ros.discrepancy.search import ranking
from saddlering_ros.discrepancy.search.evidence import forms_of
from saddlering_ros.discrepancy.search.lack_of_fit import shape_families
from saddlering_ros.discrepancy.search.selection import in_metric, Search, stopped_sizes
from saddlering_ros.discrepancy.search.signatures import MIN_LENGTH, Signature
from saddlering_ros.discrepancy.search.space import fit_each, FREE_SPREAD, ModelSpace
from saddlering_ros.estimation.least_squares import covariance
from saddlering_ros.quantities import WIDTH_95

SPREADS = np.geomspace(1e-4, 2e-2, 24)
"""Common spreads that are tried, in shares of range: from a tenth of what is material."""

MIN_STRENGTH = 0.1
"""Error over the noise below which a direction of all the errors together is left out."""

MIN_TIMES, MIN_MARGIN = 40.0, 10.0
"""Size over the spread of the small errors, and logarithm of the likelihood over that of every
other model, from which a cause stands out. On dirty rings of development true main causes had 35
to 408 times and a logarithm of 17 and more, but for two with 7 and 10; stand-ins for laws that
were taken out had 61 to 109 times and a logarithm of 6 and less, but for one with 41. One error
that is much larger than most raises the common spread, so that the spread beside it counts, which
is a fifth smaller where no error is. Right names of ten rings had 55 times beside it and more, and
an arc for the waviness of a raceway 35."""

MIN_LEADING = 1.0
"""Movement over the noise of an error of a material size, above which errors of unequal size act
along a direction. Chosen for cost."""

FACTORS = (3.0, 10.0, 30.0)
"""Sizes over the common spread of errors that are larger."""

MAX_LARGER, MAX_COMPARED = 10, 8
"""Kinds of errors that are larger, and models that are compared with them, at most."""

MIN_JOINT = 0.8
"""Power of what effects move together over the sum of their powers, below which they cancel each
other. True causes of dirty rings had 0.91 and more; effects that stood in for a wedge under two
probes, which is in no catalogue, 0.39."""

MAX_CAUSES = 3
"""Effects of a model at most: each further one fits what is left of a cause that is not listed."""

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
class Model:
    """A model among small errors.

    evidence: logarithm of its marginal likelihood, with the price of each parameter of an effect
    as in the BIC; spread: at which it is largest; visible: share of range that each effect moves;
    joint: power of what all effects move together over the sum of their powers.
    """

    fit: Fit
    evidence: float
    spread: float
    visible: Mapping[str, float]
    joint: float

    @property
    def is_acceptable(self) -> bool:
        """Whether each effect moves more than a small error, and they do not cancel."""
        return self.joint >= MIN_JOINT and min(
            self.visible.values(), default=np.inf) > self.spread


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
        """The best model and all that are nearly as likely; more likely ones may cancel."""
        least = self.best.evidence - MIN_MARGIN
        return [self.best, *(other for other in self.others if other.evidence > least)]

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
        evidences = [(self.errors.with_larger(self.space, other.fit, alike)[0], number)
                     for number, other in enumerate(others[:MAX_COMPARED])]
        evidence, number = max(evidences)
        best, _ = self.errors.with_larger(self.space, self.best.fit, ())
        return others[number], best - evidence

    def group_of(self, name: str) -> tuple[dict[str, Model], Model, float]:
        """Other causes that explain as well as an effect of the best model, each in its model.

        With them the best model without all of them, and the logarithm of the likelihood over
        that of it. Each stands out as the effect does.
        """
        group = dict[str, Model]()
        while True:
            other, margin = self.closest_without(name, *group)
            more = {own: size for own, size in other.visible.items()
                    if own not in self.best.visible}
            cause = max(more, default='', key=lambda own: more[own])
            if (margin >= MIN_MARGIN or len(group) == MAX_OTHERS or not cause
                    or self._times(other, cause) < MIN_TIMES):
                return group, other, margin
            group[cause] = other

    def times(self, name: str) -> float:
        """Size of an effect of the best model over the common spread beside one larger error."""
        return self._times(self.best, name)

    def _times(self, model: Model, name: str) -> float:
        _, spread = self.errors.with_larger(self.space, model.fit, ())
        return model.visible[name] / spread

    def margin(self, name: str) -> float:
        """Logarithm of the likelihood over that of the best model without an effect."""
        return self.closest_without(name)[1]

    def stands_out(self, name: str) -> bool:
        """Whether an effect is an outlier of the small errors."""
        return self.times(name) >= MIN_TIMES and self.margin(name) >= MIN_MARGIN


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
        process = spread * errors.columns
        nuisances = nuisance_columns(alone.problem, fit.point, fit.prediction)
        space, fit = in_metric(
            alone, alone.metric.marginalise(np.hstack([nuisances, process])), fit)
        among = _climb(space, errors, fit)
        fit = among.best.fit
        if among.best.spread > LEARNT_AGAIN * spread:
            break
        spread = among.best.spread
    return among


def _climb(space: ModelSpace, errors: SmallErrors, fit: Fit) -> Among:
    """Models about the best one so far, until none is better."""
    models: dict[object, Model] = {}

    def add(fits: Sequence[Fit]) -> None:
        for one in fits:
            if one.candidate.key not in models and not stopped_sizes(space.problem, one):
                models[one.candidate.key] = errors.model_of_fit(space, one)

    add([space.base, fit, *_with_another(space, space.base, MAX_TRIED)])
    # A cause shows beside another one that hides it, and then its first-order gain is no guide.
    singles = [model for model in models.values() if len(model.visible) == 1]
    if singles:
        pairs = _with_another(space, max(singles, key=lambda model: model.evidence).fit)
        add(sorted(pairs, key=space.foreseen)[:MAX_PAIRS])
    done: set[object] = set()
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
            if len(names) < MAX_CAUSES:
                add(_with_another(space, own, MAX_TRIED))
            for name in names:
                less = space.without(own, name)
                add([less, *_with_another(space, less, MAX_TRIED, names)])
    best = _with_contained_law(space, models.values())
    others = [model for model in models.values() if model is not best]
    return Among(space, best, others, errors)


def _with_contained_law(space: ModelSpace, models: Collection[Model]) -> Model:
    """The best model, or one with a law that a law of the best one contains.

    A law that contains others gives way to one of them that is nearly as likely if its own size
    may be zero. If its own part is a small error it gives way to one that stands out and takes
    most of what it does: a ring with large friction in one row has some in the others.
    """
    best, base = _best(models), space.problem.system.base_parameters
    half = WIDTH_95 * np.sqrt(np.diag(covariance(space.tangent_of(best.fit).white, PRIOR)))
    chosen = []
    for effect, _, part in best.fit.candidate.slices(len(base)):
        if not effect.contains:
            continue
        point = best.fit.theta_unit.copy()
        point[part.start] = effect.size.to_unit(effect.neutral)
        least = np.inf
        if abs(point - best.fit.theta_unit)[part.start] <= half[part.start]:
            least = best.evidence - MIN_MARGIN
        else:
            moved = best.fit.prediction - space.problem.predict(
                [best.fit.candidate.point(base, point)])[:, 0]
            if float(space.scale.sizes(moved[:, None]).max()) < MIN_TIMES * best.spread:
                alike = {effect.id, *effect.contains}
                without = max(model.evidence for model in models if not alike & {*model.visible})
                least = best.evidence - MAX_LOST * (best.evidence - without)
        chosen += [model for model in models if model.is_acceptable and model.evidence > least
                   and any(model.visible.get(name, 0.0) >= MIN_TIMES * model.spread
                           for name in effect.contains)]
    return _best(chosen or [best])


def _with_another(
    space: ModelSpace, fit: Fit, most: int | None = None, excluded: Sequence[str] = ()
) -> list[Fit]:
    """The model of `fit` plus each of the best effects to first order; without `most`, of all."""
    scores = ranking.rank(
        fit, space.tangent_of(fit).white, space.shown, [*fit.candidate.ids, *excluded])
    return fit_each(space, fit, ranking.best_of_each(scores)[:most])


def _best(models: Iterable[Model]) -> Model:
    """The most likely model whose effects move more than a small error, and do not cancel."""
    return max((model for model in models if model.is_acceptable),
               key=lambda model: model.evidence)


class SmallErrors:
    """Every listed effect and smooth shape of a space as an error; columns: of unit spread."""

    def __init__(self, space: ModelSpace) -> None:
        self._metric = space.metric
        listed, names = _listed(space)
        smooth, families = _smooth(space.problem)
        columns = np.hstack([listed, smooth])
        white = self._metric.whiten(columns)
        values, vectors = np.linalg.eigh(white.T @ white)
        kept = values * SPREADS[-1] ** 2 > MIN_STRENGTH**2
        self.columns = columns @ vectors[:, kept]
        self._powers = values[kept]
        self._directions = white @ (vectors[:, kept] / np.sqrt(values[kept]))
        # Errors of one kind along the directions in which they show most.
        self._leading = self._powers * space.settings.materiality**2 > MIN_LEADING**2
        along = self._directions[:, self._leading].T @ white
        members = defaultdict[tuple[str, object], list[int]](list)
        for column, kind in enumerate([*names, *families]):
            members[kind].append(column)
        self._kinds = [(name, along[:, chosen]) for (name, _), chosen in members.items()]

    def model_of_fit(self, space: ModelSpace, fit: Fit) -> Model:
        """The evidence of a fit, at the spread at which it is largest."""
        visible, joint = _moved(space, fit)
        seen = self._projected(space, fit)
        likelihoods = []
        for strength in np.outer(SPREADS**2, self._powers):
            taken = (seen.along.T * (strength / (1.0 + strength))) @ seen.along
            likelihoods.append(seen.evidence(seen.whole - taken, float(np.log1p(strength).sum())))
        place = int(np.argmax(likelihoods))
        return Model(fit, likelihoods[place], float(SPREADS[place]), visible, joint)

    def with_larger(
        self, space: ModelSpace, fit: Fit, small: Collection[str],
    ) -> tuple[float, float]:
        """Evidence of a fit if errors of some kinds are larger, and common spread if one is.

        Each is larger at the price of a choice. small: effects whose errors are not.
        """
        return space.once(
            f'unequal {sorted(small)}', fit, lambda: self._with_larger(space, fit, small))

    def _with_larger(
        self, space: ModelSpace, fit: Fit, small: Collection[str],
    ) -> tuple[float, float]:
        seen = self._projected(space, fit)
        along = seen.along[self._leading]
        outside = seen.whole - along.T @ along
        common = np.diag(self._powers[self._leading])

        def evidence(spread: float, powers: Array) -> float:
            root = np.linalg.cholesky(np.eye(len(powers)) + spread**2 * powers)
            inside = np.linalg.solve(root, along)
            volume = 2.0 * float(np.log(np.diag(root)).sum())
            return seen.evidence(outside + inside.T @ inside, volume)

        best, spread = max((evidence(one, common), float(one)) for one in SPREADS[::2])
        beside_one = spread
        factors, powers = np.ones(len(self._kinds)), common
        price = float(np.log(len(self._kinds)))
        for count in range(1, MAX_LARGER + 1):
            gain, number, factor = self._larger(
                seen, outside, spread, powers, factors, small)
            if gain < price:
                break
            kind = self._kinds[number][1]
            powers = powers + (factor**2 - factors[number] ** 2) * kind @ kind.T
            factors[number] = factor
            better, spread = max((evidence(one, powers) - count * price, float(one))
                                 for one in SPREADS if spread / 2.5 < one <= spread)
            if better <= best:
                break
            best = better
            beside_one = spread if count == 1 else beside_one
        return best, beside_one

    def _larger(
        self, seen: _Projected, outside: Array, spread: float, powers: Array, factors: Array,
        small: Collection[str],
    ) -> tuple[float, int, float]:
        """Gain of the evidence, kind and factor of the errors that are best made larger."""
        along = seen.along[self._leading]
        inverse = np.linalg.inv(np.eye(len(powers)) + spread**2 * powers)
        beside = inverse @ along
        products = outside + along.T @ beside
        inner = products[:-1, :-1] + np.eye(len(products) - 1)
        columns, left = beside[:, :-1], beside[:, -1]
        left = left - columns @ np.linalg.solve(inner, products[:-1, -1])
        weights = inverse - columns @ np.linalg.solve(inner, columns.T)
        tried = [(0.0, 0, 1.0)]
        for number, (name, kind) in enumerate(self._kinds):
            if name in small:
                continue
            values, vectors = np.linalg.eigh(kind.T @ weights @ kind)
            squares = (vectors.T @ (kind.T @ left)) ** 2
            for factor in FACTORS:
                if factor > factors[number]:
                    added = spread**2 * (factor**2 - factors[number] ** 2)
                    shares = 1.0 + added * np.maximum(values, 0.0)
                    tried.append((0.5 * float((added * squares / shares - np.log(shares)).sum()),
                                  number, factor))
        return max(tried)

    def _projected(self, space: ModelSpace, fit: Fit) -> _Projected:
        return space.once('seen among errors', fit, lambda: self._project(space, fit))

    def _project(self, space: ModelSpace, fit: Fit) -> _Projected:
        problem = space.problem
        forms = _other_forms(space, fit)
        white = self._metric.whiten(np.column_stack([
            FREE_SPREAD * space.tangent_of(fit).plain, forms, fit.prediction - problem.measured]))
        count, base = fit.theta_unit.size, len(problem.system.base_parameters)
        free = np.array([*range(base), *range(count, count + forms.shape[1])])
        price = (count - base) * space.log_size
        return _Projected(self._directions.T @ white, white.T @ white, free, price)


@dataclass(frozen=True)
class _Projected:
    """Sensitivities, other forms and residual of a fit: `along` the errors (m, c), and products.

    free: what counts by its volume. What the parameters of effects may do counts by its price.
    The law of an effect errs by the share that its `form` states, which is no small error.
    """

    along: Array
    whole: Array
    free: Array
    price: float

    def evidence(self, products: Array, volume: float) -> float:
        """Logarithm of the likelihood from products (c, c) in the metric of all errors."""
        inner, slope = products[:-1, :-1] + np.eye(len(products) - 1), products[:-1, -1]
        misfit = products[-1, -1] - slope @ np.linalg.solve(inner, slope)
        freedom = np.linalg.slogdet(inner[np.ix_(self.free, self.free)])[1]
        return -0.5 * float(misfit + volume + freedom + self.price)


def _other_forms(space: ModelSpace, fit: Fit) -> Array:
    """Columns (n, k) of the forms that the laws of a fit may have, by the share of each law."""
    shares = np.array([effect.form for effect, _ in fit.candidate.effects])
    if not shares.any():
        return np.zeros((space.problem.size, 0))
    forms, of_effect = forms_of(space, fit)
    return np.asarray((shares[of_effect] * forms)[:, shares[of_effect] > 0.0])


def _moved(space: ModelSpace, fit: Fit) -> tuple[dict[str, float], float]:
    """Share of range that each effect of a fit moves, and `Model.joint`."""
    if not fit.candidate.effects:
        return {}, 1.0
    sizes = space.scale.sizes(space.changes_of(fit))
    visible = dict(zip(fit.candidate.ids, map(float, sizes.max(axis=0)), strict=True))
    if len(visible) == 1:
        return visible, 1.0
    without = space.problem.predict([Point(fit.point.base, {})])[:, 0]
    joint = space.scale.sizes((fit.prediction - without)[:, None])
    return visible, float((joint**2).sum() / max((sizes**2).sum(), 1e-300))


def _listed(space: ModelSpace) -> tuple[Array, list[tuple[str, object]]]:
    """The change (n, k) by every effect that shows, each of its shapes an equal part; its kinds.

    Of a shape that depends on its size every size counts.
    """
    shapes = defaultdict[tuple[object, ...], list[Signature]](list)
    for signature in space.shown:
        if signature.visible > 0.0 and signature.length > MIN_LENGTH * signature.share:
            shapes[signature.shape].append(signature)
    chosen: list[Signature] = []
    for members in shapes.values():
        members.sort(key=lambda one: abs(one.size))
        seen = [one for one in members if one.length > MIN_LENGTH] or members[-1:]
        chosen += members if members[0].amplitude_dependent else seen[:1]
    counts = Counter(one.key for one in chosen)
    columns = [one.plain / (one.visible * np.sqrt(counts[one.key])) for one in chosen]
    return np.column_stack(columns), [one.key for one in chosen]


def _smooth(problem: Problem) -> tuple[Array, list[tuple[str, object]]]:
    """Smooth shapes (n, k) of every view over load, direction and time, and their kinds.

    They are laws that are not listed. The shapes of one family together have the range of the
    view.
    """
    columns = []
    kinds: list[tuple[str, object]] = []
    for name, family in shape_families(problem.runs, problem.assumptions).items():
        count = 1 + max(int(index.max()) for index, _ in family)
        for view, weights in problem.system.views.items():
            pattern = problem.view_ranges[view] * weights / float(weights @ weights)
            block = np.zeros((problem.size, count))
            for number, channel, part in problem.slices:
                index, shapes = family[number]
                block[part, index] = pattern[channel] * shapes
            columns.append(block / np.sqrt(family[0][1].shape[1]))
            kinds += [('', (name, view))] * count
    return np.hstack(columns), kinds
