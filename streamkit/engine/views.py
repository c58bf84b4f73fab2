"""Views of arrays for compiled functions: slices that are quicker to compile.

Numba's slices clip their ends and count the references to the array. A view does neither, so its ends must lie inside,
and the array must outlive it: one that the function was given, none that it has made itself.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array

from streamkit.engine.cache import helper

INTEGER = ir.IntType(64)


def _made(context: Any, builder: Any, kind: Any, data: Any, count: Any) -> Any:
    """Return an array (count,) without an owner at an address."""
    view = context.make_array(kind)(context, builder)
    size = ir.Constant(INTEGER, context.get_abi_sizeof(context.get_data_type(kind.dtype)))
    populate_array(view, data=data, shape=[count], strides=[size], itemsize=size, meminfo=None)
    return view._getvalue()


@intrinsic
def view(typing_context, array, begin, end):
    """Return elements [begin, end) of an array (n,)."""
    kind = types.Array(array.dtype, 1, "C")

    def codegen(context, builder, signature, args):
        source = context.make_array(signature.args[0])(context, builder, args[0])
        return _made(context, builder, kind, builder.gep(source.data, [args[1]]), builder.sub(args[2], args[1]))

    return kind(array, types.intp, types.intp), codegen


@intrinsic
def rest(typing_context, array, begin):
    """Return the elements of an array (n,) from begin on."""
    kind = types.Array(array.dtype, 1, "C")

    def codegen(context, builder, signature, args):
        source = context.make_array(signature.args[0])(context, builder, args[0])
        count = builder.sub(builder.extract_value(source.shape, 0), args[1])
        return _made(context, builder, kind, builder.gep(source.data, [args[1]]), count)

    return kind(array, types.intp), codegen


@intrinsic
def row_view(typing_context, array, row, begin, end):
    """Return elements [begin, end) of a row of an array (m, n)."""
    kind = types.Array(array.dtype, 1, "C")

    def codegen(context, builder, signature, args):
        source = context.make_array(signature.args[0])(context, builder, args[0])
        first = builder.add(builder.mul(args[1], builder.extract_value(source.shape, 1)), args[2])
        return _made(context, builder, kind, builder.gep(source.data, [first]), builder.sub(args[3], args[2]))

    return kind(array, types.intp, types.intp, types.intp), codegen


@intrinsic
def axes_view(typing_context, array, begin, end, apart):
    """Return elements [begin, end) of an array (n,), and those that stand once and twice so far apart."""
    kind = types.Array(array.dtype, 1, "C")

    def codegen(context, builder, signature, args):
        source = context.make_array(signature.args[0])(context, builder, args[0])
        count = builder.sub(args[2], args[1])
        first = [builder.add(args[1], builder.mul(ir.Constant(INTEGER, k), args[3])) for k in range(3)]
        views = [_made(context, builder, kind, builder.gep(source.data, [one]), count) for one in first]
        return context.make_tuple(builder, signature.return_type, views)

    return types.UniTuple(kind, 3)(array, types.intp, types.intp, types.intp), codegen


@helper
def fill(array, begin, end, value):
    """Store a number in elements [begin, end) of an array (n,)."""
    for i in range(begin, end):
        array[i] = value


@helper
def largest(array):
    """Return the largest element of an array (n,), n a multiple of 8; 0 if all are negative.

    It keeps eight maxima: the compiler takes a single one in the order of the elements, without vectors.
    """
    best = np.zeros(8)
    for i in range(0, array.shape[0], 8):
        for k in range(8):
            best[k] = max(best[k], array[i + k])
    most = 0.0
    for k in range(8):
        most = max(most, best[k])
    return most
