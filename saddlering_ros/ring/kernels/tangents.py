"""Tangents of equilibria and of time steps: derivatives of a motion by the parameters theta.

At a solved step the residual R(q, theta) is zero, so that dq = -(dR/dq)^-1 dR/dtheta (implicit
function theorem); dR/dq is the 3 x 3 matrix of the step. One pass along the motion gives the
derivatives: the sums over the rollers are those that the simulation recorded. A simulation
records its steps with these sums: the last Newton update is so small that the sums of its last
forces belong to the end of the step.

The model linearised about a motion serves small errors of the load:
m d2(dq) + D(t) d(dq) + K(t) dq = b dP.
"""

import math

import numpy as np

from saddlering_ros.ring.kernels import contact
from saddlering_ros.ring.kernels import extension_laws as laws
from saddlering_ros.ring.kernels import layout as at
from saddlering_ros.ring.kernels.contact import PARTS, ring_forces
from saddlering_ros.ring.kernels.equilibrium import differences, solve3, system
from saddlering_ros.ring.kernels.layout import FAST, INNER, kernel, OUTER


@kernel(fastmath=FAST, **INNER)
def row_geometry(rows, change, places, each):
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
def geometry_of_rows(m, rows, geometry, moves, q, v, growing, saturation, each, by):
    """`forces_by_geometry` for growing damping, or None, as in `row_sums`."""
    radius, height = m.radius, m.radial_row_height
    motions = contact.row_motions(m, q[0], q[1], q[2], v[0], v[1], v[2])
    law, rollers = contact.row_laws(m), contact.row_rollers(m)
    for row in range(3):
        if not moves[:, row].any():
            continue
        a, b, _, _ = motions[row]
        places = contact.in_contact(rows, row, rollers[row], False, a, b, 0.0)
        contact.row_sums(rows, row, rollers[row], False, motions[row], law[row], growing,
                         saturation, 0.0, None, each, places)
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
def forces_by_geometry(m, rows, geometry, moves, q, v, each, by):
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
def forces_by_law(m, sums, law, by):
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
def forces_of_step(m, rows, uniform, q, v, recorder, w):
    """`ring_forces` at motion q and its rate v; with a recorder, tangents as well."""
    if recorder is None:
        ring_forces(m, rows, uniform, q[0], q[1], q[2], v[0], v[1], v[2], w, None, False)
    else:
        _, parts, last, grows = recorder
        for i in range(3):
            last[i] = v[i]
        ring_forces(m, rows, uniform, q[0], q[1], q[2], v[0], v[1], v[2], w, parts, grows)


@kernel(**INNER)
def keep_record(m, recorder, length, load, s, w):
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
def keep_sums(record, parts, w):
    """Fill a record with matrices and, per parameter of the law, five sums of the three rows."""
    for i in range(5):
        record[STEP + i] = w[at.STIFFNESS + i]
        record[STEP + 5 + i] = w[at.DAMPING + i]
    for i in range((record.size - LAWS) // 5):
        place = LAWS + 5 * i
        record[place], record[place + 1] = parts[0, 3 + 2 * i], parts[0, 4 + 2 * i]
        record[place + 2], record[place + 3] = parts[1, 3 + 2 * i], parts[1, 4 + 2 * i]
        record[place + 4] = parts[2, 4 + 2 * i]


@kernel(fastmath=FAST, **INNER)
def solve_all(a00, a02, a11, a12, a22, by, out):
    """`equilibrium.solve3` of by (3, P) into the first rows of out; False if indefinite."""
    if not (a00 > 0.0 and a11 > 0.0):
        return False
    i00, i11 = 1.0 / a00, 1.0 / a11
    schur = a22 - a02 * a02 * i00 - a12 * a12 * i11
    if not schur > 0.0:
        return False
    inverse, b02, b12 = 1.0 / schur, a02 * i00, a12 * i11
    for j in range(by.shape[1]):
        turn = (by[2, j] - b02 * by[0, j] - b12 * by[1, j]) * inverse
        out[0, j] = by[0, j] * i00 - b02 * turn
        out[1, j] = by[1, j] * i11 - b12 * turn
        out[2, j] = turn
    return True


@kernel(fastmath=FAST, **INNER)
def carry(m, w, c0, c1, c2, own, past, by):
    """Subtract from by (3, P) the contribution of the past states, dq and dv (6, P).

    The difference formula is dv = c0 dq + past terms; past (6, P) receives the past terms of dq
    and dv.
    """
    d = at.DAMPING
    d00, d02, d11, d12, d22 = w[d], w[d + 1], w[d + 2], w[d + 3], w[d + 4]
    for j in range(by.shape[1]):
        p0 = c1 * own[0, j] + c2 * past[0, j]
        p1 = c1 * own[1, j] + c2 * past[1, j]
        p2 = c1 * own[2, j] + c2 * past[2, j]
        b0 = c0 * p0 + c1 * own[3, j] + c2 * past[3, j]
        b1 = c0 * p1 + c1 * own[4, j] + c2 * past[4, j]
        b2 = c0 * p2 + c1 * own[5, j] + c2 * past[5, j]
        by[0, j] -= m.mass * b0 + d00 * p0 + d02 * p2
        by[1, j] -= m.mass * b1 + d11 * p1 + d12 * p2
        by[2, j] -= m.inertia * b2 + d02 * p0 + d12 * p1 + d22 * p2
        past[0, j], past[1, j], past[2, j] = p0, p1, p2


@kernel(**INNER)
def hysteron_step(element, z, travel):
    """(sign, decay, slides) of a hysteron with states z (2,) over `travel`, for its tangent."""
    decay = math.exp(-abs(travel) / element.presliding)
    slides = -1.0 < z[1] + travel / element.presliding < 1.0
    return 1.0 if travel >= 0.0 else -1.0, decay, 1.0 if slides else 0.0


@kernel(**INNER)
def hysteron_tangent(element, z, travel, step, rubbed, by_travel, by_presliding):
    """Changes of the two states of `hysteron` by changes of states (2,), travel and presliding."""
    sign, decay, slides = step
    presliding = element.presliding
    relative = (sign * by_travel - abs(travel) * by_presliding / presliding) / presliding
    smooth = decay * (rubbed[0] + (sign - z[0]) * relative)
    return smooth, slides * (rubbed[1] + (by_travel - travel * by_presliding / presliding)
                             / presliding)


@kernel(**OUTER)
def motion_tangents(models, rows, law, external, friction, geometry, records, time, zero_load,
                    path, out):
    """Fill out (N, 3, P) with changes of a motion path (N, 3) from rest; False on failure.

    Each direction is a small change of law (3, LAW, P) by row, of external load (N, 3, P) or
    none (0, 3, P), of friction (P, 3, 4) and, for the first G directions, of rollers (G, 9 J).
    records (N, width) of the steps; time (N,): their stamps. rows: those of the geometry.
    """
    m = models[0]
    directions = law.shape[2]
    rubs = (m.radial_friction.limit != 0.0 or m.axial_friction.limit != 0.0
            or m.tilt_friction.limit != 0.0 or np.any(friction))
    places = rows.size // 9
    moves = np.zeros((geometry.shape[0], 3), dtype=np.bool_)
    for j in range(geometry.shape[0]):
        for i in range(3):
            moves[j, i] = np.any(geometry[j, (3 * i + 1) * places:3 * (i + 1) * places])
    w = np.zeros(at.WORK_SIZE)
    laws.load_at_rest(m, np.zeros(at.STATE_SIZE), zero_load, w)
    return follow_tangents(
        m, rows, law, external, friction, geometry, records, time, path, out, rubs,
        w, np.zeros((3, 6, directions)), np.zeros((3, directions, 2)),
        np.zeros((3, 2)), np.zeros((3, 3)), np.zeros((3, directions)), moves,
        np.empty((2, places)))


@kernel(**INNER)
def follow_tangents(m, rows, law, external, friction, geometry, records, time, path, out, rubs, w,
                    states, rubbed, elements, motion, by, moves, each):
    """`motion_tangents` with work arrays: dq and dv of three steps (3, 6, P), friction, motion.

    w begins with the load at rest; motion (3, 3): q, v, slopes of friction; moves (G, 3), each
    (2, J): as in `forces_by_geometry`.
    """
    frictions = (m.radial_friction, m.axial_friction, m.tilt_friction)
    for i, element in enumerate(frictions):
        elements[i, 0] = elements[i, 1] = laws.state_at_rest(element, i, w)
        for j in range(friction.shape[0]):
            change = friction[j, i, 3]
            if elements[i, 0] != element.initial:
                load = external[0, i, j] if external.shape[0] else 0.0
                held = laws.HELD_SHARE * load - friction[j, i, 0] * elements[i, 0]
                change = held / element.limit
            rubbed[i, j, 0] = rubbed[i, j, 1] = change
    q, v, slopes = motion[0], motion[1], motion[2]
    h_old, soft = 0.0, 1e-9 * m.K1
    for n in range(time.size):
        c0 = c1 = c2 = 0.0
        if n > 0:
            h = time[n] - time[n - 1]
            c0, c1, c2 = differences(h, h_old)
            h_old, soft = h, 0.0
            before = max(n - 2, 0)
            for i in range(3):
                v[i] = c0 * path[n, i] + c1 * path[n - 1, i] + c2 * path[before, i]
        for i in range(3):
            q[i] = path[n, i]
        own, past, new = states[n % 3], states[(n + 2) % 3], states[(n + 1) % 3]
        for i in range(5):
            w[at.STIFFNESS + i] = records[n, STEP + i]
            w[at.DAMPING + i] = records[n, STEP + 5 + i]
        for i in range(3):
            for j in range(by.shape[1]):
                by[i, j] = external[n, i, j] if external.shape[0] else 0.0
        forces_by_law(m, records[n, LAWS:], law, by)
        if geometry.shape[0]:
            forces_by_geometry(m, rows, geometry, moves, q, v, each, by)
        if rubs:
            for i, element in enumerate(frictions):
                slopes[i] = rub(element, friction[:, i], i, path, n, elements[i], rubbed[i], own,
                                by)
        carry(m, w, c0, c1, c2, own, past, by)
        a00, a02, a11, a12, a22 = system(m, w, at.STIFFNESS, at.DAMPING, c0,
                                         (slopes[0], slopes[1], slopes[2]))
        if not solve_all(a00 + soft, a02, a11 + soft, a12, a22 + soft * m.radius * m.radius, by,
                         new):
            return False
        for i in range(3):
            for j in range(by.shape[1]):
                new[3 + i, j] = c0 * new[i, j] + past[i, j]
                out[n, i, j] = new[i, j]
        if rubs and n > 0:
            for i, element in enumerate(frictions):
                keep_rubbing(element, friction[:, i], i, path, n, elements[i], rubbed[i], own, new)
    return True


@kernel(**INNER)
def rub(element, changes, i, path, n, z, rubbed, own, by):
    """Subtract from by (3, P) the change of friction i at step n; the slope of the friction.

    changes (P, 4): of limit, presliding, sharpness and initial; z (2,): the states of the
    friction; rubbed (P, 2): changes of these states.
    """
    if n == 0:
        for j in range(by.shape[1]):
            by[i, j] -= changes[j, 0] * z[0] + rubbed[j, 0] * element.limit
        return 0.0
    travel = path[n, i] - path[n - 1, i]
    smooth, sharp, now, slope = laws.hysteron(z[0], z[1], travel, element.presliding,
                                         element.sharpness)
    step = hysteron_step(element, z, travel)
    for j in range(by.shape[1]):
        by_smooth, by_sharp = hysteron_tangent(element, z, travel, step, rubbed[j], -own[i, j],
                                               changes[j, 1])
        by_now = (element.sharpness * by_sharp + (1.0 - element.sharpness) * by_smooth
                  + changes[j, 2] * (sharp - smooth))
        by[i, j] -= changes[j, 0] * now + element.limit * by_now
    return element.limit * slope


@kernel(**INNER)
def keep_rubbing(element, changes, i, path, n, z, rubbed, own, new):
    """Advance the states of friction i and their changes over step n; arguments as in `rub`."""
    travel = path[n, i] - path[n - 1, i]
    step = hysteron_step(element, z, travel)
    for j in range(own.shape[1]):
        rubbed[j, 0], rubbed[j, 1] = hysteron_tangent(
            element, z, travel, step, rubbed[j], new[i, j] - own[i, j], changes[j, 1])
    z[0], z[1], _, _ = laws.hysteron(z[0], z[1], travel, element.presliding, element.sharpness)


@kernel(**OUTER)
def static_tangents(models, rows, uniform, law, path, out):
    """Fill out (N, 3, P) with changes of equilibria path (N, 3) by law (3, LAW, P)."""
    m = models[0]
    parts, w, record = np.zeros((3, PARTS)), np.zeros(at.WORK_SIZE), np.zeros(LAWS + 5 * PLAIN_LAW)
    by = np.zeros((3, law.shape[2]))
    soft = 1e-9 * m.K1
    for n in range(path.shape[0]):
        ring_forces(m, rows, uniform, path[n, 0], path[n, 1], path[n, 2], 0.0, 0.0, 0.0, w, parts,
                    False)
        keep_sums(record, parts, w)
        by[:] = 0.0
        forces_by_law(m, record[LAWS:], law, by)
        k = at.STIFFNESS
        if not solve_all(w[k] + soft, w[k + 1], w[k + 2] + soft, w[k + 3],
                         w[k + 4] + soft * m.radius * m.radius, by, out[n]):
            out[n] = math.nan


DIED_AWAY = 1e-17
"""Share of the largest response below which the response to an error is neglected."""


@kernel(**OUTER)
def follow_errors(models, rows, uniform, q, v, h, force, sensitivity):
    """Fill sensitivity (3, J, J) about a motion q (N, 3), its rate v (N, 3), in steps of h [s].

    The response to a past error decays within some steps, so that few are followed at a time.
    """
    m = models[0]
    nodes = sensitivity.shape[1]
    size = q.shape[0] // nodes
    w, oldest, peak = np.zeros(at.WORK_SIZE), 0, 0.0
    p, a = np.zeros(3), np.zeros(3)
    state, old = np.zeros((6, nodes)), np.zeros((6, nodes))  # dq and its rate, of two steps
    for n in range(nodes * size):
        ring_forces(m, rows, uniform, q[n, 0], q[n, 1], q[n, 2], v[n, 0], v[n, 1], v[n, 2], w,
                    None, False)
        place = min(max((n + 0.5) / size - 0.5, 0.0), nodes - 1.0)
        first = int(place)
        share = place - first
        c0, c1, c2 = differences(h, h if n > 1 else 0.0)
        if n == 0:
            c0 = c1 = c2 = 0.0
        d = at.DAMPING
        matrix = system(m, w, at.STIFFNESS, d, c0, (0.0, 0.0, 0.0))
        while oldest < first:
            dx, dy, turn = abs(state[0, oldest]), abs(state[1, oldest]), abs(state[2, oldest])
            rate = max(abs(state[3, oldest]), abs(state[4, oldest]),
                       abs(state[5, oldest]) * m.radius) / max(c0, 1.0)
            if not max(dx, dy, turn * m.radius, rate) < DIED_AWAY * peak:
                break
            oldest += 1
        for j in range(oldest, min(first + 2, nodes)):
            error = 1.0 - share if j == first else (share if j == first + 1 else 0.0)
            for i in range(3):
                p[i] = c1 * state[i, j] + c2 * old[i, j]
                a[i] = c0 * p[i] + c1 * state[3 + i, j] + c2 * old[3 + i, j]
            _, x, y, tilt = solve3(
                *matrix, force[0] * error - m.mass * a[0] - w[d] * p[0] - w[d + 1] * p[2],
                force[1] * error - m.mass * a[1] - w[d + 2] * p[1] - w[d + 3] * p[2],
                force[2] * error - m.inertia * a[2]
                - w[d + 1] * p[0] - w[d + 3] * p[1] - w[d + 4] * p[2])
            for i in range(6):
                old[i, j] = state[i, j]
            for i, change in enumerate((x, y, tilt)):
                state[i, j], state[3 + i, j] = change, c0 * change + p[i]
            peak = max(peak, abs(x), abs(y), abs(tilt) * m.radius)
            for i in range(3):
                sensitivity[i, n // size, j] += state[i, j] / size
