"""The input of a proposal: a residual, its coordinates, and its metric."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from saddlering_ros.discrepancy.system import Array

LOAD, DIRECTION, RATE, TIME = 'load', 'direction', 'rate', 'time'
ANGLE, HYSTERESIS = 'angle', 'hysteresis'


@dataclass(frozen=True)
class ObservedRun:
    """One run: coordinates (N,) by name, and the change of its channels by an addition.

    coordinates: 'load' is the drive, 'direction' and 'rate' belong to the drive, 'time' [s]
    counts from the start of the run; 'angle' is periodic over 2 pi; any other name is used as
    it is. targets: name to (C, N), the change of the channels per unit of the addition, sample
    by sample. residual (C, N): measured minus predicted. slopes (C, N, P): change of the
    prediction by each base parameter. from_start: targets to which a law adds its change since
    the first sample.
    """

    name: str
    coordinates: Mapping[str, Array]
    targets: Mapping[str, Array]
    residual: Array
    slopes: Array
    from_start: frozenset[str] = frozenset()

    def added(self, target: str, values: Array) -> Array:
        """Change of the channels (C, N, k) by additions (N, k) to a target."""
        change = values - values[:1] if target in self.from_start else values
        return np.asarray(self.targets[target][:, :, None] * change[None, :, :])

    @property
    def samples(self) -> int:
        return self.residual.shape[1]


@dataclass(frozen=True)
class Misfit:
    """Residuals of the fitted runs and their metric.

    whiten: applies the metric to stacked columns (n, B), in the order of runs, channels,
    samples. degrees: degrees of freedom of the level of the noise.
    """

    runs: tuple[ObservedRun, ...]
    whiten: Callable[[Array], Array]
    degrees: int

    @property
    def size(self) -> int:
        return sum(run.residual.size for run in self.runs)

    @cached_property
    def rows(self) -> tuple[slice, ...]:
        """Rows of each run in a stacked vector."""
        ends = np.cumsum([run.residual.size for run in self.runs])
        return tuple(
            slice(int(end) - run.residual.size, int(end))
            for run, end in zip(self.runs, ends, strict=True)
        )

    @cached_property
    def base(self) -> Array:
        """Orthonormal basis (n, P) of the changes by base parameters, whitened."""
        slopes = [run.slopes.reshape(-1, run.slopes.shape[2]) for run in self.runs]
        white = self.whiten(np.concatenate(slopes))
        left, values, _ = np.linalg.svd(white, full_matrices=False)
        return np.asarray(left[:, values > 1e-8 * max(float(values.max(initial=0.0)), 1e-300)])

    @cached_property
    def residual(self) -> Array:
        """The whitened residual (n,) minus its part by base parameters."""
        plain = np.concatenate([run.residual.ravel() for run in self.runs])
        return self.freed(self.whiten(plain[:, None]))[:, 0]

    def freed(self, white: Array) -> Array:
        """Whitened columns minus their part by base parameters."""
        return np.asarray(white - self.base @ (self.base.T @ white))

    def columns(self, target: str, shapes: tuple[Array, ...]) -> Array:
        """Stacked whitened columns (n, k) of an addition of `shapes` (N, k) by run to a target."""
        return self.freed(self.whiten(stacked(self.runs, target, shapes)))


def stacked(runs: tuple[ObservedRun, ...], target: str, shapes: tuple[Array, ...]) -> Array:
    """Plain stacked columns (n, k) of an addition of `shapes` (N, k) by run to a target."""
    parts = []
    for run, shape in zip(runs, shapes, strict=True):
        parts.append(run.added(target, shape).reshape(-1, shape.shape[1]))
    return np.concatenate(parts)
