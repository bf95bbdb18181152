"""Settings of an identification and of its swarm. Light to import, for nodes that name no more."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from saddlering_ros.errors import SaddleringError
from saddlering_ros.rig import PARAMETER_NAMES, Rig, RigError
from saddlering_ros.rig.description import check_bounds

METHODS = ('default', 'paper')

Bounds = dict[str, tuple[float, float]]


class IdentificationError(SaddleringError):
    """Runs, bounds or an objective that cannot be used; the message is one line."""


class StopReason(Enum):
    """Reason for the end of a swarm."""

    ITERATIONS = 'all iterations done'
    ACCURACY = 'accuracy reached'
    STAGNATION = 'no more progress'
    CANCELLED = 'cancelled'


@dataclass(frozen=True, slots=True)
class SwarmSettings:
    """Settings of the swarm; the defaults are the paper's.

    velocity_limit is v_max as a fraction of each coordinate's range. The swarm stops early when
    the best objective is at or under `accuracy`, or has gained less than `stagnation_tolerance`
    (relative) over `stagnation` iterations; None switches that rule off.
    """

    particles: int = 20
    iterations: int = 50
    cognitive: float = 1.2  # c1, towards a particle's own best place
    social: float = 1.7  # c2, towards the best place of all
    inertia_start: float = 0.9
    inertia_end: float = 0.4
    velocity_limit: float = 0.2
    accuracy: float | None = None
    stagnation: int | None = None
    stagnation_tolerance: float = 1e-9

    def __post_init__(self) -> None:
        if self.particles < 2 or self.iterations < 1:
            raise IdentificationError(
                f'swarm of {self.particles} particles and {self.iterations} iterations: '
                'at least 2 particles and 1 iteration are needed')
        if self.stagnation is not None and self.stagnation < 1:
            raise IdentificationError(
                f'stagnation is {self.stagnation}: give a number of iterations from 1 up')
        if self.accuracy is not None and not np.isfinite(self.accuracy):
            raise IdentificationError(f'accuracy is {self.accuracy}: give a finite objective')
        numbers = (self.cognitive, self.social, self.inertia_start, self.inertia_end)
        if not all(np.isfinite(number) and number >= 0.0 for number in numbers):
            raise IdentificationError(
                f'swarm coefficients c1, c2, w = {numbers}: give finite numbers, none negative')
        if not 0.0 < self.velocity_limit <= 1.0:
            raise IdentificationError(
                f'swarm velocity limit {self.velocity_limit}: give a fraction of the range, 0 to 1'
            )

    def inertia(self, iteration: int) -> float:
        """Inertia weight of an iteration (0-based), falling linearly over all iterations."""
        share = iteration / max(1, self.iterations - 1)
        return self.inertia_start + (self.inertia_end - self.inertia_start) * share


@dataclass(frozen=True, slots=True)
class IdentificationSettings:
    """Settings of one identification.

    method: 'default' (all channels, both branches, joint least squares) or 'paper' (two steps,
    mean of the branches, swarm alone). bounds replace those of the rig for their names (SI).
    logarithmic_stiffness: the paper's swarm searches K on a logarithmic scale; the default
    method always does. use_delta_y None: the usual choice of the method (paper: without).
    fit_rate [Hz]: grid of the block means of dynamic records (its bandwidth is 0.44 of it);
    None keeps every sample.
    """

    method: str = 'default'
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    swarm: SwarmSettings = field(default_factory=SwarmSettings)
    logarithmic_stiffness: bool = False
    use_delta_y: bool | None = None
    seed: int = 0
    fit_rate: float | None = 50.0

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise IdentificationError(
                f'method {self.method!r} is unknown: give one of {", ".join(METHODS)}')
        unknown = sorted(set(self.bounds) - set(PARAMETER_NAMES))
        if unknown:
            raise IdentificationError(
                f'bounds for {unknown[0]!r}: there is no such parameter: give '
                f'{", ".join(PARAMETER_NAMES)}')
        if self.fit_rate is not None and not self.fit_rate > 0.0:
            raise IdentificationError(
                f'fit rate {self.fit_rate} Hz: give a rate above zero, or none for every sample')

    def bounds_for(self, rig: Rig) -> Bounds:
        """Bounds of all six parameters; IdentificationError if one pair is reversed."""
        bounds = {name: self.bounds.get(name, rig.bounds[name]) for name in PARAMETER_NAMES}
        try:
            return check_bounds(bounds, 'identification bounds')
        except RigError as problem:
            raise IdentificationError(str(problem)) from problem

    @property
    def channels(self) -> tuple[int, ...]:
        """Indices of the channels (delta_x, delta_y, gamma) of the objective."""
        use_delta_y = self.method == 'default' if self.use_delta_y is None else self.use_delta_y
        return (0, 1, 2) if use_delta_y else (0, 2)
