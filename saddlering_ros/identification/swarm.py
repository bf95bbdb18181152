"""Particle swarm optimisation as in the paper, for objectives of a whole swarm.

Kennedy and Eberhart's swarm with the inertia of Shi and Eberhart (1998) falling linearly: v <- w v
+ c1 r1 (own best - x) + c2 r2 (swarm's best - x), |v| <= v_max, x <- x + v. A particle that would
leave the box is put on its wall and loses its velocity towards the wall.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from saddlering_ros.estimation.process import Array
from saddlering_ros.identification.settings import IdentificationError, StopReason, SwarmSettings
from saddlering_ros.progress import IsCancelled

BatchObjective = Callable[[Array], Array]


@dataclass(frozen=True, slots=True)
class SwarmProgress:
    """State after one iteration.

    spread: mean over coordinates of the particles' standard deviation over the range.
    """

    iteration: int
    iterations: int
    best_objective: float
    best_position: Array
    spread: float


@dataclass(frozen=True, slots=True)
class SwarmResult:
    """Result of a swarm: best position (D,), its objective, and the course of the search."""

    position: Array
    objective: float
    evaluations: int
    iterations: int
    stopped: StopReason
    history: Array = field(repr=False)


class Swarm:
    """A swarm in the box low..high, driven by turns of `ask` and `tell`."""

    def __init__(self, low: Array, high: Array, settings: SwarmSettings, seed: int) -> None:
        self._low = np.asarray(low, dtype=float)
        self._high = np.asarray(high, dtype=float)
        if self._low.shape != self._high.shape or not np.all(self._low < self._high):
            raise IdentificationError(
                f'swarm bounds {self._low.tolist()} to {self._high.tolist()}: '
                'each lower bound must lie under its upper bound'
            )
        self._settings = settings
        self._random = np.random.default_rng(seed)
        shape = (settings.particles, self._low.size)
        span = self._high - self._low
        self._velocity_limit = settings.velocity_limit * span
        self._position = self._low + span * self._random.random(shape)
        self._velocity = self._velocity_limit * self._random.uniform(-1.0, 1.0, shape)
        self._own_best = self._position.copy()
        self._own_objective = np.full(settings.particles, np.inf)
        self.iteration = 0

    def ask(self) -> Array:
        """Positions (particles, D) to evaluate."""
        return np.array(self._position)

    def tell(self, objective: Array) -> None:
        """Receive the objective (particles,) of these positions, and move the swarm."""
        objective = np.asarray(objective, dtype=float)
        if objective.shape != self._own_objective.shape:
            raise ValueError(f'{objective.shape} objectives for {self._own_objective.shape}')
        if np.isnan(objective).any():
            where = self._position[int(np.argmax(np.isnan(objective)))]
            raise IdentificationError(
                f'the objective is not a number at {np.array2string(where, precision=4)}: '
                'check the bags for missing values and the bounds for impossible ones'
            )
        better = objective < self._own_objective
        self._own_best[better] = self._position[better]
        self._own_objective[better] = objective[better]
        settings = self._settings
        pull_own, pull_all = self._random.random((2, *self._position.shape))
        velocity = (
            settings.inertia(self.iteration) * self._velocity
            + settings.cognitive * pull_own * (self._own_best - self._position)
            + settings.social * pull_all * (self.best_position - self._position)
        )
        velocity = np.clip(velocity, -self._velocity_limit, self._velocity_limit)
        moved = self._position + velocity
        self._position = np.clip(moved, self._low, self._high)
        self._velocity = np.where(moved == self._position, velocity, 0.0)
        self.iteration += 1

    @property
    def best_objective(self) -> float:
        """Lowest objective so far (inf before the first)."""
        return float(self._own_objective.min())

    @property
    def best_position(self) -> Array:
        """Position (D,) of the lowest objective so far."""
        return np.array(self._own_best[int(np.argmin(self._own_objective))])

    @property
    def spread(self) -> float:
        """Mean over coordinates of the particles' standard deviation over the range."""
        return float(np.mean(self._position.std(axis=0) / (self._high - self._low)))


def minimise(
    objective: BatchObjective,
    low: Array,
    high: Array,
    settings: SwarmSettings | None = None,
    *,
    seed: int = 0,
    on_iteration: Callable[[SwarmProgress], None] | None = None,
    is_cancelled: IsCancelled | None = None,
) -> SwarmResult:
    """Minimise objective((particles, D)) -> (particles,) in the box, repeatably by its seed."""
    settings = settings or SwarmSettings()
    swarm = Swarm(low, high, settings, seed)
    history: list[float] = []
    stopped = StopReason.ITERATIONS
    while swarm.iteration < settings.iterations:
        if is_cancelled is not None and is_cancelled():
            stopped = StopReason.CANCELLED
            break
        swarm.tell(objective(swarm.ask()))
        history.append(swarm.best_objective)
        if on_iteration is not None:
            on_iteration(SwarmProgress(
                swarm.iteration, settings.iterations, swarm.best_objective, swarm.best_position,
                swarm.spread))
        reason = _reason_to_stop(history, settings)
        if reason is not None:
            stopped = reason
            break
    return SwarmResult(
        position=swarm.best_position, objective=swarm.best_objective,
        evaluations=swarm.iteration * settings.particles, iterations=swarm.iteration,
        stopped=stopped, history=np.array(history))


def _reason_to_stop(history: list[float], settings: SwarmSettings) -> StopReason | None:
    best = history[-1]
    if settings.accuracy is not None and best <= settings.accuracy:
        return StopReason.ACCURACY
    if settings.stagnation is None or len(history) <= settings.stagnation:
        return None
    before = history[-1 - settings.stagnation]
    if before - best <= settings.stagnation_tolerance * abs(before):
        return StopReason.STAGNATION
    return None
