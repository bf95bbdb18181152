"""Tangents of equilibria and of time steps: how a motion changes with what the ring is made of.

At a solved step the residual R(q, theta) is zero, so dq = -(dR/dq)^-1 dR/dtheta (implicit function
theorem), and dR/dq is the 3 x 3 matrix of the step. A motion is differentiated along itself: one
sum over the rollers a step serves all directions.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from saddlering_ros.ring.kernels import layout as at
from saddlering_ros.ring.kernels.contact import (
    DAMPING_REFERENCE,
    in_contact,
    MIN_FORCE,
    RAMP,
)
from saddlering_ros.ring.kernels.extension_laws import (
    advance_series,
    hysteron,
    load_at_ring,
    read_probes,
    series_motion,
)
from saddlering_ros.ring.kernels.integration import take_load, take_zero
from saddlering_ros.ring.kernels.options import FAST, INNER, kernel, OUTER
from saddlering_ros.ring.kernels.vector_math import exp2_of, log2_of, widest_vectors

LAW = 6
"""Parameters of one row: K, n, D, and share, exponent and saturation of growing damping."""

PARTS = 6 + 2 * LAW + 1
"""Of a row: k and d times 1, cos, cos^2; forces per parameter times 1, cos; its next guess."""

LN2 = math.log(2.0)


@kernel(fastmath=FAST, **INNER)
def row_tangents(rows: Any, row: Any, rollers: Any, uniform: Any, a: Any, b: Any, da: Any,
                 db: Any, law: Any, growing: Any, saturation: Any, part: Any) -> Any:
    """Fill part (PARTS,) of one row; penetration, rate and law as in `contact.row_sums`.

    law (K, n, D); growing: None or (share, exponent); saturation: None or the parameter.
    """
    widest_vectors()
    stiffness, exponent, damping = law
    stride = np.uint64(rows.size) // np.uint64(9)
    base = np.uint64(row) * np.uint64(3) * stride
    first, touching = in_contact(rows, base, stride, rollers, uniform, a, b,
                                 np.uint64(part[PARTS - 1]))
    for i in range(PARTS - 1):
        part[i] = 0.0
    part[PARTS - 1] = float(touching)
    if touching == np.uint64(0):
        return
    count = (touching + np.uint64(7)) & ~np.uint64(7)
    cosines = base + first
    weights, gaps = cosines + stride, cosines + np.uint64(2) * stride
    k0 = k1 = k2 = d0 = d1 = d2 = 0.0
    e0 = e1 = n0 = n1 = c0 = c1 = s0 = s1 = m0 = m1 = l0 = l1 = 0.0
    share, growth, factor, steepness, turn = 0.0, 0.0, 0.0, 0.0, 0.0
    factor_slope = level_log = turn_slope = 0.0
    if growing is not None:
        share, growth = growing
        growth = growth if growth > 0.0 else exponent
        constant = DAMPING_REFERENCE ** (-growth)
        factor_slope = -math.log(DAMPING_REFERENCE) * constant
        if saturation is not None:
            turn = saturation ** growth
            level_log = math.log(saturation)
            turn_slope = growth * turn / saturation
            factor_slope += turn * level_log
        factor = constant + turn
        factor_slope /= factor
        steepness = 1.0 / (RAMP * max(1.0 - growth, 1e-20))
    for j in range(count):
        c = rows[cosines + j]
        p = max(a + b * c - rows[gaps + j], 1e-30)
        rate = da + db * c
        binary = log2_of(p)
        natural = LN2 * binary
        relative = exp2_of((exponent - 1.0) * binary)
        u = min(p * (1.0 / RAMP), 1.0)
        shape = (1.0 - share) * (u * u * (3.0 - 2.0 * u))
        shape_slope = (1.0 - share) * (6.0 / RAMP) * (u - u * u)
        by_share = by_exponent = by_saturation = 0.0
        if growing is not None:
            rising = exp2_of((growth - 1.0) * binary)
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
                grown * log_slope + rising * p * swing * (steepness * RAMP))
            by_saturation *= damping * rate * share * grown
            shape += share * grown
            shape_slope += share * rising * (slope * fade + swing)
        elastic = relative * p
        d = damping * shape
        force = stiffness * elastic + d * rate
        k = exponent * stiffness * relative + damping * shape_slope * rate
        carries = rows[weights + j] if force > MIN_FORCE else 0.0
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
                  parts: Any) -> Any:
    """Fill parts (3, PARTS) of upper, lower and radial row at motion q (3,) and its rate v."""
    radius, height = m.radius, m.radial_row_height
    axial, radial = np.uint64(m.axial_rollers), np.uint64(m.radial_rollers)
    row_tangents(rows, 0, axial, uniform[0], q[1], -radius * q[2], v[1], -radius * v[2],
                 (m.K1 * m.upper_row_stiffness, m.n1, m.D1), growing, saturation, parts[0])
    row_tangents(rows, 1, axial, uniform[1], -q[1], radius * q[2], -v[1], radius * v[2],
                 (m.K1 * m.lower_row_stiffness, m.n1, m.D1), growing, saturation, parts[1])
    row_tangents(rows, 2, radial, uniform[2], 0.0, q[0] + height * q[2], 0.0,
                 v[0] + height * v[2], (m.K2 * m.radial_row_stiffness, m.n2, m.D2), growing,
                 saturation, parts[2])


@kernel(**INNER)
def ring_tangents(m: Any, rows: Any, uniform: Any, q: Any, v: Any, grows: Any,
                  parts: Any) -> Any:
    """`rows_tangents` with the damping law in use, or one that a direction brings in."""
    growing = (m.damping_penetration_share, m.damping_penetration_exponent)
    if not grows:
        rows_tangents(m, rows, uniform, q, v, None, None, parts)
    elif m.damping_penetration_saturation == 0.0:
        rows_tangents(m, rows, uniform, q, v, growing, None, parts)
    else:
        rows_tangents(m, rows, uniform, q, v, growing, m.damping_penetration_saturation, parts)


@kernel(fastmath=FAST, **INNER)
def row_geometry(rows: Any, change: Any, row: Any, rollers: Any, a: Any, b: Any, da: Any, db: Any,
                 m: Any, law: Any) -> Any:
    """Change of sum F and sum F cos of a row by a change (9 J,) of its weights and gaps."""
    stiffness, exponent, damping = law
    stride = rows.size // 9
    base = row * 3 * stride
    share, growth = m.damping_penetration_share, m.damping_penetration_exponent
    growth = growth if growth > 0.0 else exponent
    turn = m.damping_penetration_saturation ** growth
    if m.damping_penetration_saturation == 0.0:
        turn = 0.0
    factor = DAMPING_REFERENCE ** (-growth) + turn
    steepness = 1.0 / (RAMP * max(1.0 - growth, 1e-20))
    s0 = s1 = 0.0
    for j in range(base, base + rollers):
        c = rows[j]
        p = a + b * c - rows[2 * stride + j]
        if p <= 0.0:
            continue
        rate = da + db * c
        u = min(p / RAMP, 1.0)
        w = min(p * steepness, 1.0)
        fade = w * w * (3.0 - 2.0 * w)
        rising = p ** (growth - 1.0)
        level = 1.0 / (1.0 + turn * rising * p)
        grown = factor * rising * level
        elastic = stiffness * p ** (exponent - 1.0)
        force = elastic * p + damping * rate * (
            (1.0 - share) * u * u * (3.0 - 2.0 * u) + share * grown * p * fade)
        slope = exponent * elastic + damping * rate * (
            (1.0 - share) * 6.0 / RAMP * (u - u * u)
            + share * grown * (growth * level * fade + 6.0 * w * (w - w * w)))
        if force > MIN_FORCE:
            by = change[stride + j] * force - rows[stride + j] * slope * change[2 * stride + j]
            s0 += by
            s1 += by * c
    return s0, s1


@kernel(**INNER)
def forces_by_geometry(m: Any, rows: Any, change: Any, q: Any, v: Any, by: Any,
                       j: Any) -> Any:
    """Add to by[:, j] the change of the ring's forces by a change (9 J,) of its rollers."""
    radius, height = m.radius, m.radial_row_height
    axial, radial = int(m.axial_rollers), int(m.radial_rollers)
    up0, up1 = row_geometry(rows, change, 0, axial, q[1], -radius * q[2], v[1], -radius * v[2], m,
                            (m.K1 * m.upper_row_stiffness, m.n1, m.D1))
    low0, low1 = row_geometry(rows, change, 1, axial, -q[1], radius * q[2], -v[1],
                              radius * v[2], m, (m.K1 * m.lower_row_stiffness, m.n1, m.D1))
    _, s1 = row_geometry(rows, change, 2, radial, 0.0, q[0] + height * q[2], 0.0,
                         v[0] + height * v[2], m, (m.K2 * m.radial_row_stiffness, m.n2, m.D2))
    by[0, j] -= s1
    by[1, j] += low0 - up0
    by[2, j] += radius * (up1 - low1) - height * s1


@kernel(fastmath=FAST, **INNER)
def forces_by_law(m: Any, parts: Any, law: Any, count: Any, by: Any) -> Any:
    """Add to by (3, P) the change of the ring's forces by changes of the rows' laws (3, LAW, P).

    count: how many of the LAW parameters change. Directions are the last axis: vector code.
    """
    radius, height = m.radius, m.radial_row_height
    for i in range(count):
        up0, up1 = parts[0, 6 + 2 * i], radius * parts[0, 7 + 2 * i]
        low0, low1 = parts[1, 6 + 2 * i], radius * parts[1, 7 + 2 * i]
        s1 = parts[2, 7 + 2 * i]
        for j in range(law.shape[2]):
            upper, lower, radial = law[0, i, j], law[1, i, j], s1 * law[2, i, j]
            by[0, j] -= radial
            by[1, j] += low0 * lower - up0 * upper
            by[2, j] += up1 * upper - low1 * lower - height * radial


@kernel(fastmath=FAST, **INNER)
def solve_all(a00: Any, a02: Any, a11: Any, a12: Any, a22: Any, by: Any, out: Any) -> Any:
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
def carry(m: Any, w: Any, c0: Any, c1: Any, c2: Any, own: Any, past: Any, by: Any) -> Any:
    """Take from by (3, P) what the past states, dq and dv (6, P), do to this step.

    The difference formulas are dv = c0 dq + pulls; past (6, P) becomes the pulls of dq and dv.
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
def matrices(m: Any, parts: Any, w: Any) -> Any:
    """w[STIFFNESS] and w[DAMPING] from parts (3, PARTS), as `contact.ring_forces` fills them."""
    radius, height = m.radius, m.radial_row_height
    for place, i in ((at.STIFFNESS, 0), (at.DAMPING, 3)):
        w[place] = parts[2, i + 2]
        w[place + 1] = height * parts[2, i + 2]
        w[place + 2] = parts[0, i] + parts[1, i]
        w[place + 3] = -radius * (parts[0, i + 1] + parts[1, i + 1])
        w[place + 4] = (radius * radius * (parts[0, i + 2] + parts[1, i + 2])
                        + height * height * parts[2, i + 2])


@kernel(**INNER)
def hysteron_tangent(z_smooth: Any, z_sharp: Any, travel: Any, presliding: Any, by_smooth: Any,
                     by_sharp: Any, by_travel: Any, by_presliding: Any) -> Any:
    """Changes of the two states of `hysteron` after `travel` by changes of what they come from."""
    sign = 1.0 if travel >= 0.0 else -1.0
    decay = math.exp(-abs(travel) / presliding)
    relative = (sign * by_travel - abs(travel) * by_presliding / presliding) / presliding
    smooth = decay * (by_smooth + (sign - z_smooth) * relative)
    trial = z_sharp + travel / presliding
    sharp = 0.0
    if -1.0 < trial < 1.0:
        sharp = by_sharp + (by_travel - travel * by_presliding / presliding) / presliding
    return smooth, sharp


@kernel(**INNER)
def friction_change(element: Any, change: Any, z: Any, travel: Any, by: Any,
                    by_travel: Any) -> Any:
    """Change of a friction force by a change (limit, presliding, sharpness, initial) of it.

    z, by (2,): the states before the step and their changes.
    """
    smooth, sharp, now, _ = hysteron(z[0], z[1], travel, element.presliding, element.sharpness)
    by_smooth, by_sharp = hysteron_tangent(z[0], z[1], travel, element.presliding, by[0], by[1],
                                           by_travel, change[1])
    by_now = (element.sharpness * by_sharp + (1.0 - element.sharpness) * by_smooth
              + change[2] * (sharp - smooth))
    return change[0] * now + element.limit * by_now


@kernel(**OUTER)
def motion_tangents(models: Any, rows: Any, uniform: Any, law: Any, external: Any, friction: Any,
                    geometry: Any, time: Any, path: Any, out: Any) -> Any:
    """Fill out (N, 3, P): changes of a motion path (N, 3) that starts at rest; False if it fails.

    Each direction is a small change of law (3, LAW, P) by row, of external load (N, 3, P), of
    friction (P, 2, 4) and, for the first G, of rollers (G, 9 J). time (N,) are the steps taken.
    """
    m = models[0]
    directions = law.shape[2]
    grows = m.damping_penetration_share != 0.0 or np.any(law[:, 3:])
    rubs = (m.radial_friction.limit != 0.0 or m.tilt_friction.limit != 0.0
            or np.any(friction))
    return follow_tangents(
        m, rows, uniform, law, external, friction, geometry, time, path, out, grows, rubs,
        np.zeros((3, PARTS)), np.zeros(at.WORK_SIZE), np.zeros((3, 6, directions)),
        np.zeros((2, directions, 2)), np.zeros((2, 2)), np.zeros((2, 3)),
        np.zeros((3, directions)))


@kernel(**INNER)
def follow_tangents(m: Any, rows: Any, uniform: Any, law: Any, external: Any, friction: Any,
                    geometry: Any, time: Any, path: Any, out: Any, grows: Any, rubs: Any,
                    parts: Any, w: Any, states: Any, rubbed: Any, elements: Any,
                    motion: Any, by: Any) -> Any:
    """`motion_tangents` in work arrays: three times dq and dv (3, 6, P), friction, q and v."""
    radial, tilting = elements[0], elements[1]
    radial[0] = radial[1] = m.radial_friction.initial
    tilting[0] = tilting[1] = m.tilt_friction.initial
    q, v = motion[0], motion[1]
    h_old, soft = 0.0, 1e-9 * m.K1
    changing = LAW if grows else 3
    for n in range(time.size):
        c0 = c1 = c2 = rubbing0 = rubbing2 = 0.0
        if n > 0:
            h = time[n] - time[n - 1]
            ratio = h / h_old if h_old > 0.0 else 0.0
            if 0.0 < ratio <= 2.0:
                c0 = (1.0 + 2.0 * ratio) / (1.0 + ratio) / h
                c1 = -(1.0 + ratio) / h
                c2 = ratio * ratio / (1.0 + ratio) / h
            else:
                c0, c1, c2 = 1.0 / h, -1.0 / h, 0.0
            h_old, soft = h, 0.0
            before = max(n - 2, 0)
            for i in range(3):
                v[i] = c0 * path[n, i] + c1 * path[n - 1, i] + c2 * path[before, i]
        for i in range(3):
            q[i] = path[n, i]
        own, past, new = states[n % 3], states[(n + 2) % 3], states[(n + 1) % 3]
        ring_tangents(m, rows, uniform, q, v, grows, parts)
        matrices(m, parts, w)
        for i in range(3):
            for j in range(by.shape[1]):
                by[i, j] = external[n, i, j]
        forces_by_law(m, parts, law, changing, by)
        for j in range(geometry.shape[0]):
            forces_by_geometry(m, rows, geometry[j], q, v, by, j)
        if rubs:
            rubbing0, rubbing2 = rub(m, friction, path, n, elements, rubbed, own, by)
        carry(m, w, c0, c1, c2, own, past, by)
        k, d, square = at.STIFFNESS, at.DAMPING, c0 * c0
        if not solve_all(
                w[k] + c0 * w[d] + m.mass * square + rubbing0 + soft, w[k + 1] + c0 * w[d + 1],
                w[k + 2] + c0 * w[d + 2] + m.mass * square + soft, w[k + 3] + c0 * w[d + 3],
                w[k + 4] + c0 * w[d + 4] + m.inertia * square + rubbing2
                + soft * m.radius * m.radius, by, new):
            return False
        for i in range(3):
            for j in range(by.shape[1]):
                new[3 + i, j] = c0 * new[i, j] + past[i, j]
                out[n, i, j] = new[i, j]
        if rubs:
            keep_rubbing(m, friction, path, n, elements, rubbed, own, new)
    return True


@kernel(**INNER)
def rub(m: Any, friction: Any, path: Any, n: Any, elements: Any, rubbed: Any, own: Any,
        by: Any) -> Any:
    """Take from by (3, P) the change of friction at step n; the slopes of both frictions."""
    if n == 0:
        for j in range(by.shape[1]):
            by[0, j] -= (friction[j, 0, 0] * m.radial_friction.initial
                         + friction[j, 0, 3] * m.radial_friction.limit)
            by[2, j] -= (friction[j, 1, 0] * m.tilt_friction.initial
                         + friction[j, 1, 3] * m.tilt_friction.limit)
        return 0.0, 0.0
    travel0, travel2 = path[n, 0] - path[n - 1, 0], path[n, 2] - path[n - 1, 2]
    for j in range(by.shape[1]):
        by[0, j] -= friction_change(m.radial_friction, friction[j, 0], elements[0], travel0,
                                    rubbed[0, j], -own[0, j])
        by[2, j] -= friction_change(m.tilt_friction, friction[j, 1], elements[1], travel2,
                                    rubbed[1, j], -own[2, j])
    _, _, _, slope0 = hysteron(elements[0, 0], elements[0, 1], travel0,
                               m.radial_friction.presliding, m.radial_friction.sharpness)
    _, _, _, slope2 = hysteron(elements[1, 0], elements[1, 1], travel2,
                               m.tilt_friction.presliding, m.tilt_friction.sharpness)
    return m.radial_friction.limit * slope0, m.tilt_friction.limit * slope2


@kernel(**INNER)
def keep_rubbing(m: Any, friction: Any, path: Any, n: Any, elements: Any, rubbed: Any, own: Any,
                 new: Any) -> Any:
    """The states of friction, and their changes, after step n."""
    for e in range(2):
        element, i = (m.radial_friction, 0) if e == 0 else (m.tilt_friction, 2)
        z = elements[e]
        if n == 0:
            for j in range(own.shape[1]):
                rubbed[e, j, 0] = rubbed[e, j, 1] = friction[j, e, 3]
            continue
        travel = path[n, i] - path[n - 1, i]
        for j in range(own.shape[1]):
            rubbed[e, j, 0], rubbed[e, j, 1] = hysteron_tangent(
                z[0], z[1], travel, element.presliding, rubbed[e, j, 0], rubbed[e, j, 1],
                new[i, j] - own[i, j], friction[j, e, 1])
        z[0], z[1], _, _ = hysteron(z[0], z[1], travel, element.presliding, element.sharpness)


@kernel(**OUTER)
def static_tangents(models: Any, rows: Any, uniform: Any, law: Any, path: Any, out: Any) -> Any:
    """Fill out (N, 3, P): changes of equilibria path (N, 3) by changes of law (3, LAW, P)."""
    m = models[0]
    parts, w = np.zeros((3, PARTS)), np.zeros(at.WORK_SIZE)
    still, by = np.zeros(3), np.zeros((3, law.shape[2]))
    soft = 1e-9 * m.K1
    for n in range(path.shape[0]):
        ring_tangents(m, rows, uniform, path[n], still, False, parts)
        matrices(m, parts, w)
        by[:] = 0.0
        forces_by_law(m, parts, law, 3, by)
        k = at.STIFFNESS
        if not solve_all(w[k] + soft, w[k + 1], w[k + 2] + soft, w[k + 3],
                         w[k + 4] + soft * m.radius * m.radius, by, out[n]):
            out[n] = math.nan


@kernel(**OUTER)
def load_course(models: Any, zero_load: Any, load: Any, external: Any) -> Any:
    """Fill external (N, 3): force and moment on the ring, at rest under zero_load at sample 0."""
    m = models[0]
    s, w = np.zeros(at.STATE_SIZE), np.zeros(at.WORK_SIZE)
    load_at_rest(m, s, zero_load, w)
    for n in range(load.size):
        if n > 0:
            take_load(m, s, load[n], w)
        for i in range(3):
            external[n, i] = w[at.EXTERNAL + i]


@kernel(**INNER)
def load_at_rest(m: Any, s: Any, load: Any, w: Any) -> Any:
    """The state of the load path at the start, as `integration.rest` leaves it."""
    s[at.CYLINDER_Z] = s[at.CYLINDER_Z + 1] = m.cylinder_friction.initial
    s[at.BRACKET_Z] = s[at.BRACKET_Z + 1] = m.bracket_play.initial
    s[at.MEASURED_LOAD] = s[at.HIGHEST_LOAD] = load
    return load_at_ring(m, load, m.cylinder_friction.initial, m.bracket_play.initial, w)


@kernel(**OUTER)
def read_course(models: Any, zero_load: Any, time: Any, load: Any, path: Any, out: Any) -> Any:
    """Fill out (N, 4): what the probes read of a motion path (N, 3) that is known."""
    m = models[0]
    s, w = np.zeros(at.STATE_SIZE), np.zeros(at.WORK_SIZE)
    true_load = load_at_rest(m, s, zero_load, w)
    for i in range(3):
        s[at.Q + i] = path[0, i]
    take_zero(m, s, true_load, time[0], w)
    for n in range(time.size):
        step = 0.0
        if n > 0:
            step = time[n] - time[n - 1]
            true_load = take_load(m, s, load[n], w)
            for i in range(3):
                s[at.Q + i] = path[n, i]
        series_motion(m, s, w)
        advance_series(m, s, w, step)
        read_probes(m, s, w, true_load, time[n], step, out, n)
