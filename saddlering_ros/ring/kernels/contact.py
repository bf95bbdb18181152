"""Forces of the rollers of each row and of the ring, with stiffness and damping.

Powers have no branch and no call, so that loops over them become vector code.
"""

from typing import Any

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
def row_motions(m: Any, q0: Any, q1: Any, q2: Any, v0: Any, v1: Any, v2: Any) -> Any:
    """(a, b, da, db) of upper, lower and radial row at motion q and its rate v.

    A roller penetrates by a + b cos - gap, at a rate of da + db cos.
    """
    radius, height = m.radius, m.radial_row_height
    return ((q1, -radius * q2, v1, -radius * v2), (-q1, radius * q2, -v1, radius * v2),
            (0.0, q0 + height * q2, 0.0, v0 + height * v2))


@kernel(**INNER)
def row_laws(m: Any) -> Any:
    """(K, n, D) of upper, lower and radial row."""
    return ((m.K1 * m.upper_row_stiffness, m.n1, m.D1), (m.K1 * m.lower_row_stiffness, m.n1, m.D1),
            (m.K2 * m.radial_row_stiffness, m.n2, m.D2))


@kernel(**INNER)
def row_rollers(m: Any) -> Any:
    """Numbers of rollers of upper, lower and radial row."""
    axial = np.uint64(m.axial_rollers)
    return axial, axial, np.uint64(m.radial_rollers)


@kernel(fastmath=FAST, **INNER)
def in_contact(rows: Any, row: Any, rollers: Any, uniform: Any, a: Any, b: Any,
               guess: Any) -> Any:
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


@kernel(fastmath=FAST, **INNER)
def row_sums(rows: Any, row: Any, rollers: Any, uniform: Any, motion: Any, law: Any, growing: Any,
             saturation: Any, guess: Any) -> Any:
    """Force sums of one row with penetration p = a + b cos - gap and rate dp/dt = da + db cos.

    Returns sum F, sum F cos; stiffness sums k, k cos, k cos^2 with k = dF/dp; damping sums d,
    d cos, d cos^2 with d = dF/d(dp/dt); and the number of rollers in contact, which is the guess
    of the next call. motion: (a, b, da, db); law: (K, n, D). growing: None, or (share, m) of the
    damping that grows as p^m, or as p^n for m = 0. saturation: None, or L of the growth
    p^m / (1 + (p L)^m). The function is compiled for each combination, so that an unused law costs
    nothing. rows: flat array of `model`; every row ends with rollers that carry no load, so that
    the loop runs over whole vectors.
    """
    widest_vectors()
    a, b, da, db = motion
    stiffness, exponent, damping = law
    cosines, weights, gaps, touching = in_contact(rows, row, rollers, uniform, a, b, guess)
    s0 = s1 = k0 = k1 = k2 = d0 = d1 = d2 = 0.0
    if touching == np.uint64(0):
        return s0, s1, k0, k1, k2, d0, d1, d2, 0.0
    count = (touching + np.uint64(7)) & ~np.uint64(7)
    constant, growth, factor, steepness, turn = damping, 0.0, 0.0, 0.0, 0.0
    if growing is not None:
        share, growth = growing
        growth = growth if growth > 0.0 else exponent
        constant = damping * (1.0 - share)
        if saturation is not None:
            turn = saturation ** growth
        factor = damping * share * (DAMPING_REFERENCE ** (-growth) + turn)
        # For m < 1 the slope of p^m is unbounded at p = 0. The term is therefore faded in (C1)
        # over (1 - m) RAMP. For m >= 1 no fade is needed, and the change at m = 1 is continuous.
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
            if saturation is not None:
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
        carries = rows[weights + j] if force > MIN_FORCE else 0.0
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


@kernel(**INNER)
def keep_matrix(m: Any, sum0: Any, sum1: Any, sum2: Any, radial: Any, w: Any, place: Any) -> Any:
    """Set a matrix of w by sums of slopes: axial rows times 1, cos, cos^2, radial row cos^2."""
    radius, height = m.radius, m.radial_row_height
    w[place] = radial
    w[place + 1] = height * radial
    w[place + 2] = sum0
    w[place + 3] = -radius * sum1
    w[place + 4] = radius * radius * sum2 + height * height * radial


@kernel(**INNER)
def keep_force(m: Any, up0: Any, up1: Any, low0: Any, low1: Any, radial: Any, w: Any) -> Any:
    """Set w[FORCE] by sum F and sum F cos of the axial rows, sum F cos of the radial row."""
    w[at.FORCE] = -radial
    w[at.FORCE + 1] = low0 - up0
    w[at.FORCE + 2] = m.radius * (up1 - low1) - m.radial_row_height * radial


@kernel(**INNER)
def forces_of_rows(m: Any, rows: Any, uniform: Any, q0: Any, q1: Any, q2: Any, v0: Any, v1: Any,
                   v2: Any, growing: Any, saturation: Any, w: Any) -> Any:
    """`ring_forces` for growing and saturating damping, or None, as in `row_sums`."""
    motions, laws, rollers = row_motions(m, q0, q1, q2, v0, v1, v2), row_laws(m), row_rollers(m)
    t = at.TOUCHING
    _, s1, _, _, k2, _, _, d2, w[t + 2] = row_sums(
        rows, 2, rollers[2], uniform[2], motions[2], laws[2], growing, saturation, w[t + 2])
    up0, up1, ku0, ku1, ku2, du0, du1, du2, w[t] = row_sums(
        rows, 0, rollers[0], uniform[0], motions[0], laws[0], growing, saturation, w[t])
    low0, low1, kl0, kl1, kl2, dl0, dl1, dl2, w[t + 1] = row_sums(
        rows, 1, rollers[1], uniform[1], motions[1], laws[1], growing, saturation, w[t + 1])
    keep_force(m, up0, up1, low0, low1, s1, w)
    keep_matrix(m, ku0 + kl0, ku1 + kl1, ku2 + kl2, k2, w, at.STIFFNESS)
    keep_matrix(m, du0 + dl0, du1 + dl1, du2 + dl2, d2, w, at.DAMPING)


@kernel(**INNER)
def ring_forces(m: Any, rows: Any, uniform: Any, q0: Any, q1: Any, q2: Any, v0: Any, v1: Any,
                v2: Any, w: Any) -> Any:
    """Contact forces on the upper ring at motion q and its rate v.

    Fills w: FORCE (3,); STIFFNESS and DAMPING are -dF/dq and -dF/dv, each as its entries 00, 02,
    11, 12, 22. Entry 01 is zero, because nothing couples delta_x to delta_y.
    """
    growing = (m.damping_penetration_share, m.damping_penetration_exponent)
    if m.damping_penetration_share == 0.0:
        forces_of_rows(m, rows, uniform, q0, q1, q2, v0, v1, v2, None, None, w)
    elif m.damping_penetration_saturation == 0.0:
        forces_of_rows(m, rows, uniform, q0, q1, q2, v0, v1, v2, growing, None, w)
    else:
        forces_of_rows(m, rows, uniform, q0, q1, q2, v0, v1, v2, growing,
                       m.damping_penetration_saturation, w)


@kernel(fastmath=FAST, **INNER)
def elastic_energy(m: Any, rows: Any, q0: Any, q1: Any, q2: Any) -> Any:
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
def bits_of(typing_context: Any, number: Any) -> Any:
    """The 64 bits of a float as an integer."""
    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(arguments[0], ir.IntType(64))
    return nb.types.int64(nb.types.float64), build


@intrinsic
def float_of(typing_context: Any, bits: Any) -> Any:
    """The float whose 64 bits are those of an integer."""
    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(arguments[0], ir.DoubleType())
    return nb.types.float64(nb.types.int64), build


@intrinsic
def widest_vectors(typing_context: Any) -> Any:
    """Let the calling function use the widest registers of the core.

    LLVM uses 256 of the 512 bits of some Intel cores, because older cores lowered their clock for
    wide registers. A loop of pure arithmetic becomes a seventh faster with all bits. llvmlite does
    not list this attribute, so that its check is avoided here. Other cores ignore the attribute.
    """
    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        set.add(builder.function.attributes, '"prefer-vector-width"="512"')
        return context.get_dummy_value()
    return nb.types.none(), build


@kernel(fastmath=FAST, inline='always', **INNER)
def log2_of(p: Any) -> Any:
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
def exp2_of(y: Any) -> Any:
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
def power(p: Any, exponent: Any) -> Any:
    """P ** exponent for a positive normal number p, with a relative error below 1e-13.

    log2 is the atanh series of the mantissa, and exp2 is a polynomial. Both are fitted at
    Chebyshev points (relative errors 3e-14 and 2e-14) and summed in pairs (Estrin), which
    shortens the chain of operations. There is no branch and no call, so that a loop becomes vector
    code on any x86-64 or ARM processor.
    """
    return exp2_of(exponent * log2_of(p))
