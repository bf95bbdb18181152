"""Compiled sums over rollers, equilibrium and time stepping, as plain functions of float arrays.

The equations are those of ring-model.md (docs/ring-model.md here) and of `reference.py`, which
sums the same 304 rollers in readable numpy. What makes this file fast: rollers are sorted by their
cosine, so that those in contact are an interval; powers come from a vectorised log2/exp2 on that
interval only; BDF2 needs one implicit solve a step; a good predictor needs one Newton step mostly.

Everything here works on a `layout` of flat arrays made by `model.py`; see there for the meaning of
each index. All functions release the GIL.
"""

from __future__ import annotations

import math

import numba as nb
import numpy as np

from saddlering_ros.ring import layout as at

FAST = {'reassoc', 'contract', 'nsz', 'arcp', 'nnan', 'ninf'}
RAMP = 1e-6
"""Penetration over which the damper is faded in [m] (C1, so no force jump at touch-down)."""

DAMPING_REFERENCE = 50e-6
"""Penetration at which penetration-proportional damping equals D [m]."""

STEP_TOLERANCE = 1e-9
"""A Newton update below this [m] is the last: the next would be below 1e-12 m (quadratic)."""

LARGEST_ITERATIONS = 60

LOG2_E = 1.4426950408889634
LN_2 = 0.6931471805599453
SQRT_HALF_BITS = 0x3FE6A09E667F3BCD


@nb.njit(cache=True, nogil=True, fastmath=FAST, error_model='numpy', inline='never')
def power_into(exponent, scratch, bits, count):  # type: ignore[no-untyped-def]
    """scratch[1, :count] = scratch[0, :count] ** exponent for positive normal numbers, to 2e-15.

    log2 by the atanh series on the mantissa, exp2 by its Taylor series; written as loops that the
    compiler turns into vector code, four times faster than one libm call a roller. `bits` is the
    int64 view of `scratch`, whose row 2 is used up.
    """
    for j in range(count):
        pattern = bits[0, j]
        exponent2 = (pattern - SQRT_HALF_BITS) >> 52
        scratch[1, j] = np.float64(exponent2)
        bits[2, j] = pattern - (exponent2 << 52)
    for j in range(count):
        m = scratch[2, j]
        s = (m - 1.0) / (m + 1.0)
        z = s * s
        series = (((((((((z / 21. + 1 / 19.) * z + 1 / 17.) * z + 1 / 15.) * z + 1 / 13.) * z
                      + 1 / 11.) * z + 1 / 9.) * z + 1 / 7.) * z + 1 / 5.) * z + 1 / 3.)
        log2 = scratch[1, j] + (2.0 * s + 2.0 * s * z * series) * LOG2_E
        y = exponent * log2
        k = math.floor(y + 0.5)
        f = (y - k) * LN_2
        scratch[1, j] = 1. + f * (1. + f * (1 / 2. + f * (1 / 6. + f * (1 / 24. + f * (
            1 / 120. + f * (1 / 720. + f * (1 / 5040. + f * (1 / 40320. + f * (
                1 / 362880. + f * (1 / 3628800. + f * (1 / 39916800. + f / 479001600.)))))))))))
        scratch[2, j] = k
    for j in range(count):
        bits[2, j] = (np.int64(scratch[2, j]) + 1023) << 52
    for j in range(count):
        scratch[1, j] *= scratch[2, j]


@nb.njit(cache=True, nogil=True, fastmath=FAST, error_model='numpy', inline='never')
def row_sums(rows, row, rollers, uniform, a, b, da, db, kappa, stiffness, exponent, damping, share,
             scratch, bits, sums):  # type: ignore[no-untyped-def]
    """Force sums of one row with penetration p = a + b cos - gap and rate dp/dt = da + db cos.

    sums: [sum F, sum F cos, sum F', sum F' cos, sum F' cos^2, energy] with F' the derivative of F
    by p when dp/dt moves with `kappa` times p; energy = sum K p^(n+1)/(n+1) (static part).
    rows (3, 3, J) as made by `model`; scratch (3, >= rollers) with its int64 view `bits`.
    """
    for k in range(6):
        sums[k] = 0.0
    first, count = 0, 0
    if uniform:
        edge = rows[row, 2, 0]
        for j in range(rollers):
            if a + b * rows[row, 0, j] > edge:
                count += 1
        first = 0 if b >= 0.0 else rollers - count
    else:
        last = -1
        for j in range(rollers):
            if a + b * rows[row, 0, j] > rows[row, 2, j]:
                if last < 0:
                    first = j
                last = j
        count = last - first + 1 if last >= 0 else 0
    if count == 0:
        return
    for j in range(count):
        scratch[0, j] = max(a + b * rows[row, 0, first + j] - rows[row, 2, first + j], 1e-30)
    power_into(exponent, scratch, bits, count)
    s0 = s1 = t0 = t1 = t2 = energy = 0.0
    reference = DAMPING_REFERENCE ** (-exponent)
    for j in range(count):
        c = rows[row, 0, first + j]
        p = scratch[0, j]
        inverse = 1.0 / p
        rate = da + db * c
        elastic = stiffness * scratch[1, j]
        u = min(p * (1.0 / RAMP), 1.0)
        grown = scratch[1, j] * reference
        d = damping * ((1.0 - share) * (u * u * (3.0 - 2.0 * u)) + share * grown)
        d_slope = damping * ((1.0 - share) * (6.0 / RAMP * u * (1.0 - u))
                             + share * exponent * grown * inverse)
        force = elastic + d * rate
        tangent = exponent * elastic * inverse + d_slope * rate + kappa * d
        carried = rows[row, 1, first + j] if force > 0.0 and p > 1e-29 else 0.0
        force *= carried
        tangent *= carried
        s0 += force
        s1 += force * c
        t0 += tangent
        t1 += tangent * c
        t2 += tangent * c * c
        energy += carried * elastic * p
    sums[0] = s0
    sums[1] = s1
    sums[2] = t0
    sums[3] = t1
    sums[4] = t2
    sums[5] = energy / (exponent + 1.0)


@nb.njit(cache=True, nogil=True, error_model='numpy')
def hysteron(z_smooth, z_sharp, travel, presliding, sharpness):  # type: ignore[no-untyped-def]
    """Rate-free friction after `travel`: (z_smooth, z_sharp, z, dz/dtravel).

    z_smooth follows Dahl's dz/dx = (1 - sgn(dx) z)/presliding, solved exactly over the step;
    z_sharp is the elastic-plastic (Jenkins) element with the same initial slope.
    """
    sign = 1.0 if travel >= 0.0 else -1.0
    decay = math.exp(-abs(travel) / presliding)
    smooth = sign - (sign - z_smooth) * decay
    smooth_slope = (1.0 - sign * z_smooth) * decay / presliding
    trial = z_sharp + travel / presliding
    sharp = min(1.0, max(-1.0, trial))
    sharp_slope = 1.0 / presliding if -1.0 < trial < 1.0 else 0.0
    return (smooth, sharp, sharpness * sharp + (1.0 - sharpness) * smooth,
            sharpness * sharp_slope + (1.0 - sharpness) * smooth_slope)


@nb.njit(cache=True, nogil=True, error_model='numpy', inline='never')
def ring_forces(m, rows, uniform, q, v, kappa, scratch, bits, sums, force, tangent):  # type: ignore[no-untyped-def]
    """Contact forces on the upper ring, force (3,) and -d force/dq `tangent` (3, 3); returns energy.

    q = (delta_x, delta_y, gamma), v its rate, kappa = dv/dq of the implicit step (0: static).
    """
    radius, height = m[at.RADIUS], m[at.MIDDLE_HEIGHT]
    count_axial, count_middle = int(m[at.AXIAL_ROLLERS]), int(m[at.MIDDLE_ROLLERS])
    for i in range(3):
        force[i] = 0.0
        for j in range(3):
            tangent[i, j] = 0.0
    share = m[at.DAMPING_SHARE]
    b = q[0] + height * q[2]
    row_sums(rows, 2, count_middle, uniform[2], 0.0, b, 0.0,
             v[0] + height * v[2], kappa, m[at.K2], m[at.N2], m[at.D2], share, scratch, bits, sums)
    force[0] = -sums[1]
    force[2] = -height * sums[1]
    tangent[0, 0] = sums[4]
    tangent[0, 2] = height * sums[4]
    tangent[2, 0] = height * sums[4]
    tangent[2, 2] = height * height * sums[4]
    energy = sums[5]
    for row in range(2):
        sign = 1.0 if row == 0 else -1.0
        row_sums(rows, row, count_axial, uniform[row], sign * q[1], -sign * radius * q[2], sign * v[1], -sign * radius * v[2], kappa,
                 m[at.K1], m[at.N1], m[at.D1], share, scratch, bits, sums)
        force[1] -= sign * sums[0]
        force[2] += sign * radius * sums[1]
        tangent[1, 1] += sums[2]
        tangent[1, 2] -= radius * sums[3]
        tangent[2, 1] -= radius * sums[3]
        tangent[2, 2] += radius * radius * sums[4]
        energy += sums[5]
    return energy


@nb.njit(cache=True, nogil=True, error_model='numpy')
def solve3(a, r, out):  # type: ignore[no-untyped-def]
    """Out = a^-1 r for a symmetric positive definite 3 x 3 (Cholesky); False if it is not."""
    l00 = a[0, 0]
    if l00 <= 0.0:
        return False
    l00 = math.sqrt(l00)
    l10, l20 = a[1, 0] / l00, a[2, 0] / l00
    d = a[1, 1] - l10 * l10
    if d <= 0.0:
        return False
    l11 = math.sqrt(d)
    l21 = (a[2, 1] - l20 * l10) / l11
    d = a[2, 2] - l20 * l20 - l21 * l21
    if d <= 0.0:
        return False
    l22 = math.sqrt(d)
    y0 = r[0] / l00
    y1 = (r[1] - l10 * y0) / l11
    y2 = (r[2] - l20 * y0 - l21 * y1) / l22
    out[2] = y2 / l22
    out[1] = (y1 - l21 * out[2]) / l11
    out[0] = (y0 - l10 * out[1] - l20 * out[2]) / l00
    return True


@nb.njit(cache=True, nogil=True, error_model='numpy')
def equilibrium(m, rows, uniform, external, q, scratch, bits, sums):  # type: ignore[no-untyped-def]
    """Static equilibrium under `external` (3,), starting from and returned in q; iterations or -1.

    The elastic energy is convex, so Newton with a backtracking on total energy converges from
    anywhere. Directions without stiffness (a free play) are held by a small spring about the start.
    """
    force, step, residual = np.empty(3), np.empty(3), np.empty(3)
    tangent = np.empty((3, 3))
    still, trial = np.zeros(3), np.empty(3)
    radius = m[at.RADIUS]
    energy = ring_forces(m, rows, uniform, q, still, 0.0, scratch, bits, sums, force, tangent)
    scale = abs(external[0]) + abs(external[1]) + abs(external[2]) / radius + 1.0
    for iteration in range(200):
        largest = 0.0
        for i in range(3):
            residual[i] = external[i] + force[i]
            arm = radius if i == 2 else 1.0
            largest = max(largest, abs(residual[i]) / arm)
        if largest <= 1e-11 * scale:
            return iteration
        soft = 1e-9 * m[at.K1] if iteration < 100 else 1e-6 * m[at.K1]
        tangent[0, 0] += soft
        tangent[1, 1] += soft
        tangent[2, 2] += soft * radius * radius
        if not solve3(tangent, residual, step):
            return -1
        longest = max(abs(step[0]), abs(step[1]), abs(step[2]) * radius)
        shrink = min(1.0, 2e-4 / longest) if longest > 0.0 else 1.0
        work = 0.0
        for i in range(3):
            step[i] *= shrink
            work += residual[i] * step[i]
        accepted = False
        factor = 1.0
        for _ in range(40):
            gain = 0.0
            for i in range(3):
                trial[i] = q[i] + factor * step[i]
                gain += external[i] * factor * step[i]
            new_energy = ring_forces(m, rows, uniform, trial, still, 0.0, scratch, bits, sums,
                                     force, tangent)
            slope = 0.0
            for i in range(3):
                slope += (external[i] + force[i]) * step[i]
            if slope >= -0.5 * work or new_energy - energy <= gain - 1e-4 * factor * work:
                accepted = True
                break
            factor *= 0.5
        if not accepted:
            # Rounding ends the descent; what is left is compared with the load's own size.
            return iteration if largest <= 1e-7 * scale else -1
        for i in range(3):
            q[i] = trial[i]
        energy = new_energy
        if factor * longest * shrink < 1e-15:
            return iteration + 1
    return -1


@nb.njit(cache=True, nogil=True, error_model='numpy')
def load_at_ring(m, measured, z_cylinder, z_bracket, external, resolved):  # type: ignore[no-untyped-def]
    """From the measured load [N] to `external` (3,) with dead weight and `resolved` (3,) without.

    resolved: F_x, F_y, M of the load alone, which series compliances answer to. Returns P.
    """
    full_scale = m[at.FULL_SCALE]
    load = measured / (1.0 + m[at.LOAD_GAIN]) - m[at.LOAD_OFFSET]
    load += 4.0 * m[at.LOAD_CURVE] * measured * (full_scale - measured) / full_scale
    load -= m[at.CYLINDER_LIMIT] * z_cylinder
    elevation = m[at.ELEVATION] + m[at.ELEVATION_ERROR] + m[at.BRACKET_LIMIT] * z_bracket
    cosine, sine = math.cos(elevation), math.sin(elevation)
    resolved[0] = load * cosine
    resolved[1] = -load * sine
    resolved[2] = load * ((m[at.TRUNNION_Y] + m[at.MOMENT_ARM]) * cosine + m[at.TRUNNION_X] * sine)
    external[0] = resolved[0]
    external[1] = resolved[1] - m[at.WEIGHT]
    external[2] = resolved[2] + m[at.WEIGHT] * m[at.WEIGHT_X]
    return load


@nb.njit(cache=True, nogil=True, error_model='numpy')
def low_pass(state, old, new, dt, time_constant):  # type: ignore[no-untyped-def]
    """First-order low-pass over dt, exact for an input that is linear from `old` to `new`."""
    if time_constant <= 0.0:
        return new
    ratio = dt / time_constant
    decay = math.exp(-ratio)
    if ratio < 1e-6:
        mean_weight = 0.5 * ratio
    else:
        mean_weight = 1.0 - (1.0 - decay) / ratio
    return state * decay + old * (1.0 - decay - mean_weight) + new * mean_weight


@nb.njit(cache=True, nogil=True, error_model='numpy')
def series_motion(m, s, resolved, load, motion):  # type: ignore[no-untyped-def]
    """Motion (3,): contact motion plus series compliances, settling (before creep and resonance)."""
    highest = s[at.HIGHEST_LOAD]
    motion[0] = (s[at.Q] + m[at.RADIAL_COMPLIANCE] * resolved[0] + m[at.SETTLING_X] * highest)
    motion[1] = (s[at.Q + 1] + m[at.AXIAL_COMPLIANCE] * resolved[1] + m[at.SETTLING_Y] * highest)
    motion[2] = (s[at.Q + 2] + m[at.TILT_COMPLIANCE] * resolved[2] + m[at.SETTLING_TILT] * highest
                 + m[at.OPENING_COMPLIANCE] * max(0.0, resolved[2] - m[at.OPENING_MOMENT]))


@nb.njit(cache=True, nogil=True, error_model='numpy')
def advance_series(m, s, motion, dt):  # type: ignore[no-untyped-def]
    """Creep and second mode on `motion` (3,) over dt; their states are in s; motion is replaced."""
    for i in range(3):
        amount = m[at.CREEP_RADIAL] if i == 0 else m[at.CREEP_AXIAL]
        if amount != 0.0:
            s[at.CREEP + i] = low_pass(s[at.CREEP + i], s[at.CREEP_INPUT + i], motion[i], dt,
                                       m[at.CREEP_TIME])
            s[at.CREEP_INPUT + i] = motion[i]
            motion[i] += amount * s[at.CREEP + i]
    frequency = m[at.RESONANCE_FREQUENCY]
    if frequency <= 0.0:
        return
    zeta = min(m[at.RESONANCE_DAMPING], 0.999)
    damped = frequency * math.sqrt(1.0 - zeta * zeta)
    decay = math.exp(-zeta * frequency * dt)
    cosine, sine = math.cos(damped * dt), math.sin(damped * dt)
    for i in range(3):
        old, new = s[at.RESONANCE_INPUT + i], motion[i]
        slope = (new - old) / dt if dt > 0.0 else 0.0
        lag = 2.0 * zeta / frequency * slope     # a ramp is followed this far behind
        x = s[at.RESONANCE + i] - (old - lag)
        rate = s[at.RESONANCE_RATE + i] - slope
        swing = (rate + zeta * frequency * x) / damped
        x_new = decay * (x * cosine + swing * sine)
        rate_new = -zeta * frequency * x_new + decay * damped * (swing * cosine - x * sine)
        s[at.RESONANCE + i] = x_new + new - lag
        s[at.RESONANCE_RATE + i] = rate_new + slope
        s[at.RESONANCE_INPUT + i] = new
        motion[i] = s[at.RESONANCE + i]


@nb.njit(cache=True, nogil=True, error_model='numpy')
def read_probes(m, s, motion, resolved, load, time, dt, out):  # type: ignore[no-untyped-def]
    """Probe increments out (4,) [m] from the ring's motion, with what the measurement adds."""
    half_span = 0.5 * m[at.AXIAL_SPAN]
    x = motion[0] - s[at.ZERO]
    y = motion[1] - s[at.ZERO + 1]
    tilt = motion[2] - s[at.ZERO + 2]
    radial = x + (m[at.RADIAL_HEIGHT] + m[at.PROBE_HEIGHT]) * tilt
    oval = m[at.OVALISATION] * (resolved[0] - s[at.ZERO_FORCE_X])
    out[0] = radial + oval
    out[1] = y + tilt * half_span
    out[2] = -radial + oval
    out[3] = y - tilt * half_span
    elapsed = time - s[at.START_TIME]
    angle = 2.0 * math.pi * m[at.PICKUP_FREQUENCY] * elapsed
    for i in range(4):
        d = out[i] + m[at.BRACKET + i] * (load - s[at.ZERO_LOAD])
        d = d * (1.0 + m[at.GAIN + i]) + m[at.CURVE + i] * d * d
        lag = m[at.LAG + i]
        if lag > 0.0:
            s[at.LAGGED + i] = low_pass(s[at.LAGGED + i], s[at.LAG_INPUT + i], d, dt, lag)
            s[at.LAG_INPUT + i] = d
            d = s[at.LAGGED + i]
        d += m[at.DRIFT + i] * elapsed
        if m[at.PICKUP_COSINE + i] != 0.0 or m[at.PICKUP_SINE + i] != 0.0:
            d += (m[at.PICKUP_COSINE + i] * math.cos(angle)
                  + m[at.PICKUP_SINE + i] * math.sin(angle))
        out[i] = min(max(d, m[at.CLIP_LOW + i]), m[at.CLIP_HIGH + i])


@nb.njit(cache=True, nogil=True, error_model='numpy')
def start(m, rows, uniform, s, time, load, scratch, bits):  # type: ignore[no-untyped-def]
    """State s at rest under the measured `load` at `time`, zero taken there; False if no equilibrium."""
    sums, external, resolved = np.empty(6), np.empty(3), np.empty(3)
    for i in range(s.size):
        s[i] = 0.0
    s[at.CYLINDER_Z] = s[at.CYLINDER_Z + 1] = m[at.CYLINDER_INITIAL]
    s[at.BRACKET_Z] = s[at.BRACKET_Z + 1] = m[at.BRACKET_INITIAL]
    s[at.RADIAL_Z] = s[at.RADIAL_Z + 1] = m[at.RADIAL_INITIAL]
    s[at.TILT_Z] = s[at.TILT_Z + 1] = m[at.TILT_INITIAL]
    s[at.MEASURED_LOAD] = load
    s[at.HIGHEST_LOAD] = load
    true_load = load_at_ring(m, load, m[at.CYLINDER_INITIAL], m[at.BRACKET_INITIAL], external, resolved)
    external[0] -= m[at.RADIAL_LIMIT] * m[at.RADIAL_INITIAL]
    external[2] -= m[at.TILT_LIMIT] * m[at.TILT_INITIAL]
    q = np.empty(3)
    q[0] = math.copysign(0.5 * m[at.MIDDLE_CLEARANCE] + 1e-5, external[0])
    q[1] = math.copysign(0.5 * m[at.AXIAL_CLEARANCE] + 1e-5, external[1])
    q[2] = 0.0
    found = equilibrium(m, rows, uniform, external, q, scratch, bits, sums)
    motion = np.empty(3)
    for i in range(3):
        s[at.Q + i] = s[at.Q_OLD + i] = q[i]
    series_motion(m, s, resolved, true_load, motion)
    for i in range(3):
        s[at.CREEP + i] = s[at.CREEP_INPUT + i] = motion[i]
        motion[i] += (m[at.CREEP_RADIAL] if i == 0 else m[at.CREEP_AXIAL]) * motion[i]
        s[at.RESONANCE + i] = s[at.RESONANCE_INPUT + i] = motion[i]
        s[at.ZERO + i] = motion[i]
    s[at.ZERO_FORCE_X] = resolved[0]
    s[at.ZERO_LOAD] = true_load
    s[at.START_TIME] = s[at.TIME] = time
    return found >= 0


@nb.njit(cache=True, nogil=True, error_model='numpy')
def implicit_step(m, rows, uniform, s, h, external, friction, work, scratch, bits):  # type: ignore[no-untyped-def]
    """One BDF2 step of h seconds (backward Euler after a start or a jump in h); iterations or -1.

    Unknown is q; v and a follow from the difference formulas. friction: the state's hysterons.
    """
    sums, q, v, force, residual, step, tangent = work
    h_old = s[at.STEP_OLD]
    ratio = h / h_old if h_old > 0.0 else 0.0
    if 0.0 < ratio <= 2.0:
        c0 = (1.0 + 2.0 * ratio) / (1.0 + ratio) / h
        c1 = -(1.0 + ratio) / h
        c2 = ratio * ratio / (1.0 + ratio) / h
    else:
        c0, c1, c2 = 1.0 / h, -1.0 / h, 0.0
    longest_extrapolation = min(h, 0.01)
    for i in range(3):
        q[i] = s[at.Q + i]
        if 0.0 < ratio <= 2.0:
            q[i] += longest_extrapolation * s[at.V + i]
    radius = m[at.RADIUS]
    previous = 1e300
    damp = 1.0
    for iteration in range(LARGEST_ITERATIONS):
        for i in range(3):
            v[i] = c0 * q[i] + c1 * s[at.Q + i] + c2 * s[at.Q_OLD + i]
        ring_forces(m, rows, uniform, q, v, c0, scratch, bits, sums, force, tangent)
        for i in range(3):
            inertia = m[at.INERTIA] if i == 2 else m[at.MASS]
            a = c0 * v[i] + c1 * s[at.V + i] + c2 * s[at.V_OLD + i]
            residual[i] = external[i] + force[i] - inertia * a
            tangent[i, i] += inertia * c0 * c0
        if friction:
            if m[at.RADIAL_LIMIT] != 0.0:
                _, _, z, slope = hysteron(s[at.RADIAL_Z], s[at.RADIAL_Z + 1], q[0] - s[at.Q],
                                          m[at.RADIAL_PRESLIDING], m[at.RADIAL_SHARPNESS])
                residual[0] -= m[at.RADIAL_LIMIT] * z
                tangent[0, 0] += m[at.RADIAL_LIMIT] * slope
            if m[at.TILT_LIMIT] != 0.0:
                _, _, z, slope = hysteron(s[at.TILT_Z], s[at.TILT_Z + 1], q[2] - s[at.Q + 2],
                                          m[at.TILT_PRESLIDING], m[at.TILT_SHARPNESS])
                residual[2] -= m[at.TILT_LIMIT] * z
                tangent[2, 2] += m[at.TILT_LIMIT] * slope
        if not solve3(tangent, residual, step):
            return -1
        size = max(abs(step[0]), abs(step[1]), abs(step[2]) * radius)
        if not size < 1e300:
            return -1
        # Newton can cycle over a kink when a step is long: halve until it shrinks.
        damp = max(0.1, 0.5 * damp) if size > 0.9 * previous else min(1.0, 2.0 * damp)
        limit = min(damp, 1e-4 / size) if size > 1e-4 else damp
        for i in range(3):
            q[i] += limit * step[i]
        previous = size
        if size < STEP_TOLERANCE and limit == 1.0:
            for i in range(3):
                v_new = c0 * q[i] + c1 * s[at.Q + i] + c2 * s[at.Q_OLD + i]
                step[i] = q[i] - s[at.Q + i]
                s[at.Q_OLD + i], s[at.Q + i] = s[at.Q + i], q[i]
                s[at.V_OLD + i], s[at.V + i] = s[at.V + i], v_new
            s[at.STEP_OLD] = h
            if friction:
                s[at.RADIAL_Z], s[at.RADIAL_Z + 1], _, _ = hysteron(
                    s[at.RADIAL_Z], s[at.RADIAL_Z + 1], step[0],
                    m[at.RADIAL_PRESLIDING], m[at.RADIAL_SHARPNESS])
                s[at.TILT_Z], s[at.TILT_Z + 1], _, _ = hysteron(
                    s[at.TILT_Z], s[at.TILT_Z + 1], step[2],
                    m[at.TILT_PRESLIDING], m[at.TILT_SHARPNESS])
            return iteration + 1
    return -1


@nb.njit(cache=True, nogil=True, error_model='numpy')
def robust_step(m, rows, uniform, s, h, external, friction, work, scratch, bits):  # type: ignore[no-untyped-def]
    """One implicit step; where Newton fails on a kink, the same step in 4, 16 ... 4096 parts."""
    used = implicit_step(m, rows, uniform, s, h, external, friction, work, scratch, bits)
    if used >= 0:
        return used
    before = s.copy()
    pieces = 1
    while pieces < 4096:
        pieces *= 4
        used = 0
        for _ in range(pieces):
            more = implicit_step(m, rows, uniform, s, h / pieces, external, friction, work, scratch,
                                 bits)
            if more < 0:
                used = -1
                break
            used += more
        if used >= 0:
            return used
        s[:] = before
    return -1


@nb.njit(cache=True, nogil=True, error_model='numpy', inline='never')
def advance(m, rows, uniform, s, time, load, max_step, q_out, d_out):  # type: ignore[no-untyped-def]
    """Carry state s over the samples time (N,), load (N,); q_out (N, 3) and d_out (N, 4) are filled.

    A sample at or before the state's time is answered from the state without stepping. Returns the
    number of Newton iterations; s[TROUBLE] counts steps that did not converge (state restarted at
    equilibrium there). Live and offline call this one function, for one sample or a million.
    """
    scratch = np.empty((3, rows.shape[2]))
    bits = scratch.view(np.int64)
    work = (np.empty(6), np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3),
            np.empty((3, 3)))
    external, resolved, motion = np.empty(3), np.empty(3), np.empty(3)
    friction = m[at.RADIAL_LIMIT] != 0.0 or m[at.TILT_LIMIT] != 0.0
    iterations = 0
    true_load = load_at_ring(m, s[at.MEASURED_LOAD],
                             m[at.CYLINDER_SHARPNESS] * s[at.CYLINDER_Z + 1]
                             + (1.0 - m[at.CYLINDER_SHARPNESS]) * s[at.CYLINDER_Z],
                             m[at.BRACKET_SHARPNESS] * s[at.BRACKET_Z + 1]
                             + (1.0 - m[at.BRACKET_SHARPNESS]) * s[at.BRACKET_Z], external, resolved)
    for n in range(time.size):
        total = time[n] - s[at.TIME]
        if total > 0.0:
            substeps = max(1, int(math.ceil(total / max_step - 1e-6)))
            h = total / substeps
            load_old = s[at.MEASURED_LOAD]
            for k in range(1, substeps + 1):
                measured = load[n] if k == substeps else load_old + (load[n] - load_old) * k / substeps
                change = measured - s[at.MEASURED_LOAD]
                s[at.CYLINDER_Z], s[at.CYLINDER_Z + 1], z_cylinder, _ = hysteron(
                    s[at.CYLINDER_Z], s[at.CYLINDER_Z + 1], change,
                    m[at.CYLINDER_PRESLIDING], m[at.CYLINDER_SHARPNESS])
                s[at.BRACKET_Z], s[at.BRACKET_Z + 1], z_bracket, _ = hysteron(
                    s[at.BRACKET_Z], s[at.BRACKET_Z + 1], change,
                    m[at.BRACKET_PRESLIDING], m[at.BRACKET_SHARPNESS])
                s[at.MEASURED_LOAD] = measured
                s[at.HIGHEST_LOAD] = max(s[at.HIGHEST_LOAD], measured)
                true_load = load_at_ring(m, measured, z_cylinder, z_bracket, external, resolved)
                used = robust_step(m, rows, uniform, s, h, external, friction, work, scratch, bits)
                if used < 0:
                    s[at.TROUBLE] += 1.0
                    s[at.STEP_OLD] = 0.0
                    for i in range(3):
                        s[at.V + i] = s[at.V_OLD + i] = 0.0
                    for i in range(3):
                        motion[i] = s[at.Q + i]
                    if equilibrium(m, rows, uniform, external, motion, scratch, bits, work[0]) >= 0:
                        for i in range(3):
                            s[at.Q_OLD + i] = s[at.Q + i] = motion[i]
                else:
                    iterations += used
            s[at.TIME] = time[n]
        series_motion(m, s, resolved, true_load, motion)
        advance_series(m, s, motion, max(total, 0.0))
        read_probes(m, s, motion, resolved, true_load, time[n], max(total, 0.0), d_out[n])
        for i in range(3):
            q_out[n, i] = s[at.Q + i]
    return iterations


@nb.njit(cache=True, nogil=True, error_model='numpy', inline='never')
def run_batch(m, rows, uniform, time, load, zero_load, max_step, q_out, d_out):  # type: ignore[no-untyped-def]
    """Simulate each parameter set of m (B, M) over one record; returns sets that had trouble.

    rows (R, 3, 3, J), uniform (R, 3) with R = B or 1; q_out (B, N, 3), d_out (B, N, 4).
    """
    scratch = np.empty((3, rows.shape[3]))
    bits = scratch.view(np.int64)
    s = np.zeros(at.STATE_SIZE)
    troubled = 0
    for b in range(m.shape[0]):
        r = b if rows.shape[0] > 1 else 0
        found = start(m[b], rows[r], uniform[r], s, time[0], zero_load, scratch, bits)
        advance(m[b], rows[r], uniform[r], s, time, load, max_step, q_out[b], d_out[b])
        if not found or s[at.TROUBLE] > 0.0:
            troubled += 1
    return troubled


@nb.njit(cache=True, nogil=True, error_model='numpy', inline='never')
def static_batch(m, rows, uniform, load, q_out):  # type: ignore[no-untyped-def]
    """Equilibrium of each parameter set m (B, M) at each load (N,), in order; q_out (B, N, 3)."""
    scratch = np.empty((3, rows.shape[3]))
    bits = scratch.view(np.int64)
    sums, external, resolved, q = np.empty(6), np.empty(3), np.empty(3), np.empty(3)
    failed = 0
    for b in range(m.shape[0]):
        r = b if rows.shape[0] > 1 else 0
        for n in range(load.size):
            load_at_ring(m[b], load[n], 0.0, 0.0, external, resolved)
            if n == 0:
                q[0] = math.copysign(0.5 * m[b, at.MIDDLE_CLEARANCE] + 1e-5, external[0])
                q[1] = math.copysign(0.5 * m[b, at.AXIAL_CLEARANCE] + 1e-5, external[1])
                q[2] = 0.0
            if equilibrium(m[b], rows[r], uniform[r], external, q, scratch, bits, sums) < 0:
                failed += 1
            for i in range(3):
                q_out[b, n, i] = q[i]
    return failed
