"""The metric of the misfit: whitened by the noise, nuisance parameters marginalised.

With noise covariance C = L L' per run and channel and nuisance columns G of prior covariance S,
the metric is (C + G S G')^-1. It is applied as L^-1 followed by the symmetric operator I - U (1 -
1/sqrt(1 + s^2)) U', where U, s are the singular vectors and values of L^-1 G S^(1/2).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from saddlering_ros.discrepancy.experiment import Experiment
from saddlering_ros.discrepancy.system import Array
from saddlering_ros.estimation.process import ChannelNoise
from saddlering_ros.estimation.whitening import build_whitener, SharedErrors, Whitener

MAX_SPREADS = 2.5
"""Largest size of a nuisance parameter, in its standard deviations."""

FREE_STRENGTH = 1e3
"""Size of a nuisance parameter, in units of noise, above which it counts as free."""

JITTER = 1e-6
"""Noise added to every sample, as a share of the range of the widest channel."""


class Whitening(Protocol):
    """The interface of a metric for refits."""

    @property
    def experiment(self) -> Experiment: ...

    def whiten(self, columns: Array) -> Array:
        """Stacked columns (n, B) or (n,) in units of their usual size."""
        ...


@dataclass(frozen=True)
class Metric:
    """Noise of every run and channel, with the nuisance parameters marginalised.

    shared: the nuisance parameters, which the whitened residuals share. A metric is never
    changed: `marginalise` makes another one.
    """

    experiment: Experiment
    noise: Mapping[tuple[str, int], ChannelNoise]
    whiteners: tuple[Whitener, ...]
    shared: SharedErrors

    def marginalise(self, nuisances: Array) -> Metric:
        """The same noise with these nuisance parameters: columns (n, k) times their spreads."""
        return replace(self, shared=SharedErrors.of(self.whiten_noise(nuisances)))

    def whiten_noise(self, columns: Array) -> Array:
        """L^-1 on stacked columns (n, B) or (n,): noise alone."""
        out = np.empty_like(columns)
        for whitener, (_, _, part) in zip(self.whiteners, self.experiment.slices, strict=True):
            out[part] = whitener.whiten(columns[part])
        return out

    def colour_noise(self, columns: Array) -> Array:
        """L on whitened columns (n, B) or (n,)."""
        out = np.empty_like(columns)
        for whitener, (_, _, part) in zip(self.whiteners, self.experiment.slices, strict=True):
            out[part] = whitener.colour(columns[part])
        return out

    def whiten(self, columns: Array) -> Array:
        """The whole metric on stacked columns (n, B) or (n,)."""
        return self.shared.apply(self.whiten_noise(columns))

    def inflated(self, factor: float, free: Array) -> Array:
        """Nuisance columns, whitened and multiplied by `factor`, and columns (n, p) beside them.

        Offsets keep their spread, which is wide already.
        """
        strength = self.shared.strength
        larger = np.where(strength < FREE_STRENGTH, factor * strength, strength)
        return np.hstack([self.shared.directions * larger, self.whiten_noise(free)])

    def without_nuisances(self, residual: Array) -> Array:
        """A stacked plain residual minus its part by nuisance parameters of usual size."""
        white = self.whiten_noise(residual)
        spreads = np.clip(self.shared.along(white), -MAX_SPREADS, MAX_SPREADS)
        shared = self.shared.directions @ (self.shared.strength * spreads)
        return self.colour_noise(white - shared)

    @property
    def free_count(self) -> float:
        """Dimensions beside the nuisance parameters."""
        return self.experiment.size - self.shared.dimensions


def noise_metric(experiment: Experiment, noise: Mapping[tuple[str, int], ChannelNoise]) -> Metric:
    """The metric of the noise alone, without nuisance parameters."""
    jitter = float((JITTER * experiment.channel_ranges.max()) ** 2)
    whiteners = []
    for index, channel, _ in experiment.slices:
        run = experiment.runs[index]
        present = None if run.present is None else run.present[channel]
        own = noise[run.name, channel]
        whiteners.append(build_whitener(own, run.time, run.width, run.hold, present, jitter))
    return Metric(experiment, noise, tuple(whiteners), SharedErrors.none(experiment.size))
