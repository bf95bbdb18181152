"""What a figure needs of a run: measured and simulated channels, and what follows from them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import welch

from saddlering_ros.diagnosis.diagnose import RunFigures, Verdict
from saddlering_ros.rig import CHANNELS

Array = NDArray[np.float64]

LOAD_LEVELS = 25
"""Steps into which the load is divided where both branches are compared."""


@dataclass(frozen=True)
class RunCurves:
    """One run as a report shows it.

    time [s], load [N], direction (+1 load rises, -1 it falls), width [s] of the mean that a sample
    stands for: (N,) each; measured, before, after (4, N) [m, m, rad, m] in the order of CHANNELS:
    as measured, simulated by the contact law alone, and by the extended model (the same array
    where there is none); noise: rms noise of a sample by channel, in the channel's unit.
    """

    name: str
    test: str
    elevation_deg: float
    held_out: bool
    time: Array
    width: Array
    load: Array
    direction: Array
    measured: Array
    before: Array
    after: Array
    noise: Mapping[str, float]

    @property
    def label(self) -> str:
        """'static_50: static, 50°, kept back'."""
        role = 'kept back' if self.held_out else 'fitted'
        return f'{self.name} ({self.test}, {self.elevation_deg:g}°, {role})'

    @property
    def is_extended(self) -> bool:
        """Whether there is a second simulation to show."""
        return self.after is not self.before

    def residual(self, channel: str, *, extended: bool) -> Array:
        """Measured less simulated (N,)."""
        row = CHANNELS.index(channel)
        return np.asarray(self.measured[row] - (self.after if extended else self.before)[row])


@dataclass(frozen=True)
class Branches:
    """Both branches of a channel at M loads [N]: mean, and half-difference (up - down) / 2."""

    load: Array
    mean: Array
    half_difference: Array


def curves_of(verdict: Verdict) -> list[RunCurves]:
    """The runs of a diagnosis."""
    changed = verdict.diagnosis.after is not verdict.diagnosis.before
    return [_curves(figures, changed) for figures in verdict.runs]


def _curves(figures: RunFigures, changed: bool) -> RunCurves:
    run, test_run = figures.record.run, figures.record.test_run
    noise = {
        name: item.noise_floor * float(np.ptp(figures.measured[row]))
        for row, (name, item) in enumerate(figures.channels.items())
    }
    return RunCurves(
        name=run.name, test=test_run.test, elevation_deg=float(np.degrees(test_run.elevation)),
        held_out=run.held_out, time=run.time, width=run.width, load=run.inputs['load'],
        direction=run.inputs['direction'], measured=figures.measured, before=figures.before,
        after=figures.after if changed else figures.before, noise=noise,
    )


def branches(load: Array, direction: Array, values: Array) -> Branches:
    """Both branches compared, where both have samples at a load level."""
    span = max(float(np.ptp(load)), 1e-12)
    level = np.round((load - load.min()) / span * LOAD_LEVELS).astype(int)
    places, means, halves = [], [], []
    for number in range(LOAD_LEVELS + 1):
        here = level == number
        up, down = here & (direction > 0.0), here & (direction < 0.0)
        if not up.any() or not down.any():
            continue
        rising, falling = float(values[up].mean()), float(values[down].mean())
        places.append(float(load[here].mean()))
        means.append(0.5 * (rising + falling))
        halves.append(0.5 * (rising - falling))
    return Branches(np.array(places), np.array(means), np.array(halves))


def spectrum(time: Array, values: Array) -> tuple[Array, Array]:
    """Frequency [Hz] and amplitude density [unit/√Hz] of samples, put on an even grid first."""
    step = float(np.median(np.diff(time)))
    even = np.arange(time[0], time[-1] + 0.5 * step, step)
    filled = np.interp(even, time, values)
    frequency, density = welch(filled, 1.0 / step, nperseg=min(256, filled.size // 2))
    return np.asarray(frequency[1:]), np.asarray(np.sqrt(density[1:]))
