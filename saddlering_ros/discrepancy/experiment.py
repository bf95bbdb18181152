"""The runs that are fitted and the simulator that should reproduce them, stacked into one vector.

Stacked vectors run over runs, then channels, then samples.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np

from saddlering_ros.discrepancy.system import Array, DiscrepancyError, Point, Run, System

EMPTY_VIEW = 0.1
"""A view whose range is under this share of its neighbours' is empty but for what is wrong."""
MIN_VIEW_SHARE = 0.2
"""A view's range counts as this share of its neighbours' at least."""


class Experiment:
    """Fitted runs and their simulator; `simulations` counts how often it was asked."""

    def __init__(self, system: System, runs: Sequence[Run]) -> None:
        if not runs:
            raise DiscrepancyError('diagnose: every run is held out; leave at least one to fit')
        self.system, self.runs = system, tuple(runs)
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

    def by_run(self, stacked: Array) -> list[Array]:
        """A stacked vector (n,) as one (C, N) block a run."""
        blocks, start = [], 0
        for run in self.runs:
            blocks.append(stacked[start : start + run.channels.size].reshape(run.channels.shape))
            start += run.channels.size
        return blocks

    def view_residuals(self, residual: Array, view: str) -> list[Array]:
        """A stacked residual seen in one view, run by run, each freed of its mean."""
        weights = self.system.views[view]
        seen = []
        for run, block in zip(self.runs, self.by_run(residual), strict=True):
            combined = weights @ block
            seen.append(combined - np.average(combined, weights=run.width))
        return seen


def view_ranges(system: System, runs: Sequence[Run]) -> dict[str, float]:
    """Range that a misfit in each view is compared with.

    A view that ought to be empty (parity) is compared with the widest view made of channels it
    uses.
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
