"""How the ring answers to small errors of its load: the model made linear about a motion.

m d2(dq) + D(t) d(dq) + K(t) dq = b dP with the tangent stiffness K and damping D of all rollers in
contact along the motion, by the difference formulas (BDF2) that the simulator itself steps with.
"""

from __future__ import annotations

from typing import Any

import numba as nb
import numpy as np
from numpy.typing import NDArray

from saddlering_ros.rig import ContactParameters, Rig
from saddlering_ros.ring import layout as at
from saddlering_ros.ring.kernels import OUTER, ring_forces, solve3
from saddlering_ros.ring.model import build_model
from saddlering_ros.ring.simulator import dynamic_batch

Floats = NDArray[np.float64]


def load_answers(rig: Rig, contact: ContactParameters, elevation: float, time: Floats,
                 load: Floats, nodes: int) -> Floats:
    """Mean displacement answers (3, nodes, nodes) [m/N, m/N, rad/N] to load errors of a record.

    time (N,) [s] is even, N a multiple of `nodes`: each node is the middle of a block of it. An
    error of 1 N at node j, falling to nought at its neighbours, moves the mean of block i by
    [:, i, j]. The motion starts at rest under its first load, errors included.
    """
    law = contact.to_array()[None]
    step = float(np.mean(np.diff(time)))
    motion = np.ascontiguousarray(dynamic_batch(rig, law, elevation, time, load, 1.01 * step)[0].T)
    model = build_model(rig, contact, elevation)
    answers = np.zeros((3, nodes, nodes))
    force = np.array([np.cos(elevation), -np.sin(elevation),
                      rig.trunnion.y * np.cos(elevation) + rig.trunnion.x * np.sin(elevation)])
    rate = np.ascontiguousarray(np.gradient(motion, time, axis=0))
    follow(model.scalars, model.rows.flat, model.rows.uniform, motion, rate, step, force, answers)
    return answers


@nb.njit(**OUTER)
def follow(m: Any, rows: Any, uniform: Any, q: Any, v: Any, h: Any, force: Any,
           answers: Any) -> Any:
    """Fill answers (3, J, J) about the motion q (N, 3), its rate v (N, 3), in steps of h [s]."""
    nodes = answers.shape[1]
    size = q.shape[0] // nodes
    w = np.zeros(at.WORK_SIZE)
    state = np.zeros((6, nodes))  # dq and its rate, of this step
    old = np.zeros((6, nodes))
    for n in range(nodes * size):
        ring_forces(m, rows, uniform, q[n, 0], q[n, 1], q[n, 2], v[n, 0], v[n, 1], v[n, 2], w)
        place = min(max((n + 0.5) / size - 0.5, 0.0), nodes - 1.0)
        first = int(place)
        share = place - first
        c0, c1, c2 = 1.5 / h, -2.0 / h, 0.5 / h
        if n == 1:
            c0, c1, c2 = 1.0 / h, -1.0 / h, 0.0
        if n == 0:
            c0 = c1 = c2 = 0.0
        square = c0 * c0
        k, d = at.STIFFNESS, at.DAMPING
        a00 = w[k] + c0 * w[d] + m[at.MASS] * square
        a02 = w[k + 1] + c0 * w[d + 1]
        a11 = w[k + 2] + c0 * w[d + 2] + m[at.MASS] * square
        a12 = w[k + 3] + c0 * w[d + 3]
        a22 = w[k + 4] + c0 * w[d + 4] + m[at.INERTIA] * square
        block = n // size
        for j in range(min(first + 2, nodes)):
            error = 1.0 - share if j == first else (share if j == first + 1 else 0.0)
            p0 = c1 * state[0, j] + c2 * old[0, j]
            p1 = c1 * state[1, j] + c2 * old[1, j]
            p2 = c1 * state[2, j] + c2 * old[2, j]
            a0 = c0 * p0 + c1 * state[3, j] + c2 * old[3, j]
            a1 = c0 * p1 + c1 * state[4, j] + c2 * old[4, j]
            a2 = c0 * p2 + c1 * state[5, j] + c2 * old[5, j]
            _, x, y, tilt = solve3(
                a00, a02, a11, a12, a22,
                force[0] * error - m[at.MASS] * a0 - w[d] * p0 - w[d + 1] * p2,
                force[1] * error - m[at.MASS] * a1 - w[d + 2] * p1 - w[d + 3] * p2,
                force[2] * error - m[at.INERTIA] * a2
                - w[d + 1] * p0 - w[d + 3] * p1 - w[d + 4] * p2)
            for i in range(6):
                old[i, j] = state[i, j]
            state[0, j], state[1, j], state[2, j] = x, y, tilt
            state[3, j] = c0 * x + p0
            state[4, j] = c0 * y + p1
            state[5, j] = c0 * tilt + p2
            for i in range(3):
                answers[i, block, j] += state[i, j] / size
