"""Noise of every run and channel, learnt from stretches at rest of runs with equal sampling."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from saddlering_ros.discrepancy.noise import ChannelNoise, HeldSeries
from saddlering_ros.discrepancy.system import Array, DiscrepancyError, RunBlocks
from saddlering_ros.estimation.rest import RestSegment
from saddlering_ros.estimation.sampling_classes import noise_by_class, Quiet, sampling_class


def learn_noise(
    runs: Sequence[RunBlocks], residuals: Sequence[Array] | None = None
) -> dict[tuple[str, int], ChannelNoise]:
    """Noise by run name and channel; runs with equal sampling share one estimate.

    `residuals` (C, N) per run, if given, add the noise between holds.
    """
    segments: dict[int, list[RestSegment]] = {}
    series: dict[int, list[HeldSeries]] = {}
    for number, run in enumerate(runs):
        key = _sampling(run)
        if run.rest:
            segments.setdefault(key, []).extend(run.rest)
        held = None if residuals is None else _held_series(run, residuals[number])
        if held is not None:
            series.setdefault(key, []).append(held)
    if not segments:
        raise DiscrepancyError(
            'noise: no stretch at rest in any run: record one in which the input is held'
        )
    classes = {key: Quiet(rest, series.get(key, ())) for key, rest in segments.items()}
    count = runs[0].channels.shape[0]
    learnt = noise_by_class(classes, count)
    first = next(iter(learnt.values()))
    return {
        (run.name, channel): learnt.get(_sampling(run), first)[channel]
        for run in runs for channel in range(count)
    }


def _sampling(run: RunBlocks) -> int:
    """Class of the sampling rate of a run; -1 for a run without rest."""
    return sampling_class(run.rest[0].step) if run.rest else -1


def _held_series(run: RunBlocks, residual: Array) -> HeldSeries | None:
    """Means of a residual over consecutive holds, if the run is made of holds."""
    hold = run.hold
    if hold is None:
        return None
    levels, place = np.unique(hold, return_inverse=True)
    if levels.size < 8 or levels.size > 0.6 * hold.size:
        return None
    weight = np.bincount(place, run.width)
    time = np.bincount(place, run.width * run.time) / weight
    order = np.argsort(time)
    means = np.array([np.bincount(place, run.width * row) / weight for row in residual])
    return HeldSeries(means[:, order], time[order], weight[order].astype(np.float64))
