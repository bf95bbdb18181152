"""From recordings to the curves and figures that the demo shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.bags import plateaus, TestRun
from saddlering_ros.demo.plan import elevation_of
from saddlering_ros.report.curves import Array, RunCurves
from saddlering_ros.rig import CHANNELS, ParameterSet, Rig
from saddlering_ros.ring import simulate

BLOCKS = 500
"""A dynamic run is shown as at most so many means."""

JUDGED = CHANNELS[:3]


@dataclass(frozen=True)
class Means:
    """How one run's samples are averaged: plateaus, or equal blocks; N means.

    start, stop (N,) count the run's load samples; direction (N,) +1 load rises, -1 it falls.
    """

    start: NDArray[np.int64]
    stop: NDArray[np.int64]
    direction: Array

    def of(self, values: Array) -> Array:
        """Means (..., N) of values (..., samples), NaN samples left out."""
        return np.stack([_mean(values[..., a:b])
                         for a, b in zip(self.start, self.stop, strict=True)], axis=-1)


def _mean(values: Array) -> Array:
    """Mean over the last axis of what is finite; NaN where nothing is."""
    good = np.isfinite(values)
    count = good.sum(axis=-1)
    total = np.where(good, values, 0.0).sum(axis=-1)
    return np.asarray(np.where(count > 0, total / np.maximum(count, 1), np.nan))


def means_of(run: TestRun) -> Means:
    """Plateaus of a static run, equal blocks of a dynamic one."""
    if run.test == 'static':
        found = plateaus(run)
        return Means(found.start, found.stop, _carried(found.branch.astype(float)))
    edges = np.linspace(0, len(run.time), min(BLOCKS, len(run.time) // 4) + 1).astype(int)
    load = np.array([run.load[a:b].mean() for a, b in pairwise(edges.tolist())])
    top = int(np.argmax(load))
    direction = np.where(np.arange(load.size) <= top, 1.0, -1.0)
    return Means(edges[:-1], edges[1:], direction)


def _carried(branch: Array) -> Array:
    for index in range(branch.size):
        if branch[index] == 0.0:
            branch[index] = branch[index - 1] if index else 1.0
    return branch


def curves(
    run: TestRun, measured: Array, before: Array, after: Array, verdict: Mapping[str, Any] | None,
    *, held_out: bool,
) -> RunCurves:
    """A run's curves from its channels (4, samples) at the load's stamps."""
    means = means_of(run)
    seen, first, last = (means.of(item) for item in (measured, before, after))
    good = np.isfinite(seen + first + last).all(axis=0)
    widths = means.of(np.gradient(run.time)) * (means.stop - means.start)
    noise = dict.fromkeys(CHANNELS, 0.0)
    if verdict is not None:
        noise = {name: item['noise_floor'] * float(np.ptp(seen[row][good]))
                 for row, (name, item) in enumerate(verdict['channels'].items())}
    return RunCurves(
        name=run.path.name, test=run.test, elevation_deg=elevation_of(run), held_out=held_out,
        time=means.of(run.time)[good], width=widths[good], load=means.of(run.load)[good],
        direction=means.direction[good], measured=seen[:, good], before=first[:, good],
        after=last[:, good], noise=noise,
    )


def offline(run: TestRun, rig: Rig, parameters: ParameterSet) -> Array:
    """Simulated channels (4, samples) of a run, NaN before its zero: what the live node gives."""
    found = simulate(rig, parameters, run.elevation, run.time, run.load)
    channels = np.full((len(CHANNELS), len(run.time)), np.nan)
    stop = found.first + len(found.time)
    for row, name in enumerate(CHANNELS):
        channels[row, found.first:stop] = getattr(found.displacement, name)
    return channels


def misfit(run: RunCurves, channel: str, *, extended: bool) -> float:
    """Rms misfit as a share of the channel's measured range."""
    values = run.measured[CHANNELS.index(channel)]
    residual = run.residual(channel, extended=extended)
    return float(np.sqrt(np.mean(residual**2)) / max(float(np.ptp(values)), 1e-12))


def overall(runs: Sequence[RunCurves], *, extended: bool) -> float:
    """Root mean square of the misfits over runs and channels."""
    parts = [misfit(run, name, extended=extended) ** 2 for run in runs for name in JUDGED]
    return float(np.sqrt(np.mean(parts)))


def misfit_table(runs: Sequence[RunCurves]) -> list[dict[str, Any]]:
    """The misfits as a verdict's `runs` have them."""
    return [
        {'bag': run.name, 'test': run.test, 'elevation_deg': run.elevation_deg,
         'held_out': run.held_out, 'channels': {
             name: {'nrmse_before': misfit(run, name, extended=False),
                    'nrmse_after': misfit(run, name, extended=True),
                    'noise_floor': run.noise[name] / max(float(np.ptp(run.measured[row])), 1e-12)}
             for row, name in enumerate(CHANNELS)}}
        for run in runs
    ]
