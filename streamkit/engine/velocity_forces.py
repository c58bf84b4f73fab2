"""Forces with a part that depends on velocity (drag), and the calls of it in the loops.

The loops have a second machine code, for `DraggedForces`, which is compiled when a host first has a drag. In loops
compiled for `Forces` the functions of this file do nothing and leave no code. One kernel holds the drags of all
components. It reads whole lanes: positions, velocities, times and time steps.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic, overload

from streamkit.engine.cache import cached
from streamkit.engine.forces import BATCH, FORCES, ROW, Forces, add_forces, call_kernel
from streamkit.stream import Array, IntArray

LANES_ROWS = 8  # rows that the kernel reads: position, velocity, time and time step


class DraggedForces(NamedTuple):
    """`Forces`, and the kernel of the part that depends on velocity.

    Attributes
    ----------
    drag_address
        The address of its C function.
    drag_parameters
        Its packed parameters, behind the index of the first parameter of each component.
    """

    address: IntArray
    offset: IntArray
    trajectory: IntArray
    parameters: Array
    first: float
    step: float
    tracks: Array
    frame: Array
    drag_address: int
    drag_parameters: Array


COMPILED = {"error_model": "numpy"}
DRAGGED = types.NamedTuple([*FORCES.types, types.int64, types.float64[::1]], DraggedForces)  # its type in numba


@intrinsic
def is_dragged(typing_context, forces):
    """Return whether the forces depend on velocity: a constant when a loop is compiled."""
    dragged = ir.Constant(ir.IntType(1), int(forces.instance_class is DraggedForces))
    return types.boolean(forces), lambda context, builder, signature, args: dragged


def add_drag(forces, part, begin, end, lanes, a, centre):
    """Add the mean drag over a kick to the acceleration a of lanes [begin, end).

    A kick takes the fraction ``part`` of a time step and leaves positions unchanged. The mean is found by the classical
    method of Runge and Kutta, with the other forces that a already holds. With ``part`` 0 it is the drag at the present
    velocities.
    """


@overload(add_drag, jit_options=COMPILED)
def _add_drag(forces, part, begin, end, lanes, a, centre):
    if forces.instance_class is not DraggedForces:
        return lambda forces, part, begin, end, lanes, a, centre: None

    def call(forces, part, begin, end, lanes, a, centre):
        centre[0] = part
        p = forces.drag_parameters
        # the kernel needs the address of the first row of the lanes to find the other rows
        call_kernel(forces.drag_address, begin, end - begin, lanes, p, 0, centre, lanes, a, 0)

    return call


def renew(forces, n, lanes, relative, centre, t, a):
    """Store the acceleration of the first n lanes, of one time, at their velocity in a. Without drag a holds it."""


@overload(renew, jit_options=COMPILED)
def _renew(forces, n, lanes, relative, centre, t, a):
    if forces.instance_class is not DraggedForces:
        return lambda forces, n, lanes, relative, centre, t, a: None

    def call(forces, n, lanes, relative, centre, t, a):
        add_forces(forces, True, 0, n, t, lanes, relative, centre, a)
        add_drag(forces, 0.0, 0, n, lanes, a, centre)

    return call


def drag_centres(forces, n, t, x, u, a, centre):
    """Add the host's drag to the accelerations a of n centres, except to the first, which is the host."""


@overload(drag_centres, jit_options=COMPILED)
def _drag_centres(forces, n, t, x, u, a, centre):
    if forces.instance_class is not DraggedForces:
        return lambda forces, n, t, x, u, a, centre: None

    def call(forces, n, t, x, u, a, centre):
        lanes = np.zeros(LANES_ROWS * ROW)
        for j in range(1, n):
            for i in range(3):
                lanes[i * ROW + j] = x[i * ROW + j] - x[i * ROW]
                lanes[(3 + i) * ROW + j] = u[i * ROW + j] - u[i * ROW]
            lanes[6 * ROW + j] = t[j]
        add_drag(forces, 0.0, 1, n, lanes, a, centre)

    return call


@cached(types.void(DRAGGED, types.float64[::1], *[types.float64[:, ::1]] * 3))
def drags(forces, t, q, v, out):
    """Add the drag at q, v (3, n) and times t (n,) to out (3, n)."""
    lanes, a, centre = np.zeros(LANES_ROWS * ROW), np.empty(3 * ROW), np.empty(3)
    for begin in range(0, q.shape[1], BATCH):
        m = min(BATCH, q.shape[1] - begin)
        for i in range(m):
            for k in range(3):
                lanes[k * ROW + i], lanes[(3 + k) * ROW + i] = q[k, begin + i], v[k, begin + i]
                a[k * ROW + i] = out[k, begin + i]
            lanes[6 * ROW + i] = t[begin + i]
        add_drag(forces, 0.0, 0, m, lanes, a, centre)
        for k in range(3):
            for i in range(m):
                out[k, begin + i] = a[k * ROW + i]


def with_drag(forces: Forces, address: int, parameters: Array) -> DraggedForces:
    """Return the forces with the kernel of their drag."""
    return DraggedForces(*forces, address, parameters)
