"""Exact derivatives of motions and equilibria by the contact law.

One simulation and one pass along it give the derivatives by all parameters; finite differences
would take one simulation per parameter. The pass uses the implicit function theorem
(`kernels/tangents.py`). `neighbours.py` does the same for readings and parameters of effects.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from saddlering_ros.rig import Rig
from saddlering_ros.ring.kernels import tangents
from saddlering_ros.ring.model import Model, model_of, Rows, rows_of, with_contact
from saddlering_ros.ring.motion_path import (
    MotionPath,
    simulate_path,
    tangents_along,
    unit_laws,
)
from saddlering_ros.ring.simulator import check_simulation

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class FollowedMotion:
    """A motion of the ring without extension, (3, N) at the samples, and all its steps."""

    model: Model
    rows: Rows
    path: MotionPath

    @property
    def motion(self) -> Floats:
        return np.ascontiguousarray(self.path.motion[self.path.samples].T)

    def sensitivities(self) -> Floats:
        """Derivatives (6, 3, N) by K1, n1, D1, K2, n2, D2, in SI."""
        none = np.empty((0, 3, 6))
        changes = tangents_along(self.model, self.rows, unit_laws(self.model), none,
                                 np.zeros((6, 3, 4)), [], self.path)
        return np.ascontiguousarray(changes[self.path.samples].transpose(2, 1, 0))


def followed_motion(rig: Rig, contact: ArrayLike, elevation: float, time: ArrayLike,
                    load: ArrayLike, max_step: float = 1e-3) -> FollowedMotion:
    """Motion of a contact law (6,) from rest at load[0], NaN where a step failed."""
    seconds, force = check_simulation(time, load, elevation, max_step)
    model = with_contact(model_of(rig, elevation), contact)
    rows = rows_of(rig)
    path = simulate_path(model, rows, seconds, force, float(force[0]), max_step)
    if not np.isfinite(path.readings).all():
        path.motion[:] = np.nan
    return FollowedMotion(model, rows, path)


def motion_sensitivities(rig: Rig, contact: ArrayLike, elevation: float, time: ArrayLike,
                         load: ArrayLike, max_step: float = 1e-3) -> tuple[Floats, Floats]:
    """Motion (3, N) of a contact law (6,) from rest at load[0], and its derivatives (6, 3, N)."""
    followed = followed_motion(rig, contact, elevation, time, load, max_step)
    return followed.motion, followed.sensitivities()


def steps_taken(rig: Rig, contact: ArrayLike, elevation: float, time: ArrayLike, load: ArrayLike,
                max_step: float = 1e-3) -> tuple[Floats, Floats, Floats]:
    """Time (M,) [s], load (M,) [N], motion (3, M) at every step of a run from rest at load[0]."""
    seconds, force = check_simulation(time, load, elevation, max_step)
    model = with_contact(model_of(rig, elevation), contact)
    path = simulate_path(model, rows_of(rig), seconds, force, float(force[0]), max_step)
    return path.time, path.load, np.ascontiguousarray(path.motion.T)


def static_sensitivities(rig: Rig, contact: ArrayLike, elevation: float,
                         equilibria: Floats) -> Floats:
    """Derivatives (6, 3, N) of equilibria (3, N) by the contact law (6,), in SI."""
    model = with_contact(model_of(rig, elevation), contact)
    rows = rows_of(rig)
    path = np.ascontiguousarray(equilibria.T)
    out = np.empty((path.shape[0], 3, 6))
    tangents.static_tangents(model, rows.flat, rows.uniform, unit_laws(model), path, out)
    return np.ascontiguousarray(out.transpose(2, 1, 0))
