"""Exact derivatives of motions and equilibria by the contact law.

One simulation and one pass along it give the derivatives by all parameters; finite differences
would take one simulation per parameter. The pass uses the implicit function theorem
(`kernels/tangents.py`). `neighbours.py` does the same for readings and parameters of effects.

The sensitivity to small errors of the load is that of the model linearised about a motion,
m d2(dq) + D(t) d(dq) + K(t) dq = b dP, with the tangent stiffness K and damping D of all rollers
in contact along the motion, by the difference formulas (BDF2) of the simulator.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from saddlering_ros.rig import ContactParameters, Rig
from saddlering_ros.ring import model as ring_model
from saddlering_ros.ring.kernels import courses, integration, tangents
from saddlering_ros.ring.kernels.contact import LAW
from saddlering_ros.ring.kernels.row_tangents import LAWS, PLAIN_LAW
from saddlering_ros.ring.model import Floats, Model, model_of, Rows, rows_of
from saddlering_ros.ring.simulator import check_simulation, dynamic_batch


class FollowedMotion:
    """Motion (3, N) [m, m, rad] of a contact law (6,) from rest at load[0]; NaN if steps fail."""

    def __init__(self, rig: Rig, contact: ArrayLike, elevation: float, time: ArrayLike,
                 load: ArrayLike, max_step: float = 1e-3) -> None:
        seconds, force = check_simulation(time, load, elevation, max_step)
        self._model, self._rows = model_of(rig, elevation, contact), rows_of(rig)
        self.path = simulate_path(self._model, self._rows, seconds, force, float(force[0]),
                                   max_step)
        if not np.isfinite(self.path.readings).all():
            self.path.motion[:] = np.nan
        self.motion = np.ascontiguousarray(self.path.motion[self.path.samples].T)

    def sensitivities(self) -> Floats:
        """Derivatives (6, 3, N) by K1, n1, D1, K2, n2, D2, in SI."""
        changes = tangents_along(
            self._model, self._rows, unit_laws(self._model), np.empty((0, 3, 6)),
            np.zeros((6, 3, 4)), np.empty((0, self._rows.flat.size)), self.path)
        return np.ascontiguousarray(changes[self.path.samples].transpose(2, 1, 0))


def static_sensitivities(rig: Rig, contact: ArrayLike, elevation: float,
                         equilibria: Floats) -> Floats:
    """Derivatives (6, 3, N) of equilibria (3, N) by the contact law (6,), in SI."""
    model, rows = model_of(rig, elevation, contact), rows_of(rig)
    path = np.ascontiguousarray(equilibria.T)
    out = np.empty((path.shape[0], 3, 6))
    tangents.static_tangents(model, rows.flat, rows.uniform, unit_laws(model), path, out)
    return np.ascontiguousarray(out.transpose(2, 1, 0))


K, N, D = (ring_model.columns(a, a, b) for a, b in (('K1', 'K2'), ('n1', 'n2'), ('D1', 'D2')))
"""Indices of K, n and D of the upper, the lower and the radial row."""

FACTORS = ring_model.columns('upper_row_stiffness', 'lower_row_stiffness', 'radial_row_stiffness')
GROWTH = ring_model.columns('damping_penetration_share', 'damping_penetration_exponent',
                            'damping_penetration_saturation')
FRICTIONS = ring_model.columns('radial_friction', 'axial_friction', 'tilt_friction')
LOADS = ring_model.columns('cosine', 'sine', *(
    entry[0] for entry, stage, _ in ring_model.EXTENSION_FIELDS if stage == 'load path'))


@dataclass(frozen=True)
class MotionPath:
    """Steps of a simulation; the first step is the rest at the zero."""

    time: Floats  # (M,) [s]
    load: Floats  # (M,) [N]
    motion: Floats  # (M, 3) [m, m, rad]
    samples: NDArray[np.intp]  # (N,): their steps
    readings: Floats  # (N, 4) [m]
    records: Floats  # (M, width): sums over the rollers, for tangents (kernels/courses.py)

    def read_by(self, model: Model, zero_load: float, time: Floats, load: Floats) -> MotionPath:
        """The same motion as read by a model with other additions; NaN if steps failed.

        zero_load [N]; time (N,) [s], load (N,) [N]: of the samples.
        """
        readings = np.empty((time.size, 4))
        courses.read_courses(model, zero_load, time, load, self.motion[self.samples],
                             *courses.UNCHANGED, readings[None])
        if not np.isfinite(self.readings).all():
            readings[:] = np.nan
        return replace(self, readings=readings)


def simulate_path(model: Model, rows: Rows, time: Floats, load: Floats, zero_load: float,
                  max_step: float, grows: bool = False) -> MotionPath:
    """A run of a model (1,) at every step; grows: for tangents by growing damping too."""
    grows = grows or bool(model['damping_penetration_share'][0])
    motion, readings = np.empty((time.size, 3)), np.empty((time.size, 4))
    room = 2 + int(np.maximum(1.0, np.ceil(np.diff(time) / max_step)).sum())
    while True:
        record = np.empty((room, LAWS + 5 * (LAW if grows else PLAIN_LAW)))
        integration.run_recorded(model, rows.flat, rows.uniform, time, load, zero_load, max_step,
                                 motion, readings, record, grows)
        steps = int(record[0, 0])
        if steps < room:
            break
        room = steps + 1
    step_time, step_load, moved = (np.empty((steps + 1, *more)) for more in ((), (), (3,)))
    samples = np.empty(time.size, dtype=np.intp)
    step_load[0], moved[0] = zero_load, motion[0]
    courses.steps_of_record(record, time, max_step, step_time, step_load, moved, samples)
    return MotionPath(step_time, step_load, moved, samples, readings, record[:steps + 1])


def tangents_along(model: Model, rows: Rows, law: Floats, external: Floats, friction: Floats,
                   geometry: Floats, path: MotionPath) -> Floats:
    """Changes (M, 3, P) at every step; NaN if that fails. See `tangents.motion_tangents`.

    rows: those to which `geometry` (G, 9 J) belongs.
    """
    changes = np.empty((path.time.size, 3, law.shape[2]))
    if not tangents.motion_tangents(model, rows.flat, law, external, friction, geometry,
                                    path.records, path.time, path.motion, changes):
        changes[:] = np.nan
    return changes


def external_along(model: Model, zero_load: float, path: MotionPath) -> Floats:
    """Force [N] and moment [N m] on the ring (M, 3) at every step."""
    external = np.empty((path.time.size, 3))
    courses.load_course(model, zero_load, path.load, external)
    return external


def laws_of(models: Floats) -> Floats:
    """Laws (B, 3, LAW) of upper, lower and radial row; an exponent of 0 means n of the row."""
    share, exponent, saturation = (models[:, [place] * 3] for place in GROWTH)
    exponent = np.where(exponent > 0.0, exponent, models[:, N])
    return np.stack([models[:, K] * models[:, FACTORS], models[:, N], models[:, D], share,
                     exponent, saturation], axis=-1)


def unit_laws(model: Model) -> Floats:
    """Change (3, LAW, 6) of the rows' laws by one unit of each contact parameter."""
    factors = ring_model.floats(model)[0, FACTORS]
    unit = np.zeros((3, LAW, 6))
    for row, first in ((0, 0), (1, 0), (2, 3)):
        unit[row, 0, first] = factors[row]
        unit[row, 1, first + 1] = unit[row, 2, first + 2] = 1.0
    return unit


def load_sensitivity(rig: Rig, contact: ContactParameters, elevation: float, time: Floats,
                     load: Floats, nodes: int) -> Floats:
    """Mean displacements (3, nodes, nodes) [m/N, m/N, rad/N] per load error of a record.

    time (N,) [s] is evenly spaced, and N is a multiple of `nodes`. Each node is the middle of a
    block. An error of 1 N at node j, which falls to zero at the next nodes, changes the mean of
    block i by [:, i, j]. The motion starts at rest under its first load with the errors.
    """
    law = contact.to_array()[None]
    step = float(np.mean(np.diff(time)))
    motion = np.ascontiguousarray(dynamic_batch(rig, law, elevation, time, load, 1.01 * step)[0].T)
    model, rows = model_of(rig, elevation, law), rows_of(rig)
    sensitivity = np.zeros((3, nodes, nodes))
    force = np.array([np.cos(elevation), -np.sin(elevation),
                      rig.trunnion.y * np.cos(elevation) + rig.trunnion.x * np.sin(elevation)])
    rate = np.ascontiguousarray(np.gradient(motion, time, axis=0))
    tangents.follow_errors(model, rows.flat, rows.uniform, motion, rate, step, force, sensitivity)
    return sensitivity
