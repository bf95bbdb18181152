"""Tangents of the ring's forces: derivatives of the sums over the rollers of a row.

One pass over the rollers of a row at one motion serves all directions of a tangent. A simulation
may record its steps with these sums: the last Newton update is so small that the sums of its last
forces belong to the end of the step. A fit step therefore costs one pass over the rollers.
"""

import math
from typing import Any

import numpy as np

from saddlering_ros.ring.kernels import contact
from saddlering_ros.ring.kernels import layout as at
from saddlering_ros.ring.kernels.layout import FAST, INNER, kernel

LAW = 6
"""Number of parameters of a row: K, n, D; share, exponent, saturation of growing damping."""

PARTS = 6 + 2 * LAW + 1
"""Sums of a row: k and d times 1, cos, cos^2; force per parameter times 1, cos; next guess."""

LN2 = math.log(2.0)


@kernel(fastmath=FAST, **INNER)
def row_tangents(rows: Any, row: Any, rollers: Any, uniform: Any, motion: Any, law: Any,
                 growing: Any, saturation: Any, part: Any) -> Any:
    """Fill part (PARTS,) of one row; the other arguments are those of `contact.row_sums`."""
    contact.widest_vectors()
    a, b, da, db = motion
    stiffness, exponent, damping = law
    cosines, weights, gaps, touching = contact.in_contact(rows, row, rollers, uniform, a, b,
                                                  part[PARTS - 1])
    for i in range(PARTS - 1):
        part[i] = 0.0
    part[PARTS - 1] = float(touching)
    if touching == np.uint64(0):
        return
    count = (touching + np.uint64(7)) & ~np.uint64(7)
    k0 = k1 = k2 = d0 = d1 = d2 = 0.0
    e0 = e1 = n0 = n1 = c0 = c1 = s0 = s1 = m0 = m1 = l0 = l1 = 0.0
    share, growth, factor, steepness, turn = 0.0, 0.0, 0.0, 0.0, 0.0
    factor_slope = level_log = turn_slope = 0.0
    if growing is not None:
        share, growth = growing
        growth = growth if growth > 0.0 else exponent
        constant = contact.DAMPING_REFERENCE ** (-growth)
        factor_slope = -math.log(contact.DAMPING_REFERENCE) * constant
        if saturation is not None:
            turn = saturation ** growth
            level_log = math.log(saturation)
            turn_slope = growth * turn / saturation
            factor_slope += turn * level_log
        factor = constant + turn
        factor_slope /= factor
        steepness = 1.0 / (contact.RAMP * max(1.0 - growth, 1e-20))
    for j in range(count):
        c = rows[cosines + j]
        p = max(a + b * c - rows[gaps + j], 1e-30)
        rate = da + db * c
        binary = contact.log2_of(p)
        natural = LN2 * binary
        relative = contact.exp2_of((exponent - 1.0) * binary)
        u = min(p * (1.0 / contact.RAMP), 1.0)
        shape = (1.0 - share) * (u * u * (3.0 - 2.0 * u))
        shape_slope = (1.0 - share) * (6.0 / contact.RAMP) * (u - u * u)
        by_share = by_exponent = by_saturation = 0.0
        if growing is not None:
            rising = contact.exp2_of((growth - 1.0) * binary)
            slope, log_slope = growth, factor_slope + natural
            if saturation is not None:
                level = 1.0 / (1.0 + turn * rising * p)
                log_slope -= turn * rising * p * level * (level_log + natural)
                by_saturation = turn_slope * (1.0 / factor - rising * p * level)
                rising *= level
                slope *= level
            rising *= factor
            w = min(p * steepness, 1.0)
            fade = w * w * (3.0 - 2.0 * w)
            swing = 6.0 * w * (w - w * w)
            grown = rising * p * fade
            by_share = damping * rate * (grown - u * u * (3.0 - 2.0 * u))
            by_exponent = damping * rate * share * (
                grown * log_slope + rising * p * swing * (steepness * contact.RAMP))
            by_saturation *= damping * rate * share * grown
            shape += share * grown
            shape_slope += share * rising * (slope * fade + swing)
        elastic = relative * p
        d = damping * shape
        force = stiffness * elastic + d * rate
        k = exponent * stiffness * relative + damping * shape_slope * rate
        carries = rows[weights + j] if force > contact.MIN_FORCE else 0.0
        k *= carries
        d *= carries
        elastic *= carries
        by_damping = carries * shape * rate
        k0 += k
        k1 += k * c
        k2 += k * c * c
        d0 += d
        d1 += d * c
        d2 += d * c * c
        e0 += elastic
        e1 += elastic * c
        n0 += elastic * natural
        n1 += elastic * natural * c
        c0 += by_damping
        c1 += by_damping * c
        if growing is not None:
            s0 += carries * by_share
            s1 += carries * by_share * c
            m0 += carries * by_exponent
            m1 += carries * by_exponent * c
            l0 += carries * by_saturation
            l1 += carries * by_saturation * c
    part[0], part[1], part[2], part[3], part[4], part[5] = k0, k1, k2, d0, d1, d2
    part[6], part[7], part[8], part[9] = e0, e1, stiffness * n0, stiffness * n1
    part[10], part[11], part[12], part[13] = c0, c1, s0, s1
    part[14], part[15], part[16], part[17] = m0, m1, l0, l1


@kernel(**INNER)
def rows_tangents(m: Any, rows: Any, uniform: Any, q: Any, v: Any, growing: Any, saturation: Any,
                  parts: Any, w: Any) -> Any:
    """`ring_tangents` for growing and saturating damping, or None, as in `contact.row_sums`."""
    motions = contact.row_motions(m, q[0], q[1], q[2], v[0], v[1], v[2])
    laws, rollers = contact.row_laws(m), contact.row_rollers(m)
    for row in range(3):
        row_tangents(rows, row, rollers[row], uniform[row], motions[row], laws[row], growing,
                     saturation, parts[row])
    for place, i in ((at.STIFFNESS, 0), (at.DAMPING, 3)):
        contact.keep_matrix(m, parts[0, i] + parts[1, i], parts[0, i + 1] + parts[1, i + 1],
                    parts[0, i + 2] + parts[1, i + 2], parts[2, i + 2], w, place)


@kernel(**INNER)
def ring_tangents(m: Any, rows: Any, uniform: Any, q: Any, v: Any, grows: Any, parts: Any,
                  w: Any) -> Any:
    """Fill parts (3, PARTS) of upper, lower and radial row, w[STIFFNESS] and w[DAMPING].

    The ring has motion q (3,) and its rate v; grows: whether a direction changes the law of
    growing damping.
    """
    growing = (m.damping_penetration_share, m.damping_penetration_exponent)
    if not grows:
        rows_tangents(m, rows, uniform, q, v, None, None, parts, w)
    elif m.damping_penetration_saturation == 0.0:
        rows_tangents(m, rows, uniform, q, v, growing, None, parts, w)
    else:
        rows_tangents(m, rows, uniform, q, v, growing, m.damping_penetration_saturation, parts, w)


@kernel(fastmath=FAST, **INNER)
def roller_forces(rows: Any, row: Any, rollers: Any, motion: Any, m: Any, law: Any,
                  each: Any) -> Any:
    """Fill each (2, J) with forces and slopes dF/dp of single rollers; their places and number.

    motion and law as in `contact.row_sums`; the places are those of `contact.in_contact`.
    """
    contact.widest_vectors()
    stiffness, exponent, damping = law
    a, b, da, db = motion
    cosines, weights, gaps, count = contact.in_contact(rows, row, rollers, False, a, b, 0.0)
    share, growth = m.damping_penetration_share, m.damping_penetration_exponent
    constant = (1.0 - share) * damping
    for j in range(count):
        c = rows[cosines + j]
        p = max(a + b * c - rows[gaps + j], 1e-30)
        relative = contact.power(p, exponent - 1.0)
        rate = constant * (da + db * c)
        u = min(p * (1.0 / contact.RAMP), 1.0)
        each[0, j] = stiffness * relative * p + rate * (u * u * (3.0 - 2.0 * u))
        each[1, j] = exponent * stiffness * relative + rate * (6.0 / contact.RAMP) * (u - u * u)
    if share == 0.0:
        return cosines, weights, gaps, count
    growth = growth if growth > 0.0 else exponent
    turn = 0.0
    if m.damping_penetration_saturation > 0.0:
        turn = m.damping_penetration_saturation ** growth
    factor = damping * share * (contact.DAMPING_REFERENCE ** (-growth) + turn)
    steepness = 1.0 / (contact.RAMP * max(1.0 - growth, 1e-20))
    for j in range(count):
        c = rows[cosines + j]
        p = max(a + b * c - rows[gaps + j], 1e-30)
        rising = contact.power(p, growth - 1.0)
        level = 1.0 / (1.0 + turn * rising * p)
        rising *= factor * level * (da + db * c)
        w = min(p * steepness, 1.0)
        fade = w * w * (3.0 - 2.0 * w)
        each[0, j] += rising * p * fade
        each[1, j] += rising * (growth * level * fade + 6.0 * w * (w - w * w))
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
def forces_by_geometry(m: Any, rows: Any, geometry: Any, moves: Any, q: Any, v: Any, each: Any,
                       by: Any) -> Any:
    """Add to the first columns of by (3, P) the changes by rollers, geometry (G, 9 J).

    moves (G, 3): whether a direction changes the upper, the lower and the radial row; each (2, J):
    work array.
    """
    radius, height = m.radius, m.radial_row_height
    motions = contact.row_motions(m, q[0], q[1], q[2], v[0], v[1], v[2])
    laws, rollers = contact.row_laws(m), contact.row_rollers(m)
    for row in range(3):
        if not moves[:, row].any():
            continue
        places = roller_forces(rows, row, rollers[row], motions[row], m, laws[row], each)
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


@kernel(fastmath=FAST, **INNER)
def forces_by_law(m: Any, sums: Any, law: Any, by: Any) -> Any:
    """Add to by (3, P) the change of the ring's forces by changes of the rows' laws (3, LAW, P).

    sums (5 L,) of `recording.keep_sums` for the first L parameters of a law. Directions are the
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
    """`contact.ring_forces` at motion q and its rate v.

    recorder: None, or (records (S, width), parts (3, PARTS), last v (3,), grows). With it the sums
    of the tangents are made in the same pass; the forces then differ by rounding.
    """
    if recorder is None:
        contact.ring_forces(m, rows, uniform, q[0], q[1], q[2], v[0], v[1], v[2], w)
    else:
        _, parts, last, grows = recorder
        for i in range(3):
            last[i] = v[i]
        ring_tangents(m, rows, uniform, q, v, grows, parts, w)
        upper, lower = m.K1 * m.upper_row_stiffness, m.K1 * m.lower_row_stiffness
        up0 = upper * parts[0, 6] + m.D1 * parts[0, 10]
        up1 = upper * parts[0, 7] + m.D1 * parts[0, 11]
        low0 = lower * parts[1, 6] + m.D1 * parts[1, 10]
        low1 = lower * parts[1, 7] + m.D1 * parts[1, 11]
        radial = m.K2 * m.radial_row_stiffness * parts[2, 7] + m.D2 * parts[2, 11]
        contact.keep_force(m, up0, up1, low0, low1, radial, w)


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
                    parts[row, 10 + i] += side * ((parts[row, 3 + i] * dv1
                                                   - parts[row, 4 + i] * lean) / m.D1)
        if m.D2 > 0.0:
            parts[2, 11] += parts[2, 5] * radial / m.D2
        keep_sums(records[number], parts, w)


@kernel(**INNER)
def keep_sums(record: Any, parts: Any, w: Any) -> Any:
    """Fill a record with matrices and, per parameter of the law, five sums of the three rows."""
    for i in range(5):
        record[STEP + i] = w[at.STIFFNESS + i]
        record[STEP + 5 + i] = w[at.DAMPING + i]
    for i in range((record.size - LAWS) // 5):
        place = LAWS + 5 * i
        record[place], record[place + 1] = parts[0, 6 + 2 * i], parts[0, 7 + 2 * i]
        record[place + 2], record[place + 3] = parts[1, 6 + 2 * i], parts[1, 7 + 2 * i]
        record[place + 4] = parts[2, 7 + 2 * i]
