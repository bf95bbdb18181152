"""Common noise of two records, from the Allan variances of their sum and difference."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from saddlering_ros.estimation.allan import (
    allan_columns,
    allan_variances_of,
    averaged_counts,
    running_total,
)
from saddlering_ros.estimation.process import ChannelNoise

Array = NDArray[np.float64]

SLOW_TIMES = np.array([1.0, 2.0, 4.0, 8.0])
"""Possible time constants [s] of a common wander."""


def common_noise(
    first: Sequence[Array], second: Sequence[Array], weights: Sequence[float], step: float
) -> ChannelNoise:
    """Common noise of pairs of segments (n_i,) with samples every `step` [s].

    `weights`: of the pairs. Noise of one channel does not count. Segments of a few seconds
    hardly determine a slow time constant, so that each of SLOW_TIMES counts by its likelihood.
    """
    counts = np.array(averaged_counts(max(map(len, first))))
    pairs = np.array([[max(0, len(row) // count - 1) for count in counts] for row in first])
    seen = pairs.sum(axis=0) > 0
    counts, pairs = counts[seen], pairs[:, seen]
    share = np.asarray(weights)[:, None] * pairs
    share = share / share.sum(axis=0)
    kinds = (
        [a + b for a, b in zip(first, second, strict=True)],
        [a - b for a, b in zip(first, second, strict=True)], first, second,
    )
    of_sum, of_difference, own, other = (
        np.sum(share * _variances(kind, counts, pairs), axis=0) for kind in kinds)
    common, freedom = 0.25 * (of_sum - of_difference), pairs.sum(axis=0)
    error = np.maximum(np.sqrt((own * other + common**2) / freedom), 1e-300)
    columns = allan_columns(counts * step, SLOW_TIMES)
    amounts, likelihood = np.zeros((SLOW_TIMES.size, 2)), np.zeros(SLOW_TIMES.size)
    for place in range(SLOW_TIMES.size):
        design = columns[:, [0, 1 + place]] / error[:, None]
        amounts[place], misfit = nnls(design, common / error)
        likelihood[place] = -0.5 * misfit**2
    likelihood = np.exp(likelihood - likelihood.max())
    likelihood /= likelihood.sum()
    return ChannelNoise(float(likelihood @ amounts[:, 0]), likelihood * amounts[:, 1], 0.0,
                        int(freedom[0]), SLOW_TIMES)


def _variances(rows: Sequence[Array], counts: Array, pairs: Array) -> Array:
    """Allan variances (rows, counts); 0 where a row is too short."""
    answers = np.zeros(pairs.shape)
    lengths = np.array([len(row) for row in rows])
    for length in np.unique(lengths):
        alike = np.flatnonzero(lengths == length)
        totals = np.stack([running_total(rows[place]) for place in alike.tolist()])
        for column in np.flatnonzero(pairs[alike[0]]):
            answers[alike, column] = allan_variances_of(totals, int(counts[column]))
    return answers
