"""The ring linearised about a motion, in steps of the difference formulas of the simulator."""

from __future__ import annotations

from typing import Any

import numpy as np

from saddlering_ros.ring.kernels import layout as at
from saddlering_ros.ring.kernels.contact import ring_forces
from saddlering_ros.ring.kernels.equilibrium import solve3
from saddlering_ros.ring.kernels.options import INNER, kernel, OUTER

DIED_AWAY = 1e-17
"""Share of the largest response below which the response to an error is neglected."""


@kernel(**INNER)
def has_died(state: Any, j: Any, peak: Any, c0: Any, radius: Any) -> Any:
    """Whether response j has decayed below the share that counts."""
    size = max(abs(state[0, j]), abs(state[1, j]), abs(state[2, j]) * radius)
    rate = max(abs(state[3, j]), abs(state[4, j]), abs(state[5, j]) * radius)
    return max(size, rate / max(c0, 1.0)) < DIED_AWAY * peak


@kernel(**OUTER)
def follow_errors(models: Any, rows: Any, uniform: Any, q: Any, v: Any, h: Any, force: Any,
                  sensitivity: Any) -> Any:
    """Fill sensitivity (3, J, J) about a motion q (N, 3), its rate v (N, 3), in steps of h [s].

    The response to a past error decays within some steps, so that few are followed at a time.
    """
    m = models[0]
    nodes = sensitivity.shape[1]
    size = q.shape[0] // nodes
    w = np.zeros(at.WORK_SIZE)
    state = np.zeros((6, nodes))  # dq and its rate, of this step
    old = np.zeros((6, nodes))
    oldest, peak = 0, 0.0
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
        a00 = w[k] + c0 * w[d] + m.mass * square
        a02 = w[k + 1] + c0 * w[d + 1]
        a11 = w[k + 2] + c0 * w[d + 2] + m.mass * square
        a12 = w[k + 3] + c0 * w[d + 3]
        a22 = w[k + 4] + c0 * w[d + 4] + m.inertia * square
        block = n // size
        while oldest < first and has_died(state, oldest, peak, c0, m.radius):
            oldest += 1
        for j in range(oldest, min(first + 2, nodes)):
            error = 1.0 - share if j == first else (share if j == first + 1 else 0.0)
            p0 = c1 * state[0, j] + c2 * old[0, j]
            p1 = c1 * state[1, j] + c2 * old[1, j]
            p2 = c1 * state[2, j] + c2 * old[2, j]
            a0 = c0 * p0 + c1 * state[3, j] + c2 * old[3, j]
            a1 = c0 * p1 + c1 * state[4, j] + c2 * old[4, j]
            a2 = c0 * p2 + c1 * state[5, j] + c2 * old[5, j]
            _, x, y, tilt = solve3(
                a00, a02, a11, a12, a22,
                force[0] * error - m.mass * a0 - w[d] * p0 - w[d + 1] * p2,
                force[1] * error - m.mass * a1 - w[d + 2] * p1 - w[d + 3] * p2,
                force[2] * error - m.inertia * a2
                - w[d + 1] * p0 - w[d + 3] * p1 - w[d + 4] * p2)
            for i in range(6):
                old[i, j] = state[i, j]
            state[0, j], state[1, j], state[2, j] = x, y, tilt
            state[3, j] = c0 * x + p0
            state[4, j] = c0 * y + p1
            state[5, j] = c0 * tilt + p2
            peak = max(peak, abs(x), abs(y), abs(tilt) * m.radius)
            for i in range(3):
                sensitivity[i, block, j] += state[i, j] / size
