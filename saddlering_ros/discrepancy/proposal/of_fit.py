"""A law proposed for a fitted model: its residual, coordinates and targets combined."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol, runtime_checkable

import numpy as np

from saddlering_ros.discrepancy import gain
from saddlering_ros.discrepancy.candidate import Fit
from saddlering_ros.discrepancy.metric import Metric
from saddlering_ros.discrepancy.proposal.memory import direction_of
from saddlering_ros.discrepancy.proposal.misfit import (
    DIRECTION,
    LOAD,
    Misfit,
    ObservedRun,
    RATE,
    TIME,
)
from saddlering_ros.discrepancy.proposal.propose import LawProposal, propose_law
from saddlering_ros.discrepancy.refit import neighbours, tangent
from saddlering_ros.discrepancy.system import Array, Point, RunBlocks, System

DIRECTION_BAND = 0.01
"""Smallest return of the drive that changes its direction, as a share of its range."""


@runtime_checkable
class HasTargets(Protocol):
    """A system with further targets of an addition besides its views and channels."""

    def targets(self, run: RunBlocks, point: Point) -> Mapping[str, Array]:
        """Change of the channels (C, N) per unit of the addition, by the name of the target."""
        ...

    def start_of(self, run: RunBlocks) -> float:
        """Start of the time [s] of a law."""
        ...


def propose_for(
    metric: Metric, fit: Fit, runs: Sequence[RunBlocks], degrees: int, error_rate: float
) -> LawProposal | None:
    """The law that would explain the residual of `fit`; `runs`: all runs, fitted and held out."""
    experiment = metric.experiment
    system = experiment.system
    observed = []
    plain = tangent(metric, fit).plain
    residuals = experiment.by_run(experiment.measured - fit.prediction)
    start = 0
    for run, residual in zip(experiment.runs, residuals, strict=True):
        slopes = plain[start : start + run.channels.size]
        start += run.channels.size
        observed.append(
            _observed(system, run, fit.point, residual, slopes.reshape(*run.channels.shape, -1))
        )
    held = [_held_out(system, run, fit) for run in runs if run.held_out]
    by_name = {run.name: run for run in runs}

    def mean_square(run: ObservedRun, residual: Array) -> float:
        return gain.mean_square(experiment, [by_name[run.name]], [residual])

    misfit = Misfit(tuple(observed), metric.whiten, degrees)
    return propose_law(misfit, mean_square, held, error_rate)


def _held_out(system: System, run: RunBlocks, fit: Fit) -> ObservedRun:
    """A held-out run with the slopes of its prediction."""
    base = system.base_parameters
    parameters = fit.candidate.parameters(base)
    asked, steps = neighbours(parameters, fit.theta_unit, range(fit.theta_unit.size))
    answers = system.predict_many(run, [fit.candidate.point(base, place) for place in asked])
    slopes = (answers[1:] - answers[:1]) / np.array(steps)[:, None, None]
    residual = run.channels - answers[0]
    return _observed(system, run, fit.point, residual, np.moveaxis(slopes, 0, -1))


def _observed(
    system: System, run: RunBlocks, point: Point, residual: Array, slopes: Array
) -> ObservedRun:
    targets: dict[str, Array] = {}
    for name, weights in system.views.items():
        pattern = weights / float(weights @ weights)
        targets[name] = np.repeat(pattern[:, None], run.time.size, axis=1)
    for number, name in enumerate(system.channel_names):
        alone = np.zeros((len(system.channel_names), run.time.size))
        alone[number] = 1.0
        if not any(_alike(alone, other) for other in targets.values()):
            targets[name] = alone
    begin = float(run.time[0])
    if isinstance(system, HasTargets):
        targets.update(system.targets(run, point))
        begin = system.start_of(run)
    return ObservedRun(run.name, coordinates_of(run, begin), targets, residual, slopes)


def coordinates_of(run: RunBlocks, begin: float) -> dict[str, Array]:
    """Coordinates of a run: the drive, its direction and rate, time, and any others."""
    if not run.inputs:
        return {TIME: run.time - begin}
    first, *others = run.inputs
    drive, direction, rate = run.inputs[first], run.direction, run.rate
    if direction is None:
        direction = direction_of(drive, DIRECTION_BAND * float(np.ptp(drive)))
    if rate is None:
        rate = np.gradient(drive, run.time)
    found = {name: run.inputs[name] for name in others}
    return {**found, LOAD: drive, TIME: run.time - begin, DIRECTION: direction, RATE: rate}


def _alike(one: Array, other: Array) -> bool:
    """Whether two targets are proportional."""
    return bool(np.allclose(one / np.abs(one).max(), other / np.abs(other).max()))
