"""From recordings to the curves and figures that the demo shows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from saddlering_ros.diagnosis.wording import RunEntry
from saddlering_ros.record import Record
from saddlering_ros.report.curves import Array, curves_of_run, RunCurves
from saddlering_ros.rig import CHANNELS, ParameterSet, Rig
from saddlering_ros.ring import simulate

JUDGED = CHANNELS[:3]


def curves(
    run: Record, measured: Array, before: Array, after: Array, verdict: RunEntry | None,
    *, held_out: bool,
) -> RunCurves:
    """A run's curves from its channels (4, samples) at the load's stamps."""
    floors = {} if verdict is None else {
        name: item['noise_floor'] for name, item in verdict['channels'].items()}
    return curves_of_run(run, measured, before, after, floors, held_out=held_out)


def offline(run: Record, rig: Rig, parameters: ParameterSet) -> Array:
    """Simulated channels (4, samples) of a run, as published live; NaN before the zero."""
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


def misfit_table(runs: Sequence[RunCurves]) -> list[RunEntry]:
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
