"""Elementary functions as straight arithmetic that LLVM vectorises, put in place of `streamkit.elementary`.

The scalar ``log`` and ``exp`` of the C library keep a loop scalar. These take the exponent of a double apart by
its bits and leave only a polynomial, so that a loop around them runs on every lane. Accurate to a few units in
the last place: tested against NumPy to 1e-14 over the whole range of doubles that potentials meet.
"""

from __future__ import annotations

import math

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic, overload

from streamkit import elementary

SHIFTER = 6755399441055744.0  # 1.5 * 2^52: added to a number it rounds it, and leaves the integer in the last bits
SHIFTED_BITS = 0x4338000000000000
INSIDE = 1.0 - 2.0**-53
LN2_HI = 6.93147180369123816490e-01  # ln 2 in two pieces, so that k * LN2_HI is exact (fdlibm)
LN2_LO = 1.90821492927058770002e-10
SQRT_HALF_BITS = 0x3FE6A09E667F3BCD
MANTISSA_ONE = 0x3FF0000000000000


@intrinsic
def bits_of(typing_context, x):
    """Reinterpret a double as an int64."""

    def codegen(context, builder, signature, args):
        return builder.bitcast(args[0], ir.IntType(64))

    return types.int64(types.float64), codegen


@intrinsic
def double_of(typing_context, x):
    """Reinterpret an int64 as a double."""

    def codegen(context, builder, signature, args):
        return builder.bitcast(args[0], ir.DoubleType())

    return types.float64(types.int64), codegen


@njit(error_model="numpy", fastmath={"contract"}, forceinline=True)
def vector_log(x):
    """Ln x for normal positive x: x = 2^k m with m in [sqrt(1/2), sqrt 2), ln m = 2 atanh((m-1)/(m+1))."""
    bits = bits_of(x)
    shifted = bits - SQRT_HALF_BITS
    k = shifted >> 52
    m = double_of(bits - (k << 52))
    f = m - 1.0
    s = f / (2.0 + f)
    z = s * s
    w = z * z
    # minimax coefficients of fdlibm's e_log.c: |error| < 2^-58.45
    even = w * (0.3999999999940941908 + w * (0.2222219843214978396 + w * 0.1531383769920937332))
    odd = z * (
        0.6666666666666735130 + w * (0.2857142874366239149 + w * (0.1818357216161805012 + w * 0.1479819860511658591))
    )
    half = 0.5 * f * f
    # k as a double without an int-to-float conversion, which AVX2 lacks for 64 bits
    dk = double_of(k + 0x4338000000000000) - 6755399441055744.0
    return dk * LN2_HI - ((half - (s * (half + (even + odd)) + dk * LN2_LO)) - f)


@njit(error_model="numpy", fastmath={"contract"}, forceinline=True)
def vector_exp(x):
    """e^x with x clipped to [-708, 709]: x = k ln 2 + r, |r| <= ln 2 / 2, then a Taylor polynomial."""
    x = min(max(x, -708.0), 709.0)
    shifter = 6755399441055744.0
    t = x * 1.4426950408889634074 + shifter
    k = t - shifter
    r = (x - k * LN2_HI) - k * LN2_LO
    p = 1.0 / 6227020800.0
    p = p * r + 1.0 / 479001600.0
    p = p * r + 1.0 / 39916800.0
    p = p * r + 1.0 / 3628800.0
    p = p * r + 1.0 / 362880.0
    p = p * r + 1.0 / 40320.0
    p = p * r + 1.0 / 5040.0
    p = p * r + 1.0 / 720.0
    p = p * r + 1.0 / 120.0
    p = p * r + 1.0 / 24.0
    p = p * r + 1.0 / 6.0
    p = p * r + 0.5
    p = (p * r) * r + r
    scale = double_of((bits_of(t) << 52) + MANTISSA_ONE)
    return scale + scale * p


@overload(elementary.log, jit_options={"forceinline": True, "error_model": "numpy"})
def _log(x):
    return lambda x: vector_log(float(x))


@overload(elementary.exp, jit_options={"forceinline": True, "error_model": "numpy"})
def _exp(x):
    return lambda x: vector_exp(float(x))


@overload(elementary.power, jit_options={"forceinline": True, "error_model": "numpy"})
def _power(x, y):
    return lambda x, y: vector_exp(y * vector_log(float(x)))


@overload(elementary.sqrt, jit_options={"forceinline": True, "error_model": "numpy"})
def _sqrt(x):
    return lambda x: math.sqrt(x)  # noqa: PLW0108  numba wants a Python function


@njit(error_model="numpy", fastmath={"contract"}, forceinline=True)
def cell_of(x, first, last, count):
    """Cell of an even grid and the place in it: without branches, and safe for every x. NaN stays NaN."""
    u = (x - first) * (count / (last - first))
    inside = u if u > 0.0 else 0.0
    inside = inside if inside < count * INSIDE else count * INSIDE
    shifted = (inside - 0.5) + SHIFTER
    s = inside - (shifted - SHIFTER)
    return np.uint64(bits_of(shifted) - SHIFTED_BITS), s if u == u else u


@overload(elementary.cubic, jit_options={"forceinline": True, "error_model": "numpy"})
def _cubic(x, ends, pieces):
    def compiled(x, ends, pieces):
        k, s = cell_of(float(x), float(ends[0]), float(ends[1]), float(pieces.shape[0]))
        return pieces[k, 0] + s * (pieces[k, 1] + s * (pieces[k, 2] + s * pieces[k, 3]))

    return compiled


@overload(elementary.interp, jit_options={"forceinline": True, "error_model": "numpy"})
def _interp(x, xp, fp):
    def even(x, xp, fp):
        k, s = cell_of(float(x), float(xp[0]), float(xp[1]), float(fp.shape[0] - 1))
        return fp[k] + s * (fp[k + np.uint64(1)] - fp[k])

    def uneven(x, xp, fp):
        low, count = 0, xp.shape[0] - 1
        while count > 1:  # without branches: which half is unpredictable
            half = count >> 1
            low = low + half if xp[low + half] <= x else low
            count -= half
        s = (x - xp[low]) / (xp[low + 1] - xp[low])
        s = 0.0 if s < 0.0 else s
        s = 1.0 if s > 1.0 else s
        return fp[low] + s * (fp[low + 1] - fp[low])

    return even if isinstance(xp, types.BaseTuple) else uneven
