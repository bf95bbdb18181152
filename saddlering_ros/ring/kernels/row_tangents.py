"""Tangents of the ring's forces: derivatives of the sums over the rollers of a row.

One pass over the rollers of a row at one motion serves all directions of a tangent. A simulation
may record its steps with these sums: the last Newton update is so small that the sums of its last
forces belong to the end of the step. A fit step therefore costs one pass over the rollers.
"""

from typing import Any

from saddlering_ros.ring.kernels import contact
from saddlering_ros.ring.kernels import layout as at
from saddlering_ros.ring.kernels.layout import FAST, INNER, kernel


@kernel(fastmath=FAST, **INNER)
def roller_forces(rows: Any, row: Any, rollers: Any, motion: Any, law: Any, growing: Any,
                  saturation: Any, each: Any) -> Any:
    """Fill each (2, J) with forces and slopes dF/dp of single rollers; their places and number.

    The arguments are those of `contact.row_sums`; the places are those of `contact.in_contact`.
    """
    contact.widest_vectors()
    stiffness, exponent, damping = law
    a, b, da, db = motion
    cosines, weights, gaps, count = contact.in_contact(rows, row, rollers, False, a, b, 0.0)
    share, growth, turn, factor, steepness = 0.0, 0.0, 0.0, 1.0, 0.0
    if growing is not None:
        share, growth, turn, factor, steepness = contact.growth_terms(
            growing, saturation, exponent)
    for j in range(count):
        c = rows[cosines + j]
        p = max(a + b * c - rows[gaps + j], 1e-30)
        rate = damping * (da + db * c)
        binary = contact.log2_of(p)
        relative = contact.exp2_of((exponent - 1.0) * binary)
        u = min(p * (1.0 / contact.RAMP), 1.0)
        shape = (1.0 - share) * (u * u * (3.0 - 2.0 * u))
        shape_slope = (1.0 - share) * (6.0 / contact.RAMP) * (u - u * u)
        if growing is not None:
            rising, slope, fade, swing = contact.grown(
                p, binary, growth, turn, steepness, saturation)
            shape += share * factor * (rising * p * fade)
            shape_slope += share * factor * (rising * (slope * fade + swing))
        each[0, j] = stiffness * relative * p + rate * shape
        each[1, j] = exponent * stiffness * relative + rate * shape_slope
    return cosines, weights, gaps, count


@kernel(fastmath=FAST, **INNER)
def row_geometry(rows: Any, change: Any, places: Any, each: Any) -> Any:
    """Change of sum F and sum F cos of a row by a change (9 J,) of weights and gaps."""
    cosines, weights, gaps, count = places
    s0 = s1 = 0.0
    for j in range(count):
        force = each[0, j]
        by = change[weights + j] * force - rows[weights + j] * each[1, j] * change[gaps + j]
        by = by if force > contact.MIN_FORCE else 0.0
        s0 += by
        s1 += by * rows[cosines + j]
    return s0, s1


@kernel(**INNER)
def geometry_of_rows(m: Any, rows: Any, geometry: Any, moves: Any, q: Any, v: Any, growing: Any,
                     saturation: Any, each: Any, by: Any) -> Any:
    """`forces_by_geometry` for growing damping, or None, as in `contact.row_sums`."""
    radius, height = m.radius, m.radial_row_height
    motions = contact.row_motions(m, q[0], q[1], q[2], v[0], v[1], v[2])
    laws, rollers = contact.row_laws(m), contact.row_rollers(m)
    for row in range(3):
        if not moves[:, row].any():
            continue
        places = roller_forces(rows, row, rollers[row], motions[row], laws[row], growing,
                               saturation, each)
        for j in range(geometry.shape[0]):
            if moves[j, row]:
                s0, s1 = row_geometry(rows, geometry[j], places, each)
                if row == 2:
                    by[0, j] -= s1
                    by[2, j] -= height * s1
                else:
                    side = 1.0 if row == 0 else -1.0
                    by[1, j] -= side * s0
                    by[2, j] += side * radius * s1


@kernel(**INNER)
def forces_by_geometry(m: Any, rows: Any, geometry: Any, moves: Any, q: Any, v: Any, each: Any,
                       by: Any) -> Any:
    """Add to the first columns of by (3, P) the changes by rollers, geometry (G, 9 J).

    moves (G, 3): whether a direction changes the upper, the lower and the radial row; each (2, J):
    work array.
    """
    if m.damping_penetration_share == 0.0:
        geometry_of_rows(m, rows, geometry, moves, q, v, None, None, each, by)
    else:
        growing = m.damping_penetration_share, m.damping_penetration_exponent
        geometry_of_rows(m, rows, geometry, moves, q, v, growing,
                         m.damping_penetration_saturation, each, by)


@kernel(fastmath=FAST, **INNER)
def forces_by_law(m: Any, sums: Any, law: Any, by: Any) -> Any:
    """Add to by (3, P) the change of the ring's forces by changes of the rows' laws (3, LAW, P).

    sums (5 L,) of `keep_sums` for the first L parameters of a law. Directions are the
    last axis, so that the loop becomes vector code.
    """
    radius, height = m.radius, m.radial_row_height
    for i in range(sums.size // 5):
        up0, up1 = sums[5 * i], radius * sums[5 * i + 1]
        low0, low1 = sums[5 * i + 2], radius * sums[5 * i + 3]
        s1 = sums[5 * i + 4]
        for j in range(law.shape[2]):
            upper, lower, radial = law[0, i, j], law[1, i, j], s1 * law[2, i, j]
            by[0, j] -= radial
            by[1, j] += low0 * lower - up0 * upper
            by[2, j] += up1 * upper - low1 * lower - height * radial


STEP = 5
"""First numbers of a record: length [s], measured load [N] and q of a step."""

LAWS = STEP + 10
"""First place of a record with sums for parameters of a law; before it, stiffness and damping."""

PLAIN_LAW = 3
"""Number of the parameters of a law that change a force without growing damping."""


@kernel(**INNER)
def forces_of_step(m: Any, rows: Any, uniform: Any, q: Any, v: Any, recorder: Any,
                   w: Any) -> Any:
    """`contact.ring_forces` at motion q and its rate v; with a recorder, tangents as well."""
    if recorder is None:
        contact.ring_forces(m, rows, uniform, q[0], q[1], q[2], v[0], v[1], v[2], w, None, False)
    else:
        _, parts, last, grows = recorder
        for i in range(3):
            last[i] = v[i]
        contact.ring_forces(m, rows, uniform, q[0], q[1], q[2], v[0], v[1], v[2], w, parts, grows)


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
        # Advance the sums of the dampers by the last change of the rates, which are small. A
        # position is known far better than its rate: the other sums need no such correction.
        dv1, dv2 = s[at.V + 1] - last[1], s[at.V + 2] - last[2]
        lean, radial = m.radius * dv2, s[at.V] - last[0] + m.radial_row_height * dv2
        if m.D1 > 0.0:
            for row, side in ((0, 1.0), (1, -1.0)):
                for i in range(2):
                    parts[row, 7 + i] += side * ((parts[row, i] * dv1
                                                  - parts[row, 1 + i] * lean) / m.D1)
        if m.D2 > 0.0:
            parts[2, 8] += parts[2, 2] * radial / m.D2
        keep_sums(records[number], parts, w)


@kernel(**INNER)
def keep_sums(record: Any, parts: Any, w: Any) -> Any:
    """Fill a record with matrices and, per parameter of the law, five sums of the three rows."""
    for i in range(5):
        record[STEP + i] = w[at.STIFFNESS + i]
        record[STEP + 5 + i] = w[at.DAMPING + i]
    for i in range((record.size - LAWS) // 5):
        place = LAWS + 5 * i
        record[place], record[place + 1] = parts[0, 3 + 2 * i], parts[0, 4 + 2 * i]
        record[place + 2], record[place + 3] = parts[1, 3 + 2 * i], parts[1, 4 + 2 * i]
        record[place + 4] = parts[2, 4 + 2 * i]
