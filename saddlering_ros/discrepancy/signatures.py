"""Signatures: the change by each effect, without the part that base parameters imitate.

The angle between two signatures tells two causes apart. The length over the noise gives the
detection limit. The share beside the base parameters shows whether an effect can be seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product

import numpy as np

from saddlering_ros.discrepancy.candidate import Candidate, Fit
from saddlering_ros.discrepancy.change_scale import ChangeScale, orthonormal
from saddlering_ros.discrepancy.metric import Metric
from saddlering_ros.discrepancy.refit import Tangent
from saddlering_ros.discrepancy.system import Array, Effect, Parameter, Point

#: An effect cannot be tested if less than this share remains beside the base parameters.
MIN_SHARE = 0.02
#: A change shorter than this, in standard deviations before the projection, does not show.
MIN_LENGTH = 1.0
#: Signatures of two sizes with a smaller cosine than this differ in shape.
MIN_STRAIGHT = 0.9
#: An amplitude-dependent effect is looked at in ever smaller sizes, each this share of the last,
#: while it stands out by more than this many standard deviations, so many times at most.
SMALLER, STANDS_OUT, MAX_SMALLER = 0.3, 12.0, 4
#: Number of simulations in one batch.
BATCH = 64
#: Sizes tried of an effect without starts, as shares of its reach, and shapes, of their range.
SIZES, SHAPES, MAX_SHAPES = (0.03, 0.15, 0.6), (0.15, 0.85), 16
#: The same for a limit, which does nothing over much of its reach.
FAR = 0.9


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
        return [
            np.array(
                [
                    item.to_unit(start[item.name]) if item.name in start else item.first_guess
                    for item in effect.ordered
                ]
            )
            for start in effect.starts
        ]
    usual = [item.first_guess for item in effect.ordered[1:]]
    sizes = _sizes(effect)
    starts = [np.array([size, *usual]) for size in sizes]
    for shape in _other_shapes(effect.ordered[1:]):
        starts.append(np.array([sizes[len(SIZES) // 2], *shape]))
    return starts


def _sizes(effect: Effect) -> list[float]:
    """Bound-scaled sizes on both sides of the neutral size."""
    size, neutral = effect.size, effect.neutral
    if size.scale == 'log':
        return [0.2, 0.5, 0.8]
    origin = min(max(neutral, size.low), size.high)
    return [
        size.to_unit(origin + part * (end - origin))
        for end in (size.high, size.low)
        if end != origin
        for part in (SIZES if size.neutral is None else (*SIZES, FAR))
    ]


def _other_shapes(shapes: Sequence[Parameter]) -> list[list[float]]:
    """Shapes besides the usual one: all combinations of a few, or one parameter at a time."""
    if not shapes:
        return []
    usual = [item.first_guess for item in shapes]
    choices = [
        [(u + turn) % 1.0 for turn in (0.0, 0.25, 0.5, 0.75)] if item.periodic else [u, *SHAPES]
        for item, u in zip(shapes, usual, strict=True)
    ]
    if np.prod([len(item) for item in choices]) <= MAX_SHAPES:
        found = [list(item) for item in product(*choices)]
    else:
        found = [
            [*usual[:number], value, *usual[number + 1 :]]
            for number, values in enumerate(choices)
            for value in values
        ]
    return [item for item in found if item != usual]


def measure_signatures(
    metric: Metric,
    fit: Fit,
    base: Tangent,
    scale: ChangeScale,
) -> list[Signature]:
    """Signatures of every effect, variant and start at the base fit.

    Amplitude-dependent effects have signatures at small sizes too.
    """
    starts: list[tuple[Effect, int, Array]] = [
        (effect, variant, start)
        for effect in metric.experiment.system.effects
        if not effect.line
        for variant in range(effect.first_variant, len(effect.variants))
        for start in effect_starts(effect)
    ]
    orthogonal = orthonormal(base.white)
    found: list[Signature] = []
    for _ in range(1 + MAX_SMALLER):
        for begin in range(0, len(starts), BATCH):
            found += _measured(metric, fit, orthogonal, scale, starts[begin : begin + BATCH])
        found = with_amplitude_dependence(found)
        starts = _smaller(found)
    return found


def _measured(
    metric: Metric,
    fit: Fit,
    orthogonal: Array,
    scale: ChangeScale,
    starts: Sequence[tuple[Effect, int, Array]],
) -> list[Signature]:
    """Signatures of effects in one variant at one start each."""
    parameters = metric.experiment.system.base_parameters
    points: list[Point] = [
        Candidate(((effect, variant),)).point(
            parameters, np.concatenate([fit.theta_unit, theta_unit])
        )
        for effect, variant, theta_unit in starts
    ]
    part = metric.experiment.predict(points) - fit.prediction[:, None]
    left, lengths, shares = _beyond(metric, part, orthogonal)
    visible = scale.beyond_base_of_each(part)
    shown = [bool(np.isfinite(column).all()) for column in part.T]
    return [
        Signature(
            effect=effect, variant=variant, theta_unit=theta_unit,
            size=effect.size.from_unit(float(theta_unit[0])) - effect.neutral,
            plain=part[:, column], white=left[:, column], share=float(shares[column]),
            length=float(lengths[column]), visible=float(visible[column]))
        for column, (effect, variant, theta_unit) in enumerate(starts)
        if shown[column]
    ]


def _smaller(signatures: Sequence[Signature]) -> list[tuple[Effect, int, Array]]:
    """Smaller starts of amplitude-dependent effects that are far above noise at their least size.

    Strong friction that never reverses does not show the shape of a tenth of it, which does
    reverse. Between a limit that cuts much and one that cuts nothing lies one that cuts a
    little.
    """
    sides: dict[tuple[str, int, bool], list[Signature]] = {}
    for item in signatures:
        if item.amplitude_dependent:
            sides.setdefault((*item.key, item.size > 0.0), []).append(item)
    starts = []
    for members in sides.values():
        members.sort(key=lambda item: abs(item.size))
        least = members[0]
        if least.effect.neutral == 0.0 and least.length > STANDS_OUT:
            size = least.effect.size.to_unit(SMALLER * least.size)
            starts.append((least.effect, least.variant, np.array([size, *least.theta_unit[1:]])))
        if least.effect.neutral != 0.0:
            for one, other in pairwise(members):
                low, high = sorted((one.length, other.length))
                if low < MIN_LENGTH and high > STANDS_OUT:
                    starts.append(
                        (one.effect, one.variant, 0.5 * (one.theta_unit + other.theta_unit))
                    )
    return starts


def whitened_by(metric: Metric, signatures: Sequence[Signature], base: Tangent) -> list[Signature]:
    """The same signatures in another metric."""
    orthogonal = orthonormal(base.white)
    answers: list[Signature] = []
    for begin in range(0, len(signatures), BATCH):
        items = signatures[begin : begin + BATCH]
        part = np.column_stack([item.plain for item in items])
        left, lengths, shares = _beyond(metric, part, orthogonal)
        answers += [
            replace(
                item,
                white=left[:, column],
                share=float(shares[column]),
                length=float(lengths[column]),
            )
            for column, item in enumerate(items)
        ]
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
    for item in signatures:
        shapes.setdefault(item.shape, []).append(item)
    dependent: dict[tuple[object, ...], bool] = {}
    for key, members in shapes.items():
        shown = [item for item in members if item.length > MIN_LENGTH]
        shown.sort(key=lambda item: item.size)
        signs = {item.size > 0.0 for item in shown}
        straight = [
            abs(float(one.white @ other.white)) / (one.length * other.length)
            for sign in signs
            for one, other in pairwise([item for item in shown if (item.size > 0.0) is sign])
        ]
        found = min(straight, default=1.0) < MIN_STRAIGHT
        dependent[key[:2]] = dependent.get(key[:2], False) or found
    return [replace(item, amplitude_dependent=dependent[item.key]) for item in signatures]


def testable_share(members: Sequence[Signature]) -> float:
    """Share of the signature of an effect beside the base parameters, for its best variant.

    It is taken at the smallest size that shows. At larger sizes the curvature of the base
    parameters would count as a remainder.
    """
    best = 0.0
    for variant in {item.variant for item in members}:
        own = [item for item in members if item.variant == variant]
        shown = [item for item in own if item.length > MIN_LENGTH * item.share] or own
        smallest = min(abs(item.size) for item in shown)
        best = max(best, *(item.share for item in shown if abs(item.size) <= smallest))
    return best


def shapes_tried(signatures: Sequence[Signature]) -> int:
    """Number of signatures that differ in more than size: the number of trials of a name."""
    return len({item.shape for item in signatures})


def testable(signatures: Sequence[Signature]) -> list[Signature]:
    """Signatures of the effects that these data can test at all."""
    effects: dict[str, list[Signature]] = {}
    for item in signatures:
        effects.setdefault(item.effect.id, []).append(item)
    return [
        item
        for members in effects.values()
        if testable_share(members) >= MIN_SHARE
        for item in members
    ]


def angle_matrix(signatures: Sequence[Signature]) -> tuple[list[str], Array]:
    """Labels (effect:variant) and absolute cosines between the longest signature of each."""
    chosen: dict[tuple[str, int], Signature] = {}
    for item in signatures:
        if item.key not in chosen or item.length > chosen[item.key].length:
            chosen[item.key] = item
    kept = [item for item in chosen.values() if item.length > 1e-9 and item.share >= MIN_SHARE]
    if not kept:
        return [], np.zeros((0, 0))
    stack = np.column_stack([item.white / item.length for item in kept])
    labels = [
        item.effect.id if len(item.effect.variants) == 1 else f'{item.effect.id}:{item.variant}'
        for item in kept
    ]
    return labels, np.abs(stack.T @ stack)
