"""Families of shapes of an unknown cause, each in one coordinate.

A family has columns for every run and a penalty on their coefficients: smooth curves in load,
rate, time and angle, curves that change sign with the direction, relaxations, and play operators.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from saddlering_ros.discrepancy.proposal.memory import relaxations, stop_operators
from saddlering_ros.discrepancy.proposal.misfit import (
    ANGLE,
    DIRECTION,
    HYSTERESIS,
    LOAD,
    ObservedRun,
    RATE,
    TIME,
)
from saddlering_ros.discrepancy.system import Array

LOAD_PIECES, DIRECTION_PIECES, RATE_PIECES, TIME_PIECES, ANGLE_WAVES = 32, 12, 10, 24, 8
PLAYS = 10
REACHES = (0.004, 0.5)
"""Smallest and largest half width of a play, as shares of the range of the load."""
LAGS = 8


@dataclass(frozen=True)
class ShapeFamily:
    """One family of shapes: columns (N, k) by run, penalty (k, k) on their roughness.

    span: the range of the coordinate seen. non_negative: all coefficients have one sign.
    """

    coordinate: str
    kind: str
    shapes: tuple[Array, ...]
    penalty: Array
    span: tuple[float, float]
    non_negative: bool = False
    settings: Mapping[str, Array] | None = None


@dataclass(frozen=True)
class Spline:
    """Cubic B-splines with even knots over [low, high]; constant outside."""

    low: float
    high: float
    pieces: int

    @property
    def size(self) -> int:
        return self.pieces + 3

    def values(self, at: Array) -> Array:
        """(N, size)."""
        from scipy.interpolate import BSpline  # late: most diagnoses propose no law

        step = (self.high - self.low) / self.pieces
        knots = self.low + step * np.arange(-3, self.pieces + 4)
        inside = np.clip(at, self.low, self.high - 1e-9 * (self.high - self.low))
        return np.asarray(BSpline.design_matrix(inside, knots, 3).toarray())

    def roughness(self) -> Array:
        """Penalty on second differences of the coefficients."""
        second = np.diff(np.eye(self.size), 2, axis=0)
        return np.asarray(second.T @ second)


def span_of(runs: Sequence[ObservedRun], name: str) -> tuple[float, float]:
    """Range of a coordinate over the runs."""
    return (
        min(float(run.coordinates[name].min()) for run in runs),
        max(float(run.coordinates[name].max()) for run in runs),
    )


def blocks_of(runs: tuple[ObservedRun, ...]) -> list[ShapeFamily]:
    """Every family that these runs can show."""
    blocks = [_curve(runs, LOAD, LOAD_PIECES), _hysteresis(runs)]
    names = set.intersection(*(set(run.coordinates) for run in runs))
    if DIRECTION in names and any(np.ptp(run.coordinates[DIRECTION]) > 0.0 for run in runs):
        blocks.append(_direction(runs))
    if RATE in names and span_of(runs, RATE)[0] < span_of(runs, RATE)[1]:
        blocks += [_curve(runs, RATE, RATE_PIECES), _relaxation(runs)]
    blocks.append(_curve(runs, TIME, TIME_PIECES))
    if ANGLE in names:
        blocks.append(_angle(runs))
    known = {LOAD, DIRECTION, RATE, TIME, ANGLE}
    return blocks + [_curve(runs, name, LOAD_PIECES // 2) for name in sorted(names - known)]


def _curve(runs: tuple[ObservedRun, ...], name: str, pieces: int) -> ShapeFamily:
    low, high = span_of(runs, name)
    spline = Spline(low, high, pieces)
    shapes = tuple(spline.values(run.coordinates[name]) for run in runs)
    return ShapeFamily(name, 'curve', shapes, spline.roughness(), (low, high))


def _direction(runs: tuple[ObservedRun, ...]) -> ShapeFamily:
    low, high = span_of(runs, LOAD)
    spline = Spline(low, high, DIRECTION_PIECES)
    shapes = tuple(
        run.coordinates[DIRECTION][:, None] * spline.values(run.coordinates[LOAD]) for run in runs
    )
    return ShapeFamily(DIRECTION, 'curve', shapes, spline.roughness(), (low, high))


def _hysteresis(runs: tuple[ObservedRun, ...]) -> ShapeFamily:
    low, high = span_of(runs, LOAD)
    reaches = np.geomspace(*REACHES, PLAYS) * (high - low)
    shapes = tuple(stop_operators(run.coordinates[LOAD], reaches) / reaches for run in runs)
    settings = {'reaches': reaches}
    return ShapeFamily(HYSTERESIS, 'plays', shapes, np.eye(PLAYS), (low, high), True, settings)


def _relaxation(runs: tuple[ObservedRun, ...]) -> ShapeFamily:
    low, high = span_of(runs, LOAD)
    step = min(float(np.median(np.diff(run.coordinates[TIME]))) for run in runs)
    longest = max(float(np.ptp(run.coordinates[TIME])) for run in runs)
    constants = np.geomspace(2.0 * step, max(0.5 * longest, 4.0 * step), LAGS)
    shapes = tuple(
        relaxations(run.coordinates[TIME], run.coordinates[LOAD], constants) / (high - low)
        for run in runs
    )
    settings = {'constants': constants}
    return ShapeFamily(RATE, 'relaxation', shapes, np.eye(LAGS), (low, high), False, settings)


def own_curves(runs: tuple[ObservedRun, ...]) -> ShapeFamily:
    """One curve over time for each run: a description that predicts no other run."""
    columns, penalty = [], np.zeros((0, 0))
    for number, run in enumerate(runs):
        time = run.coordinates[TIME]
        spline = Spline(float(time.min()), float(time.max()), TIME_PIECES)
        columns.append((number, spline.values(time)))
        own = spline.roughness()
        zero = np.zeros((penalty.shape[0], own.shape[0]))
        penalty = np.block([[penalty, zero], [zero.T, own]])
    width = penalty.shape[0] // len(runs)
    shapes = []
    for number, values in columns:
        shape = np.zeros((values.shape[0], penalty.shape[0]))
        shape[:, number * width : (number + 1) * width] = values
        shapes.append(shape)
    return ShapeFamily(TIME, 'own curve', tuple(shapes), penalty, span_of(runs, TIME))


def _angle(runs: tuple[ObservedRun, ...]) -> ShapeFamily:
    waves = np.arange(1, ANGLE_WAVES + 1)
    shapes = tuple(
        np.hstack(
            [np.cos(run.coordinates[ANGLE][:, None] * waves),
             np.sin(run.coordinates[ANGLE][:, None] * waves)]
        )
        for run in runs
    )
    penalty = np.diag(np.tile(waves.astype(np.float64) ** 4, 2))
    return ShapeFamily(ANGLE, 'harmonics', shapes, penalty, span_of(runs, ANGLE))
