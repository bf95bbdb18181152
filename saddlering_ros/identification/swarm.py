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
from saddlering_ros.identification.settings import StopReason, SwarmSettings
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


def minimise(
    objective: BatchObjective, low: Array, high: Array, settings: SwarmSettings | None = None, *,
    seed: int = 0, on_iteration: Callable[[SwarmProgress], None] | None = None,
    is_cancelled: IsCancelled | None = None,
) -> SwarmResult:
    """Minimise objective((particles, D)) -> (particles,) in the box, repeatably by its seed."""
    settings = settings or SwarmSettings()
    random = np.random.default_rng(seed)
    shape, span = (settings.particles, low.size), high - low
    fastest = settings.velocity_limit * span
    position = low + span * random.random(shape)
    velocity = fastest * random.uniform(-1.0, 1.0, shape)
    own_best, own_objective = position.copy(), np.full(settings.particles, np.inf)
    history: list[float] = []
    stopped = None
    while stopped is None:
        if is_cancelled is not None and is_cancelled():
            stopped = StopReason.CANCELLED
            break
        found = objective(position)
        better = found < own_objective
        own_best[better] = position[better]
        own_objective[better] = found[better]
        best = own_best[int(np.argmin(own_objective))].copy()
        pull_own, pull_all = random.random((2, *shape))
        velocity = (
            settings.inertia(len(history)) * velocity
            + settings.cognitive * pull_own * (own_best - position)
            + settings.social * pull_all * (best - position))
        velocity = np.clip(velocity, -fastest, fastest)
        moved = position + velocity
        position = np.clip(moved, low, high)
        velocity = np.where(moved == position, velocity, 0.0)
        history.append(float(own_objective.min()))
        if on_iteration is not None:
            on_iteration(SwarmProgress(
                len(history), settings.iterations, history[-1], best,
                float(np.mean(position.std(axis=0) / span))))
        stopped = _reason_to_stop(history, settings)
    return SwarmResult(
        position=own_best[int(np.argmin(own_objective))], objective=float(own_objective.min()),
        evaluations=len(history) * settings.particles, iterations=len(history), stopped=stopped,
        history=np.array(history))


def _reason_to_stop(history: list[float], settings: SwarmSettings) -> StopReason | None:
    best = history[-1]
    if settings.accuracy is not None and best <= settings.accuracy:
        return StopReason.ACCURACY
    if settings.stagnation is not None and len(history) > settings.stagnation:
        before = history[-1 - settings.stagnation]
        if before - best <= settings.stagnation_tolerance * abs(before):
            return StopReason.STAGNATION
    return StopReason.ITERATIONS if len(history) == settings.iterations else None
