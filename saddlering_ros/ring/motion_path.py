"""A simulated motion with all its steps, and its derivatives along these steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.ring.kernels import courses, integration, tangents
from saddlering_ros.ring.kernels.recording import record_width
from saddlering_ros.ring.kernels.row_tangents import LAW
from saddlering_ros.ring.model import EXTENSION_FIELDS, MODEL, Model, Rows

Floats = NDArray[np.float64]


def _columns(*names: str) -> list[int]:
    """Indices of fields of the model's record, with all their parts, in its row of floats."""
    places: list[int] = []
    for name in names:
        kind, start = MODEL.fields[name][:2]  # type: ignore[index]
        places += range(start // 8, (start + kind.itemsize) // 8)
    return places


K, N, D = (_columns(a, a, b) for a, b in (('K1', 'K2'), ('n1', 'n2'), ('D1', 'D2')))
"""Indices of K, n and D of the upper, the lower and the radial row."""

FACTORS = _columns('upper_row_stiffness', 'lower_row_stiffness', 'radial_row_stiffness')
GROWTH = _columns('damping_penetration_share', 'damping_penetration_exponent',
                  'damping_penetration_saturation')
FRICTIONS = _columns('radial_friction', 'axial_friction', 'tilt_friction')
LOADS = _columns('cosine', 'sine', *(part[0] for part, stage, _ in EXTENSION_FIELDS
                                     if stage == 'load path'))


@dataclass(frozen=True)
class MotionPath:
    """Steps of a simulation: time and load (M,), motion (M, 3), indices of the samples, readings.

    The first step is the rest at the zero. Readings (N, 4). records (M, width): sums over the
    rollers at each step, from which its tangents follow (kernels/recording.py).
    """

    time: Floats
    load: Floats
    motion: Floats
    samples: NDArray[np.intp]
    readings: Floats
    records: Floats

    def read_by(self, model: Model, zero_load: float, time: Floats, load: Floats) -> MotionPath:
        """The same motion as read by a model with other additions; NaN if steps failed."""
        readings = np.empty((time.size, 4))
        courses.read_course(model, zero_load, time, load, self.motion[self.samples], readings)
        if not np.isfinite(self.readings).all():
            readings[:] = np.nan
        return replace(self, readings=readings)


def simulate_path(model: Model, rows: Rows, time: Floats, load: Floats, zero_load: float,
                  max_step: float, grows: bool = False) -> MotionPath:
    """A run of a model (1,), and the motion at every step of the simulator.

    grows: tangents by parameters of growing damping will be asked for.
    """
    grows = grows or bool(model['damping_penetration_share'][0])
    width = record_width(grows)
    motion, readings = np.empty((time.size, 3)), np.empty((time.size, 4))
    room = 2 + int(np.maximum(1.0, np.ceil(np.diff(time) / max_step)).sum())
    while True:
        record = np.empty((room, width))
        integration.run_recorded(model, rows.flat, rows.uniform, time, load, zero_load, max_step,
                                 motion, readings, record, grows)
        steps = int(record[0, 0])
        if steps < room:
            break
        room = steps + 1
    step_time, step_load = np.empty(steps + 1), np.empty(steps + 1)
    moved = np.empty((steps + 1, 3))
    samples = np.empty(time.size, dtype=np.intp)
    step_load[0], moved[0] = zero_load, motion[0]
    courses.steps_of_record(record, time, max_step, step_time, step_load, moved, samples)
    return MotionPath(step_time, step_load, moved, samples, readings, record[:steps + 1])


def tangents_along(model: Model, rows: Rows, law: Floats, external: Floats, friction: Floats,
                   geometry: Sequence[Floats], path: MotionPath) -> Floats:
    """Changes (M, 3, P) at every step; NaN if that fails. See `tangents.motion_tangents`.

    rows: those to which `geometry` belongs.
    """
    changes = np.empty((path.time.size, 3, law.shape[2]))
    rollers = np.array(geometry) if geometry else np.empty((0, rows.flat.size))
    if not tangents.motion_tangents(model, rows.flat, law, external, friction, rollers,
                                    path.records, path.time, path.motion, changes):
        changes[:] = np.nan
    return changes


def external_along(model: Model, zero_load: float, path: MotionPath) -> Floats:
    """Force and moment on the ring (M, 3) at every step."""
    external = np.empty((path.time.size, 3))
    courses.load_course(model, zero_load, path.load, external)
    return external


def floats(model: Model) -> Floats:
    """Records (B,) as rows of numbers (B, M)."""
    return model.view(np.float64).reshape(model.size, MODEL.itemsize // 8)


def laws_of(models: Floats) -> Floats:
    """Laws (B, 3, LAW) of upper, lower and radial row; an exponent of 0 means n of the row."""
    share, exponent, saturation = (models[:, [place] * 3] for place in GROWTH)
    exponent = np.where(exponent > 0.0, exponent, models[:, N])
    return np.stack([models[:, K] * models[:, FACTORS], models[:, N], models[:, D], share,
                     exponent, saturation], axis=-1)


def unit_laws(model: Model) -> Floats:
    """Change (3, LAW, 6) of the rows' laws by one unit of each contact parameter."""
    factors = floats(model)[0, FACTORS]
    unit = np.zeros((3, LAW, 6))
    for row, first in ((0, 0), (1, 0), (2, 3)):
        unit[row, 0, first] = factors[row]
        unit[row, 1, first + 1] = unit[row, 2, first + 2] = 1.0
    return unit
