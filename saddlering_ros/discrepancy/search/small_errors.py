"""Small errors of everything that is listed, where nothing of a machine is exact.

Load cell, probes, raceways and joints of a real ring each err a little, all at once, so that no
single effect leaves noise alone. Here every listed effect and every smooth shape of a view is an
error with a mean of zero and one common spread, a share of the range of the view that it moves
most. The spread is learnt: it is the most likely one beside the effects of a model (empirical
Bayes). What a stand-in leaves needs a larger spread than what the true cause leaves. A few errors
of a real machine are much larger than most. Where causes are compared, errors of any kind can
therefore be larger than the common spread, at a price each (automatic relevance determination),
but for the cause in question.
"""

from collections import Counter, defaultdict
from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from saddlering_ros.discrepancy.problem.fits import Fit
from saddlering_ros.discrepancy.problem.problem import Problem
from saddlering_ros.discrepancy.problem.system import Array, Point
from saddlering_ros.discrepancy.search.evidence import forms_of
from saddlering_ros.discrepancy.search.lack_of_fit import shape_families
from saddlering_ros.discrepancy.search.signatures import MIN_LENGTH, Signature
from saddlering_ros.discrepancy.search.space import FREE_SPREAD, ModelSpace

SPREADS = np.geomspace(1e-4, 2e-2, 24)
"""Common spreads that are tried, in shares of range: from a tenth of what is material."""

MIN_STRENGTH = 0.1
"""Error over the noise below which a direction of all the errors together is left out."""

MIN_LEADING = 1.0
"""Movement over the noise of an error of a material size, above which errors of unequal size act
along a direction. Chosen for cost."""

FACTORS = (3.0, 10.0, 30.0)
"""Sizes over the common spread of errors that are larger."""

MAX_LARGER = 10
"""Kinds of errors that are larger, at most."""

MIN_PARALLEL = 0.999
"""Cosine of two changes from which on they are one."""

MIN_JOINT = 0.8
"""Power of what effects move together over the sum of their powers, below which they cancel each
other. True causes of dirty rings had 0.91 and more; effects that stood in for a wedge under two
probes, which is in no catalogue, 0.39."""


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
class Unequal:
    """Errors of unequal size that are most likely beside a fit.

    evidence: with the price of each kind that is larger; beside_one: common spread if one is;
    spread, factors (k,): common spread with all of them, and the factor of each kind.
    """

    evidence: float
    beside_one: float
    spread: float
    factors: Array


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
        self._by_kind = [columns[:, chosen] for chosen in members.values()]

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

    def with_larger(self, space: ModelSpace, fit: Fit, small: Collection[str]) -> Unequal:
        """The errors beside a fit, if some kinds are larger at the price of a choice each.

        small: effects whose errors are not.
        """
        return space.once(f'unequal {sorted(small)}', fit, lambda: self._with_larger(
            self._projected(space, fit), small))

    def larger_columns(self, space: ModelSpace, fit: Fit, small: Collection[str]) -> Array:
        """Columns (n, c) of the errors of `with_larger`, each times its spread."""
        found = self.with_larger(space, fit, small)
        return np.hstack([found.spread * factor * kind for factor, kind in zip(
            found.factors, self._by_kind, strict=True)])

    def falls_in_one_view(self, space: ModelSpace, model: Model, name: str) -> dict[str, float]:
        """Fall of the evidence, with larger errors of other kinds, if an effect acted in one view.

        For each view; empty if the effect moves no more than small errors in any other one.
        """
        fit = model.fit
        small = {name, *next(
            effect.contains for effect, _ in fit.candidate.effects if effect.id == name)}
        whole = self.with_larger(space, fit, small).evidence
        return {view: whole - self._with_larger(
                    self._project(space, fit, *confined), small).evidence
                for view, *confined in space.confined(fit, name, model.spread)}

    def _with_larger(self, seen: '_Projected', small: Collection[str]) -> Unequal:
        along = seen.along[self._leading]
        outside = seen.whole - along.T @ along
        common = np.diag(self._powers[self._leading])

        def evidence(spread: float, powers: Array) -> float:
            inside, volume = _in_errors(spread**2 * powers, along)
            return seen.evidence(outside + inside.T @ inside, volume)

        best, spread = max((evidence(one, common), float(one)) for one in SPREADS[::2])
        found = Unequal(best, spread, spread, np.ones(len(self._kinds)))
        powers, price = common, float(np.log(len(self._kinds)))
        for count in range(1, MAX_LARGER + 1):
            gain, number, factor = self._larger(
                seen, outside, found.spread, powers, found.factors, small)
            if gain < price:
                break
            kind, factors = self._kinds[number][1], found.factors.copy()
            powers = powers + (factor**2 - factors[number] ** 2) * kind @ kind.T
            factors[number] = factor
            better, spread = max((evidence(one, powers) - count * price, float(one))
                                 for one in SPREADS if found.spread / 2.5 < one <= found.spread)
            if better <= found.evidence:
                break
            found = Unequal(better, spread if count == 1 else found.beside_one, spread, factors)
        return found

    def _larger(self, seen: '_Projected', outside: Array, spread: float, powers: Array,
                factors: Array, small: Collection[str]) -> tuple[float, int, float]:
        """Gain of the evidence, kind and factor of the errors that are best made larger."""
        ends = np.cumsum([len(outside), *(kind.shape[1] for _, kind in self._kinds)])
        inside, *kinds = np.split(_in_errors(spread**2 * powers, np.hstack([
            seen.along[self._leading], *(kind for _, kind in self._kinds)]))[0], ends[:-1], axis=1)
        products = outside + inside.T @ inside
        columns, root = inside[:, :-1], np.linalg.cholesky(
            products[:-1, :-1] + np.eye(len(products) - 1))
        beside = solve_triangular(root, columns.T @ np.hstack(kinds), lower=True)
        slope = solve_triangular(root, products[:-1, -1], lower=True)
        tried = [(0.0, 0, 1.0)]
        for number, ((name, _), kind, taken) in enumerate(zip(
                self._kinds, kinds, np.split(beside, ends[1:-1] - ends[0], axis=1), strict=True)):
            if name in small:
                continue
            values, vectors = np.linalg.eigh(kind.T @ kind - taken.T @ taken)
            squares = (vectors.T @ (kind.T @ inside[:, -1] - taken.T @ slope)) ** 2
            for factor in FACTORS:
                if factor > factors[number]:
                    added = spread**2 * (factor**2 - factors[number] ** 2)
                    shares = 1.0 + added * np.maximum(values, 0.0)
                    tried.append((0.5 * float((added * squares / shares - np.log(shares)).sum()),
                                  number, factor))
        return max(tried)

    def _projected(self, space: ModelSpace, fit: Fit) -> '_Projected':
        return space.once('seen among errors', fit, lambda: self._project(
            space, fit, space.tangent_of(fit).plain, fit.prediction))

    def _project(self, space: ModelSpace, fit: Fit, tangent: Array,
                 prediction: Array) -> '_Projected':
        """Sensitivities `tangent` (n, k) and `prediction` (n,) of a fit in the metric."""
        problem = space.problem
        # The forms that the laws of the fit may have, by the share of each law.
        shares, forms = [effect.form for effect, _ in fit.candidate.effects], np.zeros(
            (problem.size, 0))
        if any(shares):
            forms, of_effect = forms_of(space, fit)
            own = np.array(shares)[of_effect]
            forms = (own * forms)[:, own > 0.0]
        white = self._metric.whiten(np.column_stack([
            FREE_SPREAD * tangent, forms, prediction - problem.measured]))
        count, base = fit.theta_unit.size, len(problem.system.base_parameters)
        free = np.array([*range(base), *range(count, count + forms.shape[1])])
        price = (count - base) * space.log_size
        return _Projected(self._directions.T @ white, white.T @ white, free, price)


def _in_errors(powers: Array, columns: Array) -> tuple[Array, float]:
    """Columns (m, c) in units of noise and errors, and their volume; powers (m, m) of errors."""
    if not np.count_nonzero(powers - np.diag(np.diag(powers))):
        shares = 1.0 + np.diag(powers)
        return columns / np.sqrt(shares)[:, None], float(np.log(shares).sum())
    root = np.linalg.cholesky(np.eye(len(powers)) + powers)
    return (solve_triangular(root, columns, lower=True, check_finite=False),
            2.0 * float(np.log(np.diag(root)).sum()))


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

    Of a shape that depends on its size every size counts. A reversed sign, which cannot be small,
    stands for the gain of its probe only where this is not listed.
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
    small = [one for one in chosen if one.effect.can_be_small]
    chosen = [one for one in chosen if one.effect.can_be_small or not any(
        abs(float(one.plain @ other.plain)) > MIN_PARALLEL * float(
            np.linalg.norm(one.plain) * np.linalg.norm(other.plain)) for other in small)]
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
