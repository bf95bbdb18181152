"""Families fitted, regularised by leave-one-run-out, compared, and tested like a cause."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from saddlering_ros.discrepancy.proposal.blocks import ShapeFamily
from saddlering_ros.discrepancy.proposal.misfit import Misfit
from saddlering_ros.discrepancy.system import Array
from saddlering_ros.estimation.statistics import fisher_chance

STRENGTHS = np.geomspace(1e-6, 1e4, 11)
"""Strengths of the regularisation, in shares of the size of the columns."""

FOLDS = 5
"""Parts of a single run that are held out in turn."""

MIN_RIDGE = 1e-9


@dataclass(frozen=True)
class BlockFit:
    """One family added to one target: coefficients, and explained part of the whitened misfit.

    predicted: explained misfit of runs held out in turn, negative if the family predicts
    nothing. freedom: effective number of parameters.
    """

    target: str
    block: ShapeFamily
    coefficients: Array
    covariance: Array
    taken: float
    predicted: float
    freedom: float
    strength: float
    white: Array
    """Whitened columns (n, k)."""

    def p_value(self, degrees: int, trials: int) -> float:
        """Chance that noise alone gives one of `trials` families as much."""
        each = fisher_chance(max(self.taken, 0.0) / self.freedom, self.freedom, degrees)
        return min(1.0, trials * float(each))


def fit_block(misfit: Misfit, target: str, block: ShapeFamily, wanted: Array) -> BlockFit:
    """`block` on `target`, fitted to a whitened residual `wanted` (n,)."""
    white = misfit.columns(target, block.shapes)
    folds = _folds(misfit)
    gram, slope = white.T @ white, white.T @ wanted
    unit = float(np.trace(gram)) / max(float(np.trace(block.penalty)), 1e-300)
    parts = [(white[rows].T @ white[rows], white[rows].T @ wanted[rows]) for rows in folds]
    best, chosen = -np.inf, float(STRENGTHS[-1])
    for strength in STRENGTHS:
        penalty = _penalty(block, strength * unit, gram)
        predicted = 0.0
        for rows, (own_gram, own_slope) in zip(folds, parts, strict=True):
            found = _solve(block, gram - own_gram, slope - own_slope, penalty)
            left = wanted[rows] - white[rows] @ found
            predicted += float(wanted[rows] @ wanted[rows] - left @ left)
        if predicted > best:
            best, chosen = predicted, float(strength)
    penalty = _penalty(block, chosen * unit, gram)
    coefficients = _solve(block, gram, slope, penalty)
    left = wanted - white @ coefficients
    inverse = np.linalg.pinv(gram + penalty, hermitian=True)
    freedom = float(np.trace(inverse @ gram))
    if block.non_negative:
        freedom = min(freedom, 1.0 + float(np.count_nonzero(coefficients)))
    return BlockFit(
        target=target, block=block, coefficients=coefficients, covariance=inverse,
        taken=float(wanted @ wanted - left @ left), predicted=best, freedom=max(freedom, 1.0),
        strength=chosen, white=white)


def rank_blocks(
    misfit: Misfit, blocks: Sequence[ShapeFamily], targets: Sequence[str], wanted: Array
) -> list[BlockFit]:
    """Every family on every target, the one that predicts most first."""
    fits = [fit_block(misfit, target, block, wanted) for block in blocks for target in targets]
    return sorted(fits, key=lambda fit: -fit.predicted)


def _folds(misfit: Misfit) -> list[NDArray[np.int64]]:
    """Rows that are held out in turn: runs, or parts of a single run."""
    if len(misfit.runs) > 1:
        return [np.arange(rows.start, rows.stop) for rows in misfit.rows]
    run = misfit.runs[0]
    part = np.arange(run.samples) * FOLDS // run.samples
    stacked = np.tile(part, run.residual.shape[0])
    return [np.flatnonzero(stacked == number) for number in range(FOLDS)]


def _penalty(block: ShapeFamily, strength: float, gram: Array) -> Array:
    ridge = MIN_RIDGE * float(np.trace(gram)) / gram.shape[0] + 1e-300
    return np.asarray(strength * block.penalty + ridge * np.eye(gram.shape[0]))


def _solve(block: ShapeFamily, gram: Array, slope: Array, penalty: Array) -> Array:
    """Penalised least squares, with coefficients of one sign if the family requires it."""
    matrix = gram + penalty
    if not block.non_negative:
        return np.asarray(np.linalg.solve(matrix, slope))
    values, vectors = np.linalg.eigh(matrix)
    kept = values > 1e-12 * values[-1]
    root = np.sqrt(values[kept])[:, None] * vectors[:, kept].T
    target = (vectors[:, kept].T @ slope) / np.sqrt(values[kept])
    sides = []
    for sign in (1.0, -1.0):
        found, left = nnls(root, sign * target)
        sides.append((left, sign * found))
    return np.asarray(min(sides, key=lambda item: item[0])[1])
