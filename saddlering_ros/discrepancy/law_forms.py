"""Forms of the law of an effect: mixtures of the law with others of its kind, and bent laws.

A real law differs from the idealised law of the catalogue. A film creeps with several time
constants, joints slip at several loads: such a law is a mixture of the same law with other values
of its shape. Other laws are bent: their change is that of the catalogue times a smooth shape over
load, highest load so far, direction, time, run or channel. Each form has a prior spread. The forms
compete with a second cause for the misfit that the idealised law leaves.
"""

from __future__ import annotations

import numpy as np

from saddlering_ros.discrepancy.candidate import Fit
from saddlering_ros.discrepancy.experiment import Experiment
from saddlering_ros.discrepancy.system import Array, Point, RunBlocks

LOAD_WAVES = 4
"""Half waves over the drive by which a law may deviate."""

HIGHEST_WAVES = 2
"""The same over the highest drive so far, because joints remember it."""

OTHER_SHAPES = (-0.2, -0.1, 0.1, 0.2)
"""Distances to the other laws of a mixture, in ranges of a shape parameter."""

LAGS = (0.01, 0.05, 0.2)
"""Delays of the change of a law, as shares of the duration of a run."""


def form_columns(experiment: Experiment, fit: Fit, form_error: float) -> Array:
    """Columns (n, k), each one standard deviation, for every effect of a fit.

    form_error: share of the square of the change of an effect by which its law errs in total.
    """
    columns = []
    mixtures = _mixtures(experiment, fit)
    for change, mixed in zip(changes_of_effects(experiment, fit).T, mixtures, strict=True):
        bent = [
            np.concatenate([part.ravel() for part in item])
            for item in _shapes(experiment, experiment.by_run(change))
        ]
        shaped = [*bent, *mixed]
        scale = np.sqrt(form_error / len(shaped))
        columns += [scale * item for item in shaped]
    return np.array(columns).reshape(-1, experiment.size).T


def _mixtures(experiment: Experiment, fit: Fit) -> list[list[Array]]:
    """By effect, the changes (n,) if the law had other values of one of its shape parameters."""
    base = experiment.system.base_parameters
    owners, points = [], []
    for number, (effect, _, part) in enumerate(fit.candidate.slices(len(base))):
        shapes = range(part.start + 1, part.stop)
        for index, item in zip(shapes, effect.ordered[1:], strict=True):
            for apart in OTHER_SHAPES:
                moved = fit.theta_unit.copy()
                moved[index] = moved[index] + apart
                if item.periodic or 0.0 <= moved[index] <= 1.0:
                    owners.append(number)
                    points.append(fit.candidate.point(base, moved))
    found: list[list[Array]] = [[] for _ in fit.candidate.effects]
    if points:
        changes = experiment.predict(points) - fit.prediction[:, None]
        for owner, change in zip(owners, changes.T, strict=True):
            if np.isfinite(change).all():
                found[owner].append(change)
    return found


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
    highest = [np.maximum.accumulate(place) for place in places]
    found += [
        [part * np.cos(np.pi * wave * place) for part, place in zip(change, highest, strict=True)]
        for wave in range(1, HIGHEST_WAVES + 1)
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
