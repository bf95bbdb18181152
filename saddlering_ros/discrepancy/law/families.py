"""Families of shapes of an unknown cause, and their fits to a residual.

A family belongs to one coordinate. It has columns for every run and a penalty on their
coefficients: smooth curves in load, rate, time and angle, curves that change sign with the
direction, relaxations, and play operators. Its fit is regularised by leave-one-run-out and tested
like a cause.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from saddlering_ros.discrepancy.problem.system import Array
from saddlering_ros.estimation.statistics import fisher_chance
from saddlering_ros.memory_operators import Direction, Plays, Relaxations


def stop_operators(drive: Array, reaches: Array) -> Array:
    """(N, R): the drive (N,) minus the output of plays with half widths `reaches` (R,)."""
    plays = Plays(np.asarray(reaches, dtype=np.float64), float(drive[0]))
    return np.array([plays.push(value) for value in drive.tolist()])


def relaxations(time: Array, drive: Array, constants: Array) -> Array:
    """(N, T): the drive (N,) minus first-order lags of it with time constants (T,) [s].

    Every lag rests at the first sample. The drive is linear between samples.
    """
    lags = Relaxations(np.asarray(constants, dtype=np.float64))
    pairs = zip(np.diff(time).tolist(), np.diff(drive).tolist(), strict=True)
    first = np.zeros(np.size(constants))
    return np.array([first, *(lags.push(step, change) for step, change in pairs)])


def direction_of(drive: Array, band: float) -> Array:
    """+1 (N,) while the drive rises and -1 while it falls; at rest the last direction."""
    direction = Direction(band, float(drive[0]))
    return np.array([direction.push(value) for value in drive.tolist()])


LOAD, DIRECTION, RATE, TIME = 'load', 'direction', 'rate', 'time'
ANGLE, HYSTERESIS = 'angle', 'hysteresis'


@dataclass(frozen=True)
class ObservedRun:
    """One run: coordinates (N,) by name, and the change of its channels by an addition.

    coordinates: 'load' is the drive, 'direction' and 'rate' belong to the drive, 'time' [s]
    counts from the start of the run; 'angle' is periodic over 2 pi; any other name is used as
    it is. targets: name to (C, N), the change of the channels per unit of the addition, sample
    by sample. residual (C, N): measured minus predicted. slopes (C, N, P): change of the
    prediction by each base parameter. from_start: targets to which a law adds its change since
    the first sample.
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

    @property
    def samples(self) -> int:
        return self.residual.shape[1]


@dataclass(frozen=True)
class Misfit:
    """Residuals of the fitted runs and their metric.

    whiten: applies the metric to stacked columns (n, B), in the order of runs, channels,
    samples. degrees: degrees of freedom of the level of the noise.
    """

    runs: tuple[ObservedRun, ...]
    whiten: Callable[[Array], Array]
    degrees: int

    @property
    def size(self) -> int:
        return sum(run.residual.size for run in self.runs)

    @cached_property
    def rows(self) -> tuple[slice, ...]:
        """Rows of each run in a stacked vector."""
        ends = np.cumsum([run.residual.size for run in self.runs])
        return tuple(
            slice(int(end) - run.residual.size, int(end))
            for run, end in zip(self.runs, ends, strict=True)
        )

    @cached_property
    def base(self) -> Array:
        """Orthonormal basis (n, P) of the changes by base parameters, whitened."""
        slopes = [run.slopes.reshape(-1, run.slopes.shape[2]) for run in self.runs]
        white = self.whiten(np.concatenate(slopes))
        left, values, _ = np.linalg.svd(white, full_matrices=False)
        return np.asarray(left[:, values > 1e-8 * max(float(values.max(initial=0.0)), 1e-300)])

    @cached_property
    def residual(self) -> Array:
        """The whitened residual (n,) minus its part by base parameters."""
        plain = np.concatenate([run.residual.ravel() for run in self.runs])
        return self.freed(self.whiten(plain[:, None]))[:, 0]

    def freed(self, white: Array) -> Array:
        """Whitened columns minus their part by base parameters."""
        return np.asarray(white - self.base @ (self.base.T @ white))

    def columns(self, target: str, shapes: tuple[Array, ...]) -> Array:
        """Stacked whitened columns (n, k) of an addition of `shapes` (N, k) by run to a target."""
        return self.freed(self.whiten(stacked(self.runs, target, shapes)))


def stacked(runs: tuple[ObservedRun, ...], target: str, shapes: tuple[Array, ...]) -> Array:
    """Plain stacked columns (n, k) of an addition of `shapes` (N, k) by run to a target."""
    parts = []
    for run, shape in zip(runs, shapes, strict=True):
        parts.append(run.added(target, shape).reshape(-1, shape.shape[1]))
    return np.concatenate(parts)


LOAD_PIECES, DIRECTION_PIECES, RATE_PIECES, TIME_PIECES, ANGLE_WAVES = 32, 12, 10, 24, 8
"""Pieces of the splines and waves of the harmonics. The penalty on roughness decides how smooth a
curve is; the pieces only have to be finer than any structure that is described."""

PLAYS = 10
"""Number of plays, evenly spaced on a log scale between the REACHES."""

REACHES = (0.004, 0.5)
"""Smallest and largest half width of a play, as shares of the range of the load. A smaller play
is a change of sign with the direction; a larger one hardly slips."""

LAGS = 8
"""Number of relaxations, evenly spaced on a log scale from two samples to half of the longest
run."""


@dataclass(frozen=True)
class ShapeFamily:
    """One family of shapes: columns (N, k) by run, penalty (k, k) on their roughness.

    span: the range of the coordinate seen. non_negative: all coefficients have one sign.
    """

    coordinate: str
    kind: str
    shapes: tuple[Array, ...]
    penalty: Array
    span: tuple[float, float]
    non_negative: bool = False
    settings: Mapping[str, Array] | None = None


@dataclass(frozen=True)
class Spline:
    """Cubic B-splines with even knots over [low, high]; constant outside."""

    low: float
    high: float
    pieces: int

    @property
    def size(self) -> int:
        return self.pieces + 3

    def values(self, at: Array) -> Array:
        """(N, size)."""
        from scipy.interpolate import BSpline  # late: most diagnoses propose no law

        step = (self.high - self.low) / self.pieces
        knots = self.low + step * np.arange(-3, self.pieces + 4)
        inside = np.clip(at, self.low, self.high - 1e-9 * (self.high - self.low))
        return np.asarray(BSpline.design_matrix(inside, knots, 3).toarray())

    def roughness(self) -> Array:
        """Penalty on second differences of the coefficients."""
        second = np.diff(np.eye(self.size), 2, axis=0)
        return np.asarray(second.T @ second)


def span_of(runs: Sequence[ObservedRun], name: str) -> tuple[float, float]:
    """Range of a coordinate over the runs."""
    return (
        min(float(run.coordinates[name].min()) for run in runs),
        max(float(run.coordinates[name].max()) for run in runs))


def blocks_of(runs: tuple[ObservedRun, ...]) -> list[ShapeFamily]:
    """Every family that these runs can show."""
    blocks = [_curve(runs, LOAD, LOAD_PIECES), _hysteresis(runs)]
    names = set.intersection(*(set(run.coordinates) for run in runs))
    if DIRECTION in names and any(np.ptp(run.coordinates[DIRECTION]) > 0.0 for run in runs):
        blocks.append(_direction(runs))
    if RATE in names and span_of(runs, RATE)[0] < span_of(runs, RATE)[1]:
        blocks += [_curve(runs, RATE, RATE_PIECES), _relaxation(runs)]
    blocks.append(_curve(runs, TIME, TIME_PIECES))
    if ANGLE in names:
        blocks.append(_angle(runs))
    known = {LOAD, DIRECTION, RATE, TIME, ANGLE}
    return blocks + [_curve(runs, name, LOAD_PIECES // 2) for name in sorted(names - known)]


def _curve(runs: tuple[ObservedRun, ...], name: str, pieces: int) -> ShapeFamily:
    low, high = span_of(runs, name)
    spline = Spline(low, high, pieces)
    shapes = tuple(spline.values(run.coordinates[name]) for run in runs)
    return ShapeFamily(name, 'curve', shapes, spline.roughness(), (low, high))


def _direction(runs: tuple[ObservedRun, ...]) -> ShapeFamily:
    low, high = span_of(runs, LOAD)
    spline = Spline(low, high, DIRECTION_PIECES)
    shapes = tuple(
        run.coordinates[DIRECTION][:, None] * spline.values(run.coordinates[LOAD]) for run in runs)
    return ShapeFamily(DIRECTION, 'curve', shapes, spline.roughness(), (low, high))


def _hysteresis(runs: tuple[ObservedRun, ...]) -> ShapeFamily:
    low, high = span_of(runs, LOAD)
    reaches = np.geomspace(*REACHES, PLAYS) * (high - low)
    shapes = tuple(stop_operators(run.coordinates[LOAD], reaches) / reaches for run in runs)
    settings = {'reaches': reaches}
    return ShapeFamily(HYSTERESIS, 'plays', shapes, np.eye(PLAYS), (low, high), True, settings)


def _relaxation(runs: tuple[ObservedRun, ...]) -> ShapeFamily:
    low, high = span_of(runs, LOAD)
    step = min(float(np.median(np.diff(run.coordinates[TIME]))) for run in runs)
    longest = max(float(np.ptp(run.coordinates[TIME])) for run in runs)
    constants = np.geomspace(2.0 * step, max(0.5 * longest, 4.0 * step), LAGS)
    shapes = tuple(
        relaxations(run.coordinates[TIME], run.coordinates[LOAD], constants) / (high - low)
        for run in runs
    )
    settings = {'constants': constants}
    return ShapeFamily(RATE, 'relaxation', shapes, np.eye(LAGS), (low, high), False, settings)


def own_curves(runs: tuple[ObservedRun, ...]) -> ShapeFamily:
    """One curve over time for each run: a description that predicts no other run."""
    columns, penalty = [], np.zeros((0, 0))
    for number, run in enumerate(runs):
        time = run.coordinates[TIME]
        spline = Spline(float(time.min()), float(time.max()), TIME_PIECES)
        columns.append((number, spline.values(time)))
        own = spline.roughness()
        zero = np.zeros((penalty.shape[0], own.shape[0]))
        penalty = np.block([[penalty, zero], [zero.T, own]])
    width = penalty.shape[0] // len(runs)
    shapes = []
    for number, values in columns:
        shape = np.zeros((values.shape[0], penalty.shape[0]))
        shape[:, number * width : (number + 1) * width] = values
        shapes.append(shape)
    return ShapeFamily(TIME, 'own curve', tuple(shapes), penalty, span_of(runs, TIME))


def _angle(runs: tuple[ObservedRun, ...]) -> ShapeFamily:
    waves = np.arange(1, ANGLE_WAVES + 1)
    shapes = tuple(
        np.hstack(
            [np.cos(run.coordinates[ANGLE][:, None] * waves),
             np.sin(run.coordinates[ANGLE][:, None] * waves)]
        )
        for run in runs
    )
    penalty = np.diag(np.tile(waves.astype(np.float64) ** 4, 2))
    return ShapeFamily(ANGLE, 'harmonics', shapes, penalty, span_of(runs, ANGLE))


STRENGTHS = np.geomspace(1e-6, 1e4, 11)
"""Strengths of the regularisation, in shares of the size of the columns: from a free curve to a
straight line, by factors of ten."""

FOLDS = 5
"""Parts of a single run that are held out in turn: the usual five-fold cross-validation."""

MIN_RIDGE = 1e-9
"""Smallest regularisation, as a share of the mean square of the columns, for sums that stay
invertible in double precision."""


@dataclass(frozen=True)
class BlockFit:
    """One family added to one target: coefficients, and explained part of the whitened misfit.

    predicted: explained misfit of runs held out in turn, negative if the family predicts
    nothing. freedom: effective number of parameters.
    """

    target: str
    block: ShapeFamily
    coefficients: Array
    covariance: Array
    taken: float
    predicted: float
    freedom: float
    strength: float
    white: Array
    """Whitened columns (n, k)."""

    def p_value(self, degrees: int, trials: int) -> float:
        """Chance that noise alone gives one of `trials` families as much."""
        each = fisher_chance(max(self.taken, 0.0) / self.freedom, self.freedom, degrees)
        return min(1.0, trials * float(each))


def refitted(misfit: Misfit, fit: BlockFit, wanted: Array) -> BlockFit:
    """The same family on the same target, fitted to another residual (n,)."""
    return fit_block(misfit, fit.target, fit.block, fit.white, wanted)


def fit_block(
    misfit: Misfit, target: str, block: ShapeFamily, white: Array, wanted: Array
) -> BlockFit:
    """`block` on `target`, its whitened columns (n, k) fitted to a whitened residual (n,)."""
    folds = _folds(misfit)
    gram, slope = white.T @ white, white.T @ wanted
    unit = float(np.trace(gram)) / max(float(np.trace(block.penalty)), 1e-300)
    parts = [(white[rows].T @ white[rows], white[rows].T @ wanted[rows]) for rows in folds]
    best, chosen = -np.inf, float(STRENGTHS[-1])
    for strength in STRENGTHS:
        penalty = _penalty(block, strength * unit, gram)
        predicted = 0.0
        for rows, (own_gram, own_slope) in zip(folds, parts, strict=True):
            solution = _solve(block, gram - own_gram, slope - own_slope, penalty)
            left = wanted[rows] - white[rows] @ solution
            predicted += float(wanted[rows] @ wanted[rows] - left @ left)
        if predicted > best:
            best, chosen = predicted, float(strength)
    penalty = _penalty(block, chosen * unit, gram)
    coefficients = _solve(block, gram, slope, penalty)
    left = wanted - white @ coefficients
    inverse = np.linalg.pinv(gram + penalty, hermitian=True)
    freedom = float(np.trace(inverse @ gram))
    if block.non_negative:
        freedom = min(freedom, 1.0 + float(np.count_nonzero(coefficients)))
    return BlockFit(
        target=target, block=block, coefficients=coefficients, covariance=inverse,
        taken=float(wanted @ wanted - left @ left), predicted=best, freedom=max(freedom, 1.0),
        strength=chosen, white=white)


def ranked_fits(misfit: Misfit, blocks: Sequence[ShapeFamily], wanted: Array) -> list[BlockFit]:
    """Every family on every target, the one that predicts most first."""
    fits = [fit_block(misfit, target, block, misfit.columns(target, block.shapes), wanted)
            for block in blocks for target in misfit.runs[0].targets]
    return sorted(fits, key=lambda fit: -fit.predicted)


def _folds(misfit: Misfit) -> list[NDArray[np.int64]]:
    """Rows that are held out in turn: runs, or parts of a single run."""
    if len(misfit.runs) > 1:
        return [np.arange(rows.start, rows.stop) for rows in misfit.rows]
    run = misfit.runs[0]
    part = np.arange(run.samples) * FOLDS // run.samples
    stacked = np.tile(part, run.residual.shape[0])
    return [np.flatnonzero(stacked == number) for number in range(FOLDS)]


def _penalty(block: ShapeFamily, strength: float, gram: Array) -> Array:
    ridge = MIN_RIDGE * float(np.trace(gram)) / gram.shape[0] + 1e-300
    return np.asarray(strength * block.penalty + ridge * np.eye(gram.shape[0]))


def _solve(block: ShapeFamily, gram: Array, slope: Array, penalty: Array) -> Array:
    """Penalised least squares, with coefficients of one sign if the family requires it."""
    matrix = gram + penalty
    if not block.non_negative:
        return np.asarray(np.linalg.solve(matrix, slope))
    values, vectors = np.linalg.eigh(matrix)
    kept = values > 1e-12 * values[-1]
    root = np.sqrt(values[kept])[:, None] * vectors[:, kept].T
    target = (vectors[:, kept].T @ slope) / np.sqrt(values[kept])
    sides = []
    for sign in (1.0, -1.0):
        solution, left = nnls(root, sign * target)
        sides.append((left, sign * solution))
    return np.asarray(min(sides, key=lambda side: side[0])[1])
