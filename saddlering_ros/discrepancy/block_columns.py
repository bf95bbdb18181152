"""Stacked columns that are zero outside a few channels of a few runs, and their products.

A column of the tests on residuals belongs to one channel of one run, or to the same few channels
of every run. Full arrays of such columns would hold channels times runs times samples numbers.
This module stores only the blocks that are not zero, and forms only small products.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.discrepancy.metric import Metric
from saddlering_ros.discrepancy.system import Array

Index = NDArray[np.intp]


@dataclass(frozen=True)
class Block:
    """Columns `index` (k,) in one channel of one run: `plain` (N, k).

    `slot`: index in `Experiment.slices`.
    """

    slot: int
    index: Index
    plain: Array


class BlockColumns:
    """Columns (n, m) as blocks, whitened once; several blocks may share a column."""

    def __init__(self, metric: Metric, blocks: Sequence[Block], count: int) -> None:
        self._metric, self.blocks, self.count = metric, tuple(blocks), count
        self._white = [metric.whiteners[item.slot].whiten(item.plain) for item in self.blocks]

    @cached_property
    def gram(self) -> Array:
        """Products (m, m) of the whitened columns, nuisance parameters marginalised."""
        total = np.zeros((self.count, self.count))
        for item, white in zip(self.blocks, self._white, strict=True):
            total[np.ix_(item.index, item.index)] += white.T @ white
        shrink = self._metric.shared.shrink
        return np.asarray(total - (self._along * (2.0 * shrink - shrink**2)) @ self._along.T)

    def products(self, columns: Array) -> Array:
        """Products (m, B) or (m,) with whitened stacked columns (n, B) or (n,)."""
        flat = columns[:, None] if columns.ndim == 1 else columns
        seen = self._metric.shared.shrink[:, None] * (self._metric.shared.directions.T @ flat)
        answer = self._noise_products(flat) - self._along @ seen
        return answer[:, 0] if columns.ndim == 1 else answer

    def combined(self, weights: Array) -> Array:
        """The plain columns times `weights` (m,): stacked (n,)."""
        total = np.zeros(self._metric.experiment.size)
        for item in self.blocks:
            part = self._metric.experiment.slices[item.slot][2]
            total[part] += item.plain @ weights[item.index]
        return total

    @cached_property
    def _along(self) -> Array:
        """Products (m, K) with the directions of the nuisance parameters."""
        return self._noise_products(self._metric.shared.directions)

    def _noise_products(self, columns: Array) -> Array:
        """Products (m, B) of the columns whitened by noise alone with stacked columns (n, B)."""
        total = np.zeros((self.count, columns.shape[1]))
        for item, white in zip(self.blocks, self._white, strict=True):
            part = self._metric.experiment.slices[item.slot][2]
            total[item.index] += white.T @ columns[part]
        return total
