"""Signatures of effects, and detection limits: what these data would show of each effect.

A signature is the change by an effect without the part that base parameters imitate. The angle
between two signatures tells two causes apart. The share beside the base parameters shows whether
an effect can be seen. The length over the noise gives the detection limit: the smallest size of
an effect that these data could have shown.

To first order a limit can be far too low: refitted gravity imitates a resonance that a spring has
shifted by one percent. Where a base can have several minima, limits are therefore confirmed: the
base is refitted beside an effect of the stated size.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from operator import attrgetter
from typing import TYPE_CHECKING

import numpy as np

from saddlering_ros.discrepancy.problem.fits import Candidate, Fit, refit, run_refits, Tangent
from saddlering_ros.discrepancy.problem.metric import Metric
from saddlering_ros.discrepancy.problem.problem import Problem
from saddlering_ros.discrepancy.problem.system import Array, Effect
from saddlering_ros.estimation.process import fisher_limit

if TYPE_CHECKING:
    from saddlering_ros.discrepancy.search.space import ModelSpace


class ChangeScale:
    """Size of a change as a share of range, without noise and nuisance parameters.

    The part that the base parameters imitate, moved to the least rms over all runs and views,
    is subtracted first, because it is no misfit.
    """

    def __init__(self, problem: Problem, base_plain: Array) -> None:
        self._problem = problem
        self._edges = np.cumsum([
            run.time.size for _ in problem.system.views for run in problem.runs])[:-1]
        self._base = orthonormal(problem.in_views(base_plain))

    def by_run(self, change: Array) -> dict[str, Array]:
        """Rms of a stacked change (n,) as a share of range: per view one number per run."""
        views = self._problem.system.views
        sizes = self.sizes(change[:, None])[:, 0].reshape(len(views), -1)
        return dict(zip(views, sizes, strict=True))

    def sizes(self, changes: Array) -> Array:
        """Rms (V R, B) of stacked changes (n, B) per view and run, as shares of range."""
        joined = self._problem.in_views(changes)
        left = joined - self._base @ (self._base.T @ joined)
        return np.array([np.linalg.norm(part, axis=0) for part in np.split(left, self._edges)])


def orthonormal(columns: Array) -> Array:
    """Orthonormal basis of columns by a Gram matrix, without its weak directions."""
    if columns.shape[1] == 0:
        return columns
    scale = np.sqrt((columns**2).sum(axis=0))
    scaled = columns / np.where(scale > 0.0, scale, 1.0)
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    kept = values > 1e-10 * max(float(values[-1]), 1e-300)
    return np.asarray(scaled @ (vectors[:, kept] / np.sqrt(values[kept])))


MIN_SHARE = 0.02
"""An effect cannot be tested if less than this share remains beside the base parameters: below
it, the curvature of the base parameters counts as a remainder."""

MIN_LENGTH = 1.0
"""A change shorter than this, in standard deviations before the projection, does not show."""

MIN_STRAIGHT = 0.9
"""Cosine below which two sizes differ in shape: a fifth of the power lies elsewhere."""

SMALLER, STANDS_OUT, MAX_SMALLER = 0.3, 12.0, 4
"""An amplitude-dependent effect is looked at in ever smaller sizes, each this share of the last,
while it stands out by more than this many standard deviations, so many times at most. Friction of
250 N, a quarter of the smallest start, had no name without them."""

BATCH = 64
"""Number of simulations in one batch, which limits the memory of their predictions."""

@dataclass(frozen=True)
class Signature:
    """Change by one effect at one start, at `theta_unit` of its parameters.

    plain (n,): as measured; white (n,): whitened, without the part of base parameters.
    amplitude_dependent: the shape depends on the size, as with thresholds and frequencies, so
    that a signature at one size does not describe another size.
    """

    effect: Effect
    variant: int
    theta_unit: Array
    size: float
    plain: Array
    white: Array
    share: float
    length: float
    visible: float
    amplitude_dependent: bool = False

    @property
    def key(self) -> tuple[str, int]:
        return self.effect.id, self.variant

    @cached_property
    def shape(self) -> tuple[object, ...]:
        """A key that is equal for signatures that differ in size only."""
        return (*self.key, *np.round(self.theta_unit[1:], 6).tolist())


def measure_signatures(metric: Metric, fit: Fit, base: Tangent, scale: ChangeScale,
                       effects: Sequence[Effect]) -> list[Signature]:
    """Signatures of each of `effects`, its variants and starts at the base fit.

    Amplitude-dependent effects have signatures at small sizes too.
    """
    starts: list[tuple[Effect, int, Array]] = [
        (effect, variant, start)
        for effect in effects if not effect.line
        for variant in range(effect.first_variant, len(effect.variants))
        for start in effect.first_guesses]
    parameters, orthogonal = metric.problem.system.base_parameters, orthonormal(base.white)
    signatures: list[Signature] = []
    for _ in range(1 + MAX_SMALLER):
        for begin in range(0, len(starts), BATCH):
            batch = starts[begin : begin + BATCH]
            part = metric.problem.predict([
                Candidate(((effect, variant),)).point(
                    parameters, np.concatenate([fit.theta_unit, theta_unit]))
                for effect, variant, theta_unit in batch]) - fit.prediction[:, None]
            left, lengths, shares = _beyond(metric, part, orthogonal)
            visible = scale.sizes(part).max(axis=0)
            signatures += [
                Signature(
                    effect=effect, variant=variant, theta_unit=theta_unit,
                    size=effect.size.from_unit(float(theta_unit[0])) - effect.neutral,
                    plain=part[:, column], white=left[:, column], share=float(shares[column]),
                    length=float(lengths[column]), visible=float(visible[column]))
                for column, (effect, variant, theta_unit) in enumerate(batch)
                if np.isfinite(part[:, column]).all()]
        signatures = with_amplitude_dependence(signatures)
        starts = _smaller(signatures)
    return signatures


def _smaller(signatures: Sequence[Signature]) -> list[tuple[Effect, int, Array]]:
    """Smaller starts of amplitude-dependent effects that are far above noise at their least size.

    Strong friction that never reverses does not show the shape of a tenth of it, which does
    reverse. Between a limit that cuts much and one that cuts nothing lies one that cuts a little.
    """
    sides: dict[tuple[str, int, bool], list[Signature]] = {}
    for signature in signatures:
        if signature.amplitude_dependent:
            sides.setdefault((*signature.key, signature.size > 0.0), []).append(signature)
    starts = []
    for members in sides.values():
        members.sort(key=lambda member: abs(member.size))
        least = members[0]
        if least.effect.neutral == 0.0 and least.length > STANDS_OUT:
            size = least.effect.size.to_unit(SMALLER * least.size)
            starts.append((least.effect, least.variant, np.array([size, *least.theta_unit[1:]])))
        if least.effect.neutral != 0.0:
            for one, other in pairwise(members):
                low, high = sorted((one.length, other.length))
                if low < MIN_LENGTH and high > STANDS_OUT:
                    starts.append(
                        (one.effect, one.variant, 0.5 * (one.theta_unit + other.theta_unit)))
    return starts


def whitened_by(metric: Metric, signatures: Sequence[Signature], base: Tangent) -> list[Signature]:
    """The same signatures in another metric."""
    orthogonal, answers = orthonormal(base.white), []
    for begin in range(0, len(signatures), BATCH):
        batch = signatures[begin : begin + BATCH]
        part = np.column_stack([signature.plain for signature in batch])
        left, lengths, shares = _beyond(metric, part, orthogonal)
        answers += [
            replace(signature, white=white, share=float(share), length=float(length))
            for signature, white, share, length in zip(
                batch, left.T, shares, lengths, strict=True)]
    return answers


def _beyond(metric: Metric, changes: Array, orthogonal: Array) -> tuple[Array, Array, Array]:
    """Changes (n, B), whitened and without base parameters; their lengths and remaining shares."""
    white = metric.whiten(changes)
    whole = np.sqrt((metric.whiten_noise(changes) ** 2).sum(axis=0))
    left = white - orthogonal @ (orthogonal.T @ white)
    lengths = np.linalg.norm(left, axis=0)
    return left, lengths, lengths / np.maximum(whole, 1e-300)


def with_amplitude_dependence(signatures: Sequence[Signature]) -> list[Signature]:
    """The same signatures, marked if sizes of their shape differ in more than height."""
    shapes: dict[tuple[object, ...], list[Signature]] = {}
    for signature in signatures:
        shapes.setdefault(signature.shape, []).append(signature)
    dependent = set()
    for members in shapes.values():
        shown = sorted((member for member in members if member.length > MIN_LENGTH),
                       key=lambda signature: signature.size)
        straight = [
            abs(float(one.white @ other.white)) / (one.length * other.length)
            for one, other in pairwise(shown) if (one.size > 0.0) is (other.size > 0.0)]
        if min(straight, default=1.0) < MIN_STRAIGHT:
            dependent.add(members[0].key)
    return [replace(one, amplitude_dependent=one.key in dependent) for one in signatures]


def testable_share(members: Sequence[Signature]) -> float:
    """Share of the signature of an effect beside the base parameters, for its best variant.

    It is taken at the smallest size that shows. At larger sizes the curvature of the base
    parameters would count as a remainder.
    """
    best = 0.0
    for variant in {member.variant for member in members}:
        of_variant = [member for member in members if member.variant == variant]
        shown = [member for member in of_variant
                 if member.length > MIN_LENGTH * member.share] or of_variant
        smallest = min(abs(member.size) for member in shown)
        best = max(best, *(member.share for member in shown if abs(member.size) <= smallest))
    return best


def shapes_tried(signatures: Sequence[Signature]) -> int:
    """Number of signatures that differ in more than size: the number of trials of a name."""
    return len({signature.shape for signature in signatures})


def testable(signatures: Sequence[Signature]) -> list[Signature]:
    """Signatures of the effects that these data can test at all."""
    effects: dict[str, list[Signature]] = {}
    for signature in signatures:
        effects.setdefault(signature.effect.id, []).append(signature)
    return [member for members in effects.values()
            if testable_share(members) >= MIN_SHARE for member in members]


NOTHING = 1e-3
"""Share of the wanted height below which a size shows nothing: logarithms fail there."""

POWER_QUANTILE = 1.2816
"""Normal quantile of 0.9: a size is found nine times in ten."""

ENOUGH = 0.9
"""Share of the required length that must remain for a limit, which is known to 10 %."""

MAX_TRIES = 6
"""Larger sizes that are tried; at the smallest factor they reach five times the limit."""

MIN_FACTOR, MAX_FACTOR = 1.3, 4.0
"""Factor between two sizes: smaller ones cost refits, larger ones leave the interpolation."""

ROUNDS = 8
"""Rounds of each refit of the base, as in the refits of candidates."""


@dataclass(frozen=True)
class Observability:
    """Observability in these data: detection limits, and cosines between signatures.

    labels (effect:variant) of the rows and columns of `cosines`, which are absolute.
    """

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

    limit: smallest size that is found nine times in ten at the given error rate, in nine of ten of
    those `configurations` in which it can be found at all (inf: none); best_limit: the limit in
    the best of them; material_limit: smallest size that changes a view by the stated share of its
    range, likewise. Of both signs, the one with the larger limit counts. If an effect does nothing
    at a size other than 0 (a limit of a span), all numbers are values of the size, not distances.
    """

    effect: str
    share: float
    limit: float
    best_limit: float
    material_limit: float
    unit: str
    testable: bool
    configurations: tuple[Configuration, ...] = ()


def observed(space: ModelSpace) -> Observability:
    """Detection limits, and cosines between the longest signatures, at the base fit.

    The test is that of a candidate: it counts the shapes that the candidate was drawn from,
    its parameters, and the independent differences from which the noise is known.
    """
    settings, chosen = space.settings, dict[tuple[str, int], Signature]()
    effects: dict[str, list[Signature]] = {}
    for signature in space.shown:
        if not signature.effect.can_be_small:
            continue  # An input that is right or wrong, such as a sign, has no smallest size.
        if not signature.effect.first_variant:  # A wider form has the limit of the plain one.
            effects.setdefault(signature.effect.id, []).append(signature)
        if signature.key not in chosen or signature.length > chosen[signature.key].length:
            chosen[signature.key] = signature
    limits = []
    for members in effects.values():
        effect = members[0].effect
        needed = length_needed(space, effect)
        limit = _limit_of(effect, members, needed, settings.materiality)
        if space.problem.assumptions.many_valleys:
            limit = _confirmed(space, limit, effect, needed)
        limits.append(limit)
    kept = [one for one in chosen.values() if one.length > 1e-9 and one.share >= MIN_SHARE]
    labels = [one.effect.id if len(one.effect.variants) == 1 else f'{one.effect.id}:{one.variant}'
              for one in kept]
    stack = np.column_stack([one.white / one.length for one in kept]) if kept else np.zeros((0, 0))
    return Observability(tuple(limits), tuple(labels), np.abs(stack.T @ stack))


def length_needed(space: ModelSpace, effect: Effect) -> float:
    """Length of the signature of an effect that is found nine times in ten."""
    rate = space.settings.error_rate / max(shapes_tried(space.shown), 1)
    extra = len(effect.ordered)
    return float(np.sqrt(extra * fisher_limit(rate, extra, space.pairs))) + POWER_QUANTILE


def _limit_of(effect: Effect, members: Sequence[Signature], needed: float,
              materiality: float) -> DetectionLimit:
    """Limits of an effect whose signature is found with a length `needed` [std of the noise]."""
    share = testable_share(members)
    reach = max(abs(effect.size.low - effect.neutral), abs(effect.size.high - effect.neutral))
    shapes: dict[tuple[object, ...], list[Signature]] = {}
    for member in members:
        shapes.setdefault(member.shape, []).append(member)
    places = []
    for same in shapes.values():
        values = {parameter.name: parameter.from_unit(float(u)) for parameter, u in zip(
            effect.ordered[1:], same[0].theta_unit[1:], strict=True)}
        values.update(effect.variants[same[0].variant])
        by_sign = [[member for member in same if np.sign(member.size) == sign]
                   for sign in {np.sign(member.size) for member in same} - {0.0}]
        # The sign that shows less counts.
        sizes = [
            max((_size_at([(abs(member.size), height(member)) for member in alike], wanted)
                 for alike in by_sign), default=np.inf)
            for height, wanted in ((attrgetter('length'), needed),
                                   (attrgetter('visible'), materiality))]
        places.append(Configuration(
            values, *(size if size <= reach else np.inf for size in sizes)))

    def nine_in_ten(limits: Sequence[float]) -> float:
        """The size that is enough in nine of ten configurations that have a limit, or inf."""
        finite = [limit for limit in limits if np.isfinite(limit)]
        return float(np.quantile(finite, 0.9, method='higher')) if finite else float(np.inf)

    def value(distance: float) -> float:
        """The size at that distance from the neutral size; inf stays inf."""
        if effect.neutral == 0.0 or not np.isfinite(distance):
            return distance
        sign = 1.0 if effect.neutral < 0.5 * (effect.size.low + effect.size.high) else -1.0
        return effect.neutral + sign * distance

    limit = nine_in_ten([place.limit for place in places])
    return DetectionLimit(
        effect=effect.id, share=share, limit=value(limit),
        best_limit=value(min(place.limit for place in places)),
        material_limit=value(nine_in_ten([place.material_limit for place in places])),
        unit=effect.size.unit, testable=share >= MIN_SHARE and bool(np.isfinite(limit)),
        configurations=tuple(
            replace(place, limit=value(place.limit), material_limit=value(place.material_limit))
            for place in places))


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


def _confirmed(space: ModelSpace, stated: DetectionLimit, effect: Effect,
               needed: float) -> DetectionLimit:
    """The same limit, larger where the refitted base imitates more than its tangents do."""
    if not np.isfinite(stated.limit) or effect.neutral != 0.0 or not stated.configurations:
        return stated
    configuration = min(stated.configurations, key=lambda one: abs(one.limit - stated.limit))
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
                              space.settings.materiality, reach)
    return replace(
        stated, limit=limit,
        best_limit=max(stated.best_limit, limit if stated.best_limit == stated.limit else 0.0),
        material_limit=material, testable=stated.testable and bool(np.isfinite(limit)))


def _size_reaching(height: Callable[[float], float], size: float, wanted: float,
                   reach: float) -> float:
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


def _shown(space: ModelSpace, effect: Effect, configuration: Configuration,
           size: float) -> tuple[float, float] | None:
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
    visible = max(problem.view_sizes(left, view).max() for view in problem.system.views)
    return float(np.sqrt(fit.misfit)), float(visible)
