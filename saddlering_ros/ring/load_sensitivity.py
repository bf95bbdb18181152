"""Sensitivity of the motion to small errors of the load: the model linearised about a motion.

m d2(dq) + D(t) d(dq) + K(t) dq = b dP with the tangent stiffness K and damping D of all rollers in
contact along the motion, by the difference formulas (BDF2) of the simulator.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.rig import ContactParameters, Rig
from saddlering_ros.ring.kernels.linearised import follow_errors
from saddlering_ros.ring.model import build_model
from saddlering_ros.ring.simulator import dynamic_batch

Floats = NDArray[np.float64]


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
    model = build_model(rig, contact, elevation)
    sensitivity = np.zeros((3, nodes, nodes))
    force = np.array([np.cos(elevation), -np.sin(elevation),
                      rig.trunnion.y * np.cos(elevation) + rig.trunnion.x * np.sin(elevation)])
    rate = np.ascontiguousarray(np.gradient(motion, time, axis=0))
    follow_errors(model.constants, model.rows.flat, model.rows.uniform, motion, rate, step, force,
                  sensitivity)
    return sensitivity
