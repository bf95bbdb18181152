"""Families of shapes of an unknown cause, and their fits to a residual.

A family belongs to one coordinate. It has columns for every run and a penalty on their
coefficients: smooth curves in load, rate and time, curves that change sign with the direction,
relaxations, and play operators. Its fit is regularised by leave-one-run-out and tested like a
cause.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from saddlering_ros.discrepancy.problem.system import Array
from saddlering_ros.estimation.process import fisher_chance
from saddlering_ros.memory_operators import Plays, Relaxations

LOAD, DIRECTION, RATE, TIME = 'load', 'direction', 'rate', 'time'
HYSTERESIS = 'hysteresis'
PLAY, MEMORY = 'plays', 'relaxation'
"""Kinds of families that remember the load."""

PIECES, OTHER_PIECES = {LOAD: 32, DIRECTION: 12, RATE: 10, TIME: 24}, 16
"""Pieces of the splines by coordinate and of any other one. A penalty on roughness decides how
smooth a curve is; the pieces only have to be finer than any structure."""

PLAYS = 10
"""Number of plays, evenly spaced on a log scale between the REACHES. They leave at most 1.5 % of
the power of any other play between them, over two cycles and a smaller one; six leave 5.6 %."""

REACHES = (0.004, 0.5)
"""Smallest and largest half width of a play, as shares of the range of the load. A smaller play
is a change of sign with the direction; a larger one hardly slips."""

LAGS = 8
"""Number of relaxations, from two samples to half of the longest run on a log scale. They leave
0.001 % of the power of any other lag between them at most, five leave 0.13 %."""

STRENGTHS = np.geomspace(1e-6, 1e4, 11)
"""Strengths of the regularisation, in shares of the columns: free curve to straight line."""

FOLDS = 5
"""Parts of a single run that are held out in turn: the usual five-fold cross-validation."""

MIN_RIDGE = 1e-9
"""Smallest regularisation, as a share of the mean square: invertible in double precision."""


def remembered(kind: str, coordinates: Mapping[str, Array], at: Array) -> Array:
    """Plays of the load (N, k) by their reaches `at`, or relaxations by time constants [s].

    A play counts over its reach. A lag rests at the first sample; the load is linear in between.
    """
    load = coordinates[LOAD]
    if kind == PLAY:
        plays = Plays(at, float(load[0]))
        return np.array([plays.push(value) for value in load.tolist()])
    lags = Relaxations(at)
    pairs = zip(np.diff(coordinates[TIME]).tolist(), np.diff(load).tolist(), strict=True)
    return np.array([np.zeros(at.size), *(lags.push(step, change) for step, change in pairs)])


@dataclass(frozen=True)
class ObservedRun:
    """One run: coordinates (N,) by name, and the change of its channels by an addition.

    coordinates: 'load' is the drive, 'direction' and 'rate' belong to the drive, 'time' [s] counts
    from the start of the run; any other name is used as it is.
    targets: name to (C, N), the change of the channels per unit of the addition, sample by sample.
    residual (C, N): measured minus predicted. slopes (C, N, P): change of the prediction by each
    base parameter. from_start: targets to which a law adds its change since the first sample.
    """

    name: str
    coordinates: Mapping[str, Array]
    targets: Mapping[str, Array]
    residual: Array
    slopes: Array
    from_start: frozenset[str] = frozenset()

    def added(self, target: str, values: Array) -> Array:
        """Change of the channels (C, N, k) by additions (N, k) to a target."""
        change = values - values[:1] if target in self.from_start else values
        return np.asarray(self.targets[target][:, :, None] * change[None, :, :])


Products = Callable[[Array], tuple[Array, Array]]
"""Products (k, k) of columns (n, k), whitened, with each other, and (k, B) with whitened ones."""

Folds = Sequence[slice | NDArray[np.int64]]
"""Rows that are held out in turn."""


@dataclass(frozen=True)
class Misfit:
    """Residuals of the fitted runs and their metric.

    whiten: applies the metric to stacked columns (n, B), in the order of runs, channels,
    samples. products_with: products with whitened columns (n, B), without whitening whole
    columns. degrees: degrees of freedom of the level of the noise.
    """

    runs: tuple[ObservedRun, ...]
    whiten: Callable[[Array], Array]
    products_with: Callable[[Array], Products]
    degrees: int

    @cached_property
    def folds(self) -> Folds:
        """Rows that are held out in turn: runs, or parts of a single run."""
        if len(self.runs) > 1:
            ends = np.cumsum([run.residual.size for run in self.runs])
            return list(map(slice, (0, *ends[:-1]), ends))
        channels, samples = self.runs[0].residual.shape
        part = np.tile(np.arange(samples) * FOLDS // samples, channels)
        return [np.flatnonzero(part == number) for number in range(FOLDS)]

    @cached_property
    def slopes(self) -> Array:
        """Stacked change (n, P) of the prediction by each base parameter."""
        return np.concatenate([run.slopes.reshape(-1, run.slopes.shape[2]) for run in self.runs])

    @cached_property
    def base(self) -> Array:
        """Orthonormal basis (n, P) of the changes by base parameters, whitened."""
        left, values, _ = np.linalg.svd(self.whiten(self.slopes), full_matrices=False)
        return np.asarray(left[:, values > 1e-8 * max(float(values.max(initial=0.0)), 1e-300)])

    @cached_property
    def residual(self) -> Array:
        """The whitened residual (n,) minus its part by base parameters."""
        plain = np.concatenate([run.residual.ravel() for run in self.runs])
        return self._beside_base(plain[:, None])[:, 0]

    def plain(self, target: str, shapes: Sequence[Array]) -> Array:
        """Stacked columns (n, k) of an addition of `shapes` (N, k) by run to a target."""
        return np.concatenate([run.added(target, shape).reshape(-1, shape.shape[1])
                               for run, shape in zip(self.runs, shapes, strict=True)])

    def columns(self, target: str, shapes: Sequence[Array]) -> Array:
        """The same, whitened and without the part by base parameters."""
        return self._beside_base(self.plain(target, shapes))

    def _beside_base(self, plain: Array) -> Array:
        """Stacked columns (n, k), whitened, minus their part by base parameters."""
        white = self.whiten(plain)
        return np.asarray(white - self.base @ (self.base.T @ white))

    def columns_of(self, block: 'ShapeFamily') -> Iterator[tuple[str, Array]]:
        """Each target with its columns (n, k) of a family.

        Those of a target that moves the channels in fixed proportions are a sum over channels.
        """
        alone = np.array([self._beside_base(np.concatenate([
            np.multiply.outer(one, shape).reshape(-1, shape.shape[1]) for shape in block.shapes]))
            for one in np.eye(len(self.runs[0].residual))])
        for target, first in self.runs[0].targets.items():
            shares = first[:, 0]
            if any(target in run.from_start or (run.targets[target] != shares[:, None]).any()
                   for run in self.runs):
                yield target, self.columns(target, block.shapes)
            else:
                yield target, np.tensordot(shares, alone, axes=1)


@dataclass(frozen=True)
class ShapeFamily:
    """One family of shapes: columns (N, k) by run, penalty (k, k) on their roughness.

    span: the range of the coordinate seen. memory (k,): reaches of plays or time constants [s] of
    relaxations. non_negative: all coefficients have one sign.
    """

    coordinate: str
    kind: str
    shapes: tuple[Array, ...]
    penalty: Array
    span: tuple[float, float]
    memory: Array | None = None
    non_negative: bool = False


def spline_columns(at: Array, span: tuple[float, float], pieces: int) -> Array:
    """Cubic B-splines (N, pieces + 3) with even knots over the span; constant outside."""
    from scipy.interpolate import BSpline  # late: most diagnoses propose no law

    low, high = span
    knots = low + (high - low) / pieces * np.arange(-3, pieces + 4)
    inside = np.clip(at, low, high - 1e-9 * (high - low))
    return np.asarray(BSpline.design_matrix(inside, knots, 3).toarray())


def roughness(pieces: int) -> Array:
    """Penalty on second differences of the coefficients of a spline."""
    second = np.diff(np.eye(pieces + 3), 2, axis=0)
    return np.asarray(second.T @ second)


def span_of(runs: Sequence[ObservedRun], name: str) -> tuple[float, float]:
    """Range of a coordinate over the runs."""
    seen = [run.coordinates[name] for run in runs]
    return min(float(one.min()) for one in seen), max(float(one.max()) for one in seen)


def blocks_of(runs: tuple[ObservedRun, ...]) -> list[ShapeFamily]:
    """Every family that these runs can show."""
    low, high = loads = span_of(runs, LOAD)
    reaches = np.geomspace(*REACHES, PLAYS) * (high - low)
    plays = tuple(remembered(PLAY, run.coordinates, reaches) for run in runs)
    blocks = [
        _curve(runs, LOAD),
        ShapeFamily(HYSTERESIS, PLAY, plays, np.eye(PLAYS), loads, reaches, non_negative=True)]
    names = set.intersection(*(set(run.coordinates) for run in runs))
    if DIRECTION in names and any(np.ptp(run.coordinates[DIRECTION]) > 0.0 for run in runs):
        shapes = tuple(
            run.coordinates[DIRECTION][:, None]
            * spline_columns(run.coordinates[LOAD], loads, PIECES[DIRECTION]) for run in runs)
        blocks.append(ShapeFamily(DIRECTION, 'curve', shapes, roughness(PIECES[DIRECTION]), loads))
    if RATE in names and span_of(runs, RATE)[0] < span_of(runs, RATE)[1]:
        step = min(float(np.median(np.diff(run.coordinates[TIME]))) for run in runs)
        longest = max(float(np.ptp(run.coordinates[TIME])) for run in runs)
        lags = np.geomspace(2.0 * step, max(0.5 * longest, 4.0 * step), LAGS)
        shapes = tuple(remembered(MEMORY, run.coordinates, lags) / (high - low) for run in runs)
        blocks += [_curve(runs, RATE),
                   ShapeFamily(RATE, MEMORY, shapes, np.eye(LAGS), loads, lags)]
    blocks.append(_curve(runs, TIME))
    others = names - {LOAD, DIRECTION, RATE, TIME}
    return blocks + [_curve(runs, name) for name in sorted(others)]


def _curve(runs: tuple[ObservedRun, ...], name: str) -> ShapeFamily:
    """A smooth curve over a coordinate."""
    span, pieces = span_of(runs, name), PIECES.get(name, OTHER_PIECES)
    shapes = tuple(spline_columns(run.coordinates[name], span, pieces) for run in runs)
    return ShapeFamily(name, 'curve', shapes, roughness(pieces), span)


@dataclass(frozen=True)
class BlockFit:
    """One family added to one target: coefficients, and explained part of the whitened misfit.

    white (n, k): whitened columns. predicted: explained misfit of runs held out in turn, negative
    if the family predicts nothing. freedom: effective number of parameters.
    """

    target: str
    block: ShapeFamily
    white: Array
    coefficients: Array
    covariance: Array
    taken: float
    predicted: float
    freedom: float

    def p_value(self, degrees: int, trials: int) -> float:
        """Chance that noise alone gives one of `trials` families as much."""
        each = fisher_chance(max(self.taken, 0.0) / self.freedom, self.freedom, degrees)
        return min(1.0, trials * float(each))


def fit_block(folds: Folds, wanted: Array, target: str, block: ShapeFamily,
              white: Array) -> BlockFit:
    """`block` on `target`, its whitened columns (n, k) fitted to a whitened residual (n,)."""
    gram, slope = white.T @ white, white.T @ wanted
    unit = float(np.trace(gram)) / max(float(np.trace(block.penalty)), 1e-300)
    ridge = (MIN_RIDGE * float(np.trace(gram)) / len(gram) + 1e-300) * np.eye(len(gram))
    penalties = (STRENGTHS * unit)[:, None, None] * block.penalty + ridge
    predicted = np.zeros(STRENGTHS.size)
    for rows in folds:
        own_gram, own_slope = white[rows].T @ white[rows], white[rows].T @ wanted[rows]
        solved = _solve(block, gram - own_gram + penalties, slope - own_slope)
        predicted += 2.0 * solved @ own_slope - ((solved @ own_gram) * solved).sum(axis=1)
    best = int(np.argmax(predicted))
    penalised = gram + penalties[best]
    coefficients = _solve(block, penalised, slope)
    left = wanted - white @ coefficients
    inverse = np.linalg.pinv(penalised, hermitian=True)
    freedom = float(np.trace(inverse @ gram))
    if block.non_negative:
        freedom = min(freedom, 1.0 + float(np.count_nonzero(coefficients)))
    return BlockFit(
        target=target, block=block, white=white, coefficients=coefficients, covariance=inverse,
        taken=float(wanted @ wanted - left @ left), predicted=float(predicted[best]),
        freedom=max(freedom, 1.0))


def _solve(block: ShapeFamily, matrices: Array, slope: Array) -> Array:
    """Penalised least squares (..., k) with matrices (..., k, k).

    The coefficients have one sign if the family requires it.
    """
    if not block.non_negative:
        return np.asarray(np.linalg.solve(matrices, slope[:, None])[..., 0])
    if matrices.ndim > 2:
        return np.array([_solve(block, matrix, slope) for matrix in matrices])
    values, vectors = np.linalg.eigh(matrices)
    kept = values > 1e-12 * values[-1]
    root = np.sqrt(values[kept])[:, None] * vectors[:, kept].T
    target = (vectors[:, kept].T @ slope) / np.sqrt(values[kept])
    (up, left_up), (down, left_down) = (nnls(root, sign * target) for sign in (1.0, -1.0))
    return np.asarray(up if left_up <= left_down else -down)


def forced(changes: Sequence[Array],
           states: Mapping[str, Sequence[Array]]) -> tuple[float, str, Array, Array, list[Array]]:
    """The coordinate over which one curve, added at every sample, repeats changes (C, N) by run.

    The share of their power that it repeats, the coordinate, its splines (n, K) in all runs, the
    curve (K,), and responses (C, N, K) to each spline by run. The next sample is linear in the
    last two of every channel, because two samples of a place hold its speed, and in the curve at
    this sample or at the next one.
    """
    count, none = 2 * len(changes[0]), np.zeros((0, 0))
    best: tuple[float, str, Array, Array, list[Array]] = -np.inf, '', none, none, []
    for (name, values), late in product(states.items(), (0, 1)):
        span = min(map(np.min, values)), max(map(np.max, values))
        if span[0] == span[1]:
            continue
        splines = [spline_columns(
            np.append(at[late:], at[at.size - late:]), span, OTHER_PIECES) for at in values]
        before = np.vstack([np.hstack([change.T[1:-1], change.T[:-2], spline[1:-1]])
                            for change, spline in zip(changes, splines, strict=True)])
        after = np.vstack([change.T[2:] for change in changes])
        lengths = np.maximum(np.linalg.norm(before, axis=0), 1e-300)
        solved = np.linalg.lstsq(before / lengths, after, rcond=1e-7)[0].T / lengths
        channels, sizes, curves = np.linalg.svd(solved[:, count:], full_matrices=False)
        step = np.vstack([solved[:, :count], np.eye(count // 2, count)])
        force = np.append(channels[:, 0], np.zeros(count // 2))[:, None]
        responses = []
        with np.errstate(over='ignore', invalid='ignore'):
            for spline in splines:
                state = np.zeros((len(spline), count, spline.shape[1]))
                for number in range(1, len(spline)):
                    state[number] = step @ state[number - 1] + force * spline[number - 1]
                responses.append(state[:, : count // 2].transpose(1, 0, 2))
            missed, whole = np.sum([
                (np.sum((response @ curves[0] * sizes[0] - change) ** 2), np.sum(change**2))
                for response, change in zip(responses, changes, strict=True)], axis=0)
        repeated = 1.0 - float(missed / whole) if whole > 0.0 else 0.0
        if repeated > best[0]:
            best = repeated, name, np.vstack(splines), sizes[0] * curves[0], responses
    return best
