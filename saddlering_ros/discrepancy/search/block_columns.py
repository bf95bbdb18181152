"""Columns that are zero in most channels and runs.

A column of a test or a law belongs to one channel of one run, or to few channels of every run.
Only the blocks that are not zero are stored, and only small products are formed.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.discrepancy.problem.metric import Metric
from saddlering_ros.discrepancy.problem.system import Array

Index = NDArray[np.intp]


@dataclass(frozen=True)
class Block:
    """Columns `index` (k,) in one channel of one run: `plain` (N, k).

    `slot`: index in `Problem.slices`.
    """

    slot: int
    index: Index
    plain: Array


class BlockColumns:
    """Columns (n, m) as blocks, whitened once; several blocks may share a column."""

    def __init__(self, metric: Metric, blocks: Sequence[Block], count: int) -> None:
        self._metric, self.blocks, self.count = metric, tuple(blocks), count
        self._white = [metric.whiteners[block.slot].whiten(block.plain) for block in self.blocks]

    @cached_property
    def gram(self) -> Array:
        """Products (m, m) of the whitened columns, nuisance parameters marginalised."""
        total = np.zeros((self.count, self.count))
        for block, white in zip(self.blocks, self._white, strict=True):
            total[np.ix_(block.index, block.index)] += white.T @ white
        shrink = self._metric.shared.shrink
        return np.asarray(total - (self._along * (2.0 * shrink - shrink**2)) @ self._along.T)

    def products(self, columns: Array) -> Array:
        """Products (m, B) or (m,) with whitened stacked columns (n, B) or (n,)."""
        flat = columns.reshape(columns.shape[0], -1)
        seen = self._metric.shared.shrink[:, None] * (self._metric.shared.directions.T @ flat)
        answer = self.noise_products(flat) - self._along @ seen
        return answer.reshape(self.count, *columns.shape[1:])

    def combined(self, weights: Array) -> Array:
        """The plain columns times `weights` (m,): stacked (n,)."""
        total = np.zeros(self._metric.problem.size)
        for block in self.blocks:
            part = self._metric.problem.slices[block.slot][2]
            total[part] += block.plain @ weights[block.index]
        return total

    def size_beyond_noise(self, view: str, root: Array, inner: Array, imitated: Array) -> float:
        """Largest rms share of range of a fit in a run, less what noise alone would leave.

        root (m, k): of the covariance of the fit; inner (k,): its whitened slopes; imitated
        (n, m): the part of the columns that the sensitivities of the model take.
        """
        problem, powers = self._metric.problem, [0.0]
        for number, run in enumerate(problem.runs):
            seen = np.zeros((run.time.size, self.count))
            for block in self.blocks:
                index, channel, part = problem.slices[block.slot]
                if index == number:
                    weight = problem.system.views[view][channel]
                    seen[:, block.index] += weight * block.plain
                    seen -= weight * imitated[part]
            fits = problem.freed(seen @ root, run, view)
            powers.append(problem.mean_square(fits @ inner, run, view)
                          - problem.mean_square(np.linalg.norm(fits, axis=1), run, view))
        return max(powers) ** 0.5 / problem.view_ranges[view]

    @cached_property
    def _along(self) -> Array:
        """Products (m, K) with the directions of the nuisance parameters."""
        return self.noise_products(self._metric.shared.directions)

    def noise_products(self, columns: Array) -> Array:
        """Products (m, B) of the columns whitened by noise alone with stacked columns (n, B)."""
        total = np.zeros((self.count, columns.shape[1]))
        for block, white in zip(self.blocks, self._white, strict=True):
            part = self._metric.problem.slices[block.slot][2]
            total[block.index] += white.T @ columns[part]
        return total
