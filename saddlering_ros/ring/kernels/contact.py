"""Forces of the rollers of each row and of the ring, with stiffness and damping.

Powers have no branch and no call, so that loops over them become vector code.
"""

import math

from llvmlite import ir
import numba as nb
from numba.extending import intrinsic
import numpy as np

from saddlering_ros.ring.kernels import layout as at
from saddlering_ros.ring.kernels.layout import FAST, INNER, kernel

RAMP = 1e-6
"""Penetration [m] over which the damper is faded in (C1: the force has no jump at contact)."""

DAMPING_REFERENCE = 50e-6
"""Penetration at which penetration-proportional damping equals D [m]."""

MIN_FORCE = 1e-15
"""A roller with a smaller force [N] is open. The lower limit of p, which keeps log2 finite, gives
such a force."""


@kernel(**INNER)
def row_motions(m, q0, q1, q2, v0, v1, v2):
    """(a, b, da, db) of upper, lower and radial row at motion q and its rate v.

    A roller penetrates by a + b cos - gap, at a rate of da + db cos.
    """
    radius, height = m.radius, m.radial_row_height
    return ((q1, -radius * q2, v1, -radius * v2), (-q1, radius * q2, -v1, radius * v2),
            (0.0, q0 + height * q2, 0.0, v0 + height * v2))


@kernel(**INNER)
def row_laws(m):
    """(K, n, D) of upper, lower and radial row."""
    return ((m.K1 * m.upper_row_stiffness, m.n1, m.D1), (m.K1 * m.lower_row_stiffness, m.n1, m.D1),
            (m.K2 * m.radial_row_stiffness, m.n2, m.D2))


@kernel(**INNER)
def row_rollers(m):
    """Numbers of rollers of upper, lower and radial row."""
    axial = np.uint64(m.axial_rollers)
    return axial, axial, np.uint64(m.radial_rollers)


@kernel(fastmath=FAST, **INNER)
def in_contact(rows, row, rollers, uniform, a, b, guess):
    """Places of cosines, weights and gaps of an interval with all rollers in contact; its length.

    guess: the length at which the search starts. The length of the last call is the best guess,
    because the ends of the contact move little in a step.
    """
    zero, one, two = np.uint64(0), np.uint64(1), np.uint64(2)
    stride = np.uint64(rows.size) // np.uint64(9)
    base = np.uint64(row) * np.uint64(3) * stride
    gaps = base + two * stride
    first = count = zero
    if uniform:
        edge = rows[gaps] - a
        if abs(b) > edge:
            count = min(np.uint64(guess), rollers)
            if b >= 0.0:
                while count < rollers and b * rows[base + count] > edge:
                    count += one
                while count > zero and not b * rows[base + count - one] > edge:
                    count -= one
            else:
                last = base + rollers - one
                while count < rollers and b * rows[last - count] > edge:
                    count += one
                while count > zero and not b * rows[last + one - count] > edge:
                    count -= one
                first = rollers - count
    else:
        for j in range(rollers):
            if a + b * rows[base + j] > rows[gaps + j]:
                if count == zero:
                    first = j
                count = j + one - first
    return base + first, base + stride + first, gaps + first, count


@kernel(**INNER)
def growth_terms(growing, saturation, exponent):
    """(share, m, L^m, 1/r^m + L^m, steepness of the fade) of growing damping, as in `row_sums`."""
    share, growth = growing
    growth = growth if growth > 0.0 else exponent
    turn = 0.0
    if saturation is not None:
        turn = saturation ** growth
    # For m < 1 the slope of p^m is unbounded at p = 0. The term is therefore faded in (C1) over
    # (1 - m) RAMP. For m >= 1 no fade is needed, and the change at m = 1 is continuous.
    return (share, growth, turn, DAMPING_REFERENCE ** (-growth) + turn,
            1.0 / (RAMP * max(1.0 - growth, 1e-20)))


@kernel(fastmath=FAST, **INNER)
def grown(p, binary, growth, turn, steepness, saturation):
    """(g, s, fade, swing) of growing damping at p, of which `binary` is log2; L as in `row_sums`.

    g = p^(m-1) / (1 + (p L)^m); the damping grows as g p fade, its slope as g (s fade + swing).
    """
    rising = exp2_of((growth - 1.0) * binary)
    slope = growth
    if saturation is not None:
        level = 1.0 / (1.0 + turn * rising * p)
        rising *= level
        slope *= level
    w = min(p * steepness, 1.0)
    return rising, slope, w * w * (3.0 - 2.0 * w), 6.0 * w * (w - w * w)


LAW = 6
"""Number of parameters of a row: K, n, D; share, exponent, saturation of growing damping."""

PARTS = 3 + 2 * LAW
"""Sums of a row for tangents: d times 1, cos, cos^2; force per parameter times 1, cos."""

LN2 = math.log(2.0)


@kernel(fastmath=FAST, forceinline=True, **INNER)
def row_sums(rows, row, rollers, uniform, motion, law, growing, saturation, guess, parts=None,
             each=None, places=None):
    """Force sums of one row with penetration p = a + b cos - gap and rate dp/dt = da + db cos.

    Returns sum F, sum F cos; stiffness sums k, k cos, k cos^2 with k = dF/dp; damping sums d,
    d cos, d cos^2 with d = dF/d(dp/dt); and the number of rollers in contact, which is the guess
    of the next call. motion: (a, b, da, db); law: (K, n, D). growing: None, or (share, m) of the
    damping that grows as p^m, or as p^n for m = 0. saturation: None, or L of the growth
    p^m / (1 + (p L)^m). parts: None, or (3, PARTS) to be filled for tangents at this row. each:
    None, or (2, J) to be filled with forces and slopes dF/dp of single rollers. places: None, or
    what `in_contact` gives. The function is compiled for each combination, so that an unused law
    costs nothing. rows: flat array of `model`; every row ends with rollers that carry no load, so
    that the loop runs over whole vectors.
    """
    widest_vectors()
    a, b, da, db = motion
    stiffness, exponent, damping = law
    if places is None:
        cosines, weights, gaps, touching = in_contact(rows, row, rollers, uniform, a, b, guess)
    else:
        cosines, weights, gaps, touching = places
    s0 = s1 = k0 = k1 = k2 = d0 = d1 = d2 = 0.0
    if touching == np.uint64(0):
        if parts is not None:
            for i in range(PARTS):
                parts[row, i] = 0.0
        return s0, s1, k0, k1, k2, d0, d1, d2, 0.0
    count = (touching + np.uint64(7)) & ~np.uint64(7)
    n0 = n1 = c0 = c1 = g0 = g1 = m0 = m1 = l0 = l1 = 0.0
    share, growth, turn, factor, steepness = 0.0, 0.0, 0.0, 1.0, 0.0
    factor_slope = level_log = turn_slope = 0.0
    if growing is not None:
        share, growth, turn, factor, steepness = growth_terms(growing, saturation, exponent)
        factor_slope = -math.log(DAMPING_REFERENCE) * (factor - turn) / factor
        if saturation is not None:
            level_log = math.log(saturation)
            turn_slope = growth * turn / (factor * saturation)
            factor_slope += turn * level_log / factor
    constant, amount, turned = damping * (1.0 - share), damping * share * factor, turn / factor
    for j in range(count):
        c = rows[cosines + j]
        p = max(a + b * c - rows[gaps + j], 1e-30)
        rate = da + db * c
        binary = log2_of(p)
        relative = exp2_of((exponent - 1.0) * binary)
        u = min(p * (1.0 / RAMP), 1.0)
        closed = u * u * (3.0 - 2.0 * u)
        d = constant * closed
        d_slope = constant * (6.0 / RAMP) * (u - u * u)
        if growing is not None:
            rising, slope, fade, swing = grown(p, binary, growth, turn, steepness, saturation)
            added = amount * rising
            d += added * p * fade
            d_slope += added * (slope * fade + swing)
        elastic = relative * p
        force = stiffness * elastic + d * rate
        k = exponent * stiffness * relative + d_slope * rate
        if each is not None:
            each[0, j], each[1, j] = force, k
        carries = rows[weights + j] if force > MIN_FORCE else 0.0
        k *= carries
        d *= carries
        k0 += k
        k1 += k * c
        k2 += k * c * c
        d0 += d
        d1 += d * c
        d2 += d * c * c
        if parts is None:
            force *= carries
            s0 += force
            s1 += force * c
            continue
        natural = LN2 * binary
        elastic *= carries
        s0 += elastic
        s1 += elastic * c
        n0 += elastic * natural
        n1 += elastic * natural * c
        moving = carries * rate
        c0 += moving * closed
        c1 += moving * closed * c
        if growing is not None:
            level = factor * rising * p  # of the growing part for D = 1 and a share of 1
            log_slope, by_saturation = factor_slope + natural, 0.0
            if saturation is not None:
                log_slope -= turned * level * (level_log + natural)
                by_saturation = turn_slope * (1.0 - level) * level * fade
            by_exponent = level * (fade * log_slope + swing * (steepness * RAMP))
            g0 += moving * level * fade
            g1 += moving * level * fade * c
            m0 += moving * by_exponent
            m1 += moving * by_exponent * c
            l0 += moving * by_saturation
            l1 += moving * by_saturation * c
    if parts is not None:
        part, by_growth = parts[row], damping * share
        part[0], part[1], part[2] = d0, d1, d2
        part[3], part[4], part[5], part[6] = s0, s1, stiffness * n0, stiffness * n1
        part[7], part[8] = (1.0 - share) * c0 + share * g0, (1.0 - share) * c1 + share * g1
        part[9], part[10] = damping * (g0 - c0), damping * (g1 - c1)
        part[11], part[12] = by_growth * m0, by_growth * m1
        part[13], part[14] = by_growth * l0, by_growth * l1
        s0, s1 = stiffness * s0 + damping * part[7], stiffness * s1 + damping * part[8]
    return s0, s1, k0, k1, k2, d0, d1, d2, float(touching)


@kernel(**INNER)
def keep_matrix(m, sum0, sum1, sum2, radial, w, place):
    """Set a matrix of w by sums of slopes: axial rows times 1, cos, cos^2, radial row cos^2."""
    radius, height = m.radius, m.radial_row_height
    w[place] = radial
    w[place + 1] = height * radial
    w[place + 2] = sum0
    w[place + 3] = -radius * sum1
    w[place + 4] = radius * radius * sum2 + height * height * radial


@kernel(**INNER)
def forces_of_rows(m, rows, uniform, q0, q1, q2, v0, v1, v2, growing, saturation, w, parts):
    """`ring_forces` for growing and saturating damping, or None, as in `row_sums`."""
    motions, laws, rollers = row_motions(m, q0, q1, q2, v0, v1, v2), row_laws(m), row_rollers(m)
    axial = turn = radial = k0 = k1 = k2 = k3 = d0 = d1 = d2 = d3 = 0.0
    for row in range(3):
        s0, s1, ks0, ks1, ks2, ds0, ds1, ds2, w[at.TOUCHING + row] = row_sums(
            rows, row, rollers[row], uniform[row], motions[row], laws[row], growing, saturation,
            w[at.TOUCHING + row], parts)
        if row == 2:
            radial, k3, d3 = s1, ks2, ds2
        else:
            side = 1.0 - 2.0 * row
            axial, turn = axial - side * s0, turn + side * s1
            k0, k1, k2 = k0 + ks0, k1 + ks1, k2 + ks2
            d0, d1, d2 = d0 + ds0, d1 + ds1, d2 + ds2
    w[at.FORCE] = -radial
    w[at.FORCE + 1] = axial
    w[at.FORCE + 2] = m.radius * turn - m.radial_row_height * radial
    keep_matrix(m, k0, k1, k2, k3, w, at.STIFFNESS)
    keep_matrix(m, d0, d1, d2, d3, w, at.DAMPING)


@kernel(**INNER)
def ring_forces(m, rows, uniform, q0, q1, q2, v0, v1, v2, w, parts, grows):
    """Contact forces on the upper ring at motion q and its rate v.

    Fills w: FORCE (3,); STIFFNESS and DAMPING are -dF/dq and -dF/dv, each as its entries 00, 02,
    11, 12, 22. Entry 01 is zero, because nothing couples delta_x to delta_y. parts: as in
    `row_sums`, of upper, lower and radial row; grows: whether tangents by the law of growing
    damping are wanted, also at a share of 0.
    """
    growing = (m.damping_penetration_share, m.damping_penetration_exponent)
    if not grows and m.damping_penetration_share == 0.0:
        forces_of_rows(m, rows, uniform, q0, q1, q2, v0, v1, v2, None, None, w, parts)
    elif m.damping_penetration_saturation == 0.0:
        forces_of_rows(m, rows, uniform, q0, q1, q2, v0, v1, v2, growing, None, w, parts)
    else:
        forces_of_rows(m, rows, uniform, q0, q1, q2, v0, v1, v2, growing,
                       m.damping_penetration_saturation, w, parts)


@kernel(fastmath=FAST, **INNER)
def elastic_energy(m, rows, q0, q1, q2):
    """Elastic energy [J] of all rollers at motion q, sum K p^(n+1)/(n+1)."""
    motions, laws, rollers = row_motions(m, q0, q1, q2, 0.0, 0.0, 0.0), row_laws(m), row_rollers(m)
    stride = np.uint64(rows.size) // np.uint64(9)
    total = 0.0
    for row in range(3):
        a, b, _, _ = motions[row]
        stiffness, exponent, _ = laws[row]
        base = np.uint64(row) * np.uint64(3) * stride
        energy = 0.0
        for j in range(rollers[row]):
            p = max(a + b * rows[base + j] - rows[base + np.uint64(2) * stride + j], 1e-30)
            energy += rows[base + stride + j] * stiffness * power(p, exponent + 1.0)
        total += energy / (exponent + 1.0)
    return total


SQRT_HALF_BITS = 0x3FE6A09E667F3BCD

INTEGER_FLOAT = 6755399441055744.0
"""1.5 * 2^52. The lowest bits of the sum with a small whole number hold this number."""

INTEGER_FLOAT_BITS = 0x4338000000000000


@intrinsic
def bits_of(typing_context, number):
    """The 64 bits of a float as an integer."""
    def build(context, builder, signature, arguments):
        return builder.bitcast(arguments[0], ir.IntType(64))
    return nb.types.int64(nb.types.float64), build


@intrinsic
def float_of(typing_context, bits):
    """The float whose 64 bits are those of an integer."""
    def build(context, builder, signature, arguments):
        return builder.bitcast(arguments[0], ir.DoubleType())
    return nb.types.float64(nb.types.int64), build


@intrinsic
def widest_vectors(typing_context):
    """Let the calling function use the widest registers of the core.

    LLVM uses 256 of the 512 bits of some Intel cores, because older cores lowered their clock for
    wide registers. A loop of pure arithmetic becomes a seventh faster with all bits. llvmlite does
    not list this attribute, so that its check is avoided here. Other cores ignore the attribute.
    """
    def build(context, builder, signature, arguments):
        set.add(builder.function.attributes, '"prefer-vector-width"="512"')
        return context.get_dummy_value()
    return nb.types.none(), build


@kernel(fastmath=FAST, inline='always', **INNER)
def log2_of(p):
    """Logarithm to base 2 of a positive normal number p."""
    pattern = bits_of(p)
    whole = (pattern - SQRT_HALF_BITS) >> 52
    m = float_of(pattern - (whole << 52))
    s = (m - 1.0) / (m + 1.0)
    z = s * s
    z2 = z * z
    series = ((2.8853900817778504 + z * 0.9617966941123595)
              + z2 * ((0.5770779426302618 + z * 0.41220922733052445)
                      + z2 * (0.3199066608891474 + z * 0.28288718263073565)))
    return (float_of(whole + INTEGER_FLOAT_BITS) - INTEGER_FLOAT) + s * series


@kernel(fastmath=FAST, inline='always', **INNER)
def exp2_of(y):
    """2 ** y, if the result is a normal number."""
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


@kernel(fastmath=FAST, inline='always', **INNER)
def power(p, exponent):
    """P ** exponent for a positive normal number p, with a relative error below 1e-13.

    log2 is the atanh series of the mantissa, and exp2 is a polynomial. Both are fitted at
    Chebyshev points (relative errors 3e-14 and 2e-14) and summed in pairs (Estrin), which
    shortens the chain of operations. There is no branch and no call, so that a loop becomes vector
    code on any x86-64 or ARM processor.
    """
    return exp2_of(exponent * log2_of(p))
