"""Errors of the law of an effect: its change times smooth shapes.

The shapes lie over load, direction, time, run and channel. A real law differs from the idealised
law of the catalogue. Products of the change of the effect and smooth shapes, each with a prior
spread, describe the difference. If a misfit needs a further cause with these columns marginalised,
no form of the law explains it.
"""

from __future__ import annotations

import numpy as np

from saddlering_ros.discrepancy.candidate import Fit
from saddlering_ros.discrepancy.experiment import Experiment
from saddlering_ros.discrepancy.system import Array, Point, RunBlocks

LOAD_WAVES = 4
"""Half waves over the drive by which a law may deviate."""

LAGS = (0.01, 0.05, 0.2)
"""Delays of the change of a law, as shares of the duration of a run."""


def form_columns(experiment: Experiment, fit: Fit, form_error: float) -> Array:
    """Columns (n, k), each one standard deviation, for every effect of a fit.

    form_error: share of the square of the change of an effect by which its law errs in total.
    """
    columns = []
    for change in changes_of_effects(experiment, fit).T:
        shaped = _shapes(experiment, experiment.by_run(change))
        scale = np.sqrt(form_error / len(shaped))
        columns += [scale * np.concatenate([part.ravel() for part in item]) for item in shaped]
    return np.array(columns).reshape(-1, experiment.size).T


def changes_of_effects(experiment: Experiment, fit: Fit) -> Array:
    """Change (n, E) by each effect of a fit; 0 where the simulator fails."""
    effects = fit.point.effects
    points = [
        Point(fit.point.base, {name: values for name, values in effects.items() if name != less})
        for less in effects
    ]
    if not points:
        return np.zeros((experiment.size, 0))
    changes = fit.prediction[:, None] - experiment.predict(points)
    return np.asarray(np.where(np.isfinite(changes), changes, 0.0))


def _shapes(experiment: Experiment, change: list[Array]) -> list[list[Array]]:
    """The change of an effect (C, N) per run, times each shape."""
    runs = experiment.runs
    drives = [_drive(run) for run in runs]
    low = min(float(item.min()) for item in drives)
    high = max(float(item.max()) for item in drives)
    places = [(drive - low) / max(high - low, 1e-300) for drive in drives]
    found = [
        [part * np.cos(np.pi * wave * place) for part, place in zip(change, places, strict=True)]
        for wave in range(1, LOAD_WAVES + 1)
    ]
    found.append([
        part * (np.zeros(run.time.size) if run.direction is None else run.direction)
        for part, run in zip(change, runs, strict=True)
    ])
    for index in range(len(runs)):
        found.append([part * (number == index) for number, part in enumerate(change)])
    for channel in range(change[0].shape[0]):
        chosen = np.zeros((change[0].shape[0], 1))
        chosen[channel] = 1.0
        found.append([part * chosen for part in change])
    for lag in LAGS:
        found.append([
            _lagged(part, run, lag) - part for part, run in zip(change, runs, strict=True)
        ])
    return found


def _drive(run: RunBlocks) -> Array:
    """The first coordinate (N,), or time if a run has none."""
    return next(iter(run.inputs.values()), run.time - run.time[0])


def _lagged(change: Array, run: RunBlocks, lag: float) -> Array:
    """A change (C, N) delayed by a first-order lag of a share of the duration of the run."""
    slow = change.copy()
    decay = np.exp(-np.diff(run.time) / (lag * max(float(np.ptp(run.time)), 1e-300)))
    for number, kept in enumerate(decay, start=1):
        slow[:, number] = kept * slow[:, number - 1] + (1.0 - kept) * change[:, number]
    return slow
