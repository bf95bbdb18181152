"""Powers without branch or call, so that loops over them become vector code."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
import numba as nb
from numba.extending import intrinsic
import numpy as np

from saddlering_ros.ring.kernels.options import FAST, INNER, kernel

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
