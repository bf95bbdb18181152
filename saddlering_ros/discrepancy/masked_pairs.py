"""Pairs of effects that mask each other: together they explain what neither explains alone.

A lower row that is softer and a probe that reads too much move the same channel in opposite
directions. Each effect alone leaves almost the whole misfit, so that a search of one effect after
another finds neither. All pairs of signatures are therefore compared to first order, which costs
no simulation, and the best pairs are refitted if they promise more than the model found.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from saddlering_ros.discrepancy import criteria
from saddlering_ros.discrepancy.candidate import Candidate, Fit
from saddlering_ros.discrepancy.model_space import ModelSpace
from saddlering_ros.discrepancy.ranking import reach_of
from saddlering_ros.discrepancy.refit import refit, run_refits
from saddlering_ros.discrepancy.results import SearchLog
from saddlering_ros.discrepancy.signatures import Signature
from saddlering_ros.discrepancy.system import Array

MAX_PAIRS = 4
"""Largest number of pairs that are refitted."""


@dataclass(frozen=True)
class _Pair:
    """Two signatures, their factors, and the fall of the misfit to first order."""

    signatures: tuple[Signature, Signature]
    factors: tuple[float, float]
    gain: float


def masked_pair(space: ModelSpace, fit: Fit, log: SearchLog) -> Fit:
    """Two effects that explain surely more than a `fit` of at most one effect; else `fit`."""
    if len(fit.candidate.effects) > 1:
        return fit
    least = space.base.misfit - fit.misfit + space.real_gain * (2 - len(fit.candidate.effects))
    pairs = [pair for pair in _best_pairs(space) if pair.gain > least]
    if not pairs:
        return fit
    found = run_refits(
        space.metric,
        [
            refit(space.metric, candidate, start, rounds=space.settings.rounds,
                  full_jacobian=True)
            for candidate, start in (_start(space.base, pair) for pair in pairs)
        ],
        space.watch.check,
    )
    log.candidates += [space.compare(space.base, item).evidence(1) for item in found]
    best = min(found, key=space.penalised)
    return space.keep(best) if _is_better(space, fit, best) else fit


def _is_better(space: ModelSpace, fit: Fit, pair: Fit) -> bool:
    """Whether a pair is real beside a `fit` of at most one effect, with all pairs counted."""
    extra = max(1, pair.theta_unit.size - fit.theta_unit.size)
    trials = space.trials if fit.candidate.effects else space.trials**2 // 2
    p_value = criteria.likelihood_ratio_test(
        fit.misfit - pair.misfit, extra, space.known.pairs, trials)
    return p_value < space.settings.error_rate and space.penalised(pair) < space.penalised(fit)


def _start(base: Fit, pair: _Pair) -> tuple[Candidate, Array]:
    """The model of a pair, and the parameters at which its refit begins."""
    candidate, parts = Candidate(), [base.theta_unit]
    for item, factor in zip(pair.signatures, pair.factors, strict=True):
        candidate = candidate.plus(item.effect, item.variant)
        size = item.effect.size.to_unit(item.effect.neutral + factor * item.size)
        parts.append(np.array([np.clip(size, 1e-3, 1.0 - 1e-3), *item.theta_unit[1:]]))
    return candidate, np.concatenate(parts)


def _best_pairs(space: ModelSpace) -> list[_Pair]:
    """The best pair of shapes of each pair of effects, those with the largest gain."""
    items = _one_of_each_shape(space.usable)
    if not items:
        return []
    stack = np.column_stack([item.white for item in items])
    gains, first, second = _pair_gains(
        stack, -(stack.T @ space.base.whitened), np.array([reach_of(item) for item in items]))
    names = np.array([item.effect.id for item in items])
    gains[names[:, None] == names] = -np.inf
    found: dict[frozenset[str], _Pair] = {}
    for flat in np.argsort(-gains, axis=None):
        row, column = divmod(int(flat), len(items))
        if len(found) == MAX_PAIRS or not np.isfinite(gains[row, column]):
            break
        pair = _Pair(
            (items[row], items[column]),
            (float(first[row, column]), float(second[row, column])),
            float(gains[row, column]),
        )
        found.setdefault(frozenset((names[row], names[column])), pair)
    return list(found.values())


def _one_of_each_shape(signatures: Sequence[Signature]) -> list[Signature]:
    """Signatures with one size of every straight effect, and all sizes of the others."""
    found: dict[tuple[object, ...], Signature] = {}
    for item in signatures:
        if item.length > 1e-9 and item.size != 0.0:
            key = (*item.shape, item.size) if item.amplitude_dependent else item.shape
            found.setdefault(key, item)
    return list(found.values())


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
        for first, second in pairs
    ])
    best = gains.argmax(axis=0)[None]
    first, second = (np.stack(item) for item in zip(*pairs, strict=True))
    return (
        np.take_along_axis(gains, best, 0)[0],
        np.take_along_axis(first, best, 0)[0],
        np.take_along_axis(second, best, 0)[0],
    )
