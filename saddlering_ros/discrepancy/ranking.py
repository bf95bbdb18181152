"""Choice of candidates for a refit: effects by their first-order gain."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from saddlering_ros.discrepancy.candidate import Fit
from saddlering_ros.discrepancy.change_scale import orthonormal
from saddlering_ros.discrepancy.signatures import Signature
from saddlering_ros.discrepancy.system import Array, Effect

#: A start of another shape is tried if its first-order gain is at least this share of the best.
OTHER_SHARE = 0.3
MAX_OTHERS = 2
#: Shapes that differ by less than this share of their range count as one.
MIN_APART = 0.05
#: A start is scaled by so much at most: straight effects, and amplitude-dependent ones.
STRAIGHT_REACH, AMPLITUDE_DEPENDENT_REACH = (-5.0, 5.0), (0.7, 1.4)
#: An amplitude-dependent effect starts at the size that was seen if that takes so much of what its
#: shape could.
SEEN_ENOUGH = 0.5
#: Variants of one effect with first-order gains this close are equal in these data.
ALIKE = 1e-4
#: A second variant of an effect is refitted if its gain is this share of the best gain.
MAX_VARIANTS, VARIANT_SHARE = 2, 0.6


@dataclass(frozen=True)
class Score:
    """First-order gain of one candidate, and its start.

    `others`: starts of another shape with a first-order gain above OTHER_SHARE of this one;
    amplitude_dependent: as in its signature.
    """

    effect: Effect
    variant: int
    gain: float
    start: Array
    others: tuple[Array, ...] = ()
    amplitude_dependent: bool = False


def rank(
    fit: Fit,
    white_columns: Array,
    signatures: Sequence[Signature],
    skip: Sequence[str] = (),
) -> list[Score]:
    """Candidates by the first-order gain of their signatures, each with its best start."""
    orthogonal = orthonormal(white_columns)
    found: dict[tuple[str, int], list[tuple[float, Signature, Array]]] = {}
    usable = [item for item in signatures if item.effect.id not in skip and item.length > 1e-9]
    if not usable:
        return []
    stack = np.column_stack([item.white for item in usable])
    stack = stack - orthogonal @ (orthogonal.T @ stack)
    lengths = (stack**2).sum(axis=0)
    inner = -(stack.T @ fit.whitened)
    for item, squared, product in zip(usable, lengths, inner, strict=True):
        if squared <= 1e-12 * item.length**2 or item.size == 0.0:
            continue
        neutral, (low, high) = item.effect.neutral, reach_of(item)
        factor = float(np.clip(product / squared, low, high))
        gain = float(2.0 * factor * product - factor**2 * squared)
        if item.amplitude_dependent:
            # Another size has another, unknown shape. The gain that this shape could reach at
            # its best height counts, or an effect seen too large would never be tried.
            gain = float(max(product, 0.0) ** 2 / squared)
            if 2.0 * product - squared > SEEN_ENOUGH * gain:
                factor = 1.0
        start = item.theta_unit.copy()
        start[0] = np.clip(
            item.effect.size.to_unit(neutral + item.size * factor), 1e-3, 1.0 - 1e-3
        )
        found.setdefault(item.key, []).append((gain, item, start))
    scores = []
    for members in found.values():
        gain, item, start = max(members, key=lambda member: member[0])
        others = _other_shapes(members, start, OTHER_SHARE * gain)
        scores.append(
            Score(item.effect, item.variant, gain, start, others, item.amplitude_dependent)
        )
    return sorted(scores, key=lambda score: -score.gain)


def reach_of(item: Signature) -> tuple[float, float]:
    """Factors of the size of a signature between which its shape and its bounds hold."""
    neutral, size = item.effect.neutral, item.effect.size
    if neutral != 0.0:
        return 1.0, 1.0
    low, high = sorted(((size.low - neutral) / item.size, (size.high - neutral) / item.size))
    least, most = AMPLITUDE_DEPENDENT_REACH if item.amplitude_dependent else STRAIGHT_REACH
    return max(low, least), min(high, most)


def best_of_each(scores: Sequence[Score]) -> list[Score]:
    """The first score of each effect, in their order."""
    best: dict[str, Score] = {}
    for score in scores:
        best.setdefault(score.effect.id, score)
    return list(best.values())


def _other_shapes(
    members: Sequence[tuple[float, Signature, Array]], start: Array, least: float
) -> tuple[Array, ...]:
    """Starts that differ in shape from `start` and from each other, largest gain first.

    The size of an amplitude-dependent effect is part of its shape.
    """
    kept = [start]
    first = 0 if members[0][1].amplitude_dependent else 1
    for gain, _, other in sorted(members, key=lambda member: -member[0]):
        apart = all(
            np.abs(other[first:] - item[first:]).max(initial=0.0) > MIN_APART for item in kept
        )
        if gain > least and apart and len(kept) <= MAX_OTHERS:
            kept.append(other)
    return tuple(kept[1:])


def shortlist(scores: Sequence[Score], least: float, count: int) -> list[Score]:
    """The best `count` effects with a gain of `least` or more, at most two variants of each."""
    chosen: list[Score] = []
    used: Counter[str] = Counter()
    last: dict[str, float] = {}
    for score in scores:
        name = score.effect.id
        if score.gain < least or (len(used) >= count and name not in used):
            continue
        if used[name] >= MAX_VARIANTS:
            continue
        if used[name] and score.gain < VARIANT_SHARE * scores[0].gain:
            continue
        if used[name] and score.gain > (1.0 - ALIKE) * last[name]:
            continue
        last[name] = score.gain
        used[name] += 1
        chosen.append(score)
    return chosen
