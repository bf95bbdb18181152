"""Ranking of effects, and of pairs of effects, by their first-order gain beside a fit.

The first-order gain is the fall of the misfit that a signature could give at its best size. It
costs no simulation and gives each candidate the starts of its refit.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from saddlering_ros.discrepancy.problem.fits import Candidate, Fit
from saddlering_ros.discrepancy.problem.system import Array, Effect
from saddlering_ros.discrepancy.search.signatures import orthonormal, Signature

OTHER_SHARE = 0.3
"""First-order gain over the best at which another shape is a start: a gain is a poor guide."""

MAX_OTHERS = 2
"""Largest number of further starts of one effect, which limits the cost of a step."""

MIN_APART = 0.05
"""Shapes within this share of their range are one: a refit covers such a distance."""

STRAIGHT_REACH, AMPLITUDE_DEPENDENT_REACH = (-5.0, 5.0), (0.7, 1.4)
"""Factors by which a start is scaled at most: an amplitude-dependent signature holds near its own
size only."""

SEEN_ENOUGH = 0.5
"""Share of what its shape could take at which an amplitude-dependent effect starts as seen."""

ALIKE = 1e-4
"""Variants of one effect with first-order gains this close are equal in these data."""

MAX_VARIANTS, VARIANT_SHARE = 2, 0.6
"""Number of variants of an effect that are refitted, and the share of the best gain that a second
one needs. The other variants follow in the race of all candidates."""


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


def rank(fit: Fit, white_columns: Array, signatures: Sequence[Signature],
         skip: Sequence[str] = ()) -> list[Score]:
    """Candidates by the first-order gain of their signatures, each with its best start.

    No effect of the fit is a candidate, and no law that contains one of these or that one of these
    contains: two laws would describe the same part. skip: ids of others that are none.
    """
    orthogonal = orthonormal(white_columns)
    starts: dict[tuple[str, int], list[tuple[float, Signature, Array]]] = {}
    own = [effect for effect, _ in fit.candidate.effects]
    usable = [one for one in signatures if one.effect.id not in skip and one.length > 1e-9
              and not any(one.effect.overlaps(effect) for effect in own)]
    if not usable:
        return []
    stack = np.column_stack([signature.white for signature in usable])
    stack = stack - orthogonal @ (orthogonal.T @ stack)
    lengths = (stack**2).sum(axis=0)
    inner = -(stack.T @ fit.whitened)
    for signature, squared, along in zip(usable, lengths, inner, strict=True):
        if squared <= 1e-12 * signature.length**2 or signature.size == 0.0:
            continue
        factor = float(np.clip(along / squared, *reach_of(signature)))
        gain = float(2.0 * factor * along - factor**2 * squared)
        if signature.amplitude_dependent:
            # Another size has another, unknown shape. The gain that this shape could reach at
            # its best height counts, or an effect seen too large would never be tried.
            gain = float(max(along, 0.0) ** 2 / squared)
            if 2.0 * along - squared > SEEN_ENOUGH * gain:
                factor = 1.0
        start = np.array([_size_unit(signature, factor), *signature.theta_unit[1:]])
        starts.setdefault(signature.key, []).append((gain, signature, start))
    scores = []
    for members in starts.values():
        members.sort(key=lambda member: -member[0])
        gain, best, start = members[0]
        # Starts that differ in shape from this and from each other. The size of an
        # amplitude-dependent effect is part of its shape.
        kept, first = [start], 0 if best.amplitude_dependent else 1
        for other_gain, _, other in members:
            is_new = all(np.abs(other[first:] - chosen[first:]).max(initial=0.0) > MIN_APART
                         for chosen in kept)
            if other_gain > OTHER_SHARE * gain and is_new and len(kept) <= MAX_OTHERS:
                kept.append(other)
        scores.append(Score(best.effect, best.variant, gain, start, tuple(kept[1:]),
                            best.amplitude_dependent))
    return sorted(scores, key=lambda score: -score.gain)


def _size_unit(signature: Signature, factor: float) -> float:
    """The size of a signature times a factor, bound-scaled and off its bounds."""
    effect = signature.effect
    return float(np.clip(
        effect.size.to_unit(effect.neutral + factor * signature.size), 1e-3, 1.0 - 1e-3))


def reach_of(signature: Signature) -> tuple[float, float]:
    """Factors of the size of a signature between which its shape and its bounds hold."""
    neutral, size = signature.effect.neutral, signature.effect.size
    if neutral != 0.0:
        return 1.0, 1.0
    low, high = sorted(bound / signature.size for bound in (size.low, size.high))
    lowest, highest = (
        AMPLITUDE_DEPENDENT_REACH if signature.amplitude_dependent else STRAIGHT_REACH)
    return max(low, lowest), min(high, highest)


def best_of_each(scores: Sequence[Score]) -> list[Score]:
    """The first score of each effect, in their order."""
    best: dict[str, Score] = {}
    for score in scores:
        best.setdefault(score.effect.id, score)
    return list(best.values())


def shortlist(scores: Sequence[Score], least: float, count: int) -> list[Score]:
    """The best `count` effects with a gain of `least` or more, at most two variants of each."""
    chosen: list[Score] = []
    used: Counter[str] = Counter()
    last: dict[str, float] = {}
    for score in scores:
        name = score.effect.id
        if name in used:
            is_wanted = used[name] < MAX_VARIANTS and (
                VARIANT_SHARE * scores[0].gain <= score.gain <= (1.0 - ALIKE) * last[name])
        else:
            is_wanted = len(used) < count
        if is_wanted and score.gain >= least:
            last[name] = score.gain
            used[name] += 1
            chosen.append(score)
    return chosen


Trial = tuple[Score, Sequence[Array]]
"""A candidate and its starts."""


def starts_of_each(scores: Sequence[Score]) -> list[Trial]:
    """All starts of each candidate; of the first two a smaller size of the same shape too."""
    trials: list[Trial] = []
    for number, score in enumerate(scores):
        starts = [score.start, *score.others]
        if number < 2 and not score.others:
            size = score.effect.size
            second = score.start.copy()
            second[0] = size.to_unit(0.4 * size.from_unit(float(second[0])))
            starts.append(second)
        trials.append((score, starts))
    return trials


MAX_PAIRS = 4
"""Largest number of pairs that are refitted. Chosen for cost."""


def best_pairs(base: Fit, usable: Sequence[Signature],
               least: float) -> list[tuple[Candidate, Array]]:
    """The best pairs of effects that promise more than `least`, with starts of their refits."""
    # One size of every straight effect, and all sizes of the others.
    shapes: dict[tuple[object, ...], Signature] = {}
    for one in usable:
        if one.length > 1e-9 and one.size != 0.0:
            shapes.setdefault((one.shape, one.amplitude_dependent and one.size), one)
    signatures = list(shapes.values())
    if not signatures:
        return []
    reaches = np.array([reach_of(signature) for signature in signatures])
    stack = np.column_stack([signature.white for signature in signatures])
    gains, *factors = _pair_gains(stack, -(stack.T @ base.whitened), reaches)
    pairs: dict[frozenset[str], tuple[Candidate, Array]] = {}
    for flat in np.argsort(-gains, axis=None):
        place = divmod(int(flat), len(signatures))
        if len(pairs) == MAX_PAIRS or not gains[place] > least:
            break
        both = [signatures[index] for index in place]
        ids = frozenset(one.effect.id for one in both)
        if ids in pairs or both[0].effect.overlaps(both[1].effect):
            continue
        start = np.concatenate([base.theta_unit, *(
            [_size_unit(one, float(factor[place])), *one.theta_unit[1:]]
            for one, factor in zip(both, factors, strict=True))])
        pairs[ids] = Candidate(tuple((one.effect, one.variant) for one in both)), start
    return list(pairs.values())


def _pair_gains(stack: Array, products: Array, reach: Array) -> tuple[Array, Array, Array]:
    """Fall of the misfit by every pair of columns (K, K), and the factors of both columns.

    products (K,): columns times the residual; reach (K, 2): bounds of the factor of a column. The
    best factors are free, or one of them is at a bound and the other is the best beside it.
    """
    gram = stack.T @ stack
    own = np.maximum(np.diag(gram), 1e-300)[:, None]
    aim = products[:, None]
    low, high = (np.broadcast_to(bound[:, None], gram.shape) for bound in reach.T)

    def best_beside(factor: Array) -> Array:
        """The best factor of the column of a row, beside factors of the other column."""
        return np.asarray(np.clip((aim - gram * factor) / own, low, high))

    determinant = np.maximum(own * own.T - gram**2, 1e-9 * own * own.T)
    free = np.clip((aim * own.T - gram * aim.T) / determinant, low, high)
    firsts = [free, low, high, best_beside(low.T), best_beside(high.T)]
    pairs = [(first, best_beside(first.T).T) for first in firsts]
    gains = np.stack([
        2.0 * first * aim - first**2 * own + 2.0 * second * aim.T - second**2 * own.T
        - 2.0 * first * second * gram
        for first, second in pairs])
    best = gains.argmax(axis=0)[None]
    first, second = (np.stack(factors) for factors in zip(*pairs, strict=True))
    gain, factor, other = (np.take_along_axis(one, best, 0)[0] for one in (gains, first, second))
    return gain, factor, other
