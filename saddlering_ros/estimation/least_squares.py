"""Bounded least squares of whitened residuals, and the covariance at the optimum.

The method is Levenberg-Marquardt (Marquardt, J. SIAM 11 (1963) 431) in coordinates whose box is 0
to 1. Sensitivities that are not computed anew have Broyden's update (Math. Comp. 19 (1965) 577). A
descent is a generator that yields points and receives answers. Many descents can therefore share
batches of simulations, and sensitivities can come from the cheapest source.
"""

from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from sys import maxsize
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from saddlering_ros.estimation.process import Array
from saddlering_ros.rig import ContactParameters, PARAMETER_NAMES

AT_BOUND = 1e-3
"""Distance from a bound, as a share of the range, within which a point is on it: half of the step
of a sensitivity."""

PERIODIC_REACH = 0.25
"""Largest step of a periodic coordinate, as a share of its period."""

MIN_MOVE = 1e-6
"""Length of a step, in shares of the box, below which a descent ends."""

FAILED_ROUNDS = 4
"""Number of steps uphill in a row after which a descent ends."""

GROWTH = 6.0
"""Factor of the damping after a step uphill, its square after a second one in a row, and so on: a
jump of the misfit can lie at any share of a step."""

MAX_ROUNDS = 60
"""Rounds of `minimise`."""

USUAL_DAMPING, NEAR = 1e-3, 1e-6
"""Damping of the first step of a descent, and of one that starts where it will end."""

NEGLIGIBLE = 1e-7
"""Gain of chi square with which no parameter moves by more than 3e-4 of its deviation."""


class Answer(Protocol):
    """Whitened residual (n,) and sensitivities (n, k) at a point; NaN where it failed."""

    @property
    def residual(self) -> Array: ...

    @property
    def columns(self) -> Array: ...


Answers = TypeVar('Answers', bound=Answer)


@dataclass(frozen=True)
class Rule:
    """Settings of a descent."""

    periodic: NDArray[np.bool_]  # (F,): coordinates that are angles
    prior: float  # standard deviations in the whole box, which keeps idle coordinates still
    rounds: int  # of steps, at most
    quiet_gain: float  # a gain below it is quiet
    quiet_share: float  # so is one below this share of the misfit
    quiet_rounds: int = 2  # so many quiet gains in a row end the descent
    negligible: float = 0.0  # an expected gain of at most this ends it too
    damping: float = USUAL_DAMPING  # that of the first step
    stays_from: int = maxsize  # idle coordinates from this one on stay, whatever the prior

    def cost(self, residual: Array, point: Array) -> float:
        """Misfit and prior; infinite for a residual that is not finite."""
        apart = np.where(self.periodic, 0.0, point - 0.5)
        value = float(residual @ residual + self.prior**2 * (apart**2).sum())
        return value if np.isfinite(value) else np.inf

    def inside(self, point: Array) -> Array:
        """The point inside the box; periodic coordinates wrap around."""
        return np.where(self.periodic, point % 1.0, np.clip(point, 0.0, 1.0))


@dataclass(frozen=True)
class Descent(Generic[Answers]):
    """End of a descent."""

    point: Array  # (F,)
    columns: Array  # sensitivities (n, F)
    answer: Answers  # at this point
    costs: tuple[float, ...]  # misfit and prior on the way, infinite if the start failed
    converged: bool

    @property
    def cost(self) -> float:
        return min(self.costs)


def descend(start: Array, rule: Rule, fresh: Sequence[int], known: Array | None = None,
            first_fresh: Sequence[int] | None = None,
            first_answer: Answers | None = None) -> Generator[Array, Answers, Descent[Answers]]:
    """Levenberg-Marquardt from `start` (F,): yields points and receives answers.

    fresh: coordinates whose sensitivities an answer holds (`first_fresh`: the first answer).
    Those of the other coordinates, which come first, begin with `known` (n, k) and are
    improved by Broyden's update. first_answer: the answer at the start, if it is known.
    """
    first_fresh = fresh if first_fresh is None else first_fresh
    kept = 0 if known is None else known.shape[1]
    point = rule.inside(start)
    if first_answer is None:
        first_answer = yield point
    answer = first_answer
    residual = answer.residual
    columns = np.zeros((residual.size, start.size))
    if known is not None:
        columns[:, :kept] = known
    columns[:, list(first_fresh)] = answer.columns
    improves = len(fresh) < start.size
    best = rule.cost(residual, point)
    costs, damping, quiet, failed, converged = [best], rule.damping, 0, 0, False
    for _ in range(rule.rounds):
        if not np.isfinite(best):
            break
        move = bounded_step(columns, residual, point, damping, rule)
        converged = bool(np.abs(move).max() < MIN_MOVE)
        if rule.negligible > 0.0:
            linear = rule.cost(residual + columns @ move, point + move)
            converged |= rule.cost(residual, point) - linear < rule.negligible
        if converged:
            break
        trial = rule.inside(point + move)
        new = yield trial
        value = rule.cost(new.residual, trial)
        if value < best:
            if improves:
                surprise = new.residual - residual - columns @ move
                reach = move[:kept]
                if reach @ reach > 0.25 * (move @ move):
                    columns[:, :kept] += np.outer(surprise, reach) / (move @ move)
            gain = best - value
            point, answer, residual, best = trial, new, new.residual, value
            columns[:, list(fresh)] = answer.columns
            damping = max(damping * 0.2, 1e-9)
            is_quiet = gain < max(rule.quiet_gain, rule.quiet_share * best)
            quiet, failed = (quiet + 1 if is_quiet else 0), 0
        else:
            failed += 1
            damping = min(damping * GROWTH**failed, 1e6)
        costs.append(best)
        converged = quiet >= rule.quiet_rounds or failed >= FAILED_ROUNDS
        if converged:
            break
    return Descent(point, columns, answer, tuple(costs), converged)


def bounded_step(columns: Array, residual: Array, point: Array, damping: float,
                 rule: Rule) -> Array:
    """Damped Gauss-Newton step inside the box.

    A late coordinate that changes nothing stays: a switch between two samples is not idle.
    """
    gram = columns.T @ columns
    slope = columns.T @ residual
    is_free = rule.periodic.copy()
    is_free[rule.stays_from:] |= ~columns[:, rule.stays_from:].any(axis=0)
    slope = slope + rule.prior**2 * np.where(is_free, 0.0, point - 0.5)
    diagonal = np.einsum('ii->i', gram)  # a view
    diagonal += rule.prior**2
    diagonal *= 1.0 + damping
    # The coordinates are scaled by the diagonal, because K and n of a contact are almost parallel.
    scale = 1.0 / np.sqrt(np.maximum(diagonal, 1e-12 * diagonal.max()))
    scaled = gram * np.outer(scale, scale)
    free = -np.linalg.solve(scaled, slope * scale) * scale
    least = np.where(rule.periodic, -PERIODIC_REACH, -point)
    most = np.where(rule.periodic, PERIODIC_REACH, 1.0 - point)
    if np.all((free >= least) & (free <= most)):
        return np.asarray(free)
    root = np.linalg.cholesky(scaled + 1e-12 * np.eye(point.size)).T
    target = -np.linalg.solve(root.T, slope * scale)
    low, high = least / scale, most / scale
    answer = lsq_linear(root, target, bounds=(low - 1e-12, high + 1e-12), method='bvls')
    return np.asarray(np.clip(answer.x * scale, least, most))


@dataclass(frozen=True)
class Minimum:
    """The optimum: point (F,), chi square, Jacobian (R, F), mask of coordinates on a bound."""

    point: Array
    chi_square: float
    jacobian: Array
    at_bound: NDArray[np.bool_]


@dataclass(frozen=True)
class LazyAnswer:
    """An answer whose sensitivities (n, k) are computed when a step is taken."""

    residual: Array
    slopes: Callable[[], Array] = field(repr=False)

    @cached_property
    def columns(self) -> Array:
        return self.slopes()


def minimise(linearised: Callable[[Array], LazyAnswer], start: Array, low: Array, high: Array,
             negligible: float = NEGLIGIBLE, damping: float = USUAL_DAMPING) -> Minimum:
    """Least squares in the box from `start` (F,); an expected gain that is negligible ends it."""
    span = high - low
    rule = Rule(np.zeros(span.size, dtype=bool), 0.0, MAX_ROUNDS, 1e-6, 1e-10,
                negligible=negligible, damping=damping)

    def answer(unit: Array) -> LazyAnswer:
        end = linearised(low + span * unit)
        return LazyAnswer(end.residual, lambda: end.columns * span)

    descent: Generator[Array, LazyAnswer, Descent[LazyAnswer]] = descend(
        (start - low) / span, rule, range(span.size))
    asked = next(descent)
    while True:
        try:
            asked = descent.send(answer(asked))
        except StopIteration as stop:
            end: Descent[LazyAnswer] = stop.value
            break
    point = low + span * end.point
    return Minimum(point, end.cost, end.columns / span, on_bound(point, low, high))


def on_bound(point: Array, low: Array, high: Array) -> NDArray[np.bool_]:
    """Mask (F,) of coordinates of a point on a bound of the box."""
    near = AT_BOUND * (high - low)
    return np.asarray((point - low < near) | (high - point < near))


def covariance(jacobian: Array, prior: float = 0.0) -> Array:
    """(J^T J + prior^2)^-1 by columns of unit length.

    Without a prior, directions without effect get a huge variance.
    """
    if prior:
        jacobian = np.vstack([jacobian, prior * np.eye(jacobian.shape[1])])
    length = np.linalg.norm(jacobian, axis=0)
    length = np.where(length > 0.0, length, 1e-12)
    _, singular, rows = np.linalg.svd(jacobian / length, full_matrices=False)
    singular = np.maximum(singular, 1e-9 * singular[0])
    inner = (rows.T / singular**2) @ rows
    return np.asarray(inner / np.outer(length, length))


@dataclass(frozen=True)
class SearchSpace:
    """Box of the free parameters; the others stay at `held`."""

    free: NDArray[np.intp]  # (F,) indices into the six
    logarithmic: NDArray[np.bool_]  # (6,): searched as ln(value)
    low: Array  # (F,) in coordinates
    high: Array  # (F,) in coordinates
    held: Array  # (6,) values

    @classmethod
    def of(cls, bounds: Mapping[str, tuple[float, float]], free: Iterable[str],
           held: ContactParameters, logarithmic: Iterable[str] = ()) -> 'SearchSpace':
        """Space of the names in `free`, inside bounds (values); the others are held."""
        logarithmic = set(logarithmic)
        names = [name for name in PARAMETER_NAMES if name in set(free)]
        mask = np.array([name in logarithmic for name in PARAMETER_NAMES])
        indices = np.array([PARAMETER_NAMES.index(name) for name in names], dtype=np.intp)
        box = np.array([bounds[name] for name in names], dtype=float)
        box[mask[indices]] = np.log(np.maximum(box[mask[indices]], 1e-9))
        return cls(indices, mask, box[:, 0], box[:, 1], held.to_array())

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters in coordinate order."""
        return tuple(PARAMETER_NAMES[index] for index in self.free)

    def contacts(self, points: Array) -> Array:
        """Contact parameters (B, 6) at coordinates (B, F)."""
        points = np.atleast_2d(points)
        contacts = np.tile(self.held, (len(points), 1))
        contacts[:, self.free] = np.where(
            self.logarithmic[self.free], np.exp(np.minimum(points, 700.0)), points)
        return contacts

    def coordinates(self, contact: Array) -> Array:
        """Coordinates (F,) of contact parameters (6,), clipped into the box."""
        values = np.asarray(contact, dtype=float)[self.free]
        log = self.logarithmic[self.free]
        values = np.where(log, np.log(np.maximum(values, 1e-9)), values)
        return np.asarray(np.clip(values, self.low, self.high))

    def scale(self, contact: Array) -> Array:
        """Derivative d value / d coordinate (F,) at contact parameters (6,)."""
        values = np.asarray(contact, dtype=float)[self.free]
        return np.where(self.logarithmic[self.free], values, 1.0)
