"""The curves of a run as figures and the CSV file beside a report show them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.diagnosis.verdict import Verdict
from saddlering_ros.record import plateaus, Record
from saddlering_ros.rig import CHANNELS, FORCE_UNITS

Array = NDArray[np.float64]

BLOCKS = 500
"""Largest number of means by which a dynamic run is shown."""

LOAD_LEVELS = 25
"""Steps into which the load is divided where both branches are compared."""


@dataclass(frozen=True)
class RunCurves:
    """One run as a report shows it.

    time [s], load [N], direction (+1 load rises, -1 it falls), width [s] of the mean that a sample
    stands for: (N,) each; measured, before, after (4, N) [m, m, rad, m] in the order of CHANNELS:
    as measured, simulated by the contact law alone, and by the extended model (the same array
    where there is none); noise: rms noise of a sample by channel, in the channel's unit; sound:
    the same with small errors of a sound ring, where they are known; force_unit: unit in which
    loads are shown, that of the rig file.
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
    force_unit: str = 't'
    sound: Mapping[str, float] = field(default_factory=dict)

    @property
    def load_in_unit(self) -> Array:
        """The load (N,) in `force_unit`."""
        return np.asarray(self.load / FORCE_UNITS[self.force_unit])

    @property
    def label(self) -> str:
        """'static_50: static, 50°, held out'."""
        role = 'held out' if self.held_out else 'fitted'
        return f'{self.name} ({self.test}, {self.elevation_deg:g}°, {role})'

    @property
    def is_extended(self) -> bool:
        """Whether there is a second simulation to show."""
        return self.after is not self.before

    def residual(self, channel: str, *, extended: bool) -> Array:
        """Measured minus simulated (N,)."""
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
    changed = verdict.diagnosis.fits.after is not verdict.diagnosis.fits.before
    found = []
    for figures in verdict.runs:
        run, test_run = figures.record.run, figures.record.test_run
        spans = dict(zip(figures.channels, np.ptp(figures.measured, axis=1), strict=False))
        noise = {name: item.noise_floor * float(spans[name])
                 for name, item in figures.channels.items()}
        found.append(RunCurves(
            name=run.name, test=test_run.test, held_out=run.held_out, time=run.time,
            elevation_deg=float(np.degrees(test_run.elevation)), width=run.width,
            load=run.inputs['load'], measured=figures.measured, before=figures.before,
            direction=np.ones(run.time.size) if run.direction is None else run.direction,
            after=figures.after if changed else figures.before, noise=noise,
            force_unit=verdict.rig.force_unit,
            sound={name: float(np.hypot(noise[name], item.sound * spans[name]))
                   for name, item in figures.channels.items() if item.sound}))
    return found


def curves_of_run(
    run: Record, measured: Array, before: Array, after: Array, floors: Mapping[str, float | None],
    *, held_out: bool, force_unit: str = 't',
) -> RunCurves:
    """A run's curves from its channels (4, samples) at the load's stamps.

    A static run is shown by the means of its plateaus, a dynamic one by those of equal blocks.
    floors: noise floor by channel as a share of the channel's measured range; 0 where missing.
    """
    if run.test == 'static':
        holds = plateaus(run)
        edges = list(zip(holds.start, holds.stop, strict=True))
        direction = holds.branch.astype(float)
        for index in np.flatnonzero(direction == 0.0):  # at the peak and at the ends
            direction[index] = direction[index - 1] if index else 1.0
    else:
        places = np.linspace(0, len(run.time), min(BLOCKS, len(run.time) // 4) + 1).astype(int)
        edges = list(pairwise(places.tolist()))
        top = int(np.argmax([run.load[start:stop].mean() for start, stop in edges]))
        direction = np.where(np.arange(len(edges)) <= top, 1.0, -1.0)

    def means(values: Array) -> Array:
        """Means (..., N) of values (..., samples); NaN samples left out."""
        sums = [np.nansum(values[..., start:stop], axis=-1) for start, stop in edges]
        counts = [np.isfinite(values[..., start:stop]).sum(axis=-1) for start, stop in edges]
        total, count = np.stack(sums, axis=-1), np.stack(counts, axis=-1)
        return np.asarray(np.where(count > 0, total / np.maximum(count, 1), np.nan))

    seen, first = means(measured), means(before)
    last = first if after is before else means(after)
    there = np.isfinite(seen).any(axis=1)  # The parity is unknown if a probe is absent.
    good = np.isfinite(seen + first + last)[there].all(axis=0)
    widths = means(np.gradient(run.time)) * [stop - start for start, stop in edges]
    noise = {name: (floors.get(name) or 0.0) * float(np.ptp(seen[row][good]))
             for row, name in enumerate(CHANNELS)}
    shown = first[:, good]
    return RunCurves(
        name=run.path.name, test=run.test,
        elevation_deg=round(float(np.degrees(run.elevation)), 2), held_out=held_out,
        time=means(run.time)[good], width=widths[good], load=means(run.load)[good],
        direction=direction[good], measured=seen[:, good], before=shown,
        after=shown if last is first else last[:, good], noise=noise, force_unit=force_unit,
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
    """Frequency [Hz] and amplitude density [unit/√Hz] of samples, put on an even grid first.

    By Welch's method: segments that overlap by half, each without its mean and under a Hann
    window. By hand, because scipy.signal takes a second to import.
    """
    step = float(np.median(np.diff(time)))
    even = np.arange(time[0], time[-1] + 0.5 * step, step)
    filled = np.interp(even, time, values)
    count = min(256, filled.size // 2)
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(count) / count)
    segments = np.lib.stride_tricks.sliding_window_view(filled, count)[::count - count // 2]
    segments = segments - segments.mean(axis=1, keepdims=True)
    power = np.abs(np.fft.rfft(window * segments)) ** 2
    density = power.mean(axis=0) * step / (window**2).sum()
    density[1:(count + 1) // 2] *= 2.0
    return np.asarray(np.fft.rfftfreq(count, step)[1:]), np.asarray(np.sqrt(density[1:]))


FACTS = ('bag', 'test', 'elevation_deg', 'held_out', 'time_s', 'load_N', 'direction')
"""Columns of the CSV file that are no curves."""


def curves_path(report: Path | str) -> Path:
    """'report_curves.csv' for 'report.html'."""
    path = Path(report)
    return path.with_name(f'{path.stem}_curves.csv')


def curve_columns(curves: Sequence[RunCurves]) -> dict[str, list[Any]]:
    """Every run's curves as one table, one row per sample.

    Columns: FACTS, then each channel measured, simulated by the contact law alone and, if any run
    has it, by the extended model: [m], gamma [rad].
    """
    versions = {'measured': 'measured', 'simulated': 'before'}
    if any(run.is_extended for run in curves):
        versions['simulated_extended'] = 'after'
    columns: dict[str, list[Any]] = {name: [] for name in (
        *FACTS, *(f'{name}_{kind}' for kind in versions for name in CHANNELS))}
    for run in curves:
        same = (run.name, run.test, run.elevation_deg, int(run.held_out))
        for name, value in zip(FACTS, same, strict=False):
            columns[name] += [value] * run.time.size
        for name, values in zip(FACTS[len(same):], (
                run.time, run.load, run.direction.astype(int)), strict=True):
            columns[name] += values.tolist()
        for kind, attribute in versions.items():
            for name, row in zip(CHANNELS, getattr(run, attribute), strict=True):
                columns[f'{name}_{kind}'] += row.tolist()
    return columns
