"""The next measurement: of the possible runs, the one that best tells alternatives apart.

T-optimality (Atkinson and Fedorov, Biometrika 62 (1975) 57): the run with the largest whitened
distance between two predictions after the base parameters were refitted on old and new data.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from saddlering_ros.discrepancy.candidate import Candidate, Fit
from saddlering_ros.discrepancy.metric import Metric
from saddlering_ros.discrepancy.refit import neighbours, Tangent
from saddlering_ros.discrepancy.system import Array, RunBlocks


@dataclass(frozen=True)
class Proposal:
    """A run that could be made: a sentence to say, and the run with empty channels."""

    sentence: str
    run: RunBlocks


def choose_next(
    metric: Metric,
    known: Tangent,
    pairs: Sequence[tuple[Fit, Fit]],
    proposals: Sequence[Proposal],
) -> str | None:
    """Sentence of the best proposal: the largest smallest distance over all pairs."""
    if not proposals or not pairs:
        return None
    scored = [
        (min(separation(metric, known, pair, proposal.run) for pair in pairs), proposal)
        for proposal in proposals
    ]
    return max(scored, key=lambda item: item[0])[1].sentence


def separation(metric: Metric, known: Tangent, pair: tuple[Fit, Fit], run: RunBlocks) -> float:
    """Whitened distance of two fits on `run` and the old data, base parameters free."""
    system = metric.experiment.system
    base = system.base_parameters
    best, alternative = pair
    thetas, steps = neighbours(base, best.theta_unit[: len(base)], range(len(base)))
    empty = Candidate()
    points = [best.point, alternative.point]
    points += [empty.point(base, theta_unit) for theta_unit in thetas]
    answers = system.predict_many(run, points)
    channels = answers.shape[1]
    difference = answers[1] - answers[0]
    columns = (answers[3:] - answers[2:3]) / np.array(steps)[:, None, None]
    reference = metric.experiment.runs[0]
    white, sensitivity = [], []
    for channel in range(channels):
        noise = metric.noise[reference.name, channel].covariance(run.time, run.width)
        lower = cholesky(noise, lower=True)
        stack = np.column_stack(
            [difference[channel], columns[:, channel].T, np.ones(run.time.size)]
        )
        stack = solve_triangular(lower, stack, lower=True)
        level = stack[:, -1] / np.linalg.norm(stack[:, -1])
        stack = stack[:, :-1] - np.outer(level, level @ stack[:, :-1])
        white.append(stack[:, 0])
        sensitivity.append(stack[:, 1:])
    old = metric.whiten(alternative.prediction - best.prediction)
    joined = np.concatenate([old, *white])
    basis: Array = np.vstack([known.white[:, : len(base)], *sensitivity])
    gram = basis.T @ basis + np.eye(len(base))
    inner = basis.T @ joined
    return float(joined @ joined - inner @ np.linalg.solve(gram, inner))
