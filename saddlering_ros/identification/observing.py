"""From test runs to observations: readings, their noise, and the part of the load cell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.bags import refuse_repeats
from saddlering_ros.estimation.statistics import block_means, filled
from saddlering_ros.estimation.whitening import build_whitener
from saddlering_ros.identification.checks import run_name
from saddlering_ros.identification.errors import IdentificationError
from saddlering_ros.identification.load_cell import cell_noise, load_errors_of, slow_cell_noise
from saddlering_ros.identification.observation import Observation
from saddlering_ros.identification.prepared import (
    block_sizes,
    MAX_SIMULATED,
    noise_of,
    NoiseModel,
    prepare,
    PreparedRun,
)
from saddlering_ros.record.record import Record
from saddlering_ros.rig import ContactParameters, Rig

Array = NDArray[np.float64]

SETTLING_STEP = 0.1
"""Step [s] of the simulation of a static run with settling."""


def observe(
    runs: Sequence[Record], rig: Rig, *, fit_rate: float | None,
    contact: ContactParameters | None = None,
) -> list[Observation]:
    """Observations of runs; IdentificationError if a run cannot be used.

    The noise is estimated from all runs of one sampling rate together. contact: a first
    result, by which a damped ring follows the load cell's noise; without it the ring follows
    at once, in proportion.
    """
    prepared = prepare_all(runs, rig, fit_rate)
    if contact is None:
        return observe_prepared(prepared, fit_rate)
    return observe_with_cell(prepared, rig, fit_rate, contact)


def prepare_all(
    runs: Sequence[Record], rig: Rig, fit_rate: float | None
) -> list[PreparedRun]:
    """Runs with the input of their observations, once for all contact laws."""
    if not runs:
        raise IdentificationError('no runs to identify from: give at least one bag')
    refuse_repeats(runs)
    return [prepare(run, rig, fit_rate) for run in runs]


def observe_prepared(
    prepared: Sequence[PreparedRun], fit_rate: float | None
) -> list[Observation]:
    """Observations without the noise of the load cell."""
    noise = noise_of(prepared)
    return [
        _observe_dynamic(one, noise[number], fit_rate)
        if one.branch is None
        else _observe_static(one, noise[number])
        for number, one in enumerate(prepared)
    ]


def observe_with_cell(
    prepared: Sequence[PreparedRun], rig: Rig, fit_rate: float | None, contact: ContactParameters
) -> list[Observation]:
    """Observations with the noise of the load cell, evaluated at a first result."""
    explained = [one.explained_by(rig, contact) for one in prepared]
    observed = observe_prepared(explained, fit_rate)
    slow = slow_cell_noise(rig, contact, explained)
    return [
        replace(seen, load_errors=load_errors_of(rig, contact, one, seen, cell_noise(one, slow)))
        for one, seen in zip(explained, observed, strict=True)
    ]


def _observe_static(one: PreparedRun, noise: NoiseModel) -> Observation:
    measured, plateaus = one.measured, one.plateaus
    assert plateaus is not None
    lasting = one.interval * np.array([stop - start for start, stop in one.rests], dtype=float)
    step = max(1, int(round(SETTLING_STEP / one.interval)),
               -(-len(measured.load) // MAX_SIMULATED))
    zero_error = _zero_error(one, noise)
    error = np.sqrt([channel.variances(lasting) for channel in noise.channels])
    return Observation(
        name=run_name(one.run), dynamic=False, elevation=float(one.run.elevation),
        time=plateaus.time, load=plateaus.load, zero_load=measured.zero.load,
        displacement=plateaus.displacement, branch=np.asarray(one.branch),
        whitening=tuple(
            build_whitener(channel, plateaus.time, lasting) for channel in noise.channels),
        correlation=noise.correlation, zero_error=zero_error,
        standard_error=np.hypot(error, zero_error[:, None]),
        fine_time=block_means(measured.time, step),
        fine_load=block_means(measured.load, step), spans=_grid_spans(one, step),
    )


def _grid_spans(one: PreparedRun, size: int) -> NDArray[np.intp]:
    """Start and stop (N, 2) of each plateau among blocks of `size` samples, at least one each."""
    blocks = len(one.measured.load) // size
    edges = np.array(one.rests, dtype=np.intp)
    starts = np.minimum(-(-edges[:, 0] // size), blocks - 1)
    return np.stack([starts, np.maximum(edges[:, 1] // size, starts + 1)], axis=1)


def _observe_dynamic(
    one: PreparedRun, noise: NoiseModel, fit_rate: float | None
) -> Observation:
    measured = one.measured
    good = np.all(np.isfinite(one.displacement), axis=0)
    first, last = int(np.argmax(good)), len(good) - int(np.argmax(good[::-1]))
    span = slice(first, last)
    size, per_block = block_sizes(one.interval, last - first, fit_rate)
    time, load = measured.time[span], measured.load[span]
    means = block_means(one.displacement[:, span], size)
    displacement, middle = filled(means), block_means(time, size)
    samples = displacement.shape[1]
    lasting = np.full(samples, size * one.interval)
    zero_error = _zero_error(one, noise)
    error = np.sqrt([channel.variances(lasting) for channel in noise.channels])
    fine = samples * per_block
    mean_load = block_means(load, size)
    return Observation(
        name=run_name(one.run), dynamic=True, elevation=float(one.run.elevation),
        time=middle, load=mean_load, zero_load=measured.zero.load,
        displacement=displacement, branch=np.sign(np.gradient(mean_load)),
        whitening=tuple(
            build_whitener(channel, middle, lasting, present=np.isfinite(row))
            for channel, row in zip(noise.channels, means, strict=True)
        ),
        correlation=noise.correlation, zero_error=zero_error,
        standard_error=np.hypot(error, zero_error[:, None]),
        fine_time=block_means(time, size // per_block)[:fine],
        fine_load=block_means(one.load[span], size // per_block)[:fine],
        per_block=per_block, doubtful_lag=one.run.doubtful_lag,
    )


def _zero_error(one: PreparedRun, noise: NoiseModel) -> Array:
    """Standard deviation (3,) of the zero, a mean over its window."""
    zero = one.measured.zero
    lasting = one.interval * max(1, zero.end - zero.start)
    return np.array([channel.deviation(lasting) for channel in noise.channels])
