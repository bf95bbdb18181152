"""Steps of a simulation with the sums over their rollers, from which tangents follow.

The sums of a step's last forces serve its tangents too: the last Newton update is so small that
they belong to the end of the step. A fit step therefore costs one pass over the rollers.
"""

from __future__ import annotations

from typing import Any

from saddlering_ros.ring.kernels import layout as at
from saddlering_ros.ring.kernels.contact import ring_forces
from saddlering_ros.ring.kernels.options import INNER, kernel
from saddlering_ros.ring.kernels.row_tangents import LAW, matrices, ring_tangents

STEP = 5
"""First numbers of a record: length [s], measured load [N] and q of a step."""

MATRICES = 10
"""Numbers that follow: entries of stiffness and damping as in `layout`."""

PLAIN_LAW = 3
"""Number of the parameters of a law that change a force without growing damping."""


def record_width(grows: bool) -> int:
    """Numbers of a record; `grows`: with those of growing damping."""
    return STEP + MATRICES + 5 * (LAW if grows else PLAIN_LAW)


@kernel(**INNER)
def forces_of_step(m: Any, rows: Any, uniform: Any, q: Any, v: Any, recorder: Any,
                   w: Any) -> Any:
    """`contact.ring_forces` at motion q and its rate v.

    recorder: None, or (records (S, width), parts (3, PARTS), last v (3,), grows). With it the sums
    of the tangents are made in the same pass; the forces then differ by rounding.
    """
    if recorder is None:
        ring_forces(m, rows, uniform, q[0], q[1], q[2], v[0], v[1], v[2], w)
    else:
        _, parts, last, grows = recorder
        for i in range(3):
            last[i] = v[i]
        ring_tangents(m, rows, uniform, q, v, grows, parts)
        matrices(m, parts, w)
        forces_of_parts(m, parts, w)


@kernel(**INNER)
def forces_of_parts(m: Any, parts: Any, w: Any) -> Any:
    """Set w[FORCE] from parts (3, PARTS): each force is K times one sum and D times another."""
    upper, lower = m.K1 * m.upper_row_stiffness, m.K1 * m.lower_row_stiffness
    up0 = upper * parts[0, 6] + m.D1 * parts[0, 10]
    up1 = upper * parts[0, 7] + m.D1 * parts[0, 11]
    low0 = lower * parts[1, 6] + m.D1 * parts[1, 10]
    low1 = lower * parts[1, 7] + m.D1 * parts[1, 11]
    s1 = m.K2 * m.radial_row_stiffness * parts[2, 7] + m.D2 * parts[2, 11]
    w[at.FORCE] = -s1
    w[at.FORCE + 1] = low0 - up0
    w[at.FORCE + 2] = m.radius * (up1 - low1) - m.radial_row_height * s1


@kernel(**INNER)
def keep_record(m: Any, recorder: Any, length: Any, load: Any, s: Any, w: Any) -> Any:
    """Record a solved step; the first number of all counts the steps, also those without room."""
    records, parts, last, _ = recorder
    records[0, 0] += 1.0
    number = int(records[0, 0])
    if number < records.shape[0]:
        records[number, 0], records[number, 1] = length, load
        for i in range(3):
            records[number, 2 + i] = s[at.Q + i]
        move_on(m, parts, s[at.V + 1] - last[1], s[at.V + 2] - last[2],
                s[at.V] - last[0] + m.radial_row_height * (s[at.V + 2] - last[2]))
        keep_sums(records[number], parts, w)


@kernel(**INNER)
def move_on(m: Any, parts: Any, dv1: Any, dv2: Any, radial: Any) -> Any:
    """Advance the sums of the dampers by the last change of the rates, which are small.

    A position is known far better than its rate: the other sums need no such correction.
    """
    lean = m.radius * dv2
    if m.D1 > 0.0:
        parts[0, 10] += (parts[0, 3] * dv1 - parts[0, 4] * lean) / m.D1
        parts[0, 11] += (parts[0, 4] * dv1 - parts[0, 5] * lean) / m.D1
        parts[1, 10] -= (parts[1, 3] * dv1 - parts[1, 4] * lean) / m.D1
        parts[1, 11] -= (parts[1, 4] * dv1 - parts[1, 5] * lean) / m.D1
    if m.D2 > 0.0:
        parts[2, 11] += parts[2, 5] * radial / m.D2


@kernel(**INNER)
def keep_sums(record: Any, parts: Any, w: Any) -> Any:
    """Fill a record with matrices and, per parameter of the law, five sums of the three rows."""
    for i in range(5):
        record[STEP + i] = w[at.STIFFNESS + i]
        record[STEP + 5 + i] = w[at.DAMPING + i]
    for i in range((record.size - STEP - MATRICES) // 5):
        place = STEP + MATRICES + 5 * i
        record[place], record[place + 1] = parts[0, 6 + 2 * i], parts[0, 7 + 2 * i]
        record[place + 2], record[place + 3] = parts[1, 6 + 2 * i], parts[1, 7 + 2 * i]
        record[place + 4] = parts[2, 7 + 2 * i]
