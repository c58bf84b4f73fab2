"""The sum of all forces on a batch of particles: kernels by address, the moving progenitor from its track."""

from __future__ import annotations

from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

from streamkit.engine.cache import INLINE, OPTIONS

BATCH = 4096
"""Particles taken together."""
LANES = 8
"""Doubles in the widest vector register: groups of equal steps are padded to a multiple of it."""
DEEPEST = 20
"""A block takes at most 2 to this power steps."""
LEVELS = DEEPEST + 2
"""Groups of equal steps: one and two half steps of Nystrom's method, and 2 to 2^DEEPEST steps of another one."""

ROW = BATCH + LANES * LEVELS
"""Distance between the x, y and z of a particle in a batch. A constant: it proves to LLVM that rows are apart."""


@intrinsic
def call_kernel(typing_context, address, begin, n, t, p, offset, centre, q, a, fresh):
    """Call the C function of `kernels.SIGNATURE` at an integer address for n lanes from begin on.

    t, q and a are passed from begin on, p from offset on: as pointers, since a slice of an array counts references.
    """

    def codegen(context, builder, signature, args):
        integer, double = ir.IntType(64), ir.DoubleType().as_pointer()
        function = ir.FunctionType(ir.VoidType(), [integer, *[double] * 5, integer])
        pointer = builder.inttoptr(args[0], function.as_pointer())

        def data(i, first):
            array = context.make_array(signature.args[i])(context, builder, args[i])
            return builder.gep(array.data, [first])

        begin, n, zero = args[1], args[2], ir.Constant(integer, 0)
        places = data(3, begin), data(4, args[5]), data(6, zero), data(7, begin), data(8, begin)
        builder.call(pointer, [n, *places, args[9]])
        return context.get_dummy_value()

    count = types.intp
    return types.void(types.int64, count, count, t, p, types.int64, centre, q, a, count), codegen


@njit(**INLINE)
def track_at(t, first, step, track, out):
    """Position of the progenitor at time t, from the polynomials (T, 20) between its states, into out (3,)."""
    i = min(max(int((t - first) / step), 0), track.shape[0] - 1)
    s = (t - first) / step - i
    for k in range(3):
        last = track[i, 9 + k] + s * (track[i, 12 + k] + s * track[i, 15 + k])
        out[k] = track[i, k] + s * (track[i, 3 + k] + s * (track[i, 6 + k] + s * last))


@njit(**INLINE)
def mass_left_at(t, first, step, track):
    """Fraction of its mass that the progenitor still has at time t: the last two columns of its track, linearly."""
    i = min(max(int((t - first) / step), 0), track.shape[0] - 1)
    return track[i, 18] + ((t - first) / step - i) * track[i, 19]


@njit(**OPTIONS)
def add_forces(address, offset, follows, p, first, step, track, uniform, begin, end, t, x, rel, centre, a):
    """Sum the accelerations of lanes begin to end at x, times t, into a (rows ROW apart); rel is scratch."""
    n, fresh, shifted = end - begin, 1, False
    for c in range(address.shape[0]):
        if not follows[c]:
            continue
        if not uniform and not shifted:
            for i in range(begin, end):
                track_at(t[i], first, step, track, centre)
                for k in range(3):
                    rel[k * ROW + i] = x[k * ROW + i] - centre[k]
            centre[:] = 0.0
        elif not shifted:
            track_at(t[begin], first, step, track, centre)
        shifted = True
        call_kernel(address[c], begin, n, t, p, offset[c], centre, x if uniform else rel, a, fresh)
        fresh = 0
    if shifted and mass_left_at(first + step * track.shape[0], first, step, track) != 1.0:  # it loses mass
        for i in range(begin, end):
            left = mass_left_at(t[begin if uniform else i], first, step, track)
            for k in range(3):
                a[k * ROW + i] *= left
    centre[:] = 0.0
    for c in range(address.shape[0]):
        if not follows[c]:
            call_kernel(address[c], begin, n, t, p, offset[c], centre, x, a, fresh)
            fresh = 0
    if fresh == 1:  # no force at all
        for k in range(3):
            a[k * ROW + begin : k * ROW + end] = 0.0
