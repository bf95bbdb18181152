"""Signatures of effects: what each of them changes beyond the base parameters.

A signature is the change by an effect without the part that base parameters imitate. The angle
between two signatures tells two causes apart. The length over the noise gives the detection
limit. The share beside the base parameters shows whether an effect can be seen.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product

import numpy as np

from saddlering_ros.discrepancy.problem.fits import Candidate, Fit, Tangent
from saddlering_ros.discrepancy.problem.problem import Metric, Problem
from saddlering_ros.discrepancy.problem.system import Array, Effect


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

    def beyond_base_of_each(self, changes: Array) -> Array:
        """Largest rms (B,) over runs and views of stacked changes (n, B), as shares of range."""
        return np.asarray(self._sizes(changes).max(axis=0))

    def by_run(self, change: Array) -> dict[str, Array]:
        """Rms of a stacked change (n,) as a share of range: per view one number per run."""
        views = self._problem.system.views
        sizes = self._sizes(change[:, None])[:, 0].reshape(len(views), -1)
        return dict(zip(views, sizes, strict=True))

    def _sizes(self, changes: Array) -> Array:
        """Rms (V R, B) of stacked changes (n, B) per view and run."""
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

SIZES, SHAPES, MAX_SHAPES = (0.03, 0.15, 0.6), (0.15, 0.85), 16
"""Sizes tried of an effect without starts, as shares of its reach, shapes as shares of their
range, and the largest number of combinations of shapes. The sizes are a factor of four to five
apart, so that one of them is near any true size."""

FAR = 0.9
"""A further size of a limit, which does nothing over much of its reach."""


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

    @property
    def shape(self) -> tuple[object, ...]:
        """A key that is equal for signatures that differ in size only."""
        return (*self.key, *np.round(self.theta_unit[1:], 6))


def effect_starts(effect: Effect) -> list[Array]:
    """First guesses of the parameters of an effect, bound-scaled."""
    if effect.starts:
        return [np.array([one.to_unit(start[one.name]) if one.name in start else one.first_guess
                          for one in effect.ordered]) for start in effect.starts]
    # Sizes on both sides of the neutral one, with the usual shape.
    size, sizes = effect.size, [0.2, 0.5, 0.8]
    if size.scale != 'log':
        origin = min(max(effect.neutral, size.low), size.high)
        sizes = [size.to_unit(origin + part * (end - origin))
                 for end in (size.high, size.low) if end != origin
                 for part in (SIZES if size.neutral is None else (*SIZES, FAR))]
    shapes = effect.ordered[1:]
    usual = [shape.first_guess for shape in shapes]
    # Other shapes of a middle size: all combinations of a few, or one parameter at a time.
    choices = [
        [(u + turn) % 1.0 for turn in (0.0, 0.25, 0.5, 0.75)] if shape.periodic else [u, *SHAPES]
        for shape, u in zip(shapes, usual, strict=True)]
    others = [[*usual[:number], value, *usual[number + 1 :]]
              for number, values in enumerate(choices) for value in values]
    if np.prod([len(choice) for choice in choices]) <= MAX_SHAPES:
        others = [list(choice) for choice in product(*choices)]
    return [np.array([one, *usual]) for one in sizes] + [
        np.array([sizes[len(SIZES) // 2], *other]) for other in others if other != usual]


def measure_signatures(
    metric: Metric, fit: Fit, base: Tangent, scale: ChangeScale, effects: Sequence[Effect]
) -> list[Signature]:
    """Signatures of each of `effects`, its variants and starts at the base fit.

    Amplitude-dependent effects have signatures at small sizes too.
    """
    starts: list[tuple[Effect, int, Array]] = [
        (effect, variant, start)
        for effect in effects if not effect.line
        for variant in range(effect.first_variant, len(effect.variants))
        for start in effect_starts(effect)]
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
            visible = scale.beyond_base_of_each(part)
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
    reverse. Between a limit that cuts much and one that cuts nothing lies one that cuts a
    little.
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
    orthogonal = orthonormal(base.white)
    answers: list[Signature] = []
    for begin in range(0, len(signatures), BATCH):
        batch = signatures[begin : begin + BATCH]
        part = np.column_stack([signature.plain for signature in batch])
        left, lengths, shares = _beyond(metric, part, orthogonal)
        answers += [
            replace(signature, white=left[:, column], share=float(shares[column]),
                    length=float(lengths[column]))
            for column, signature in enumerate(batch)]
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


def angle_matrix(signatures: Sequence[Signature]) -> tuple[list[str], Array]:
    """Labels (effect:variant) and absolute cosines between the longest signature of each."""
    chosen: dict[tuple[str, int], Signature] = {}
    for signature in signatures:
        if signature.key not in chosen or signature.length > chosen[signature.key].length:
            chosen[signature.key] = signature
    kept = [one for one in chosen.values() if one.length > 1e-9 and one.share >= MIN_SHARE]
    if not kept:
        return [], np.zeros((0, 0))
    stack = np.column_stack([signature.white / signature.length for signature in kept])
    labels = [one.effect.id if len(one.effect.variants) == 1 else f'{one.effect.id}:{one.variant}'
              for one in kept]
    return labels, np.abs(stack.T @ stack)
