"""The fitted runs and their simulator, stacked into one vector.

The order of a stacked vector is runs, then channels, then samples.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np

from saddlering_ros.discrepancy.assumptions import Assumptions
from saddlering_ros.discrepancy.system import (
    Array,
    DiscrepancyError,
    Point,
    RunBlocks,
    System,
    SystemWithTangents,
)

EMPTY_VIEW = 0.1
"""A view is empty except for faults if its range is below this share of its neighbours' range."""
MIN_SHARED, MIN_SHARED_PART = 8, 0.1
"""Two runs share content if they share so many samples and this part of the shorter run."""
MIN_VIEW_SHARE = 0.2
"""Smallest range of a view, as a share of its neighbours' range."""


class Experiment:
    """Fitted runs and their simulator; `simulations` counts the points that were simulated."""

    def __init__(
        self,
        system: System,
        runs: Sequence[RunBlocks],
        assumptions: Assumptions | None = None,
    ) -> None:
        if not runs:
            raise DiscrepancyError('diagnose: every run is held out: leave at least one run to '
                                   'fit')
        self.system, self.runs = system, tuple(runs)
        self.assumptions = assumptions or Assumptions()
        self.simulations = 0

    @cached_property
    def size(self) -> int:
        """Length n of a stacked vector."""
        return sum(run.channels.size for run in self.runs)

    @cached_property
    def slices(self) -> tuple[tuple[int, int, slice], ...]:
        """(run index, channel, slice of the stacked vector)."""
        parts, start = [], 0
        for index, run in enumerate(self.runs):
            for channel in range(run.channels.shape[0]):
                parts.append((index, channel, slice(start, start + run.time.size)))
                start += run.time.size
        return tuple(parts)

    @cached_property
    def measured(self) -> Array:
        """All channels of all runs (n,)."""
        return np.concatenate([run.channels.ravel() for run in self.runs])

    @cached_property
    def channel_ranges(self) -> Array:
        """Largest range (C,) of each channel in any run."""
        count = len(self.system.channel_names)
        return np.array(
            [
                max(float(np.ptp(run.channels[channel])) for run in self.runs)
                for channel in range(count)
            ]
        )

    @cached_property
    def view_ranges(self) -> Mapping[str, float]:
        """Range that a misfit in each view is compared with."""
        return view_ranges(self.system, self.runs)

    def predict(self, points: Sequence[Point]) -> Array:
        """Stacked channels (n, B) at `points`."""
        self.simulations += len(points)
        parts = []
        for run in self.runs:
            batch = self.system.predict_many(run, points)
            if batch.shape != (len(points), *run.channels.shape):
                raise DiscrepancyError(f'simulator: wrong shape {batch.shape} for run {run.name}')
            parts.append(batch.reshape(len(points), -1))
        return np.ascontiguousarray(np.concatenate(parts, axis=1).T)

    def predict_neighbours(self, groups: Sequence[Sequence[Point]]) -> list[Array]:
        """Stacked channels (n, B) of each group: a point, and others a small step away.

        A system with tangents of its own computes the others from them; any other system
        simulates every point.
        """
        if not isinstance(self.system, SystemWithTangents):
            answers = self.predict([point for group in groups for point in group])
            ends = np.cumsum([len(group) for group in groups])
            return np.split(answers, ends[:-1], axis=1)
        self.simulations += sum(len(group) for group in groups)
        prepared = self.system.neighbourhood(groups)
        runs = [prepared.predict(run) for run in self.runs]
        return [
            np.concatenate([answer.reshape(len(answer), -1) for answer in parts], axis=1).T
            for parts in zip(*runs, strict=True)
        ]

    def by_run(self, stacked: Array) -> list[Array]:
        """A stacked vector (n,) or columns (n, B) as one (C, N) or (C, N, B) block per run."""
        blocks, start = [], 0
        for run in self.runs:
            part = stacked[start : start + run.channels.size]
            blocks.append(part.reshape(*run.channels.shape, *stacked.shape[1:]))
            start += run.channels.size
        return blocks

    def view_residuals(self, residual: Array, view: str) -> list[Array]:
        """Stacked residuals (n,) or (n, B) in one view, run by run.

        A mean that has no meaning is subtracted.
        """
        weights = self.system.views[view]
        return [
            self.freed(np.tensordot(weights, block, axes=1), run, view)
            for run, block in zip(self.runs, self.by_run(residual), strict=True)
        ]

    def freed(self, seen: Array, run: RunBlocks, view: str) -> Array:
        """Values of one view (N,) or (N, k), minus their mean if a constant is free."""
        channels = np.flatnonzero(self.system.views[view])
        if not any(self.assumptions.frees_constant(int(channel)) for channel in channels):
            return seen
        weights = sample_weights(self.system, run, view)
        return np.asarray(seen - weights @ seen / weights.sum())

    def root_weights(self, run: RunBlocks, view: str) -> Array:
        """Square roots (N,) of the weights of samples in a mean square over time."""
        weights = sample_weights(self.system, run, view)
        return np.asarray(np.sqrt(weights / weights.sum()))

    def mean_square(self, seen: Array, run: RunBlocks, view: str) -> float:
        """Mean square over time of the values (N,) of a view, without missing samples."""
        return float(np.average(seen**2, weights=sample_weights(self.system, run, view)))


def refuse_repeats(runs: Sequence[RunBlocks]) -> None:
    """Refuse the same name or the same content twice: no run is both fitted and held out."""
    for number, run in enumerate(runs):
        for other in runs[:number]:
            if _shares_content(run.channels, other.channels):
                same = run.channels.shape == other.channels.shape
                what = 'one is held out' if run.held_out != other.held_out else 'it counts once'
                raise DiscrepancyError(
                    f'runs {other.name} and {run.name} '
                    f'{"are the same recording" if same else "share a part of a recording"}: '
                    f'give it once ({what})'
                )
            if run.name == other.name:
                raise DiscrepancyError(f'two runs are called {run.name}: give each its own name')


def _shares_content(one: Array, other: Array) -> bool:
    """Whether a stretch of one run (C, N) is a stretch of the other, bit for bit.

    One run then contains the other, or begins in it and continues beyond its end.
    """
    least = max(MIN_SHARED, round(MIN_SHARED_PART * min(one.shape[1], other.shape[1])))
    for first, second in ((one, other), (other, one)):
        for begin in np.flatnonzero((first == second[:, :1]).all(axis=0)):
            length = min(first.shape[1] - int(begin), second.shape[1])
            if length < least:
                break
            if all(
                np.array_equal(first[:, begin : begin + end], second[:, :end])
                for end in (MIN_SHARED, length)
            ) and np.ptp(second[:, :length], axis=1).any():
                return True
    return False


def sample_weights(system: System, run: RunBlocks, view: str) -> Array:
    """Weight (N,) of each sample in a view as a time; 0 if one of its channels is missing."""
    if run.present is None:
        return run.width
    channels = np.flatnonzero(system.views[view])
    return np.asarray(run.width * run.present[channels].all(axis=0))


def view_ranges(system: System, runs: Sequence[RunBlocks]) -> dict[str, float]:
    """Range that a misfit in each view is compared with.

    A view that should be empty (parity) is compared with the widest view that uses its
    channels.
    """
    ranges = {
        name: max(float(np.ptp(weights @ run.channels)) for run in runs)
        for name, weights in system.views.items()
    }
    scaled: dict[str, float] = {}
    for name, weights in system.views.items():
        alike = max(
            ranges[other] * float(np.abs(weights).sum() / np.abs(vector).sum())
            for other, vector in system.views.items()
            if np.any((weights != 0) & (vector != 0))
        )
        empty = ranges[name] <= EMPTY_VIEW * alike
        scaled[name] = alike if empty else max(ranges[name], MIN_VIEW_SHARE * alike)
    return scaled
