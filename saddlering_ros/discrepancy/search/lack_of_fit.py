"""Lack of fit: tests of the residual on generic shapes with their own error rate.

Each family of shapes belongs to one coordinate (drive, direction of the drive, its rate, time) and
one view. Its statistic is the whitened misfit that the family explains beside the sensitivities of
the model. The noise comes from stretches at rest, so that the tested structure is not part of it.

What is faster than the slow structure is tested by octaves of half waves in whitened samples.

Consistency asks whether the same parameters and laws fit in every run, channel and state. A wrong
cause can explain almost the whole misfit, so that the remainder is too small for a test of all
slow shapes. The remainder then resembles the change of the cause, or of the base parameters, in
proportions that differ from run to run, from channel to channel, or over state and time. Each
family of such shapes is small, so that a small remainder is significant.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.sparse.csgraph import connected_components

from saddlering_ros.discrepancy.noise import KNOWN_EXACTLY
from saddlering_ros.discrepancy.problem.fits import Fit, refit, run_refits, Tangent, tangent
from saddlering_ros.discrepancy.problem.metric import Block, BlockColumns, Index, Metric
from saddlering_ros.discrepancy.problem.problem import Assumptions, Problem, shares_of_range
from saddlering_ros.discrepancy.problem.system import Array, RunBlocks, Settings
from saddlering_ros.discrepancy.search.signatures import orthonormal
from saddlering_ros.estimation.least_squares import AT_BOUND
from saddlering_ros.estimation.process import fisher_chance
from saddlering_ros.estimation.whitening import BasisBand, octaves_of, TransformBand
from saddlering_ros.memory_operators import direction_of
from saddlering_ros.quantities import CHANCE

WAVES_PER_RUN = 20
"""Half waves per run of the slow structure: a ramp with a kink, or a loop."""

TIME_WAVES = 8
"""Half waves along the time of each run, as one family: few, for small drifts."""

WAVE_SAMPLES = 4
"""Samples per half wave at the fastest structure: fewer look like scatter."""

CONSTANT, MIN_CONSTANT = 'no coordinate, as a constant does', 0.9
"""What a misfit goes along whose mean has this share of the power of a shape: every coordinate has
a constant, and a switch with two values would be named, because it has no other shape."""


@dataclass(frozen=True)
class ShapeTest:
    """One family of shapes, its size as a share of range; shape (n,): what it takes, if sure.

    beyond_noise: the size less what noise alone would leave, where a model error is declared;
    run: index of the run whose residual goes most along the shape.
    """

    view: str
    coordinate: str
    p_value: float
    statistic: float
    dimensions: int
    visible: float
    shape: Array | None = field(default=None, repr=False, compare=False)
    beyond_noise: float = 0.0
    run: int = 0


@dataclass(frozen=True)
class Structure:
    """Structure of a residual: whitened excess over noise, p-value, and share of range."""

    excess: float
    p_value: float
    visible: float

    def is_real_and_material(self, settings: Settings) -> bool:
        """Whether the structure is more than noise, and large enough to matter."""
        return self.p_value < settings.error_rate and self.visible >= settings.materiality


@dataclass(frozen=True)
class SlowResidual(Structure):
    """All slow structure of a residual.

    powers: mean square beyond noise by view, in the worst run, as shares of range; sizes (R,):
    its root by view and run; chances: by channel and run, the chance of as much from noise
    alone, with the number of channels and runs included.
    """

    dimensions: int
    where: str
    powers: Mapping[str, float]
    sizes: Mapping[str, Array]
    chances: Mapping[tuple[str, str], float]


@dataclass(frozen=True)
class FastResidual(Structure):
    """Structure too fast for `SlowResidual`: excess in all bands, and the largest real one.

    The largest one has a view, a run and an approximate frequency [Hz]. powers: mean square of
    all real bands beyond noise by view and run, as shares of range.
    """

    view: str
    run: str
    frequency: float
    powers: Mapping[tuple[str, str], float] = field(default_factory=dict)


def _principal(gram: Array) -> tuple[Array, Array]:
    """Eigenvalues and vectors of products of columns, by groups of columns that share samples.

    All columns of 200 short runs at once took 5 s.
    """
    count, groups = connected_components(gram != 0.0, directed=False)
    values, vectors = np.zeros(len(gram)), np.zeros_like(gram)
    for own in (np.flatnonzero(groups == number) for number in range(count)):
        values[own], vectors[np.ix_(own, own)] = np.linalg.eigh(gram[np.ix_(own, own)])
    return values, vectors


class LackOfFitTests:
    """Shapes that are evaluated once for a set of runs and used for every fit."""

    def __init__(self, metric: Metric, noise_pairs: int) -> None:
        self._metric = metric
        self._ranges = metric.problem.view_ranges
        self._pairs = noise_pairs
        # Cosines of time in every run and channel, with a constant if a constant is a misfit.
        problem = metric.problem
        times = [run.time for run in problem.runs]
        cosines = [half_waves(time, min(WAVES_PER_RUN, time.size // 4)) for time in times]
        blocks, start = [], 0
        for slot, (number, channel, _) in enumerate(problem.slices):
            first = 1 if problem.assumptions.frees_constant(channel) else 0
            plain = cosines[number][:, first:]
            blocks.append(Block(slot, np.arange(start, start + plain.shape[1]), plain))
            start += plain.shape[1]
        self._structure = BlockColumns(metric, blocks, start)
        gram = self._structure.gram.copy()
        gram[np.diag_indices_from(gram)] *= 1.0 + 1e-9
        values, vectors = _principal(gram)
        kept = values > 1e-8 * values.max()
        self._root = vectors[:, kept] / np.sqrt(values[kept])
        self._dimensions = int(kept.sum())
        # Mean square of the fitted structure under noise alone over the range, per view and run.
        self._variances: dict[str, list[float]] = {}
        for view, weights in problem.system.views.items():
            own = self._variances[view] = []
            for number, run in enumerate(problem.runs):
                there = [(weights[channel] * block.plain, self._root[block.index])
                         for block in self._structure.blocks
                         for index, channel, _ in [problem.slices[block.slot]]
                         if weights[channel] and index == number]
                joined = problem.freed(np.hstack([seen for seen, _ in there]), run, view)
                share = problem.sample_weights(run, view)
                spread = joined.T @ (joined * (share / share.sum())[:, None])
                stacked = np.vstack([rows for _, rows in there])
                own.append(float(np.sum(stacked * (spread @ stacked))) / self._ranges[view] ** 2)
        # Octaves from the end of the slow structure up to the limit of the samples of a run.
        self._bands: list[tuple[RunBlocks, BasisBand | TransformBand]] = []
        for index, run in enumerate(problem.runs):
            slots = [slot for slot, (number, _, _) in enumerate(problem.slices) if number == index]
            octaves = octaves_of(
                run.time, run.width, [problem.slices[slot][2] for slot in slots],
                [metric.whiteners[slot] for slot in slots],
                WAVES_PER_RUN + 1, run.time.size // WAVE_SAMPLES)
            self._bands += [(run, octave) for octave in octaves]
        self._grams: dict[tuple[str, str], Array] = {}

    def fast(self, fit: Fit) -> FastResidual:
        """Structure too fast for `slow`: the largest real band, with its view and run.

        The p-value counts the number of bands. Only the part of a band beyond noise counts.
        """
        metric = self._metric
        left = metric.without_nuisances(fit.prediction - metric.problem.measured)
        white = metric.whiten_noise(left)
        excess, strongest_band = 0.0, FastResidual(0.0, 1.0, 0.0, '', '', 0.0)
        powers: dict[tuple[str, str], float] = {}
        for run, band in self._bands:
            parts = band.coefficients(white)
            free = sum(part.size for part in parts)
            statistic = float(sum(part @ part for part in parts))
            p_value = float(fisher_chance(statistic / free, free, self._pairs)) * len(self._bands)
            excess += max(statistic - free, 0.0)
            seen = band.seen(parts)
            for view, weights in metric.problem.system.views.items():
                power = float(np.average((weights @ seen) ** 2, weights=run.width))
                power -= float(weights**2 @ band.noise)
                size = max(power, 0.0) ** 0.5 / self._ranges[view]
                if p_value < CHANCE:
                    powers[view, run.name] = powers.get((view, run.name), 0.0) + size**2
                if p_value < CHANCE and size > strongest_band.visible:
                    strongest = int(np.argmax(np.sum([part**2 for part in parts], axis=0)))
                    frequency = 0.5 * (band.first + strongest) / band.duration
                    strongest_band = FastResidual(0.0, p_value, size, view, run.name, frequency)
        return replace(strongest_band, excess=excess, powers=powers)

    def slow(self, fit: Fit) -> SlowResidual:
        """Slow structure of the residual as a whole."""
        slopes = self._structure.products(fit.whitened)
        inner = self._root.T @ slopes
        free = max(self._dimensions - fit.theta_unit.size, 1)
        statistic = float(inner @ inner)
        p_value = float(fisher_chance(statistic / free, free, self._pairs))
        shape = self._structure.combined(self._root @ inner)
        sizes, runs = {}, self._metric.problem.runs
        for view, variances in self._variances.items():
            sizes[view] = np.sqrt(np.maximum(self._powers(fit, shape, view) - variances, 0.0))
        most = {view: float(size.max()) for view, size in sizes.items()}
        view = max(most, key=lambda name: most[name])
        where = f'{view} in {runs[int(sizes[view].argmax())].name}' if most[view] > 0.0 else ''
        problem, blocks, chances = self._metric.problem, self._structure.blocks, {}
        for block in blocks:
            number, channel, _ = problem.slices[block.slot]
            name, own = runs[number].name, slopes[block.index]
            gram = self._structure.gram[np.ix_(block.index, block.index)]
            structure = float(own @ np.linalg.lstsq(gram, own, rcond=1e-8)[0])
            pairs = min(self._pairs, max(self._metric.noise[name, channel].pairs, 1))
            chance = float(fisher_chance(structure / own.size, own.size, pairs)) * len(blocks)
            chances[problem.system.channel_names[channel], name] = min(1.0, chance)
        return SlowResidual(
            excess=statistic - free, dimensions=free, p_value=p_value, visible=most[view],
            where=where, powers={name: size**2 for name, size in most.items()}, sizes=sizes,
            chances=chances)

    def _powers(self, fit: Fit, shape: Array, view: str) -> Array:
        """Mean squares (R,) of a structure (n,) over the range, at most those of the residual.

        A structure that nuisance parameters can imitate has an estimate with a large error. The
        estimate may then be larger than the residual itself.
        """
        problem = self._metric.problem
        return np.minimum(problem.view_sizes(shape, view), problem.view_sizes(
            fit.prediction - problem.measured, view)) ** 2

    @cached_property
    def _families(self) -> 'dict[str, Family]':
        return shape_families(self._metric.problem.runs, self._metric.problem.assumptions)

    def shapes(self, fit: Fit, tangent: Tangent) -> list[ShapeTest]:
        """Every family in every view, the most significant first; p-values count their number."""
        problem, orthogonal, tests = self._metric.problem, orthonormal(tangent.white), []
        residual = fit.prediction - problem.measured
        parameters = np.linalg.pinv(orthogonal.T @ tangent.white)
        # At a bound, a misfit that the parameters could take is left, and no shape holds it.
        beside = residual - tangent.plain @ (parameters @ (orthogonal.T @ fit.whitened))
        both = self._metric.shared.apply(np.column_stack([orthogonal, fit.whitened]))
        for coordinate, family in self._families.items():
            for view, weights in problem.system.views.items():
                # The smallest change of channels with 1 in the view.
                pattern = weights / float(weights @ weights)
                columns = BlockColumns(self._metric, [
                    Block(slot, family[number][0], pattern[channel] * family[number][1])
                    for slot, (number, channel, _) in enumerate(problem.slices)
                    if weights[channel]], 1 + max(int(index.max()) for index, _ in family))
                # Beside the sensitivities of the model.
                shared, along = np.split(columns.noise_products(both), [-1], axis=1)
                if (view, coordinate) not in self._grams:
                    self._grams[view, coordinate] = columns.gram
                gram = self._grams[view, coordinate]
                values, vectors = np.linalg.eigh(gram - shared @ shared.T)
                rounding = 1e-13 * float(np.trace(gram))
                kept = values > max(1e-8 * float(values[-1]), rounding, 1e-300)
                root = vectors[:, kept] / np.sqrt(values[kept])
                inner = root.T @ (along[:, 0] - shared @ (orthogonal.T @ fit.whitened))
                count, statistic = int(kept.sum()), float(inner @ inner)
                shape = columns.combined(root @ inner)
                size = self._powers(fit, shape, view).max() ** 0.5
                chance = fisher_chance(statistic / count, count, self._pairs) if count else 1.0
                beyond = columns.size_beyond_noise(
                    view, root, inner, tangent.plain @ (parameters @ shared.T)
                ) if problem.allowed_sizes[view] and chance < CHANCE else 0.0
                run = problem.run_along(residual, shape, view)
                is_constant = _is_constant(problem, beside, shape, view, run)
                tests.append(ShapeTest(
                    view, CONSTANT if is_constant else coordinate, float(chance), statistic,
                    max(count, 1), float(size), shape if chance < CHANCE else None, beyond,
                    run))
        return sorted(
            (replace(test, p_value=min(1.0, test.p_value * len(tests))) for test in tests),
            key=lambda test: (test.p_value, -test.statistic / test.dimensions))


def _is_constant(problem: Problem, residual: Array, shape: Array, view: str, number: int) -> bool:
    """Whether a residual (n,) along a shape (n,) is a constant in a view of a run."""
    run, weights = problem.runs[number], problem.system.views[view]
    left, taken = (problem.freed(weights @ problem.by_run(one)[number], run, view)
                   for one in (residual, shape))
    mean = np.average(left, weights=problem.sample_weights(run, view))
    return bool(mean**2 > MIN_CONSTANT * min(
        problem.mean_square(one, run, view) for one in (left, taken)))


def _half_turns(values: Sequence[Array]) -> list[Array]:
    """A state (N,) of each run, scaled to the interval from 0 to pi."""
    return [np.pi * share for share in shares_of_range(values)]


def half_waves(values: Array, count: int) -> Array:
    """Cosines (N, 1 + count) of 0 to `count` half waves along `values`, the first constant."""
    share, = shares_of_range([values])
    return np.asarray(np.cos(np.pi * share[:, None] * np.arange(count + 1)))


Family = Sequence[tuple[Index, Array]]
"""Shapes along one coordinate: by run, the indices of its shapes, and the shapes (N, k)."""


def shape_families(runs: Sequence[RunBlocks], assumptions: Assumptions) -> dict[str, Family]:
    """Shapes by coordinate. Runs of one group share them; shapes over time belong to one run."""
    first, others = assumptions.coordinate_waves
    seen = [run.coordinates for run in runs]
    names = [name for name in seen[0] if all(name in other for other in seen)]
    groups = sorted({run.group for run in runs})
    places = [groups.index(run.group) for run in runs]
    families: dict[str, Family] = {}
    for number, name in enumerate(names):
        shares = [turn[:, None] for turn in _half_turns([values[name] for values in seen])]
        waves = np.arange(1, (first if number == 0 else others) + 1)
        families[name] = _family([np.cos(share * waves) for share in shares], places)
        given = [run.direction for run in runs if run.direction is not None]
        is_drive = number == 0 and len(given) == len(runs)
        directions = given if is_drive else [] if given else _turns(
            [values[name] for values in seen])
        if directions:
            families['direction' if is_drive else f'the direction of {name}'] = _family([
                direction[:, None]
                * np.hstack([np.ones_like(share), np.sin(share * np.arange(1, 3))])
                for direction, share in zip(directions, shares, strict=True)], places)
    families['time'] = _family(
        [half_waves(run.time, TIME_WAVES)[:, 1:] for run in runs], range(len(runs)))
    return families


def _turns(values: Sequence[Array]) -> list[Array]:
    """The direction (N,) of a coordinate in each run, +1 or -1; none if it hardly turns."""
    band = TURN * max(float(np.ptp(run)) for run in values)
    turns = []
    for run in values:
        places = np.linspace(0, run.size - 1, min(run.size, MAX_TURNING)).round().astype(int)
        followed = np.searchsorted(places, np.arange(run.size), side='right') - 1
        direction = direction_of(run[places], band)
        reversals = [0, *(1 + np.flatnonzero(np.diff(direction))).tolist()]
        for begin, end in pairwise(reversals):  # Each counts from its turning point on.
            sign = direction[begin]
            direction[begin + int(np.argmax(sign * run[places[begin:end]])):end] = -sign
        turns.append(direction[followed])
    rising = float(np.mean(np.concatenate(turns) > 0.0))
    return turns if MIN_TURNED < rising < 1.0 - MIN_TURNED else []


def _family(shapes: Sequence[Array], places: Sequence[int]) -> Family:
    """Shapes (N, k) of each run, with the same indices in the runs of one place."""
    each = shapes[0].shape[1]
    return [(each * place + np.arange(each), part)
            for place, part in zip(places, shapes, strict=True)]


TURN, MIN_TURNED, MAX_TURNING = 0.02, 0.1, 2000
"""Return of a coordinate that changes its direction, as a share of its range; smallest share of
the samples with either direction; samples of a run in which it is followed. Chosen."""

CAUSE_WAVES, PARAMETER_WAVES, STATE_WAVES = 2, 1, 3
"""Half waves over a state: for the change of a cause, the sensitivities, a channel. Families stay
small, so that a small remainder is significant: no sound record of seven machines (seeds 201 to
203) had a family under 1 %."""

CAUSE_TIMES, PARAMETER_TIMES = 3, 2
"""Half waves over the time of a run, for the change of a cause and the sensitivities."""

MIN_LEFT = 1e-4
"""Smallest share of the square of a shape beside the parameters for the shape to count, the
square of 1 %: with less, rounding and curvature would be tested."""

MIN_LEVEL = 0.2
"""Smallest share of the learnt noise that is assumed, so that a residual far under the noise does
not make every shape significant."""


def consistency_tests(metric: Metric, fit: Fit, tangent: Tangent, slow: SlowResidual,
                      pairs: int) -> list[ShapeTest]:
    """Every family of these runs; the number of families is counted in the p-values.

    Noise that is learnt from fast parts of a residual can be too large at slow times. The slow
    structure of the residual bounds its level from above, as far as its own dimensions tell it.
    Noise of a declared level stays as it is.
    """
    is_declared = min(noise.pairs for noise in metric.noise.values()) >= KNOWN_EXACTLY
    problem, tests = metric.problem, []
    residual = fit.prediction - problem.measured
    inverse = np.linalg.pinv(tangent.white.T @ tangent.white, rcond=1e-10, hermitian=True)
    # A solver's errors keep a fit from its minimum, which shapes that parameters nearly imitate
    # would magnify. What a bound keeps is a misfit.
    free = np.abs(fit.theta_unit - 0.5) < 0.5 - AT_BOUND
    slope = np.zeros(free.size)
    slope[free] = np.linalg.lstsq(tangent.white[:, free], fit.whitened, rcond=1e-5)[0]
    for name, blocks in _consistent_families(problem, fit, tangent):
        columns = BlockColumns(metric, blocks, 1 + max(int(one.index[-1]) for one in blocks))
        tangents, lengths = columns.products(tangent.white), np.sqrt(
            np.maximum(np.diag(columns.gram), 1e-300))
        imitated = inverse @ tangents.T
        values, vectors = np.linalg.eigh(
            (columns.gram - tangents @ imitated) / np.outer(lengths, lengths))
        kept = values > MIN_LEFT
        count = int(kept.sum())
        if not count:
            continue  # The sensitivities of the model imitate every shape.
        root = vectors[:, kept] / np.sqrt(values[kept])
        inner = root.T @ ((columns.products(fit.whitened) - tangents @ slope) / lengths)
        statistic = float(inner @ inner)
        others, level, known = slow.dimensions - count, 1.0, pairs
        if others > 0 and not is_declared:
            left = (slow.excess + slow.dimensions - statistic) / others
            level = min(1.0, max(left, MIN_LEVEL))
            known = pairs if level == 1.0 else min(pairs, others)
        weights = (root @ inner) / lengths
        shape = columns.combined(weights) - tangent.plain @ (imitated @ weights)
        sizes = {view: float(problem.view_sizes(shape, view).max())
                 for view in problem.system.views}
        view = max(sizes, key=lambda name: sizes[name])
        beyond = max(statistic - count * level, 0.0) / max(statistic, 1e-300)
        # A shape that parameters nearly imitate has an estimate with a large error.
        largest = float(problem.view_sizes(residual, view).max())
        tests.append(ShapeTest(
            view, name, float(fisher_chance(statistic / count / level, count, known)), statistic,
            count, min(sizes[view] * beyond**0.5, largest),
            run=problem.run_along(residual, shape, view)))
    return [replace(test, p_value=min(1.0, test.p_value * len(tests))) for test in tests]


def is_noise_alone(metric: Metric, fit: Fit) -> bool:
    """Whether no test of the residual of a model finds more than the noise of a metric.

    fit: the model, fitted in another metric.
    """
    settings = metric.problem.settings
    [fit] = run_refits(metric, [refit(metric, fit.candidate, fit.theta_unit)])
    pairs = max(noise.pairs for noise in metric.noise.values())
    tests, sensitivities = LackOfFitTests(metric, pairs), tangent(metric, fit)
    slow = tests.slow(fit)

    def chances() -> Iterator[float]:  # The tests that cost most come last.
        yield from (slow.p_value, *slow.chances.values())
        yield from (one.p_value for one in tests.shapes(fit, sensitivities))
        yield from (one.p_value for one in consistency_tests(
            metric, fit, sensitivities, slow, pairs))
        yield tests.fast(fit).p_value

    return all(chance >= settings.error_rate for chance in chances())


def _consistent_families(problem: Problem, fit: Fit,
                         tangent: Tangent) -> Iterator[tuple[str, list[Block]]]:
    """Families of shapes about a fit by their kind, one at a time because they are large."""
    runs, slices, plain = problem.runs, problem.slices, tangent.plain
    channels = len(problem.system.channel_names)
    predicted = problem.by_run(fit.prediction)
    seen = [_half_turns([run[row] for run in predicted]) for row in range(channels)]
    shared = [name for name in runs[0].inputs if all(name in run.inputs for run in runs)]
    states = [*seen, *(_half_turns([run.inputs[name] for run in runs]) for name in shared)]
    times = [[_half_turns([run.time])[0] for run in runs]]

    def along(shapes: Array, states: Sequence[Sequence[Array]], waves: int) -> list[Block]:
        """Shapes (n, k) times cosines over each state, which has an array (N,) for each run."""
        return [
            Block(slot, np.arange(shapes.shape[1] * len(states) * waves), np.hstack([
                shapes[part] * np.cos(wave * places[run])[:, None]
                for places in states for wave in range(1, waves + 1)]))
            for slot, (run, _, part) in enumerate(slices)]

    def in_one(owners: Sequence[int], shapes: Sequence[Array]) -> list[Block]:
        """Shapes (N, k) of each slice, in the columns of its owner, a run or a channel."""
        return [
            Block(slot, owner * shape.shape[1] + np.arange(shape.shape[1]), shape)
            for slot, (owner, shape) in enumerate(zip(owners, shapes, strict=True))]

    sensitivities = plain[:, : len(problem.system.base_parameters)]
    yield 'state, as the parameters act', along(sensitivities, states, PARAMETER_WAVES)
    yield 'time, as the parameters act', along(sensitivities, times, PARAMETER_TIMES)
    owners = np.array([(run, channel) for run, channel, _ in slices]).T
    waves = np.arange(1, STATE_WAVES + 1)
    yield 'the predicted state', in_one(owners[1], [
        np.hstack([np.cos(places[run][:, None] * waves) for places in seen])
        for run, _, _ in slices])
    # The last run, or channel, is given by the others and the sensitivities themselves.
    for kind, words, count in ((0, 'runs', len(runs)), (1, 'channels', channels)):
        if count > 1:
            yield f'the {words}, as the parameters act', [
                block for block, owner in zip(
                    in_one(owners[kind], [plain[part] for _, _, part in slices]), owners[kind],
                    strict=True) if owner < count - 1]
    if fit.candidate.effects:
        changes = problem.changes_of_effects(fit.point, fit.prediction)
        yield 'state, as the cause acts', along(changes, states, CAUSE_WAVES)
        yield 'time, as the cause acts', along(changes, times, CAUSE_TIMES)
