"""Compiled sums over rollers, equilibrium and time stepping, as plain functions of float arrays.

The equations are those of docs/ring-model.md and of `reference.py`, which sums the same 304
rollers in readable numpy. What makes this file fast: rollers are sorted by their cosine, so that
those in contact are an interval; their powers, forces and tangents are one loop that the compiler
turns into vector code; BDF2 needs one implicit solve a step; the last step's stiffness and damping
predict the next so well that mostly one Newton iteration is left to do.

Everything here works on flat arrays made by `model.py`; `layout.py` has the meaning of each place.
All functions release the GIL.
"""

from __future__ import annotations

import math
from typing import Any

from llvmlite import ir
import numba as nb
from numba.extending import intrinsic
import numpy as np

from saddlering_ros.ring import layout as at
from saddlering_ros.ring.caching import CACHE

OUTER = {'cache': CACHE, 'nogil': True, 'error_model': 'numpy'}
"""Options of kernels that allocate or are called from Python."""

INNER = {**OUTER, '_nrt': False}
"""Options of the rest: they borrow their arrays, so none is counted (an atomic each otherwise)."""

FAST = {'reassoc', 'contract', 'nsz', 'arcp', 'nnan', 'ninf'}
RAMP = 1e-6
"""Penetration over which the damper is faded in [m] (C1, so no force jump at touch-down)."""

DAMPING_REFERENCE = 50e-6
"""Penetration at which penetration-proportional damping equals D [m]."""

STEP_TOLERANCE = 5e-11
"""A Newton update below this [m] is the last: the next would be below 1e-12 m (quadratic)."""

LARGEST_ITERATIONS = 60

LAYOUT = 'be678cdeadde'
"""Digest of `layout`: a change there must change this file, by which numba keeps kernels."""

LARGEST_PREDICTION = 5e-6
"""A predicted move beyond this [m] is not trusted: the step starts from the old rate instead."""

LEAST_FORCE = 1e-15
"""A unit that carries less [N] is open; so is one at the floor under p (finite log2)."""

SQRT_HALF_BITS = 0x3FE6A09E667F3BCD
INTEGER_FLOAT = 6755399441055744.0
"""1.5 * 2^52: a small whole number added to it stands in its lowest bits."""

INTEGER_FLOAT_BITS = 0x4338000000000000


@intrinsic
def bits_of(typing_context: Any, number: Any) -> Any:
    """The 64 bits of a float as an integer."""
    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(arguments[0], ir.IntType(64))
    return nb.types.int64(nb.types.float64), build


@intrinsic
def float_of(typing_context: Any, bits: Any) -> Any:
    """The float that an integer's 64 bits stand for."""
    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(arguments[0], ir.DoubleType())
    return nb.types.float64(nb.types.int64), build


@intrinsic
def widest_vectors(typing_context: Any) -> Any:
    """Let the calling function use the core's widest registers.

    LLVM holds itself to 256 bits on Intel cores that have 512 (they once lowered their clock for
    them); a loop that is arithmetic only gains a seventh. llvmlite's list of attributes does not
    know this one, hence the way round its check; other cores ignore it.
    """
    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        set.add(builder.function.attributes, '"prefer-vector-width"="512"')
        return context.get_dummy_value()
    return nb.types.none(), build


@nb.njit(fastmath=FAST, inline='always', **INNER)
def power(p: Any, exponent: Any) -> Any:
    """P ** exponent for a positive normal number p, relative error below 1e-13.

    log2 by its atanh series on the mantissa, exp2 by a polynomial, both fitted at Chebyshev
    points (relative error 3e-14 and 2e-14), both summed in pairs (Estrin) for a short chain; no
    branch and no call, so that a loop over it becomes vector code on any x86-64 or ARM.
    """
    pattern = bits_of(p)
    whole = (pattern - SQRT_HALF_BITS) >> 52
    m = float_of(pattern - (whole << 52))
    s = (m - 1.0) / (m + 1.0)
    z = s * s
    z2 = z * z
    series = ((2.8853900817778504 + z * 0.9617966941123595)
              + z2 * ((0.5770779426302618 + z * 0.41220922733052445)
                      + z2 * (0.3199066608891474 + z * 0.28288718263073565)))
    y = exponent * ((float_of(whole + INTEGER_FLOAT_BITS) - INTEGER_FLOAT) + s * series)
    k = np.rint(y)
    f = y - k
    f2 = f * f
    f4 = f2 * f2
    low = ((0.6931471805599462 + f * 0.2402265069564034)
           + f2 * (0.05550410866465167 + f * 0.009618129193934313))
    high = ((0.0013333558200794592 + f * 0.0001540343375125101)
            + f2 * (1.5252672924850737e-05 + f * 1.325964524488711e-06)
            + f4 * 1.0205905413765595e-07)
    scale = float_of((bits_of(k + INTEGER_FLOAT) - INTEGER_FLOAT_BITS + 1023) << 52)
    return scale + scale * (f * (low + f4 * high))


@nb.njit(fastmath=FAST, **INNER)
def in_contact(rows: Any, base: Any, stride: Any, rollers: Any, uniform: Any, a: Any, b: Any,
               guess: Any) -> Any:
    """First roller of a row and their number between which all rollers in contact lie.

    guess: a number to start from, best that of the last call: contact edges move little in a step.
    """
    zero, one, two = np.uint64(0), np.uint64(1), np.uint64(2)
    gaps = base + two * stride
    if uniform:
        edge = rows[gaps] - a
        if abs(b) <= edge:
            return zero, zero
        count = min(guess, rollers)
        if b >= 0.0:
            while count < rollers and b * rows[base + count] > edge:
                count += one
            while count > zero and not b * rows[base + count - one] > edge:
                count -= one
            return zero, count
        last = base + rollers - one
        while count < rollers and b * rows[last - count] > edge:
            count += one
        while count > zero and not b * rows[last + one - count] > edge:
            count -= one
        return rollers - count, count
    first = rollers
    end = zero
    for j in range(rollers):
        if a + b * rows[base + j] > rows[gaps + j]:
            if first == rollers:
                first = j
            end = j + one
    if end == zero:
        return zero, zero
    return first, end - first


@nb.njit(fastmath=FAST, **INNER)
def row_sums(rows: Any, row: Any, rollers: Any, uniform: Any, a: Any, b: Any, da: Any, db: Any,
             stiffness: Any, exponent: Any, damping: Any, growing: Any, levelling: Any,
             guess: Any) -> Any:
    """Force sums of one row with penetration p = a + b cos - gap and rate dp/dt = da + db cos.

    Returns sum F, sum F cos; stiffness sums k, k cos, k cos^2 with k = dF/dp; damping sums d,
    d cos, d cos^2 with d = dF/d(dp/dt); rollers in contact, the next call's guess. growing: None,
    or (share, m) of the damping that grows as p^m, as p^exponent for m = 0; levelling: None, or L
    of growth as p^m / (1 + (p L)^m). Compiled for each, so that a law not in use costs nothing.
    rows: flat, by `model`; every row is padded with rollers that carry nothing, so that the loop
    may run over whole vectors.
    """
    widest_vectors()
    stride = np.uint64(rows.size) // np.uint64(9)
    base = np.uint64(row) * np.uint64(3) * stride
    first, touching = in_contact(rows, base, stride, rollers, uniform, a, b, np.uint64(guess))
    s0 = s1 = k0 = k1 = k2 = d0 = d1 = d2 = 0.0
    if touching == np.uint64(0):
        return s0, s1, k0, k1, k2, d0, d1, d2, 0.0
    count = (touching + np.uint64(7)) & ~np.uint64(7)
    cosines = base + first
    weights, gaps = cosines + stride, cosines + np.uint64(2) * stride
    constant, growth, factor, steepness, turn = damping, 0.0, 0.0, 0.0, 0.0
    if growing is not None:
        share, growth = growing
        growth = growth if growth > 0.0 else exponent
        constant = damping * (1.0 - share)
        if levelling is not None:
            turn = levelling ** growth
        factor = damping * share * (DAMPING_REFERENCE ** (-growth) + turn)
        # For m < 1 the slope of p^m has no bound at p = 0. It is faded as the constant is (C1),
        # over (1 - m) RAMP, so that it goes over without a jump to m >= 1, where it is p^m alone.
        steepness = 1.0 / (RAMP * max(1.0 - growth, 1e-20))
    for j in range(count):
        c = rows[cosines + j]
        p = max(a + b * c - rows[gaps + j], 1e-30)
        rate = da + db * c
        relative = power(p, exponent - 1.0)
        u = min(p * (1.0 / RAMP), 1.0)
        d = constant * (u * u * (3.0 - 2.0 * u))
        d_slope = constant * (6.0 / RAMP) * (u - u * u)
        if growing is not None:
            rising = power(p, growth - 1.0)
            slope = growth
            if levelling is not None:
                level = 1.0 / (1.0 + turn * rising * p)
                rising *= level
                slope *= level
            rising *= factor
            w = min(p * steepness, 1.0)
            fade = w * w * (3.0 - 2.0 * w)
            d += rising * p * fade
            d_slope += rising * (slope * fade + 6.0 * w * (w - w * w))
        force = stiffness * relative * p + d * rate
        k = exponent * stiffness * relative + d_slope * rate
        carries = rows[weights + j] if force > LEAST_FORCE else 0.0
        force *= carries
        k *= carries
        d *= carries
        s0 += force
        s1 += force * c
        k0 += k
        k1 += k * c
        k2 += k * c * c
        d0 += d
        d1 += d * c
        d2 += d * c * c
    return s0, s1, k0, k1, k2, d0, d1, d2, float(touching)


@nb.njit(fastmath=FAST, **INNER)
def row_energy(rows: Any, row: Any, rollers: Any, a: Any, b: Any, stiffness: Any,
               exponent: Any) -> Any:
    """Elastic energy of one row, sum K p^(n+1)/(n+1), at penetrations p = a + b cos - gap."""
    stride = np.uint64(rows.size) // np.uint64(9)
    base = np.uint64(row) * np.uint64(3) * stride
    energy = 0.0
    for j in range(rollers):
        p = max(a + b * rows[base + j] - rows[base + np.uint64(2) * stride + j], 1e-30)
        energy += rows[base + stride + j] * stiffness * power(p, exponent + 1.0)
    return energy / (exponent + 1.0)


@nb.njit(**INNER)
def hysteron(z_smooth: Any, z_sharp: Any, travel: Any, presliding: Any, sharpness: Any) -> Any:
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


@nb.njit(**INNER)
def forces_of_rows(m: Any, rows: Any, uniform: Any, q0: Any, q1: Any, q2: Any, v0: Any, v1: Any,
                   v2: Any, growing: Any, levelling: Any, w: Any) -> Any:
    """`ring_forces` with damping that grows and levels off, or None, as of `row_sums`."""
    radius, height = m[at.RADIUS], m[at.MIDDLE_HEIGHT]
    axial, middle = np.uint64(m[at.AXIAL_ROLLERS]), np.uint64(m[at.MIDDLE_ROLLERS])
    w0 = at.TOUCHING
    _, s1, _, _, k2, _, _, d2, w[w0 + 2] = row_sums(
        rows, 2, middle, uniform[2], 0.0, q0 + height * q2, 0.0, v0 + height * v2,
        m[at.K2] * m[at.MIDDLE_STIFFNESS], m[at.N2], m[at.D2], growing, levelling, w[w0 + 2])
    up0, up1, ku0, ku1, ku2, du0, du1, du2, w[w0] = row_sums(
        rows, 0, axial, uniform[0], q1, -radius * q2, v1, -radius * v2,
        m[at.K1] * m[at.UPPER_STIFFNESS], m[at.N1], m[at.D1], growing, levelling, w[w0])
    low0, low1, kl0, kl1, kl2, dl0, dl1, dl2, w[w0 + 1] = row_sums(
        rows, 1, axial, uniform[1], -q1, radius * q2, -v1, radius * v2,
        m[at.K1] * m[at.LOWER_STIFFNESS], m[at.N1], m[at.D1], growing, levelling, w[w0 + 1])
    w[at.FORCE] = -s1
    w[at.FORCE + 1] = low0 - up0
    w[at.FORCE + 2] = radius * (up1 - low1) - height * s1
    w[at.STIFFNESS] = k2
    w[at.STIFFNESS + 1] = height * k2
    w[at.STIFFNESS + 2] = ku0 + kl0
    w[at.STIFFNESS + 3] = -radius * (ku1 + kl1)
    w[at.STIFFNESS + 4] = radius * radius * (ku2 + kl2) + height * height * k2
    w[at.DAMPING] = d2
    w[at.DAMPING + 1] = height * d2
    w[at.DAMPING + 2] = du0 + dl0
    w[at.DAMPING + 3] = -radius * (du1 + dl1)
    w[at.DAMPING + 4] = radius * radius * (du2 + dl2) + height * height * d2


@nb.njit(**INNER)
def ring_forces(m: Any, rows: Any, uniform: Any, q0: Any, q1: Any, q2: Any, v0: Any, v1: Any,
                v2: Any, w: Any) -> Any:
    """Contact forces on the upper ring at motion q and its rate v.

    Fills w: FORCE (3,), STIFFNESS and DAMPING, -dF/dq and -dF/dv, each as its entries 00, 02, 11,
    12, 22 (01 is zero: nothing couples delta_x to delta_y).
    """
    if m[at.DAMPING_SHARE] == 0.0:
        forces_of_rows(m, rows, uniform, q0, q1, q2, v0, v1, v2, None, None, w)
    elif m[at.DAMPING_LEVELLING] == 0.0:
        forces_of_rows(m, rows, uniform, q0, q1, q2, v0, v1, v2,
                       (m[at.DAMPING_SHARE], m[at.DAMPING_EXPONENT]), None, w)
    else:
        forces_of_rows(m, rows, uniform, q0, q1, q2, v0, v1, v2,
                       (m[at.DAMPING_SHARE], m[at.DAMPING_EXPONENT]), m[at.DAMPING_LEVELLING], w)


@nb.njit(**INNER)
def elastic_energy(m: Any, rows: Any, q0: Any, q1: Any, q2: Any) -> Any:
    """Energy [J] in all rollers at motion q."""
    radius, height = m[at.RADIUS], m[at.MIDDLE_HEIGHT]
    axial, middle = np.uint64(m[at.AXIAL_ROLLERS]), np.uint64(m[at.MIDDLE_ROLLERS])
    return (row_energy(rows, 2, middle, 0.0, q0 + height * q2,
                       m[at.K2] * m[at.MIDDLE_STIFFNESS], m[at.N2])
            + row_energy(rows, 0, axial, q1, -radius * q2,
                         m[at.K1] * m[at.UPPER_STIFFNESS], m[at.N1])
            + row_energy(rows, 1, axial, -q1, radius * q2,
                         m[at.K1] * m[at.LOWER_STIFFNESS], m[at.N1]))

@nb.njit(**INNER)
def solve3(a00: Any, a02: Any, a11: Any, a12: Any, a22: Any, r0: Any, r1: Any, r2: Any) -> Any:
    """(found, x0, x1, x2) of a x = r, a symmetric with a01 = 0; not found unless a is definite."""
    if a00 <= 0.0 or a11 <= 0.0:
        return False, 0.0, 0.0, 0.0
    i00, i11 = 1.0 / a00, 1.0 / a11
    schur = a22 - a02 * a02 * i00 - a12 * a12 * i11
    if not schur > 0.0:
        return False, 0.0, 0.0, 0.0
    x2 = (r2 - a02 * i00 * r0 - a12 * i11 * r1) / schur
    return True, (r0 - a02 * x2) * i00, (r1 - a12 * x2) * i11, x2


@nb.njit(**INNER)
def equilibrium(m: Any, rows: Any, uniform: Any, w: Any, x: Any, y: Any, tilt: Any) -> Any:
    """(iterations or -1, q) of static equilibrium under w[EXTERNAL], starting at (x, y, tilt).

    The elastic energy is convex, so Newton with a backtracking on total energy converges from
    anywhere. Directions without stiffness (a free play) are held by a small spring there.
    """
    radius = m[at.RADIUS]
    e0, e1, e2 = w[at.EXTERNAL], w[at.EXTERNAL + 1], w[at.EXTERNAL + 2]
    ring_forces(m, rows, uniform, x, y, tilt, 0.0, 0.0, 0.0, w)
    scale = abs(e0) + abs(e1) + abs(e2) / radius + 1.0
    if not scale < 1e300:
        return -1, x, y, tilt
    for iteration in range(200):
        r0, r1, r2 = e0 + w[at.FORCE], e1 + w[at.FORCE + 1], e2 + w[at.FORCE + 2]
        largest = max(abs(r0), abs(r1), abs(r2) / radius)
        if largest <= 1e-11 * scale:
            return iteration, x, y, tilt
        soft = 1e-9 * m[at.K1] if iteration < 100 else 1e-6 * m[at.K1]
        found, step0, step1, step2 = solve3(
            w[at.STIFFNESS] + soft, w[at.STIFFNESS + 1], w[at.STIFFNESS + 2] + soft,
            w[at.STIFFNESS + 3], w[at.STIFFNESS + 4] + soft * radius * radius, r0, r1, r2)
        if not found:
            return -1, x, y, tilt
        longest = max(abs(step0), abs(step1), abs(step2) * radius)
        shrink = min(1.0, 2e-4 / longest) if longest > 0.0 else 1.0
        step0, step1, step2 = step0 * shrink, step1 * shrink, step2 * shrink
        work = r0 * step0 + r1 * step1 + r2 * step2
        factor, accepted = 1.0, False
        for _ in range(40):
            x1, y1, tilt1 = x + factor * step0, y + factor * step1, tilt + factor * step2
            ring_forces(m, rows, uniform, x1, y1, tilt1, 0.0, 0.0, 0.0, w)
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
            # Rounding ends the descent; what is left is compared with the load's own size.
            return (iteration if largest <= 1e-7 * scale else -1), x, y, tilt
        x, y, tilt = x + factor * step0, y + factor * step1, tilt + factor * step2
        if factor * longest * shrink < 1e-15:
            break
    largest = max(abs(e0 + w[at.FORCE]), abs(e1 + w[at.FORCE + 1]),
                  abs(e2 + w[at.FORCE + 2]) / radius)
    return (200 if largest <= 1e-7 * scale else -1), x, y, tilt


@nb.njit(**INNER)
def load_at_ring(m: Any, measured: Any, z_cylinder: Any, z_bracket: Any, w: Any) -> Any:
    """From the measured load [N] to w[EXTERNAL] (3,) with dead weight and w[RESOLVED] without.

    Resolved: F_x, F_y, M of the load alone, which series compliances answer to. Returns P.
    """
    full_scale = m[at.FULL_SCALE]
    load = measured / (1.0 + m[at.LOAD_GAIN]) - m[at.LOAD_OFFSET]
    load += 4.0 * m[at.LOAD_CURVE] * measured * (full_scale - measured) / full_scale
    load -= m[at.CYLINDER_LIMIT] * z_cylinder
    cosine, sine = m[at.COSINE], m[at.SINE]
    if m[at.BRACKET_LIMIT] != 0.0:
        elevation = m[at.ELEVATION] + m[at.ELEVATION_ERROR] + m[at.BRACKET_LIMIT] * z_bracket
        cosine, sine = math.cos(elevation), math.sin(elevation)
    w[at.RESOLVED] = load * cosine
    w[at.RESOLVED + 1] = -load * sine
    w[at.RESOLVED + 2] = load * ((m[at.TRUNNION_Y] + m[at.MOMENT_ARM]) * cosine
                                 + m[at.TRUNNION_X] * sine)
    w[at.EXTERNAL] = w[at.RESOLVED]
    w[at.EXTERNAL + 1] = w[at.RESOLVED + 1] - m[at.WEIGHT]
    w[at.EXTERNAL + 2] = w[at.RESOLVED + 2] + m[at.WEIGHT] * m[at.WEIGHT_X]
    return load


@nb.njit(**INNER)
def low_pass(state: Any, old: Any, new: Any, dt: Any, time_constant: Any) -> Any:
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


@nb.njit(**INNER)
def opened(beyond: Any, spread: Any) -> Any:
    """Mean of max(0, beyond - s) over s from -spread to spread [N m]: bolts that open in turn."""
    if spread <= 0.0:
        return max(0.0, beyond)
    inside = min(max(beyond + spread, 0.0), 2.0 * spread)
    return inside * inside / (4.0 * spread) + max(0.0, beyond - spread)


@nb.njit(**INNER)
def series_motion(m: Any, s: Any, w: Any) -> Any:
    """w[MOTION] (3,): contact motion, series compliances, settling; then come creep, resonance."""
    highest = s[at.HIGHEST_LOAD]
    moment = w[at.RESOLVED + 2]
    w[at.MOTION] = (s[at.Q] + m[at.RADIAL_COMPLIANCE] * w[at.RESOLVED]
                    + m[at.SETTLING_X] * highest)
    w[at.MOTION + 1] = (s[at.Q + 1] + m[at.AXIAL_COMPLIANCE] * w[at.RESOLVED + 1]
                        + m[at.SETTLING_Y] * highest)
    w[at.MOTION + 2] = (s[at.Q + 2] + m[at.TILT_COMPLIANCE] * moment
                        + m[at.SETTLING_TILT] * highest
                        + m[at.OPENING_COMPLIANCE] * opened(
                            moment - m[at.OPENING_MOMENT], m[at.OPENING_SPREAD]))


@nb.njit(**INNER)
def advance_series(m: Any, s: Any, w: Any, dt: Any) -> Any:
    """Creep and second mode on w[MOTION] over dt, replaced; their states are in s."""
    for i in range(3):
        amount = m[at.CREEP_RADIAL] if i == 0 else m[at.CREEP_AXIAL]
        if amount != 0.0:
            s[at.CREEP + i] = low_pass(s[at.CREEP + i], s[at.CREEP_INPUT + i], w[at.MOTION + i],
                                       dt, m[at.CREEP_TIME])
            s[at.CREEP_INPUT + i] = w[at.MOTION + i]
            w[at.MOTION + i] += amount * s[at.CREEP + i]
    frequency = m[at.RESONANCE_FREQUENCY]
    if frequency <= 0.0:
        return
    zeta = min(m[at.RESONANCE_DAMPING], 0.999)
    damped = frequency * math.sqrt(1.0 - zeta * zeta)
    decay = math.exp(-zeta * frequency * dt)
    cosine, sine = math.cos(damped * dt), math.sin(damped * dt)
    for i in range(3):
        old, new = s[at.RESONANCE_INPUT + i], w[at.MOTION + i]
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
        w[at.MOTION + i] = new + m[at.RESONANCE_SHARE] * (s[at.RESONANCE + i] - new)


@nb.njit(**INNER)
def read_probes(m: Any, s: Any, w: Any, load: Any, time: Any, dt: Any, out: Any,
                n: Any) -> Any:
    """Probe increments out[n] (4,) [m] from w[MOTION], with what the measurement adds."""
    half_span = 0.5 * m[at.AXIAL_SPAN]
    x = w[at.MOTION] - s[at.ZERO]
    y = w[at.MOTION + 1] - s[at.ZERO + 1]
    tilt = w[at.MOTION + 2] - s[at.ZERO + 2]
    radial = x + (m[at.RADIAL_HEIGHT] + m[at.PROBE_HEIGHT]) * tilt
    oval = m[at.OVALISATION] * (w[at.RESOLVED] - s[at.ZERO_FORCE_X])
    out[n, 0] = radial + oval
    out[n, 1] = y + tilt * half_span
    out[n, 2] = -radial + oval
    out[n, 3] = y - tilt * half_span
    elapsed = time - s[at.START_TIME]
    angle = 2.0 * math.pi * m[at.PICKUP_FREQUENCY] * elapsed
    for i in range(4):
        d = out[n, i] + m[at.BRACKET + i] * (load - s[at.ZERO_LOAD])
        d = d * (1.0 + m[at.GAIN + i]) + m[at.CURVE + i] * d * d
        lag = m[at.LAG + i]
        if lag > 0.0:
            second = lag * m[at.LAG_SECOND + i]
            old = s[at.LAGGED + i]
            s[at.LAGGED + i] = low_pass(old, s[at.LAG_INPUT + i], d, dt, lag - second)
            s[at.LAG_INPUT + i] = d
            d = low_pass(s[at.LAGGED_TWICE + i], old, s[at.LAGGED + i], dt, second)
            s[at.LAGGED_TWICE + i] = d
        d += m[at.DRIFT + i] * elapsed
        if m[at.PICKUP_COSINE + i] != 0.0 or m[at.PICKUP_SINE + i] != 0.0:
            d += (m[at.PICKUP_COSINE + i] * math.cos(angle)
                  + m[at.PICKUP_SINE + i] * math.sin(angle))
        out[n, i] = min(max(d, m[at.CLIP_LOW + i]), m[at.CLIP_HIGH + i])


@nb.njit(**OUTER)
def start(m: Any, rows: Any, uniform: Any, s: Any, time: Any, load: Any) -> Any:
    """State s at rest under the measured `load` at `time`, zero taken there; False if none."""
    w = np.zeros(at.WORK_SIZE)
    for i in range(s.size):
        s[i] = 0.0
    s[at.CYLINDER_Z] = s[at.CYLINDER_Z + 1] = m[at.CYLINDER_INITIAL]
    s[at.BRACKET_Z] = s[at.BRACKET_Z + 1] = m[at.BRACKET_INITIAL]
    s[at.RADIAL_Z] = s[at.RADIAL_Z + 1] = m[at.RADIAL_INITIAL]
    s[at.TILT_Z] = s[at.TILT_Z + 1] = m[at.TILT_INITIAL]
    s[at.MEASURED_LOAD] = load
    s[at.HIGHEST_LOAD] = load
    true_load = load_at_ring(m, load, m[at.CYLINDER_INITIAL], m[at.BRACKET_INITIAL], w)
    w[at.EXTERNAL] -= m[at.RADIAL_LIMIT] * m[at.RADIAL_INITIAL]
    w[at.EXTERNAL + 2] -= m[at.TILT_LIMIT] * m[at.TILT_INITIAL]
    found, s[at.Q], s[at.Q + 1], s[at.Q + 2] = equilibrium(
        m, rows, uniform, w, math.copysign(0.5 * m[at.MIDDLE_CLEARANCE] + 1e-5, w[at.EXTERNAL]),
        math.copysign(0.5 * m[at.AXIAL_CLEARANCE] + 1e-5, w[at.EXTERNAL + 1]), 0.0)
    for i in range(3):
        s[at.Q_OLD + i] = s[at.Q + i]
    series_motion(m, s, w)
    for i in range(3):
        s[at.CREEP + i] = s[at.CREEP_INPUT + i] = w[at.MOTION + i]
        w[at.MOTION + i] *= 1.0 + (m[at.CREEP_RADIAL] if i == 0 else m[at.CREEP_AXIAL])
        s[at.RESONANCE + i] = s[at.RESONANCE_INPUT + i] = w[at.MOTION + i]
        s[at.ZERO + i] = w[at.MOTION + i]
    s[at.ZERO_FORCE_X] = w[at.RESOLVED]
    s[at.ZERO_LOAD] = true_load
    s[at.START_TIME] = s[at.TIME] = time
    return found >= 0


@nb.njit(**INNER)
def predict(m: Any, s: Any, c0: Any, past: Any, w: Any) -> Any:
    """Move (3,) from the last state by its own stiffness and damping: no force is evaluated.

    Solves m a + K (q - q_old) + D (v - v_old) = external + F_old for the step's difference
    formulas v = c0 q + ..., a = c0 v + ...; (False, 0, 0, 0) if that cannot be trusted.
    """
    c1, c2 = past
    mass, inertia = m[at.MASS], m[at.INERTIA]
    b0 = c0 * s[at.Q] + c1 * s[at.Q] + c2 * s[at.Q_OLD]
    b1 = c0 * s[at.Q + 1] + c1 * s[at.Q + 1] + c2 * s[at.Q_OLD + 1]
    b2 = c0 * s[at.Q + 2] + c1 * s[at.Q + 2] + c2 * s[at.Q_OLD + 2]
    a0 = c0 * b0 + c1 * s[at.V] + c2 * s[at.V_OLD]
    a1 = c0 * b1 + c1 * s[at.V + 1] + c2 * s[at.V_OLD + 1]
    a2 = c0 * b2 + c1 * s[at.V + 2] + c2 * s[at.V_OLD + 2]
    j0, j1, j2 = b0 - s[at.V], b1 - s[at.V + 1], b2 - s[at.V + 2]
    k, d = at.LAST_STIFFNESS, at.LAST_DAMPING
    r0 = w[at.EXTERNAL] + s[at.LAST_FORCE] - mass * a0 - s[d] * j0 - s[d + 1] * j2
    r1 = w[at.EXTERNAL + 1] + s[at.LAST_FORCE + 1] - mass * a1 - s[d + 2] * j1 - s[d + 3] * j2
    r2 = (w[at.EXTERNAL + 2] + s[at.LAST_FORCE + 2] - inertia * a2
          - s[d + 1] * j0 - s[d + 3] * j1 - s[d + 4] * j2)
    square = c0 * c0
    found, x, y, tilt = solve3(
        s[k] + c0 * s[d] + mass * square, s[k + 1] + c0 * s[d + 1],
        s[k + 2] + c0 * s[d + 2] + mass * square, s[k + 3] + c0 * s[d + 3],
        s[k + 4] + c0 * s[d + 4] + inertia * square, r0, r1, r2)
    size = max(abs(x), abs(y), abs(tilt) * m[at.RADIUS])
    return found and size < LARGEST_PREDICTION, x, y, tilt


@nb.njit(**INNER)
def keep_step(m: Any, s: Any, h: Any, c0: Any, p: Any, past: Any, q: Any, friction: Any,
              w: Any) -> Any:
    """The solved step becomes the state; its forces and slopes are kept for `predict`."""
    if friction:
        s[at.RADIAL_Z], s[at.RADIAL_Z + 1], _, _ = hysteron(
            s[at.RADIAL_Z], s[at.RADIAL_Z + 1], q[0] - s[at.Q],
            m[at.RADIAL_PRESLIDING], m[at.RADIAL_SHARPNESS])
        s[at.TILT_Z], s[at.TILT_Z + 1], _, _ = hysteron(
            s[at.TILT_Z], s[at.TILT_Z + 1], q[2] - s[at.Q + 2],
            m[at.TILT_PRESLIDING], m[at.TILT_SHARPNESS])
    for i in range(3):
        v = c0 * q[i] + p[i]
        inertia = m[at.INERTIA] if i == 2 else m[at.MASS]
        s[at.LAST_FORCE + i] = inertia * (c0 * v + past[i]) - w[at.EXTERNAL + i]
        s[at.Q_OLD + i], s[at.Q + i] = s[at.Q + i], q[i]
        s[at.V_OLD + i], s[at.V + i] = s[at.V + i], v
    for i in range(5):
        s[at.LAST_STIFFNESS + i] = w[at.STIFFNESS + i]
        s[at.LAST_DAMPING + i] = w[at.DAMPING + i]
    s[at.STEP_OLD] = h


@nb.njit(**INNER)
def implicit_step(m: Any, rows: Any, uniform: Any, s: Any, h: Any, friction: Any, w: Any) -> Any:
    """One BDF2 step of h seconds (backward Euler after a start or a jump in h); iterations or -1.

    Unknown is q; v and a follow from the difference formulas. friction: the state's hysterons.
    """
    h_old = s[at.STEP_OLD]
    ratio = h / h_old if h_old > 0.0 else 0.0
    second_order = 0.0 < ratio <= 2.0
    if second_order:
        c0 = (1.0 + 2.0 * ratio) / (1.0 + ratio) / h
        c1 = -(1.0 + ratio) / h
        c2 = ratio * ratio / (1.0 + ratio) / h
    else:
        c0, c1, c2 = 1.0 / h, -1.0 / h, 0.0
    mass, inertia, radius = m[at.MASS], m[at.INERTIA], m[at.RADIUS]
    p0 = c1 * s[at.Q] + c2 * s[at.Q_OLD]
    p1 = c1 * s[at.Q + 1] + c2 * s[at.Q_OLD + 1]
    p2 = c1 * s[at.Q + 2] + c2 * s[at.Q_OLD + 2]
    past0 = c1 * s[at.V] + c2 * s[at.V_OLD]
    past1 = c1 * s[at.V + 1] + c2 * s[at.V_OLD + 1]
    past2 = c1 * s[at.V + 2] + c2 * s[at.V_OLD + 2]
    trusted, move0, move1, move2 = False, 0.0, 0.0, 0.0
    if second_order and not friction:
        trusted, move0, move1, move2 = predict(m, s, c0, (c1, c2), w)
    if second_order and not trusted:
        ahead = min(h, 0.01)
        move0, move1, move2 = ahead * s[at.V], ahead * s[at.V + 1], ahead * s[at.V + 2]
    q0, q1, q2 = s[at.Q] + move0, s[at.Q + 1] + move1, s[at.Q + 2] + move2
    previous = 1e300
    damp = 1.0
    square = c0 * c0
    for iteration in range(LARGEST_ITERATIONS):
        v0, v1, v2 = c0 * q0 + p0, c0 * q1 + p1, c0 * q2 + p2
        ring_forces(m, rows, uniform, q0, q1, q2, v0, v1, v2, w)
        r0 = w[at.EXTERNAL] + w[at.FORCE] - mass * (c0 * v0 + past0)
        r1 = w[at.EXTERNAL + 1] + w[at.FORCE + 1] - mass * (c0 * v1 + past1)
        r2 = w[at.EXTERNAL + 2] + w[at.FORCE + 2] - inertia * (c0 * v2 + past2)
        rubbing0 = rubbing2 = 0.0
        if friction:
            _, _, z, slope = hysteron(s[at.RADIAL_Z], s[at.RADIAL_Z + 1], q0 - s[at.Q],
                                      m[at.RADIAL_PRESLIDING], m[at.RADIAL_SHARPNESS])
            r0 -= m[at.RADIAL_LIMIT] * z
            rubbing0 = m[at.RADIAL_LIMIT] * slope
            _, _, z, slope = hysteron(s[at.TILT_Z], s[at.TILT_Z + 1], q2 - s[at.Q + 2],
                                      m[at.TILT_PRESLIDING], m[at.TILT_SHARPNESS])
            r2 -= m[at.TILT_LIMIT] * z
            rubbing2 = m[at.TILT_LIMIT] * slope
        k, d = at.STIFFNESS, at.DAMPING
        found, step0, step1, step2 = solve3(
            w[k] + c0 * w[d] + mass * square + rubbing0, w[k + 1] + c0 * w[d + 1],
            w[k + 2] + c0 * w[d + 2] + mass * square, w[k + 3] + c0 * w[d + 3],
            w[k + 4] + c0 * w[d + 4] + inertia * square + rubbing2, r0, r1, r2)
        if not found:
            return -1
        size = max(abs(step0), abs(step1), abs(step2) * radius)
        if not size < 1e300:
            return -1
        # Newton can cycle over a kink when a step is long: halve until it shrinks.
        damp = max(0.1, 0.5 * damp) if size > 0.9 * previous else min(1.0, 2.0 * damp)
        limit = min(damp, 1e-4 / size) if size > 1e-4 else damp
        q0, q1, q2 = q0 + limit * step0, q1 + limit * step1, q2 + limit * step2
        previous = size
        if size < STEP_TOLERANCE and limit == 1.0:
            keep_step(m, s, h, c0, (p0, p1, p2), (past0, past1, past2), (q0, q1, q2), friction, w)
            return iteration + 1
    return -1


@nb.njit(**INNER)
def robust_step(m: Any, rows: Any, uniform: Any, s: Any, h: Any, friction: Any, w: Any) -> Any:
    """One implicit step; where Newton fails on a kink, the same step in 4, 16 ... 4096 parts."""
    used = implicit_step(m, rows, uniform, s, h, friction, w)
    if used >= 0:
        return used
    for i in range(at.STATE_SIZE):
        w[at.BACKUP + i] = s[i]
    pieces = 1
    while pieces < 4096:
        pieces *= 4
        used = 0
        for _ in range(pieces):
            more = implicit_step(m, rows, uniform, s, h / pieces, friction, w)
            if more < 0:
                used = -1
                break
            used += more
        if used >= 0:
            return used
        for i in range(at.STATE_SIZE):
            s[i] = w[at.BACKUP + i]
    return -1


@nb.njit(**INNER)
def restart_at_rest(m: Any, rows: Any, uniform: Any, s: Any, w: Any) -> Any:
    """Count a step that did not converge and go on from equilibrium under w[EXTERNAL]."""
    s[at.TROUBLE] += 1.0
    s[at.STEP_OLD] = 0.0
    found, x, y, tilt = equilibrium(m, rows, uniform, w, s[at.Q], s[at.Q + 1], s[at.Q + 2])
    if found >= 0:
        s[at.Q], s[at.Q + 1], s[at.Q + 2] = x, y, tilt
    for i in range(3):
        s[at.V + i] = s[at.V_OLD + i] = 0.0
        s[at.Q_OLD + i] = s[at.Q + i]


@nb.njit(**INNER)
def take_load(m: Any, s: Any, measured: Any, w: Any) -> Any:
    """Move the measured load [N] on to its next value; the load path's friction follows it."""
    change = measured - s[at.MEASURED_LOAD]
    z_cylinder = z_bracket = 0.0
    if m[at.CYLINDER_LIMIT] != 0.0:
        s[at.CYLINDER_Z], s[at.CYLINDER_Z + 1], z_cylinder, _ = hysteron(
            s[at.CYLINDER_Z], s[at.CYLINDER_Z + 1], change,
            m[at.CYLINDER_PRESLIDING], m[at.CYLINDER_SHARPNESS])
    if m[at.BRACKET_LIMIT] != 0.0:
        s[at.BRACKET_Z], s[at.BRACKET_Z + 1], z_bracket, _ = hysteron(
            s[at.BRACKET_Z], s[at.BRACKET_Z + 1], change,
            m[at.BRACKET_PRESLIDING], m[at.BRACKET_SHARPNESS])
    s[at.MEASURED_LOAD] = measured
    s[at.HIGHEST_LOAD] = max(s[at.HIGHEST_LOAD], measured)
    return load_at_ring(m, measured, z_cylinder, z_bracket, w)


@nb.njit(**OUTER)
def advance(m: Any, rows: Any, uniform: Any, s: Any, time: Any, load: Any, max_step: Any,
            q_out: Any, d_out: Any) -> Any:
    """Carry state s over the samples time (N,), load (N,); q_out (N, 3) and d_out (N, 4) filled.

    A sample at or before the state's time is answered from the state without stepping. Returns the
    number of Newton iterations; s[TROUBLE] counts steps that did not converge (state restarted at
    equilibrium there), whose samples are NaN. Live and offline call this one function, for one
    sample or a million.
    """
    w = np.zeros(at.WORK_SIZE)
    friction = m[at.RADIAL_LIMIT] != 0.0 or m[at.TILT_LIMIT] != 0.0
    iterations = 0
    true_load = take_load(m, s, s[at.MEASURED_LOAD], w)
    for n in range(time.size):
        before = s[at.TROUBLE]
        total = time[n] - s[at.TIME]
        if total > 0.0:
            substeps = max(1, int(math.ceil(total / max_step - 1e-6)))
            h = total / substeps
            load_old = s[at.MEASURED_LOAD]
            for k in range(1, substeps + 1):
                measured = load[n]
                if k < substeps:
                    measured = load_old + (load[n] - load_old) * k / substeps
                true_load = take_load(m, s, measured, w)
                used = robust_step(m, rows, uniform, s, h, friction, w)
                if used < 0:
                    restart_at_rest(m, rows, uniform, s, w)
                iterations += max(used, 0)
            s[at.TIME] = time[n]
        series_motion(m, s, w)
        advance_series(m, s, w, max(total, 0.0))
        read_probes(m, s, w, true_load, time[n], max(total, 0.0), d_out, n)
        for i in range(3):
            q_out[n, i] = s[at.Q + i]
        if s[at.TROUBLE] != before:
            q_out[n, :] = math.nan
            d_out[n, :] = math.nan
    return iterations


@nb.njit(**OUTER)
def run_batch(m: Any, rows: Any, uniform: Any, time: Any, load: Any, zero_load: Any,
              max_step: Any, q_out: Any, d_out: Any) -> Any:
    """Simulate each parameter set of m (B, M) over one record; returns sets that had trouble.

    NaN stands for what did not converge.

    rows (R, 9 J), uniform (R, 3) with R = B or 1; q_out (B, N, 3), d_out (B, N, 4).
    """
    s = np.zeros(at.STATE_SIZE)
    troubled = 0
    for b in range(m.shape[0]):
        r = b if rows.shape[0] > 1 else 0
        found = start(m[b], rows[r], uniform[r], s, time[0], zero_load)
        advance(m[b], rows[r], uniform[r], s, time, load, max_step, q_out[b], d_out[b])
        if not found:
            q_out[b] = math.nan
            d_out[b] = math.nan
        if not found or s[at.TROUBLE] > 0.0:
            troubled += 1
    return troubled


@nb.njit(**INNER)
def static_run(m: Any, rows: Any, uniform: Any, load: Any, w: Any, q_out: Any) -> Any:
    """Equilibrium at each load (N,), NaN for none; each starts where the last one points to."""
    failed = 0
    x = y = tilt = 0.0
    anew = True
    for n in range(load.size):
        old0, old1, old2 = w[at.EXTERNAL], w[at.EXTERNAL + 1], w[at.EXTERNAL + 2]
        load_at_ring(m, load[n], 0.0, 0.0, w)
        if anew:
            x = math.copysign(0.5 * m[at.MIDDLE_CLEARANCE] + 1e-5, w[at.EXTERNAL])
            y = math.copysign(0.5 * m[at.AXIAL_CLEARANCE] + 1e-5, w[at.EXTERNAL + 1])
        else:
            k, radius = at.STIFFNESS, m[at.RADIUS]
            found, step0, step1, step2 = solve3(
                w[k], w[k + 1], w[k + 2], w[k + 3], w[k + 4], w[at.EXTERNAL] - old0,
                w[at.EXTERNAL + 1] - old1, w[at.EXTERNAL + 2] - old2)
            if found and max(abs(step0), abs(step1), abs(step2) * radius) < 2e-5:
                x, y, tilt = x + step0, y + step1, tilt + step2
        used, x, y, tilt = equilibrium(m, rows, uniform, w, x, y, tilt)
        q_out[n, 0], q_out[n, 1], q_out[n, 2] = x, y, tilt
        anew = used < 0
        if anew:
            failed += 1
            q_out[n, :] = math.nan
    return failed


@nb.njit(**OUTER)
def static_batch(m: Any, rows: Any, uniform: Any, load: Any, q_out: Any) -> Any:
    """Equilibrium of each parameter set m (B, M) at each load (N,), in order; q_out (B, N, 3)."""
    w = np.zeros(at.WORK_SIZE)
    failed = 0
    for b in range(m.shape[0]):
        r = b if rows.shape[0] > 1 else 0
        failed += static_run(m[b], rows[r], uniform[r], load, w, q_out[b])
    return failed
