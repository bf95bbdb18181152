"""The verdict on the selected model, and tests of its consistency.

Consistency asks whether the same parameters and laws fit in every run, channel and state. A wrong
cause can explain almost the whole misfit, so that the remainder is too small for a test of all
slow shapes. The remainder then resembles the change of the cause, or of the base parameters, in
proportions that differ from run to run, from channel to channel, or over state and time. Each
family of such shapes is small, so that a small remainder is significant.
"""

from collections.abc import Callable, Sequence
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
from saddlering_ros.discrepancy.search.lack_of_fit import ShapeTest, SlowResidual
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

Columns = Callable[[int], Array]
"""Shapes (N, k) of a family in one channel of one run, by the index of the slice."""


def consistency_tests(
    metric: Metric, fit: Fit, tangent: Tangent, slow: SlowResidual, pairs: int
) -> list[ShapeTest]:
    """Every family of these runs; the number of families is counted in the p-values."""
    families = _families(metric.problem, fit, tangent)
    tests = [
        test for name, columns in families.items()
        if (test := _tested(metric, fit, tangent, name, columns, slow, pairs)) is not None]
    return [replace(test, p_value=min(1.0, test.p_value * len(tests))) for test in tests]


def _families(problem: Problem, fit: Fit, tangent: Tangent) -> dict[str, Columns]:
    """Shapes about a fit by their kind, each evaluated for one channel of one run at a time."""
    runs, slices, plain = problem.runs, problem.slices, tangent.plain
    channels = len(problem.system.channel_names)
    predicted = problem.by_run(fit.prediction)
    seen = [_places([run[row] for run in predicted]) for row in range(channels)]
    shared = [name for name in runs[0].inputs if all(name in run.inputs for run in runs)]
    states = [*seen, *(_places([run.inputs[name] for run in runs]) for name in shared)]
    times = [[np.pi * (run.time - run.time[0]) / np.ptp(run.time) for run in runs]]

    def over(shapes: Array, states: Sequence[Sequence[Array]], waves: int) -> Columns:
        """Shapes (n, k) times cosines over each state, which has an array (N,) for each run."""
        return lambda slot: np.hstack([
            shapes[slices[slot][2]] * np.cos(wave * places[slices[slot][0]])[:, None]
            for places in states for wave in range(1, waves + 1)])

    def one_of(kind: int, count: int) -> Columns:
        """The sensitivities in one of `count` runs (kind 0) or channels (1), not in the last."""
        return lambda slot: np.asarray(
            np.kron(np.eye(count)[slices[slot][kind], :-1], plain[slices[slot][2]]))

    def of_channels(slot: int) -> Array:
        """Shapes over the predicted channels, in this channel of any run."""
        run, channel, _ = slices[slot]
        waves = np.arange(1, STATE_WAVES + 1)
        own = np.hstack([np.cos(places[run][:, None] * waves) for places in seen])
        return np.asarray(np.kron(np.eye(channels)[channel], own))

    sensitivities = plain[:, : len(problem.system.base_parameters)]
    families: dict[str, Columns] = {
        'state, as the parameters act': over(sensitivities, states, PARAMETER_WAVES),
        'time, as the parameters act': over(sensitivities, times, PARAMETER_TIMES),
        'the predicted state': of_channels}
    if len(runs) > 1:
        families['the runs, as the parameters act'] = one_of(0, len(runs))
    if channels > 1:
        families['the channels, as the parameters act'] = one_of(1, channels)
    if fit.candidate.effects:
        changes = problem.changes_of_effects(fit.point, fit.prediction)
        families['state, as the cause acts'] = over(changes, states, CAUSE_WAVES)
        families['time, as the cause acts'] = over(changes, times, CAUSE_TIMES)
    return families


def _places(values: Sequence[Array]) -> list[Array]:
    """A state (N,) of each run, scaled to the interval from 0 to pi."""
    low = min(float(state.min()) for state in values)
    high = max(float(state.max()) for state in values)
    return [np.pi * (state - low) / max(high - low, 1e-300) for state in values]


def _tested(
    metric: Metric, fit: Fit, tangent: Tangent, name: str, columns: Columns, slow: SlowResidual,
    pairs: int,
) -> ShapeTest | None:
    """The test of one family; None if the sensitivities of the model imitate every shape.

    Noise that is learnt from fast parts of a residual can be too large at slow times. The slow
    structure of the residual bounds its level from above.
    """
    gram, tangents, residual = _products(metric, fit, tangent, columns)
    lengths = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    inverse = np.linalg.pinv(tangent.white.T @ tangent.white, rcond=1e-10, hermitian=True)
    imitated = inverse @ tangents.T
    values, vectors = np.linalg.eigh((gram - tangents @ imitated) / np.outer(lengths, lengths))
    kept = values > MIN_LEFT
    count = int(kept.sum())
    if not count:
        return None
    root = vectors[:, kept] / np.sqrt(values[kept])
    inner = root.T @ (residual / lengths)
    statistic = float(inner @ inner)
    left = (slow.excess + slow.dimensions - statistic) / max(slow.dimensions - count, 1)
    level = min(1.0, max(left, MIN_LEVEL)) if slow.dimensions > count else 1.0
    p_value = float(fisher_chance(statistic / count / level, count, pairs))
    weights = (root @ inner) / lengths
    problem = metric.problem
    shape = np.concatenate([
        columns(slot) @ weights - tangent.plain[part] @ (imitated @ weights)
        for slot, (_, _, part) in enumerate(problem.slices)])
    sizes = {view: max(problem.view_sizes(shape, view)) for view in problem.system.views}
    view = max(sizes, key=lambda name: sizes[name])
    beyond = max(statistic - count * level, 0.0) / max(statistic, 1e-300)
    return ShapeTest(view, name, p_value, statistic, count, sizes[view] * beyond**0.5)


def _products(
    metric: Metric, fit: Fit, tangent: Tangent, columns: Columns
) -> tuple[Array, Array, Array]:
    """Products of whitened shapes with each other (k, k), the tangents (k, p) and the residual."""
    shared = metric.shared
    count = columns(0).shape[1]
    gram, residual = np.zeros((count, count)), np.zeros(count)
    tangents = np.zeros((count, tangent.white.shape[1]))
    along = np.zeros((count, shared.directions.shape[1]))
    for slot, (_, _, part) in enumerate(metric.problem.slices):
        white = metric.whiteners[slot].whiten(columns(slot))
        gram += white.T @ white
        tangents += white.T @ tangent.white[part]
        residual += white.T @ fit.whitened[part]
        along += white.T @ shared.directions[part]
    shrink = shared.shrink
    return (
        gram - (along * (2.0 * shrink - shrink**2)) @ along.T,
        tangents - along @ (shrink[:, None] * (shared.directions.T @ tangent.white)),
        residual - along @ (shrink * (shared.directions.T @ fit.whitened)))


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
    settings = space.settings
    share = explained_share_of(before, after) if fit.candidate.effects else 0.0
    left = _is_left(space, after)
    warnings: list[str] = []
    verdict: Verdict = 'none'
    if fit.candidate.effects:
        open_members = [name for name in fit.candidate.ids if alternatives.get(name)]
        doubts = _doubts(space, fit, after, share)
        if open_members and len(fit.candidate.effects) > MAX_WITH_ALTERNATIVES:
            doubts.append(wording.too_many_words(len(fit.candidate.effects), open_members))
        verdict = 'unknown' if doubts else 'ambiguous' if open_members else 'named'
        warnings += doubts
        if after.slow.is_real_and_material(settings) and not doubts:
            warnings.append(wording.other_form_words(share, after.slow.where))
    elif left:
        verdict = 'unknown'
    if after.fast.is_real_and_material(settings):
        warnings.append(wording.oscillation_words(after.fast))
    return Judgement(verdict, share, tuple(warnings))


def _is_left(space: ModelSpace, after: Residual) -> bool:
    """Whether a real and material residual remains, in all or in one channel of one run."""
    settings = space.settings
    if any(allowed_sizes(space).values()):
        return _exceeds_declared_error(space, after)
    if after.slow.is_real_and_material(settings) or after.fast.is_real_and_material(settings):
        return True
    return bool(_unexplained(space, after))


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


def is_under_declared_error(space: ModelSpace, before: Residual) -> bool:
    """Whether a model error is declared and the simulator alone is not wrong by more."""
    return any(allowed_sizes(space).values()) and not _exceeds_declared_error(space, before)


def _exceeds_declared_error(space: ModelSpace, residual: Residual) -> bool:
    """Whether a real residual is larger than the declared model error somewhere."""
    settings, slow, fast = space.settings, residual.slow, residual.fast
    least = {view: max(settings.materiality, own) for view, own in allowed_sizes(space).items()}
    chance = min([slow.p_value, *slow.chances.values()])
    if chance < settings.error_rate and any(
        float(np.max(size)) >= least[view] for view, size in slow.sizes.items()
    ):
        return True
    return fast.is_real_and_material(settings) and fast.visible >= least[fast.view]


def _unexplained(space: ModelSpace, after: Residual) -> list[str]:
    """Channels and runs whose residual exceeds the noise and the declared model error."""
    problem = space.problem
    if not problem.assumptions.exact_laws:
        return []  # Judged in each view, against the form error of the effects.
    allowed = allowed_sizes(space)
    least = {view: max(space.settings.materiality, own) for view, own in allowed.items()}
    names = [run.name for run in problem.runs]
    unexplained = [
        f'{channel} in {run}'
        for (channel, run), chance in after.slow.chances.items()
        if chance < space.settings.error_rate
        and after.slow.sizes[channel][names.index(run)] >= least[channel]
    ]
    unexplained += [
        f'{test.view} along {test.coordinate}'
        for test in (*after.consistency, *after.shapes)
        if test.p_value < space.settings.error_rate and test.visible >= least[test.view]
    ]
    return unexplained


def _doubts(space: ModelSpace, fit: Fit, after: Residual, share: float) -> list[str]:
    """Reasons why real causes are not named, one sentence each."""
    settings, assumptions = space.settings, space.problem.assumptions
    doubts = []
    if _is_left(space, after):
        where = ', '.join(_unexplained(space, after)) or after.slow.where or after.fast.view
        is_exact = assumptions.exact_laws
        if share < settings.min_total or is_exact or space.tests.slow(
                with_forms(space, fit, fit)).is_real_and_material(settings):
            doubts.append(wording.partial_words(fit.candidate.ids, share, where))
    members = [Comparison(space, space.without(fit, name), fit).added
               for name in fit.candidate.ids]
    if crowded(members, settings):
        doubts.append(wording.crowded_words(len(fit.candidate.effects)))
    return [*doubts, *shapes_at_bounds(space, fit)]


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
