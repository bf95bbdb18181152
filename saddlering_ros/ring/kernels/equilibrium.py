"""Static equilibrium under a load or a sequence of loads, by Newton on a convex energy."""

import math

import numpy as np

from saddlering_ros.ring.kernels import layout as at
from saddlering_ros.ring.kernels.contact import elastic_energy, ring_forces
from saddlering_ros.ring.kernels.extension_laws import load_at_ring
from saddlering_ros.ring.kernels.layout import INNER, kernel, OUTER


@kernel(**INNER)
def solve3(a00, a02, a11, a12, a22, r0, r1, r2):
    """(found, x0, x1, x2) with a x = r, a symmetric and a01 = 0; found only if a is definite."""
    if a00 <= 0.0 or a11 <= 0.0:
        return False, 0.0, 0.0, 0.0
    i00, i11 = 1.0 / a00, 1.0 / a11
    schur = a22 - a02 * a02 * i00 - a12 * a12 * i11
    if not schur > 0.0:
        return False, 0.0, 0.0, 0.0
    x2 = (r2 - a02 * i00 * r0 - a12 * i11 * r1) / schur
    return True, (r0 - a02 * x2) * i00, (r1 - a12 * x2) * i11, x2


@kernel(**INNER)
def differences(h, h_old):
    """(c0, c1, c2) of v = c0 q + c1 q_old + c2 q_older; c2 = 0 after a start or a jump in h.

    BDF2 for a step of h after one of h_old; backward Euler after a start.
    """
    ratio = h / h_old if h_old > 0.0 else 0.0
    if not 0.0 < ratio <= 2.0:
        return 1.0 / h, -1.0 / h, 0.0
    return ((1.0 + 2.0 * ratio) / (1.0 + ratio) / h, -(1.0 + ratio) / h,
            ratio * ratio / (1.0 + ratio) / h)


@kernel(**INNER)
def system(m, a, k, d, c0, rubbing):
    """Entries 00, 02, 11, 12, 22 of K + c0 D + c0^2 M + slopes of friction, the matrix of a step.

    K and D are at places k and d of an array a.
    """
    square = c0 * c0
    return (a[k] + c0 * a[d] + m.mass * square + rubbing[0], a[k + 1] + c0 * a[d + 1],
            a[k + 2] + c0 * a[d + 2] + m.mass * square + rubbing[1], a[k + 3] + c0 * a[d + 3],
            a[k + 4] + c0 * a[d + 4] + m.inertia * square + rubbing[2])


@kernel(**INNER)
def equilibrium(m, rows, uniform, w, x, y, tilt):
    """(found, q) of static equilibrium under w[EXTERNAL], starting at (x, y, tilt).

    The elastic energy is convex. Newton with backtracking on the total energy therefore converges
    from any start. A small spring holds directions without stiffness (free play).
    """
    radius = m.radius
    e0, e1, e2 = w[at.EXTERNAL], w[at.EXTERNAL + 1], w[at.EXTERNAL + 2]
    ring_forces(m, rows, uniform, x, y, tilt, 0.0, 0.0, 0.0, w, None, False)
    scale = abs(e0) + abs(e1) + abs(e2) / radius + 1.0
    if not scale < 1e300:
        return False, x, y, tilt
    for iteration in range(200):
        r0, r1, r2 = e0 + w[at.FORCE], e1 + w[at.FORCE + 1], e2 + w[at.FORCE + 2]
        largest = max(abs(r0), abs(r1), abs(r2) / radius)
        if largest <= 1e-11 * scale:
            return True, x, y, tilt
        soft = 1e-9 * m.K1 if iteration < 100 else 1e-6 * m.K1
        found, step0, step1, step2 = solve3(
            w[at.STIFFNESS] + soft, w[at.STIFFNESS + 1], w[at.STIFFNESS + 2] + soft,
            w[at.STIFFNESS + 3], w[at.STIFFNESS + 4] + soft * radius * radius, r0, r1, r2)
        if not found:
            return False, x, y, tilt
        longest = max(abs(step0), abs(step1), abs(step2) * radius)
        shrink = min(1.0, 2e-4 / longest) if longest > 0.0 else 1.0
        step0, step1, step2 = step0 * shrink, step1 * shrink, step2 * shrink
        work = r0 * step0 + r1 * step1 + r2 * step2
        factor, accepted = 1.0, False
        for _ in range(40):
            x1, y1, tilt1 = x + factor * step0, y + factor * step1, tilt + factor * step2
            ring_forces(m, rows, uniform, x1, y1, tilt1, 0.0, 0.0, 0.0, w, None, False)
            gain = factor * (e0 * step0 + e1 * step1 + e2 * step2)
            slope = ((e0 + w[at.FORCE]) * step0 + (e1 + w[at.FORCE + 1]) * step1
                     + (e2 + w[at.FORCE + 2]) * step2)
            accepted = slope >= -0.5 * work or (
                elastic_energy(m, rows, x1, y1, tilt1) - elastic_energy(m, rows, x, y, tilt)
                <= gain - 1e-4 * factor * work)
            if accepted:
                break
            factor *= 0.5
        if not accepted:
            # Rounding ends the descent. The residual is judged by the size of the load.
            return largest <= 1e-7 * scale, x, y, tilt
        x, y, tilt = x + factor * step0, y + factor * step1, tilt + factor * step2
        if factor * longest * shrink < 1e-15:
            break
    largest = max(abs(e0 + w[at.FORCE]), abs(e1 + w[at.FORCE + 1]),
                  abs(e2 + w[at.FORCE + 2]) / radius)
    return largest <= 1e-7 * scale, x, y, tilt


@kernel(**OUTER)
def static_batch(models, rows, uniform, load, q_out):
    """Equilibrium of each model (B,) at each load (N,) in order, or NaN; q_out (B, N, 3).

    The last equilibrium and its stiffness predict the next.
    """
    w, k = np.zeros(at.WORK_SIZE), at.STIFFNESS
    for b in range(models.shape[0]):
        m, r = models[b], b if rows.shape[0] > 1 else 0
        found, x, y, tilt = False, 0.0, 0.0, 0.0
        for n in range(load.size):
            old0, old1, old2 = w[at.EXTERNAL], w[at.EXTERNAL + 1], w[at.EXTERNAL + 2]
            load_at_ring(m, load[n], 0.0, 0.0, w)
            if found:
                near, step0, step1, step2 = solve3(
                    w[k], w[k + 1], w[k + 2], w[k + 3], w[k + 4], w[at.EXTERNAL] - old0,
                    w[at.EXTERNAL + 1] - old1, w[at.EXTERNAL + 2] - old2)
                if near and max(abs(step0), abs(step1), abs(step2) * m.radius) < 2e-5:
                    x, y, tilt = x + step0, y + step1, tilt + step2
            else:
                x = math.copysign(0.5 * m.radial_clearance + 1e-5, w[at.EXTERNAL])
                y = math.copysign(0.5 * m.axial_clearance + 1e-5, w[at.EXTERNAL + 1])
            found, x, y, tilt = equilibrium(m, rows[r], uniform[r], w, x, y, tilt)
            q_out[b, n, 0], q_out[b, n, 1], q_out[b, n, 2] = x, y, tilt
            if not found:
                q_out[b, n, :] = math.nan
