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
"""Most levels of power-of-two steps."""

ROW = BATCH + LANES * (DEEPEST + 1)
"""Distance between the x, y and z of a particle in a batch. A constant: it proves to LLVM that rows are apart."""


@intrinsic
def call_kernel(typing_context, address, n, t, p, q, a):
    """Call ``void (*)(intp, double*, double*, double*, double*)`` at an integer address, with arrays."""

    def codegen(context, builder, signature, args):
        integer, double = ir.IntType(64), ir.DoubleType().as_pointer()
        function = ir.FunctionType(ir.VoidType(), [integer, double, double, double, double])
        pointer = builder.inttoptr(args[0], function.as_pointer())
        data = [
            context.make_array(kind)(context, builder, value).data
            for kind, value in zip(signature.args[2:], args[2:])  # noqa: B905  numba tuples
        ]
        builder.call(pointer, [args[1], *data])
        return context.get_dummy_value()

    return types.void(types.int64, types.intp, t, p, q, a), codegen


@njit(**INLINE)
def track_at(t, first, step, track, out):
    """Quintic Hermite position of the progenitor at time t from its states (T, 10), into out (3,)."""
    last = track.shape[0] - 2
    i = min(max(int((t - first) / step), 0), last)
    s = (t - first) / step - i
    for k in range(3):
        q0, v0, a0 = track[i, k], track[i, 3 + k] * step, track[i, 6 + k] * step * step
        q1, v1, a1 = track[i + 1, k], track[i + 1, 3 + k] * step, track[i + 1, 6 + k] * step * step
        d = q1 - q0 - v0 - 0.5 * a0
        dv = v1 - v0 - a0
        da = a1 - a0
        c3 = 10.0 * d - 4.0 * dv + 0.5 * da
        c4 = -15.0 * d + 7.0 * dv - da
        c5 = 6.0 * d - 3.0 * dv + 0.5 * da
        out[k] = q0 + s * (v0 + s * (0.5 * a0 + s * (c3 + s * (c4 + s * c5))))


@njit(**INLINE)
def mass_left_at(t, first, step, track):
    """Fraction of its mass that the progenitor still has at time t: the last column of its states, linearly."""
    i = min(max(int((t - first) / step), 0), track.shape[0] - 2)
    s = (t - first) / step - i
    return (1.0 - s) * track[i, 9] + s * track[i + 1, 9]


@njit(**OPTIONS)
def add_forces(address, offset, follows, p, first, step, track, uniform, begin, end, t, x, rel, centre, a):
    """Sum the accelerations of lanes begin to end at x, times t, into a (rows ROW apart); rel is scratch."""
    for k in range(3):
        a[k * ROW + begin : k * ROW + end] = 0.0
    shifted = False
    for c in range(address.shape[0]):
        if not follows[c]:
            continue
        if not shifted:
            shifted = True
            if uniform:
                track_at(t[begin], first, step, track, centre)
                for k in range(3):
                    shift = centre[k]
                    from_row, to_row = x[k * ROW + begin : k * ROW + end], rel[k * ROW + begin : k * ROW + end]
                    for i in range(to_row.shape[0]):
                        to_row[i] = from_row[i] - shift
            else:
                for i in range(begin, end):
                    track_at(t[i], first, step, track, centre)
                    for k in range(3):
                        rel[k * ROW + i] = x[k * ROW + i] - centre[k]
        call_kernel(address[c], end - begin, t[begin:], p[offset[c] :], rel[begin:], a[begin:])
    if shifted and track[track.shape[0] - 1, 9] != 1.0:  # the progenitor loses mass
        for i in range(begin, end):
            left = mass_left_at(t[begin if uniform else i], first, step, track)
            for k in range(3):
                a[k * ROW + i] *= left
    for c in range(address.shape[0]):
        if not follows[c]:
            call_kernel(address[c], end - begin, t[begin:], p[offset[c] :], x[begin:], a[begin:])
