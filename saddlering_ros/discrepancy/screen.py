"""Signatures: what each effect would do to the data, freed of what the base parameters can do.

A signature's angle to another is what tells two causes apart; its length over the noise is what
can be detected; the share left after the base parameters took theirs says whether it shows at all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.stats import f as fisher

from saddlering_ros.discrepancy.likelihood import Likelihood
from saddlering_ros.discrepancy.refit import Candidate, Fit, Tangent
from saddlering_ros.discrepancy.system import Array, Effect, Point

#: An effect of which less than this share is left beside the base parameters cannot be tested.
LEAST_SHARE = 0.02
#: A change shorter than this, in standard deviations before the projection, does not show.
LEAST_LENGTH = 1.0
#: A start of another shape is tried too if it promises this share of the best one's gain.
OTHER_SHARE = 0.3
MOST_OTHERS = 2
#: Shapes nearer than this, in shares of their range, are one.
LEAST_APART = 0.05
#: Signatures of two sizes less parallel than this (cosine) differ in shape: the effect is bent.
LEAST_STRAIGHT = 0.9
#: A start is scaled by so much at most: what is straight, and what is bent.
STRAIGHT_REACH, BENT_REACH = (-5.0, 5.0), (0.7, 1.4)
#: A bent effect starts at the size that was seen if that takes so much of what its shape could.
SEEN_ENOUGH = 0.5
#: A bent effect is looked at in ever smaller sizes, each this share of the last, while it stands
#: out by more than this many standard deviations, so many times at most.
SMALLER, STANDS_OUT, MOST_SMALLER = 0.3, 12.0, 4
#: A change of less than this share of what is wanted is none.
NOTHING = 1e-3
#: So many simulations are asked for at once.
BATCH = 64
#: Normal quantile of 0.9: found nine times in ten.
POWER_QUANTILE = 1.2816


@dataclass(frozen=True)
class Signature:
    """Change that one effect at one start makes, at `places` of its parameters.

    plain (n,) as it is measured; white (n,): whitened, with what base parameters take off.
    bent: its shape depends on its size, as with thresholds and frequencies; so what was seen at
    one size promises nothing of another.
    """

    effect: Effect
    variant: int
    places: Array
    size: float
    plain: Array
    white: Array
    share: float
    length: float
    visible: float
    bent: bool = False

    @property
    def key(self) -> tuple[str, int]:
        return self.effect.id, self.variant

    @property
    def shape(self) -> tuple[object, ...]:
        """The same for signatures that differ in size only."""
        return (*self.key, *np.round(self.places[1:], 6))


@dataclass(frozen=True)
class Score:
    """How much of the misfit one candidate would explain, to first order, and from where.

    `others`: starts of another shape that promise more than OTHER_SHARE of it; `bent`: as of its
    signature.
    """

    effect: Effect
    variant: int
    gain: float
    start: Array
    others: tuple[Array, ...] = ()
    bent: bool = False


@dataclass(frozen=True)
class Place:
    """Detection and materiality limit of an effect that acts in one way: which probe, which arc.

    `values`: its fixed values and the parameters that shape it, in their units.
    """

    values: Mapping[str, float]
    limit: float
    material_limit: float


@dataclass(frozen=True)
class Detectability:
    """What these data could have shown of one effect.

    limit: smallest size found nine times in ten at the given error rate, in nine of ten of the
    `places` tried at which it can be found at all (inf: none can); best_limit: at the best place;
    material_limit: smallest size that changes a view by the stated share of its range, likewise.
    Of either sign, the one that shows less. Of an effect whose size is not 0 where it does nothing
    (a limit of a span) all are values of it, not distances from there.
    """

    effect: str
    share: float
    limit: float
    best_limit: float
    material_limit: float
    unit: str
    testable: bool
    places: tuple[Place, ...] = ()


def effect_starts(effect: Effect) -> list[Array]:
    """First guesses of an effect's parameters, bound-scaled."""
    if effect.starts:
        return [
            np.array(
                [
                    item.to_unit(start[item.name])
                    if item.name in start
                    else 0.5
                    if item.start is None
                    else item.to_unit(item.start)
                    for item in effect.parameters
                ]
            )
            for start in effect.starts
        ]
    shape = [
        0.5 if item.start is None else item.to_unit(item.start) for item in effect.parameters[1:]
    ]
    reach = max(abs(effect.size.high), abs(effect.size.low))
    return [
        np.array([effect.size.to_unit(min(effect.size.high, part * reach)), *shape])
        for part in (0.03, 0.15, 0.6)
    ]


def measure_signatures(
    likelihood: Likelihood,
    fit: Fit,
    base: Tangent,
    scale: PlainScale,
) -> list[Signature]:
    """Signatures of every effect, variant and start at the base fit, of bent ones in small too."""
    places: list[tuple[Effect, int, Array]] = [
        (effect, variant, start)
        for effect in likelihood.system.effects
        if not effect.line
        for variant in range(len(effect.variants))
        for start in effect_starts(effect)
    ]
    orthogonal = orthonormal(base.white)
    found: list[Signature] = []
    for _ in range(1 + MOST_SMALLER):
        for begin in range(0, len(places), BATCH):
            found += _measured(likelihood, fit, orthogonal, scale, places[begin : begin + BATCH])
        found = _with_bends(found)
        places = _smaller(found)
    return found


def _measured(
    likelihood: Likelihood,
    fit: Fit,
    orthogonal: Array,
    scale: PlainScale,
    places: Sequence[tuple[Effect, int, Array]],
) -> list[Signature]:
    """Signatures of effects in one variant at one place each."""
    parameters = likelihood.system.base_parameters
    points: list[Point] = [
        Candidate(((effect, variant),)).point(parameters, np.concatenate([fit.place, place]))
        for effect, variant, place in places
    ]
    part = likelihood.predict(points) - fit.prediction[:, None]
    left, lengths, shares = _beyond(likelihood, part, orthogonal)
    return [
        Signature(
            effect,
            variant,
            place,
            effect.size.from_unit(float(place[0])) - effect.neutral,
            part[:, column],
            left[:, column],
            float(shares[column]),
            float(lengths[column]),
            scale.beyond_base(part[:, column]),
        )
        for column, (effect, variant, place) in enumerate(places)
    ]


def _smaller(signatures: Sequence[Signature]) -> list[tuple[Effect, int, Array]]:
    """Places where bent effects do less, for those that at their least still stand far out.

    What friction does that never turns round says little of one a tenth as strong, which does; and
    between a limit that cuts much and one that cuts nothing lies one that cuts a little.
    """
    sides: dict[tuple[str, int, bool], list[Signature]] = {}
    for item in signatures:
        if item.bent:
            sides.setdefault((*item.key, item.size > 0.0), []).append(item)
    places = []
    for members in sides.values():
        members.sort(key=lambda item: abs(item.size))
        least = members[0]
        if least.effect.neutral == 0.0 and least.length > STANDS_OUT:
            size = least.effect.size.to_unit(SMALLER * least.size)
            places.append((least.effect, least.variant, np.array([size, *least.places[1:]])))
        if least.effect.neutral != 0.0:
            for one, other in pairwise(members):
                low, high = sorted((one.length, other.length))
                if low < LEAST_LENGTH and high > STANDS_OUT:
                    places.append((one.effect, one.variant, 0.5 * (one.places + other.places)))
    return places


def whitened_anew(
    likelihood: Likelihood, signatures: Sequence[Signature], base: Tangent
) -> list[Signature]:
    """The same signatures in the metric of today."""
    orthogonal = orthonormal(base.white)
    answers: list[Signature] = []
    for begin in range(0, len(signatures), BATCH):
        items = signatures[begin : begin + BATCH]
        part = np.column_stack([item.plain for item in items])
        left, lengths, shares = _beyond(likelihood, part, orthogonal)
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


def _beyond(
    likelihood: Likelihood, changes: Array, orthogonal: Array
) -> tuple[Array, Array, Array]:
    """Changes (n, B) whitened, beyond base parameters; their lengths and shares left."""
    white = likelihood.whiten(changes)
    whole = np.sqrt((likelihood.whiten_plain(changes) ** 2).sum(axis=0))
    left = white - orthogonal @ (orthogonal.T @ white)
    lengths = np.linalg.norm(left, axis=0)
    return left, lengths, lengths / np.maximum(whole, 1e-300)


def _with_bends(signatures: Sequence[Signature]) -> list[Signature]:
    """The same signatures, each told whether sizes of its shape differ in more than height."""
    shapes: dict[tuple[object, ...], list[Signature]] = {}
    for item in signatures:
        shapes.setdefault(item.shape, []).append(item)
    bent: dict[tuple[object, ...], bool] = {}
    for key, members in shapes.items():
        shown = [item for item in members if item.length > LEAST_LENGTH]
        shown.sort(key=lambda item: item.size)
        signs = {item.size > 0.0 for item in shown}
        straight = [
            abs(float(one.white @ other.white)) / (one.length * other.length)
            for sign in signs
            for one, other in pairwise([item for item in shown if (item.size > 0.0) is sign])
        ]
        found = min(straight, default=1.0) < LEAST_STRAIGHT
        bent[key[:2]] = bent.get(key[:2], False) or found
    return [replace(item, bent=bent[item.key]) for item in signatures]


def visible_gains(
    likelihood: Likelihood, less: Array, more: Array, ranges: Mapping[str, float]
) -> dict[str, Array]:
    """Fall of the rms residual between two predictions (n,): per view one number per run.

    Taken in quadrature, as a share of the view's range, after the nuisances took what they can of
    either: what is beyond a sound system's own small errors.
    """
    measured = likelihood.measured()
    less, more = (
        measured + likelihood.without_nuisances(item - measured) for item in (less, more)
    )
    falls: dict[str, Array] = {}
    for view in likelihood.system.views:
        seen = zip(
            likelihood.runs,
            likelihood.view_residuals(less - measured, view),
            likelihood.view_residuals(more - measured, view),
            strict=True,
        )
        powers = [
            float(np.average(before**2 - after**2, weights=run.width))
            for run, before, after in seen
        ]
        falls[view] = np.sqrt(np.maximum(powers, 0.0)) / ranges[view]
    return falls


class PlainScale:
    """How large a change is as a share of range, noise and nuisances apart.

    What the base parameters, moved to the least rms over all runs and views, make of a change is
    taken off first: it is no misfit.
    """

    def __init__(
        self, likelihood: Likelihood, ranges: Mapping[str, float], base_plain: Array
    ) -> None:
        self._likelihood, self._ranges = likelihood, ranges
        self._base = orthonormal(
            np.column_stack([np.concatenate(self._seen(column)) for column in base_plain.T])
        )

    def beyond_base(self, change: Array) -> float:
        """Largest rms over runs and views of a stacked change (n,), as a share of range."""
        return max(float(sizes.max()) for sizes in self.by_run(change).values())

    def by_run(self, change: Array) -> dict[str, Array]:
        """Rms of a stacked change (n,) as a share of range: per view one number per run."""
        parts = self._seen(change)
        joined = np.concatenate(parts)
        left = joined - self._base @ (self._base.T @ joined)
        edges = np.cumsum([part.size for part in parts])[:-1]
        sizes = np.array([np.linalg.norm(part) for part in np.split(left, edges)])
        views = self._likelihood.system.views
        return dict(zip(views, sizes.reshape(len(views), -1), strict=True))

    def _seen(self, change: Array) -> list[Array]:
        """One part per view and run, its squares adding up to the mean square share of range."""
        likelihood = self._likelihood
        return [
            seen * np.sqrt(run.width / run.width.sum()) / self._ranges[view]
            for view in likelihood.system.views
            for run, seen in zip(
                likelihood.runs, likelihood.view_residuals(change, view), strict=True
            )
        ]


def orthonormal(columns: Array) -> Array:
    """Orthonormal basis of columns, by a Gram matrix with its weak directions left out."""
    scale = np.sqrt((columns**2).sum(axis=0))
    scaled = columns / np.where(scale > 0.0, scale, 1.0)
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    kept = values > 1e-10 * max(float(values[-1]), 1e-300)
    return np.asarray(scaled @ (vectors[:, kept] / np.sqrt(values[kept])))


def rank(
    fit: Fit,
    white_columns: Array,
    signatures: Sequence[Signature],
    skip: Sequence[str] = (),
) -> list[Score]:
    """Candidates by how much of the fit's misfit their signature takes, best start of each."""
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
        neutral = item.effect.neutral
        low, high = sorted(
            (
                (item.effect.size.low - neutral) / item.size,
                (item.effect.size.high - neutral) / item.size,
            )
        )
        least, most = BENT_REACH if item.bent else STRAIGHT_REACH
        if neutral != 0.0:
            least = most = 1.0
        factor = float(np.clip(product / squared, max(low, least), min(high, most)))
        gain = float(2.0 * factor * product - factor**2 * squared)
        if item.bent:
            # Of another size it takes another shape, none knows which: what this one could take at
            # its best height counts, or an effect seen too large would never be tried.
            gain = float(max(product, 0.0) ** 2 / squared)
            if 2.0 * product - squared > SEEN_ENOUGH * gain:
                factor = 1.0
        start = item.places.copy()
        start[0] = np.clip(
            item.effect.size.to_unit(neutral + item.size * factor), 1e-3, 1.0 - 1e-3
        )
        found.setdefault(item.key, []).append((gain, item, start))
    scores = []
    for members in found.values():
        gain, item, start = max(members, key=lambda member: member[0])
        others = _other_shapes(members, start, OTHER_SHARE * gain)
        scores.append(Score(item.effect, item.variant, gain, start, others, item.bent))
    return sorted(scores, key=lambda score: -score.gain)


def best_of_each(scores: Sequence[Score]) -> list[Score]:
    """The first score of each effect, in their order."""
    best: dict[str, Score] = {}
    for score in scores:
        best.setdefault(score.effect.id, score)
    return list(best.values())


def _other_shapes(
    members: Sequence[tuple[float, Signature, Array]], start: Array, least: float
) -> tuple[Array, ...]:
    """Starts that differ from `start` and each other in shape, most promising first.

    Of a bent effect the size is part of the shape.
    """
    kept = [start]
    first = 0 if members[0][1].bent else 1
    for gain, _, other in sorted(members, key=lambda member: -member[0]):
        apart = all(
            np.abs(other[first:] - item[first:]).max(initial=0.0) > LEAST_APART for item in kept
        )
        if gain > least and apart and len(kept) <= MOST_OTHERS:
            kept.append(other)
    return tuple(kept[1:])


def testable_share(members: Sequence[Signature]) -> float:
    """Share of an effect's signature that base parameters leave, of its best variant.

    Taken at the smallest size that shows: at larger ones the base parameters' own curvature would
    pass for something left.
    """
    best = 0.0
    for variant in {item.variant for item in members}:
        own = [item for item in members if item.variant == variant]
        shown = [item for item in own if item.length > LEAST_LENGTH * item.share] or own
        smallest = min(abs(item.size) for item in shown)
        best = max(best, *(item.share for item in shown if abs(item.size) <= smallest))
    return best


def shapes_tried(signatures: Sequence[Signature]) -> int:
    """How many signatures differ in more than size: what a name is drawn from."""
    return len({item.shape for item in signatures})


def testable(signatures: Sequence[Signature]) -> list[Signature]:
    """Signatures of the effects that these data can test at all."""
    effects: dict[str, list[Signature]] = {}
    for item in signatures:
        effects.setdefault(item.effect.id, []).append(item)
    return [
        item
        for members in effects.values()
        if testable_share(members) >= LEAST_SHARE
        for item in members
    ]


def detectability(
    signatures: Sequence[Signature],
    error_rate: float,
    materiality: float,
    pairs: int,
) -> list[Detectability]:
    """What can be found of each effect, and what shows, wherever it acts.

    By the test that a candidate has to pass: with the shapes it was drawn from, the parameters it
    brings, and the noise known from `pairs` independent differences.
    """
    effects: dict[str, list[Signature]] = {}
    for item in signatures:
        effects.setdefault(item.effect.id, []).append(item)
    rate = error_rate / max(shapes_tried(signatures), 1)
    answers = []
    for name, members in effects.items():
        effect = members[0].effect
        extra = len(effect.parameters)
        needed = float(np.sqrt(extra * fisher.isf(rate, extra, pairs))) + POWER_QUANTILE
        share = testable_share(members)
        reach = max(
            abs(effect.size.low - effect.neutral), abs(effect.size.high - effect.neutral)
        )
        shapes: dict[tuple[object, ...], list[Signature]] = {}
        for item in members:
            shapes.setdefault(item.shape, []).append(item)
        places = [_limits_at(own, needed, materiality, reach) for own in shapes.values()]
        limit = _nine_in_ten([place.limit for place in places])
        answers.append(
            Detectability(
                name,
                share,
                _value(effect, limit),
                _value(effect, min(place.limit for place in places)),
                _value(effect, _nine_in_ten([place.material_limit for place in places])),
                effect.size.unit,
                share >= LEAST_SHARE and bool(np.isfinite(limit)),
                tuple(_as_values(effect, place) for place in places),
            )
        )
    return answers


def _as_values(effect: Effect, place: Place) -> Place:
    """A place whose limits are distances from where the effect does nothing, as sizes."""
    return replace(
        place,
        limit=_value(effect, place.limit),
        material_limit=_value(effect, place.material_limit),
    )


def _value(effect: Effect, distance: float) -> float:
    """The size at that distance from where the effect does nothing; inf stays."""
    if effect.neutral == 0.0 or not np.isfinite(distance):
        return distance
    sign = 1.0 if effect.neutral < 0.5 * (effect.size.low + effect.size.high) else -1.0
    return effect.neutral + sign * distance


def _limits_at(
    members: Sequence[Signature], needed: float, materiality: float, reach: float
) -> Place:
    """Limits in one variant and shape, whose sizes go to `reach`; of the sign that shows less."""
    effect, shape = members[0].effect, members[0].places[1:]
    values = {
        item.name: item.from_unit(float(u))
        for item, u in zip(effect.parameters[1:], shape, strict=True)
    }
    values.update(effect.variants[members[0].variant])
    signs = {np.sign(item.size) for item in members} - {0.0}
    limit = material = 0.0 if signs else np.inf
    for sign in signs:
        own = [item for item in members if np.sign(item.size) == sign]
        limit = max(limit, _size_at([(abs(item.size), item.length) for item in own], needed))
        material = max(
            material, _size_at([(abs(item.size), item.visible) for item in own], materiality)
        )
    return Place(
        values, limit if limit <= reach else np.inf, material if material <= reach else np.inf
    )


def _nine_in_ten(limits: Sequence[float]) -> float:
    """The size that is enough in nine of ten of the places where any is; inf if none is."""
    finite = [item for item in limits if np.isfinite(item)]
    return float(np.quantile(finite, 0.9, method='higher')) if finite else float(np.inf)


def _size_at(heights: Sequence[tuple[float, float]], wanted: float) -> float:
    """Size at which a growing height reaches `wanted`, from (size > 0, height) pairs.

    In proportion below the least size and beyond the largest, log-log between; where a size does
    nothing and the next more than enough, that next one.
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


def angle_matrix(signatures: Sequence[Signature]) -> tuple[list[str], Array]:
    """Labels (effect:variant) and absolute cosines between signatures, longest of each."""
    chosen: dict[tuple[str, int], Signature] = {}
    for item in signatures:
        if item.key not in chosen or item.length > chosen[item.key].length:
            chosen[item.key] = item
    kept = [item for item in chosen.values() if item.length > 1e-9 and item.share >= LEAST_SHARE]
    if not kept:
        return [], np.zeros((0, 0))
    stack = np.column_stack([item.white / item.length for item in kept])
    labels = [
        item.effect.id if len(item.effect.variants) == 1 else f'{item.effect.id}:{item.variant}'
        for item in kept
    ]
    return labels, np.abs(stack.T @ stack)
