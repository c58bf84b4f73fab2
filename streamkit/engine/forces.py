"""The sum of all forces on lanes of particles: kernels by address, centred on the origin or on a trajectory."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

from streamkit.engine.cache import INLINE, helper
from streamkit.engine.views import fill, view
from streamkit.stream import Array, IntArray

BATCH = 4096  # particles taken together
LANES = 8  # doubles in the widest vector register: groups of equal steps are padded to a multiple of it
DEEPEST = 20  # a block takes at most 2 to this power steps
# Groups of equal steps: one and two half steps of Nystrom's method, and 2 to 2^DEEPEST steps of another one.
LEVELS = DEEPEST + 2

# Distance between the x, y and z of a particle in a batch. As a constant it shows LLVM that rows do not overlap.
ROW = BATCH + LANES * LEVELS


class Forces(NamedTuple):
    """The forces that add up: as arrays, so that one machine code serves every composition of them.

    Attributes
    ----------
    address
        (c,) addresses of their C functions.
    offset
        (c + 1,) where each force's parameters start in ``parameters``.
    trajectory
        (c,) index of the trajectory that the centre of each force moves on; -1: it is fixed at the origin.
    parameters
        Packed parameters in engine units.
    first, step, tracks
        (b, T, 20) the trajectories between the times ``first + k * step``: the six coefficients of `Orbit.polynomials`,
        and the fraction of its mass that is left, with its change to the next, by which the moving forces are
        multiplied. Mass is lost on the first trajectory alone.
    frame
        (T, 12) the acceleration of the origin itself on the same grid, which is subtracted: four coefficients of
        cubics, three numbers each; (0, 12) where the origin does not accelerate.
    """

    address: IntArray
    offset: IntArray
    trajectory: IntArray
    parameters: Array
    first: float
    step: float
    tracks: Array
    frame: Array


_I1, _F1, _F = types.int64[::1], types.float64[::1], types.float64
# The type of `Forces` in numba.
FORCES = types.NamedTuple([_I1, _I1, _I1, _F1, _F, _F, types.float64[:, :, ::1], types.float64[:, ::1]], Forces)
NO_TRACKS, NO_FRAME = np.zeros((0, 1, 20)), np.zeros((0, 12))


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
def centre_at(forces, b, t, out):
    """Write the position of trajectory b at time t, from the polynomials between its states, into out (3,)."""
    since, tracks = (t - forces.first) / forces.step, forces.tracks
    i = min(max(int(since), 0), tracks.shape[1] - 1)
    s = since - i
    for k in range(3):
        last = tracks[b, i, 9 + k] + s * (tracks[b, i, 12 + k] + s * tracks[b, i, 15 + k])
        out[k] = tracks[b, i, k] + s * (tracks[b, i, 3 + k] + s * (tracks[b, i, 6 + k] + s * last))


@njit(**INLINE)
def mass_left_at(forces, b, t):
    """Return the fraction of the initial mass that is left on trajectory b at time t, linear between its states."""
    since = (t - forces.first) / forces.step
    i = min(max(int(since), 0), forces.tracks.shape[1] - 1)
    return forces.tracks[b, i, 18] + (since - i) * forces.tracks[b, i, 19]


@njit(**INLINE)
def frame_at(forces, t, out):
    """Write the acceleration of the origin at time t into out (3,)."""
    since, frame = (t - forces.first) / forces.step, forces.frame
    i = min(max(int(since), 0), frame.shape[0] - 1)
    s = since - i
    for k in range(3):
        out[k] = frame[i, k] + s * (frame[i, 3 + k] + s * (frame[i, 6 + k] + s * frame[i, 9 + k]))


@njit(**INLINE)
def positions_about(forces, b, uniform, begin, end, t, x, relative, centre):
    """Return what holds positions of lanes [begin, end) for trajectory b, with its place in centre (3,) at those times.

    If `uniform` it is x, and centre is where the trajectory is; else it is `relative`, with zeros in centre.
    """
    if uniform:
        centre_at(forces, b, t[begin], centre)
    else:
        for i in range(begin, end):
            centre_at(forces, b, t[i], centre)
            for k in range(3):
                relative[k * ROW + i] = x[k * ROW + i] - centre[k]
        fill(centre, 0, 3, 0.0)
    return x if uniform else relative


@helper
def add_forces(forces, uniform, begin, end, t, x, relative, centre, a):
    """Store in a the acceleration of lanes [begin, end) at positions x and times t. If `uniform`, all times are equal.

    x, a and `relative` have rows ROW apart; `relative` and centre (3,) are scratch.
    """
    n, fresh, address, offset, p = end - begin, 1, forces.address, forces.offset, forces.parameters
    for b in range(forces.tracks.shape[0]):
        q = positions_about(forces, b, uniform, begin, end, t, x, relative, centre)
        for c in range(address.shape[0]):
            if forces.trajectory[c] == b:
                call_kernel(address[c], begin, n, t, p, offset[c], centre, q, a, fresh)
                fresh = 0
        if mass_left_at(forces, b, forces.first + forces.step * forces.tracks.shape[1]) != 1.0:  # it loses mass
            for i in range(begin, end):
                left = mass_left_at(forces, b, t[begin if uniform else i])
                for k in range(3):
                    a[k * ROW + i] *= left
    fill(centre, 0, 3, 0.0)
    for c in range(address.shape[0]):
        if forces.trajectory[c] < 0:
            call_kernel(address[c], begin, n, t, p, offset[c], centre, x, a, fresh)
            fresh = 0
    if fresh == 1:  # no force at all
        for k in range(3):
            fill(a, k * ROW + begin, k * ROW + end, 0.0)
    if forces.frame.shape[0] > 0:
        together = end - begin if uniform else 1
        for i in range(begin, end, together):
            frame_at(forces, t[i], centre)
            for k in range(3):
                a_i, shift = view(a, k * ROW + i, k * ROW + i + together), centre[k]
                for j in range(a_i.shape[0]):
                    a_i[j] -= shift
