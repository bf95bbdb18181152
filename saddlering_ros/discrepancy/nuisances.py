"""Nuisance parameters: small errors of every sound system, as columns times a prior spread."""

from __future__ import annotations

import numpy as np

from saddlering_ros.discrepancy.experiment import Experiment
from saddlering_ros.discrepancy.priors import FREE_OFFSET, ModelErrorPrior
from saddlering_ros.discrepancy.system import Array, Point

RATE_SHAPES = 4
"""Shapes over the drive of the error that depends on its rate."""


def nuisance_columns(experiment: Experiment, point: Point, prediction: Array) -> Array:
    """Every nuisance parameter as a column (n, k) at the prediction (n,) of a point."""
    columns = [offset_columns(experiment)]
    prior = experiment.assumptions.model_error
    if prior is not None:
        columns.append(model_error_columns(experiment, prior))
        columns.append(timing_columns(experiment, prior, prediction))
    columns.append(system_columns(experiment, point))
    return np.hstack(columns)


def offset_columns(experiment: Experiment) -> Array:
    """A constant for every run and channel, with a very wide spread where it is free."""
    declared = experiment.assumptions.offsets
    columns = []
    for _, channel, part in experiment.slices:
        free = FREE_OFFSET * experiment.channel_ranges.max()
        spread = float(free) if declared is None else declared[channel]
        if spread > 0.0:
            column = np.zeros(experiment.size)
            column[part] = spread
            columns.append(column)
    return np.array(columns).reshape(-1, experiment.size).T


def model_error_columns(experiment: Experiment, prior: ModelErrorPrior) -> Array:
    """Smooth model error over the drive, shared inside a group, in every channel."""
    widest = experiment.channel_ranges.max()
    rates = [run.rate for run in experiment.runs if run.rate is not None]
    fastest = max([1e-300, *(float(np.abs(rate).max()) for rate in rates)])
    columns: list[Array] = []
    for group in sorted({run.group for run in experiment.runs}):
        members = [run for run in experiment.runs if run.group == group]
        drives = {run.name: next(iter(run.inputs.values())) for run in members}
        low = min(float(drive.min()) for drive in drives.values())
        high = max(float(drive.max()) for drive in drives.values())
        shapes = {}
        for run in members:
            place = (drives[run.name] - low) / max(high - low, 1e-300)
            still = np.zeros(run.time.size)
            rate = (still if run.rate is None else run.rate) / fastest
            direction = still if run.direction is None else run.direction
            shapes[run.name] = _error_shapes(prior, place, direction, rate)
        for channel, span in enumerate(experiment.channel_ranges):
            scale = max(float(span), 0.2 * float(widest))
            for number in range(prior.degree + 1 + RATE_SHAPES):
                column = np.zeros(experiment.size)
                for index, other, part in experiment.slices:
                    run = experiment.runs[index]
                    if other == channel and run.group == group:
                        column[part] = scale * shapes[run.name][number]
                columns.append(column)
    return np.column_stack(columns)


def _error_shapes(
    prior: ModelErrorPrior, place: Array, direction: Array, rate: Array
) -> list[Array]:
    """Shapes (N,) of model error at positions of the drive (0 to 1), each times its spread."""
    smooth = [prior.smooth * np.cos(np.pi * wave * place) for wave in range(1, prior.degree + 1)]
    loop = prior.loop * direction * 4.0 * place * (1.0 - place)
    rates = [prior.rate * rate * np.cos(np.pi * wave * place) for wave in range(RATE_SHAPES)]
    return [*smooth, loop, *rates]


def timing_columns(experiment: Experiment, prior: ModelErrorPrior, prediction: Array) -> Array:
    """Changes (n, k) by a small delay of each channel, in runs whose drive has a rate."""
    columns = []
    for index, _, part in experiment.slices:
        run = experiment.runs[index]
        if run.rate is not None and np.any(run.rate):
            column = np.zeros(experiment.size)
            column[part] = prior.instants * np.gradient(prediction[part], run.time)
            columns.append(column)
    return np.array(columns).reshape(-1, experiment.size).T


def system_columns(experiment: Experiment, point: Point) -> Array:
    """The system's own nuisance parameters as stacked columns (n, k)."""
    parts = experiment.system.nuisances(experiment.runs, point)
    return np.concatenate(
        [part.reshape(part.shape[0] * part.shape[1], part.shape[2]) for part in parts]
    )
