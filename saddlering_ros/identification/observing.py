"""From test runs to observations: readings, their noise, and the load cell's part in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.bags import refuse_repeats, TestRun
from saddlering_ros.estimation.blocks import block_means, filled
from saddlering_ros.estimation.whitening import Whitening
from saddlering_ros.identification.checks import run_name
from saddlering_ros.identification.errors import IdentificationError
from saddlering_ros.identification.load_cell import cell_noise, load_errors_of, slow_cell_noise
from saddlering_ros.identification.observation import Observation
from saddlering_ros.identification.prepared import (
    block_sizes,
    noise_on_grid,
    prepare,
    PreparedRun,
)
from saddlering_ros.rig import ContactParameters, Rig

SETTLING_STEP = 0.1
"""Step [s] in which a static run is simulated where the rings' settling counts."""


def observe(
    runs: Sequence[TestRun], rig: Rig, *, fit_rate: float | None,
    contact: ContactParameters | None = None,
) -> list[Observation]:
    """Observations of runs; IdentificationError where a run cannot be used to identify.

    The noise is estimated from all runs of one sampling rate together. contact: a first finding,
    by which the load cell's noise is followed as a damped ring follows it; else it is taken to
    follow at once, in proportion.
    """
    if not runs:
        raise IdentificationError('no runs to identify from: give at least one bag')
    refuse_repeats(runs)
    prepared = [prepare(run, rig, fit_rate, contact) for run in runs]
    observed = [
        _observe_dynamic(one, prepared, fit_rate)
        if one.branch is None
        else _observe_static(one, prepared, fit_rate)
        for one in prepared
    ]
    if contact is None:
        return observed
    slow = slow_cell_noise(rig, contact, prepared)
    return [
        replace(seen, load_errors=load_errors_of(rig, contact, one, seen, cell_noise(one, slow)))
        for one, seen in zip(prepared, observed, strict=True)
    ]


def _observe_static(
    one: PreparedRun, runs: Sequence[PreparedRun], fit_rate: float | None
) -> Observation:
    size, _ = block_sizes(one.interval, 1, fit_rate or 50.0)
    noise = noise_on_grid(runs, one, size)
    measured = one.measured
    spans = [slice(start, stop) for start, stop in one.rests]
    displacement = np.stack(
        [np.nanmean(one.displacement[:, span], axis=1) for span in spans], axis=1
    )
    counts = [max(1, (stop - start) // size) for start, stop in one.rests]
    load = np.array([float(np.nanmean(measured.load[span])) for span in spans])
    time = np.array([float(np.mean(measured.time[span])) for span in spans])
    blocks = _zero_blocks(one, size)
    step = max(1, int(round(SETTLING_STEP / one.interval)))
    whitening = []
    error = []
    for channel in noise.channels:
        own = channel.covariance_of_means(time, counts)
        common = channel.variance_of_mean(blocks)
        whitening.append(Whitening.of_covariance(own, common))
        error.append(np.sqrt(np.diag(own) + common))
    return Observation(
        name=run_name(one.run), dynamic=False, elevation=float(one.run.elevation),
        time=time, load=load, zero_load=measured.zero.load,
        displacement=displacement, branch=np.asarray(one.branch),
        whitening=tuple(whitening), correlation=noise.correlation,
        standard_error=np.stack(error), fine_time=block_means(measured.time, step),
        fine_load=block_means(measured.load, step), spans=_grid_spans(one, step),
    )


def _grid_spans(one: PreparedRun, size: int) -> NDArray[np.intp]:
    """Start and stop (N, 2) of each plateau among blocks of `size` samples, at least one each."""
    blocks = len(one.measured.load) // size
    edges = np.array(one.rests, dtype=np.intp)
    starts = np.minimum(-(-edges[:, 0] // size), blocks - 1)
    return np.stack([starts, np.maximum(edges[:, 1] // size, starts + 1)], axis=1)


def _observe_dynamic(
    one: PreparedRun, runs: Sequence[PreparedRun], fit_rate: float | None
) -> Observation:
    measured = one.measured
    good = np.all(np.isfinite(one.displacement), axis=0)
    first, last = int(np.argmax(good)), len(good) - int(np.argmax(good[::-1]))
    span = slice(first, last)
    size, per_block = block_sizes(one.interval, last - first, fit_rate)
    noise = noise_on_grid(runs, one, size)
    time, load = measured.time[span], measured.load[span]
    means = block_means(one.displacement[:, span], size)
    displacement = filled(means)
    samples = displacement.shape[1]
    blocks = _zero_blocks(one, size)
    common = [channel.variance_of_mean(blocks) for channel in noise.channels]
    error = [
        np.full(samples, np.hypot(channel.standard_deviation, np.sqrt(zero)))
        for channel, zero in zip(noise.channels, common, strict=True)
    ]
    fine = samples * per_block
    mean_load = block_means(load, size)
    return Observation(
        name=run_name(one.run), dynamic=True, elevation=float(one.run.elevation),
        time=block_means(time, size), load=mean_load, zero_load=measured.zero.load,
        displacement=displacement, branch=np.sign(np.gradient(mean_load)),
        whitening=tuple(
            Whitening.of_process(channel, samples, zero)
            for channel, zero in zip(noise.channels, common, strict=True)
        ),
        correlation=noise.correlation, standard_error=np.stack(error),
        fine_time=block_means(time, size // per_block)[:fine],
        fine_load=block_means(one.load[span], size // per_block)[:fine],
        per_block=per_block, doubtful_lag=one.run.doubtful_lag,
        weight=np.isfinite(means).astype(np.float64),
    )


def _zero_blocks(one: PreparedRun, size: int) -> int:
    return max(1, (one.measured.zero.end - one.measured.zero.start) // size)
