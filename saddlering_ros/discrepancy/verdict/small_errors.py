"""One large cause among many small errors: every listed effect, in a small common size.

What the catalogue of a ring lists is present in small amounts all at once. Every listed effect is
an error here, with one common spread: a share of the range of the view that it moves most, learnt
beside the effects of a model. A main cause is an outlier of this spread, and the likelihood,
marginalised over all the small errors, compares it with others.
"""

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from saddlering_ros.discrepancy.problem.fits import Fit, tangent
from saddlering_ros.discrepancy.problem.problem import nuisance_columns
from saddlering_ros.discrepancy.problem.system import Array
from saddlering_ros.discrepancy.search import ranking
from saddlering_ros.discrepancy.search.selection import in_metric
from saddlering_ros.discrepancy.search.signatures import MIN_LENGTH, Signature
from saddlering_ros.discrepancy.search.space import fit_each, FREE_SPREAD, ModelSpace

SPREADS = np.geomspace(2e-4, 2e-2, 13)
"""Common spreads that are tried, in shares of range: from a fifth of what is material."""

MIN_STRENGTH = 0.1
"""Error over the noise below which a direction of all the errors together is left out."""

MAX_OTHERS = 5
"""Other effects that are refitted in place of a main cause: the best to first order."""


@dataclass(frozen=True)
class Evidence:
    """Logarithm of the marginal likelihood of a model, and the spread at which it is largest."""

    likelihood: float
    spread: float


MIN_TIMES, MIN_MARGIN = 5.0, 100.0
"""Size over the spread of the small errors, and logarithm of the likelihood over that of every
other model, from which a cause stands out. Of 16 stand-ins on dirty rings (51 to 134), the surest
of those that are five times as large has 79; of 14 true main causes, six have more than 100."""


@dataclass(frozen=True)
class MainCause:
    """The cause of a model that moves most, judged among small errors of all that is listed.

    times: its size over the spread of the small errors; margin: logarithm of the likelihood over
    that of the best other model: one without it, or with another effect in its place.
    """

    name: str
    times: float
    margin: float

    @property
    def stands_out(self) -> bool:
        """Whether it is an outlier of the small errors that nothing else explains."""
        return self.times >= MIN_TIMES and self.margin >= MIN_MARGIN


class SmallErrors:
    """Every listed effect of a space as an error, about a fit."""

    def __init__(self, space: ModelSpace, fit: Fit) -> None:
        self._space, self._problem = space, space.problem
        signatures = _of_each_shape(space.shown)
        shapes = Counter(one.key for one in signatures)
        columns = np.column_stack([
            one.plain / (one.visible * np.sqrt(shapes[one.key])) for one in signatures])
        white = space.metric.whiten_noise(columns)
        values, vectors = np.linalg.eigh(white.T @ white)
        kept = vectors[:, values * SPREADS[-1] ** 2 > MIN_STRENGTH**2]
        self._columns = columns @ kept
        self._nuisances = nuisance_columns(self._problem, fit.point, fit.prediction)
        self._white = np.hstack([space.metric.whiten_noise(self._nuisances), white @ kept])
        self._gram = self._white.T @ self._white

    def space_at(self, spread: float, fit: Fit) -> tuple[ModelSpace, Fit]:
        """The space in whose metric the errors have a spread, and the fit there."""
        columns = np.hstack([self._nuisances, spread * self._columns])
        return in_metric(self._space, self._space.metric.marginalise(columns), fit)

    def evidence(self, fit: Fit) -> Evidence:
        """The evidence of a fit; each parameter of an effect costs as much as in the BIC."""
        metric = self._space.metric
        residual = metric.whiten_noise(fit.prediction - self._problem.measured)
        own = metric.whiten_noise(tangent(metric, fit).plain)
        mixed, count = own.T @ self._white, own.shape[1]
        gram = np.block([[own.T @ own, mixed], [mixed.T, self._gram]])
        along = np.concatenate([own.T @ residual, self._white.T @ residual])
        base = len(self._problem.system.base_parameters)
        # What the parameters of the effects may do is counted by their price.
        errors = np.r_[0:base, count : along.size]
        best = Evidence(-np.inf, 0.0)
        for spread in SPREADS:
            scales = np.full(along.size, spread)
            scales[: count + self._nuisances.shape[1]] = 1.0
            scales[:count] = FREE_SPREAD
            inverse = np.eye(along.size) + gram * np.outer(scales, scales)
            taken = along * scales
            misfit = residual @ residual - taken @ np.linalg.solve(inverse, taken)
            volume = np.linalg.slogdet(inverse[np.ix_(errors, errors)])[1]
            price = (count - base) * np.log(residual.size)
            found = Evidence(-0.5 * float(misfit + volume + price), float(spread))
            best = max(best, found, key=lambda one: one.likelihood)
        return best


def _of_each_shape(signatures: Sequence[Signature]) -> list[Signature]:
    """One signature of each shape that shows; all sizes of one that depends on its size."""
    shapes = defaultdict[tuple[object, ...], list[Signature]](list)
    for one in signatures:
        if one.visible > 0.0 and one.length > MIN_LENGTH * one.share:
            shapes[one.shape].append(one)
    chosen = []
    for members in shapes.values():
        members.sort(key=lambda one: abs(one.size))
        shown = [one for one in members if one.length > MIN_LENGTH] or members[-1:]
        chosen += members if members[0].amplitude_dependent else shown[:1]
    return chosen


def visible_sizes(space: ModelSpace, fit: Fit) -> Array:
    """Share of range by which each effect of a fit changes the view that it moves most."""
    changes = space.problem.changes_of_effects(fit.point, fit.prediction)
    return np.asarray(space.scale.sizes(changes).max(axis=0))


def main_cause(space: ModelSpace, fit: Fit) -> MainCause:
    """The effect of a fit that moves most, compared with every other one in its place."""
    errors = SmallErrors(space, fit)
    beside, fit = errors.space_at(errors.evidence(fit).spread, fit)
    visible = visible_sizes(beside, fit)
    name, own = fit.candidate.ids[int(visible.argmax())], errors.evidence(fit)
    less = beside.without(fit, name)
    scores = ranking.rank(
        less, beside.tangent_of(less).white, beside.shown, [*less.candidate.ids, name])
    others = fit_each(beside, less, ranking.best_of_each(scores)[:MAX_OTHERS])
    best = errors.evidence(less).likelihood
    for other in others:
        found = errors.evidence(other)
        if visible_sizes(beside, other)[-1] > found.spread:  # One that moves nothing is no cause.
            best = max(best, found.likelihood)
    return MainCause(name, float(visible.max()) / own.spread, own.likelihood - best)
