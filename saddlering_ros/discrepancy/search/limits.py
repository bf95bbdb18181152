"""Detection limits: the smallest size of every effect that these data could have shown.

A signature shows to first order which part of a change the base parameters imitate. A nonlinear
example is a resonance that a spring has shifted by one percent: refitted gravity imitates the
shift almost completely, and a limit from signatures is far too low. Where a base can have several
minima, limits are therefore confirmed: the base is refitted beside an effect of the stated size.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np

from saddlering_ros.discrepancy.problem.fits import Candidate, refit, run_refits
from saddlering_ros.discrepancy.problem.system import Array, Effect
from saddlering_ros.discrepancy.search import signatures as shown_by
from saddlering_ros.discrepancy.search.signatures import MIN_SHARE, shapes_tried, Signature
from saddlering_ros.discrepancy.search.space import ModelSpace
from saddlering_ros.estimation.statistics import fisher_limit

NOTHING = 1e-3
"""Share of the wanted height below which a size shows nothing: logarithms fail there."""

POWER_QUANTILE = 1.2816
"""Normal quantile of 0.9: a size is found nine times in ten."""


@dataclass(frozen=True)
class Observability:
    """Observability in these data: detection limits, and cosines between signatures."""

    limits: tuple[DetectionLimit, ...]
    labels: tuple[str, ...]
    cosines: Array


@dataclass(frozen=True)
class Configuration:
    """Detection and materiality limit of an effect that acts in one way (which probe, which arc).

    `values`: fixed values, and the parameters of its shape in their units.
    """

    values: Mapping[str, float]
    limit: float
    material_limit: float


@dataclass(frozen=True)
class DetectionLimit:
    """Detection limits of one effect in these data.

    limit: smallest size that is found nine times in ten at the given error rate, in nine of
    ten of those `configurations` in which it can be found at all (inf: none); best_limit: the
    limit in the best of them; material_limit: smallest size that changes a view by the stated
    share of its range, likewise. Of both signs, the one with the larger limit counts. If an
    effect does nothing at a size other than 0 (a limit of a span), all numbers are values of
    the size, not distances.
    """

    effect: str
    share: float
    limit: float
    best_limit: float
    material_limit: float
    unit: str
    testable: bool
    configurations: tuple[Configuration, ...] = ()


def detection_limits(
    signatures: Sequence[Signature], error_rate: float, materiality: float, pairs: int
) -> list[DetectionLimit]:
    """Limits of each effect in all its configurations.

    The test is that of a candidate: it counts the shapes that the candidate was drawn from,
    its parameters, and the noise known from `pairs` independent differences.
    """
    effects: dict[str, list[Signature]] = {}
    for signature in signatures:
        if not signature.effect.first_variant:  # A wider form has the limit of the plain one.
            effects.setdefault(signature.effect.id, []).append(signature)
    rate = error_rate / max(shapes_tried(signatures), 1)
    answers = []
    for name, members in effects.items():
        effect = members[0].effect
        needed = needed_length(len(effect.ordered), rate, pairs)
        share = shown_by.testable_share(members)
        reach = max(abs(effect.size.low - effect.neutral), abs(effect.size.high - effect.neutral))
        shapes: dict[tuple[object, ...], list[Signature]] = {}
        for member in members:
            shapes.setdefault(member.shape, []).append(member)
        places = [_limits_at(shape, needed, materiality, reach) for shape in shapes.values()]
        limit = _nine_in_ten([one.limit for one in places])
        material = _nine_in_ten([one.material_limit for one in places])
        answers.append(DetectionLimit(
            effect=name, share=share, limit=_value(effect, limit),
            best_limit=_value(effect, min(one.limit for one in places)),
            material_limit=_value(effect, material), unit=effect.size.unit,
            testable=share >= MIN_SHARE and bool(np.isfinite(limit)),
            configurations=tuple(
                replace(one, limit=_value(effect, one.limit),
                        material_limit=_value(effect, one.material_limit)) for one in places)))
    return answers


def needed_length(extra: int, rate: float, pairs: int) -> float:
    """Length [standard deviations] of a signature that the test finds nine times in ten.

    extra: parameters of the effect; rate: chance of a false cause in one test.
    """
    return float(np.sqrt(extra * fisher_limit(rate, extra, pairs))) + POWER_QUANTILE


def _value(effect: Effect, distance: float) -> float:
    """The size at that distance from the neutral size; inf stays inf."""
    if effect.neutral == 0.0 or not np.isfinite(distance):
        return distance
    sign = 1.0 if effect.neutral < 0.5 * (effect.size.low + effect.size.high) else -1.0
    return effect.neutral + sign * distance


def _limits_at(
    members: Sequence[Signature], needed: float, materiality: float, reach: float
) -> Configuration:
    """Limits in one variant and shape, for sizes up to `reach` and the sign that shows less."""
    effect, shape = members[0].effect, members[0].theta_unit[1:]
    values = {parameter.name: parameter.from_unit(float(u))
              for parameter, u in zip(effect.ordered[1:], shape, strict=True)}
    values.update(effect.variants[members[0].variant])
    by_sign = [[member for member in members if np.sign(member.size) == sign]
               for sign in {np.sign(member.size) for member in members} - {0.0}]
    limit, material = (
        max((_size_at([(abs(one.size), height(one)) for one in same], wanted)
             for same in by_sign), default=np.inf)
        for height, wanted in ((attrgetter('length'), needed),
                               (attrgetter('visible'), materiality)))
    return Configuration(
        values, limit if limit <= reach else np.inf, material if material <= reach else np.inf)


def _nine_in_ten(limits: Sequence[float]) -> float:
    """The size that is enough in nine of ten configurations that have a limit; inf if none has."""
    finite = [limit for limit in limits if np.isfinite(limit)]
    return float(np.quantile(finite, 0.9, method='higher')) if finite else float(np.inf)


def _size_at(heights: Sequence[tuple[float, float]], wanted: float) -> float:
    """Size at which a growing height reaches `wanted`, from (size > 0, height) pairs.

    Below the smallest and beyond the largest size the height is proportional; between two
    sizes the interpolation is log-log. If a size has no effect and the next one more than
    enough, the result is the next one.
    """
    sizes, tall = np.array(sorted(heights)).T
    if not tall.any():
        return np.inf
    above = np.flatnonzero(tall >= wanted)
    first = int(above[0]) if above.size else int(np.flatnonzero(tall)[-1])
    if first == 0 or not above.size:
        return float(sizes[first] * wanted / tall[first])
    if tall[first - 1] < NOTHING * wanted:
        return float(sizes[first])
    slope = np.log(wanted / tall[first - 1]) / np.log(tall[first] / tall[first - 1])
    return float(sizes[first - 1] * (sizes[first] / sizes[first - 1]) ** slope)


ENOUGH = 0.9
"""Share of the required length that must remain for a limit, which is known to 10 %."""

MAX_TRIES = 6
"""Larger sizes that are tried; at the smallest factor they reach five times the limit."""

MIN_FACTOR, MAX_FACTOR = 1.3, 4.0
"""Factor between two sizes: smaller ones cost refits, larger ones leave the interpolation."""

ROUNDS = 8
"""Rounds of each refit of the base, as in the refits of candidates."""


def observed(space: ModelSpace) -> Observability:
    """Detection limits, and cosines between signatures, at the base fit."""
    settings = space.settings
    limits = detection_limits(
        space.signatures, settings.error_rate, settings.materiality, space.pairs)
    if space.problem.assumptions.many_valleys:
        trials = max(shapes_tried(space.signatures), 1)
        effects = {effect.id: effect for effect in space.problem.system.effects}
        limits = [confirmed(space, limit, effects[limit.effect], trials) for limit in limits]
    labels, cosines = shown_by.angle_matrix(space.signatures)
    return Observability(tuple(limits), tuple(labels), cosines)


def confirmed(
    space: ModelSpace, stated: DetectionLimit, effect: Effect, trials: int
) -> DetectionLimit:
    """The same limit, larger where the refitted base imitates more than its tangents do."""
    if not np.isfinite(stated.limit) or effect.neutral != 0.0 or not stated.configurations:
        return stated
    settings = space.settings
    configuration = min(
        stated.configurations, key=lambda one: abs(one.limit - stated.limit))
    needed = needed_length(len(effect.ordered), settings.error_rate / trials, space.pairs)
    reach = max(abs(effect.size.low), abs(effect.size.high))

    def shown(size: float, failed: float) -> tuple[float, float]:
        """As `_shown`, for the sign with the smaller part; `failed` if the simulator fails."""
        space.watch.check()
        low, high = effect.size.low, effect.size.high
        parts = [_shown(space, effect, configuration, sign * size) for sign in (1.0, -1.0)
                 if low <= sign * size <= high]
        return min(filter(None, parts), key=lambda part: part[0], default=(failed, failed))

    if shown(stated.limit, np.inf)[0] >= ENOUGH * needed:
        return stated
    # An effect at which the simulator fails shows nothing.
    limit = _size_reaching(lambda size: shown(size, 0.0)[0], stated.limit, needed, reach)
    material = _size_reaching(lambda size: shown(size, 0.0)[1], stated.material_limit,
                              settings.materiality, reach)
    return replace(
        stated, limit=limit,
        best_limit=max(stated.best_limit, limit if stated.best_limit == stated.limit else 0.0),
        material_limit=material, testable=stated.testable and bool(np.isfinite(limit)))


def _size_reaching(
    height: Callable[[float], float], size: float, wanted: float, reach: float
) -> float:
    """The size, from `size` on, at which a height reaches `wanted`; inf if none up to `reach`."""
    if not np.isfinite(size):
        return size
    low, below = size, height(size)
    if below >= ENOUGH * wanted:
        return size
    for _ in range(MAX_TRIES):
        if low >= reach:
            break
        high = min(low * float(np.clip(wanted / max(below, 1e-9), MIN_FACTOR, MAX_FACTOR)), reach)
        above = height(high)
        if above >= wanted:
            share = np.log(wanted / max(below, 1e-9)) / np.log(above / max(below, 1e-9))
            return float(low * (high / low) ** share)
        low, below = high, above
    return float(np.inf)


def _shown(
    space: ModelSpace, effect: Effect, configuration: Configuration, size: float
) -> tuple[float, float] | None:
    """Part of an effect that the base, fitted to the effect's prediction, does not imitate.

    Its length [standard deviations], and its share of the range; None if the simulator fails.
    """
    metric, base = space.metric, space.base
    problem = metric.problem
    variant = next(
        number for number, fixed in enumerate(effect.variants)
        if all(configuration.values.get(name) == value for name, value in fixed.items()))
    effect_unit = [effect.size.to_unit(size), *(
        shape.to_unit(configuration.values[shape.name]) for shape in effect.ordered[1:])]
    point = Candidate(((effect, variant),)).point(
        problem.system.base_parameters, np.concatenate([base.theta_unit, effect_unit]))
    target = problem.predict([point])[:, 0]
    if not np.all(np.isfinite(target)):
        return None
    # The same problem with other readings (n,), without held-out runs.
    runs = [replace(run, channels=channels)
            for run, channels in zip(problem.runs, problem.by_run(target), strict=True)]
    other = problem.with_runs(runs)
    moved = replace(metric, problem=other)
    [fit] = run_refits(moved, [refit(moved, Candidate(), base.theta_unit, rounds=ROUNDS)])
    problem.simulations += other.simulations
    left = fit.prediction - target
    visible = max(max(problem.view_sizes(left, view)) for view in problem.system.views)
    return float(np.sqrt(fit.misfit)), visible
