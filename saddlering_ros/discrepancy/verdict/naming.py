"""The verdict on the selected model, and tests of its consistency.

Consistency asks whether the same parameters and laws fit in every run, channel and state. A wrong
cause can explain almost the whole misfit, so that the remainder is too small for a test of all
slow shapes. The remainder then resembles the change of the cause, or of the base parameters, in
proportions that differ from run to run, from channel to channel, or over state and time. Each
family of such shapes is small, so that a small remainder is significant.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from saddlering_ros.discrepancy.problem.fits import Fit, PRIOR, Tangent
from saddlering_ros.discrepancy.problem.problem import Metric, Problem
from saddlering_ros.discrepancy.problem.system import Array
from saddlering_ros.discrepancy.search.evidence import (
    alternative_floor,
    Comparison,
    crowded,
    MAX_WITH_ALTERNATIVES,
    with_forms,
)
from saddlering_ros.discrepancy.search.lack_of_fit import (
    Block,
    BlockColumns,
    ShapeTest,
    SlowResidual,
)
from saddlering_ros.discrepancy.search.selection import Alternatives
from saddlering_ros.discrepancy.search.space import AT_BOUND, ModelSpace
from saddlering_ros.discrepancy.verdict import wording
from saddlering_ros.discrepancy.verdict.results import Residual, Verdict
from saddlering_ros.estimation.least_squares import covariance
from saddlering_ros.estimation.statistics import fisher_chance

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


def consistency_tests(
    metric: Metric, fit: Fit, tangent: Tangent, slow: SlowResidual, pairs: int
) -> list[ShapeTest]:
    """Every family of these runs; the number of families is counted in the p-values.

    Noise that is learnt from fast parts of a residual can be too large at slow times. The slow
    structure of the residual bounds its level from above.
    """
    problem, tests = metric.problem, []
    inverse = np.linalg.pinv(tangent.white.T @ tangent.white, rcond=1e-10, hermitian=True)
    for name, blocks in _families(problem, fit, tangent):
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
        inner = root.T @ (columns.products(fit.whitened) / lengths)
        statistic = float(inner @ inner)
        left = (slow.excess + slow.dimensions - statistic) / max(slow.dimensions - count, 1)
        level = min(1.0, max(left, MIN_LEVEL)) if slow.dimensions > count else 1.0
        weights = (root @ inner) / lengths
        shape = columns.combined(weights) - tangent.plain @ (imitated @ weights)
        sizes = {view: max(problem.view_sizes(shape, view)) for view in problem.system.views}
        view = max(sizes, key=lambda name: sizes[name])
        beyond = max(statistic - count * level, 0.0) / max(statistic, 1e-300)
        tests.append(ShapeTest(
            view, name, float(fisher_chance(statistic / count / level, count, pairs)), statistic,
            count, sizes[view] * beyond**0.5))
    return [replace(test, p_value=min(1.0, test.p_value * len(tests))) for test in tests]


def _families(problem: Problem, fit: Fit, tangent: Tangent) -> Iterator[tuple[str, list[Block]]]:
    """Families of shapes about a fit by their kind, one at a time because they are large."""
    runs, slices, plain = problem.runs, problem.slices, tangent.plain
    channels = len(problem.system.channel_names)
    predicted = problem.by_run(fit.prediction)
    seen = [_places([run[row] for run in predicted]) for row in range(channels)]
    shared = [name for name in runs[0].inputs if all(name in run.inputs for run in runs)]
    states = [*seen, *(_places([run.inputs[name] for run in runs]) for name in shared)]
    times = [[np.pi * (run.time - run.time[0]) / np.ptp(run.time) for run in runs]]

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


def _places(values: Sequence[Array]) -> list[Array]:
    """A state (N,) of each run, scaled to the interval from 0 to pi."""
    low = min(float(state.min()) for state in values)
    high = max(float(state.max()) for state in values)
    return [np.pi * (state - low) / max(high - low, 1e-300) for state in values]


@dataclass(frozen=True)
class Judgement:
    """The verdict on the selected model, with warnings for the reader."""

    verdict: Verdict
    explained: float
    warnings: tuple[str, ...]

    def doubted(self, doubts: Sequence[str]) -> 'Judgement':
        """The same with reasons, if there are any, why no cause is established."""
        if not doubts:
            return self
        return replace(self, verdict='unknown', warnings=(*self.warnings, *doubts))


def residual_of(space: ModelSpace, fit: Fit) -> Residual:
    """The residual of a fit; with consistency tests if laws are assumed to be exact."""
    sensitivities, slow = space.tangent_of(fit), space.slow_residual(fit)
    shapes = space.tests.shapes(fit, sensitivities.white)
    consistency: list[ShapeTest] = []
    if space.problem.assumptions.exact_laws:
        consistency = consistency_tests(
            space.metric, fit, sensitivities, slow, space.max_pairs)
    return Residual(slow, space.tests.fast(fit), tuple(shapes), tuple(consistency))


def judge(
    space: ModelSpace, fit: Fit, alternatives: Alternatives, before: Residual, after: Residual
) -> Judgement:
    """The verdict: whether the causes have alternatives, and whether they explain the misfit."""
    settings, ids, left = space.settings, fit.candidate.ids, _left_in(space, after)
    fast = [wording.oscillation_words(after.fast)] if after.fast.is_real_and_material(
        settings) else []
    if not ids:
        return Judgement('unknown' if left else 'none', 0.0, tuple(fast))
    share, doubts = explained_share_of(before, after), []
    # The law of a ring's effect may have another form, which leaves a small part.
    if left and (share < settings.min_total or space.problem.assumptions.exact_laws
                 or space.tests.slow(with_forms(space, fit, fit)).is_real_and_material(settings)):
        doubts.append(wording.partial_words(ids, share, left))
    if crowded([Comparison(space, space.without(fit, name), fit).added for name in ids], settings):
        doubts.append(wording.crowded_words(len(ids)))
    doubts += shapes_at_bounds(space, fit)
    open_members = [name for name in ids if alternatives.get(name)]
    if open_members and len(ids) > MAX_WITH_ALTERNATIVES:
        doubts.append(wording.too_many_words(len(ids), open_members))
    warnings = [*doubts, *fast]
    if after.slow.is_real_and_material(settings) and not doubts:
        warnings.insert(0, wording.other_form_words(share, after.slow.where))
    verdict: Verdict = 'unknown' if doubts else 'ambiguous' if open_members else 'named'
    return Judgement(verdict, share, tuple(warnings))


def _left_in(space: ModelSpace, after: Residual) -> str:
    """Where a real and material residual remains, in all or in one channel of one run; or ''."""
    settings, problem, slow = space.settings, space.problem, after.slow
    allowed, names = allowed_sizes(space), [run.name for run in problem.runs]
    least = {view: max(settings.materiality, own) for view, own in allowed.items()}
    places = []
    # The laws of a ring are judged in each view, against the form error of the effects.
    if problem.assumptions.exact_laws:
        places = [
            f'{channel} in {run}' for (channel, run), chance in slow.chances.items()
            if chance < settings.error_rate
            and slow.sizes[channel][names.index(run)] >= least[channel]]
        places += [
            f'{test.view} along {test.coordinate}' for test in (*after.consistency, *after.shapes)
            if test.p_value < settings.error_rate and test.visible >= least[test.view]]
    is_left = exceeds_declared_error(space, after) if any(allowed.values()) else (
        places or slow.is_real_and_material(settings) or after.fast.is_real_and_material(settings))
    return (', '.join(places) or slow.where or after.fast.view) if is_left else ''


def allowed_sizes(space: ModelSpace) -> dict[str, float]:
    """Size by view, as a share of range, under which a residual is declared to be nothing."""
    problem = space.problem
    declared = problem.assumptions.allowed_error
    if declared is None:
        return dict.fromkeys(problem.system.views, 0.0)
    return {
        view: max(declared[channel] for channel in np.flatnonzero(weights))
        for view, weights in problem.system.views.items()
    }


def exceeds_declared_error(space: ModelSpace, residual: Residual) -> bool:
    """Whether a real residual is larger than the declared model error somewhere."""
    settings, slow, fast = space.settings, residual.slow, residual.fast
    least = {view: max(settings.materiality, own) for view, own in allowed_sizes(space).items()}
    chance = min([slow.p_value, *slow.chances.values()])
    if chance < settings.error_rate and any(
        float(np.max(size)) >= least[view] for view, size in slow.sizes.items()
    ):
        return True
    return fast.is_real_and_material(settings) and fast.visible >= least[fast.view]


def shapes_at_bounds(space: ModelSpace, fit: Fit) -> list[str]:
    """A sentence for every shape of a cause that is stopped by its bound.

    A shape is stopped if the misfit beyond the bound would fall by more than noise and the
    form error of the effect explain. A shape at its neutral value or at its start is not
    stopped.
    """
    problem, settings = space.problem, space.settings
    white = space.tangent_of(fit).white
    variances = np.diag(covariance(white, PRIOR))
    slopes = white.T @ fit.whitened
    floor = alternative_floor(space.pairs, settings)
    form_error = 0.0 if problem.assumptions.exact_laws else settings.form_error
    taken = max(space.base.misfit - fit.misfit, 0.0)
    sentences = []
    for effect, _, part in fit.candidate.slices(len(problem.system.base_parameters)):
        shapes = zip(
            effect.ordered, fit.theta_unit[part], slopes[part], variances[part], strict=True)
        for parameter, theta_unit, slope, variance in list(shapes)[1:]:
            outward = slope if theta_unit < 0.5 else -slope
            beyond = max(float(outward), 0.0) ** 2 * variance
            allowed = max(floor, form_error * taken)
            bound = parameter.high if theta_unit > 0.5 else parameter.low
            is_near = not parameter.periodic and min(theta_unit, 1.0 - theta_unit) < AT_BOUND
            is_stopped = is_near and bound not in (parameter.neutral, parameter.start)
            if beyond > allowed and is_stopped:
                value = parameter.from_unit(float(theta_unit))
                sentences.append(wording.shape_at_bound_words(effect.id, parameter, value))
    return sentences


def explained_share_of(before: Residual, after: Residual) -> float:
    """Share of the misfit beyond noise that is explained, 0 to 1.

    A small cause can be certain although all structures together are no more than noise.
    """
    remaining = max(after.slow.excess, 0.0) + after.fast.excess
    misfit = max(before.slow.excess, 0.0) + before.fast.excess
    return 1.0 - min(1.0, remaining / max(misfit, 1e-9))
