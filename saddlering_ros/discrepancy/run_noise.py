"""Noise of every run and channel, learnt from the stretches at rest of runs sampled alike."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from saddlering_ros.discrepancy.noise import (
    ChannelNoise,
    HeldSeries,
    measure_noise,
    TIME_CONSTANTS,
)
from saddlering_ros.discrepancy.system import Array, DiscrepancyError, RunBlocks
from saddlering_ros.estimation.rest import RestSegment

SEEN_SHARE = 0.25
"""A stretch at rest shows noise of time constants up to this share of its length."""

FEW_STRETCHES = 10
"""Fewer stretches at rest than this tell nothing of noise slower than themselves."""


def learn_noise(
    runs: Sequence[RunBlocks], residuals: Sequence[Array] | None = None
) -> dict[tuple[str, int], ChannelNoise]:
    """Noise by run name and channel; runs sampled alike share what is learnt from all of them.

    `residuals` (C, N) per run, once there are some, tell the noise from hold to hold.
    """
    classes: dict[int, list[RestSegment]] = {}
    series: dict[int, list[HeldSeries]] = {}
    for number, run in enumerate(runs):
        for segment in run.rest:
            classes.setdefault(_sampling(run), []).append(segment)
        held = None if residuals is None else _held_series(run, residuals[number])
        if held is not None:
            series.setdefault(_sampling(run), []).append(held)
    if not classes:
        raise DiscrepancyError('noise: no stretch at rest in any run; hold the load somewhere')
    count = runs[0].channels.shape[0]
    usable = {
        key: segments
        for key, segments in classes.items()
        if sum(segment.values.shape[1] for segment in segments) >= 16
    }
    if not usable:
        raise DiscrepancyError('noise: the stretches at rest are too short to learn from')
    # Slow noise is a matter of the instrument, not of the rate: take it from who saw most of it.
    richest = max(usable, key=lambda key: len(usable[key]))
    learnt = {
        key: measure_noise(
            segments,
            count,
            series.get(key, ()),
            np.inf if key == richest else _longest_seen(segments),
        )
        for key, segments in usable.items()
    }
    if richest not in series and len(usable[richest]) < FEW_STRETCHES:
        learnt[richest] = [_going_on(item, usable[richest]) for item in learnt[richest]]
    for key in learnt:
        learnt[key] = [
            replace(
                own,
                slow=np.maximum(own.slow, np.where(TIME_CONSTANTS >= 0.3, best.slow, 0.0)),
            )
            for own, best in zip(learnt[key], learnt[richest], strict=True)
        ]
    noise: dict[tuple[str, int], ChannelNoise] = {}
    for run in runs:
        own = _sampling(run)
        key = own if own in learnt else next(iter(learnt))
        for channel in range(count):
            noise[run.name, channel] = learnt[key][channel]
    return noise


def _longest_seen(segments: Sequence[RestSegment]) -> float:
    """Time constant [s] up to which stretches at rest tell noise from a trend."""
    return SEEN_SHARE * max(segment.step * segment.values.shape[1] for segment in segments)


def _going_on(noise: ChannelNoise, segments: Sequence[RestSegment]) -> ChannelNoise:
    """Noise that at times longer than any stretch at rest is as large as at the longest seen."""
    span = max(segment.step * segment.values.shape[1] for segment in segments)
    longest = noise.deviation(0.25 * span) ** 2
    slow = np.where(span < TIME_CONSTANTS, np.maximum(noise.slow, longest), noise.slow)
    return replace(noise, slow=slow)


def _sampling(run: RunBlocks) -> int:
    """Class of sampling rates a run belongs to; -1 for one without rest."""
    return round(20 * np.log10(run.rest[0].step)) if run.rest else -1


def _held_series(run: RunBlocks, residual: Array) -> HeldSeries | None:
    """Means of a residual over consecutive holds, if the run is made of holds."""
    hold = run.inputs.get('hold')
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
