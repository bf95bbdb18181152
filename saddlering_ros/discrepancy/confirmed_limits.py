"""Detection limits confirmed: the base is refitted beside an effect of the stated size.

A signature shows to first order which part of a change the base parameters imitate. A nonlinear
example is a resonance that a spring has shifted by one percent: refitted gravity imitates the
shift almost completely, and a limit from signatures is far too low.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from saddlering_ros.discrepancy.candidate import Candidate
from saddlering_ros.discrepancy.detection_limits import (
    Configuration,
    DetectionLimit,
    needed_length,
)
from saddlering_ros.discrepancy.experiment import Experiment
from saddlering_ros.discrepancy.model_space import ModelSpace
from saddlering_ros.discrepancy.refit import refit, run_refits
from saddlering_ros.discrepancy.system import Array, Effect

ENOUGH = 0.9
"""Share of the required length that must remain beside the refitted base for a limit to hold."""

MAX_TRIES = 6
"""Largest number of larger sizes that are tried."""

MIN_FACTOR, MAX_FACTOR = 1.3, 4.0
"""Factor between two sizes that are tried."""

ROUNDS = 8
"""Rounds of each refit of the base."""


@dataclass(frozen=True)
class Shown:
    """Visible part of an effect of one size beside the base: deviations, share of range."""

    length: float
    visible: float


def confirmed_limits(
    space: ModelSpace, limits: Sequence[DetectionLimit], trials: int
) -> list[DetectionLimit]:
    """The same limits, larger where the refitted base imitates more than its tangents do."""
    effects = {effect.id: effect for effect in space.metric.experiment.system.effects}
    return [_confirmed(space, item, effects[item.effect], trials) for item in limits]


def _confirmed(
    space: ModelSpace, item: DetectionLimit, effect: Effect, trials: int
) -> DetectionLimit:
    if not np.isfinite(item.limit) or effect.neutral != 0.0 or not item.configurations:
        return item
    settings, pairs = space.settings, space.known.pairs
    configuration = _configuration(item)
    needed = needed_length(len(effect.ordered), settings.error_rate / trials, pairs)
    reach = max(abs(effect.size.low), abs(effect.size.high))

    def shown(size: float) -> Shown | None:
        space.watch.check()
        return _shown(space, effect, configuration, size)

    first = shown(item.limit)
    if first is None or first.length >= ENOUGH * needed:
        return item
    limit = _size_at(lambda size: _part(shown(size), 'length'), item.limit, needed, reach)
    material = _size_at(
        lambda size: _part(shown(size), 'visible'),
        item.material_limit,
        settings.materiality,
        reach,
    )
    return replace(
        item,
        limit=limit,
        best_limit=max(item.best_limit, limit if item.best_limit == item.limit else 0.0),
        material_limit=material,
        testable=item.testable and bool(np.isfinite(limit)),
    )


def _configuration(item: DetectionLimit) -> Configuration:
    """The configuration with the stated limit."""
    return min(item.configurations, key=lambda one: abs(one.limit - item.limit))


def _part(shown: Shown | None, name: str) -> float:
    return 0.0 if shown is None else float(getattr(shown, name))


def _size_at(
    height: Callable[[float], float], size: float, wanted: float, reach: float
) -> float:
    """The size, from `size` on, at which a height reaches `wanted`; inf if none up to `reach`."""
    if not np.isfinite(size):
        return size
    low, below = size, height(size)
    if below >= ENOUGH * wanted:
        return size
    for _ in range(MAX_TRIES):
        if low >= reach:
            break
        high = min(low * float(np.clip(wanted / max(below, 1e-9), MIN_FACTOR, MAX_FACTOR)), reach)
        above = height(high)
        if above >= wanted:
            share = np.log(wanted / max(below, 1e-9)) / np.log(above / max(below, 1e-9))
            return float(low * (high / low) ** share)
        low, below = high, above
    return float(np.inf)


def _shown(
    space: ModelSpace, effect: Effect, configuration: Configuration, size: float
) -> Shown | None:
    """Visible part of one size beside the refitted base, for the sign with the smaller part."""
    signs = [
        sign
        for sign in (1.0, -1.0)
        if effect.size.low <= sign * size <= effect.size.high
    ]
    found = [_refitted(space, effect, configuration, sign * size) for sign in signs]
    kept = [item for item in found if item is not None]
    return min(kept, key=lambda item: item.length) if kept else None


def _refitted(
    space: ModelSpace, effect: Effect, configuration: Configuration, size: float
) -> Shown | None:
    """Part of an effect that the base, fitted to the effect's prediction, does not imitate."""
    metric, base = space.metric, space.base
    experiment = metric.experiment
    variant = next(
        number
        for number, fixed in enumerate(effect.variants)
        if all(configuration.values.get(name) == value for name, value in fixed.items())
    )
    own = [effect.size.to_unit(size)]
    own += [item.to_unit(configuration.values[item.name]) for item in effect.ordered[1:]]
    point = Candidate(((effect, variant),)).point(
        experiment.system.base_parameters, np.concatenate([base.theta_unit, own])
    )
    target = experiment.predict([point])[:, 0]
    if not np.all(np.isfinite(target)):
        return None
    other = _with_readings(experiment, target)
    moved = replace(metric, experiment=other)
    start = refit(moved, Candidate(), base.theta_unit, rounds=ROUNDS, full_jacobian=True)
    fit = run_refits(moved, [start], space.watch.check)[0]
    experiment.simulations += other.simulations
    left = fit.prediction - target
    visible = max(
        other.mean_square(seen, run, view) ** 0.5 / experiment.view_ranges[view]
        for view in experiment.system.views
        for run, seen in zip(other.runs, other.view_residuals(left, view), strict=True)
    )
    return Shown(float(np.sqrt(fit.misfit)), visible)


def _with_readings(experiment: Experiment, stacked: Array) -> Experiment:
    """The same experiment with other readings (n,)."""
    runs = [
        replace(run, channels=channels)
        for run, channels in zip(experiment.runs, experiment.by_run(stacked), strict=True)
    ]
    return Experiment(experiment.system, runs, experiment.assumptions)
