"""Forces with a part that depends on velocity: what the loops do with them, and nothing where there is none.

The loops are compiled a second time, for `DraggedForces`, when a host first asks for it; those for `Forces` are what
they would be without this file. The drag of all components is one kernel, called with whole lanes: positions,
velocities, times and time steps.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numba import types
from numba.extending import overload

from streamkit.engine.cache import cached
from streamkit.engine.forces import BATCH, FORCES, ROW, Forces, add_forces, call_kernel
from streamkit.stream import Array, IntArray

LANES_ROWS = 8  # rows that the kernel reads: position, velocity, time and time step


class DraggedForces(NamedTuple):
    """`Forces`, and the kernel of what depends on velocity.

    Attributes
    ----------
    drag_address
        The address of its C function.
    drag_parameters
        Its packed parameters, with where those of each component begin in front.
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
DRAGGED = types.NamedTuple([*FORCES.types, types.int64, types.float64[::1]], DraggedForces)  # what numba calls them


def is_dragged(forces):
    """Say whether the forces depend on velocity: known when a loop is compiled."""


@overload(is_dragged, jit_options=COMPILED)
def _is_dragged(forces):
    return (lambda forces: True) if forces.instance_class is DraggedForces else (lambda forces: False)


def add_drag(forces, part, begin, end, lanes, a, centre):
    """Add to the acceleration a of lanes [begin, end) its mean part that depends on velocity over a kick.

    That is over the fraction ``part`` of their time steps, in which positions stand still: by the classical method of
    Runge and Kutta, with the forces that a holds already. ``part`` 0 takes the velocities as they are.
    """


@overload(add_drag, jit_options=COMPILED)
def _add_drag(forces, part, begin, end, lanes, a, centre):
    if forces.instance_class is not DraggedForces:
        return lambda forces, part, begin, end, lanes, a, centre: None

    def call(forces, part, begin, end, lanes, a, centre):
        centre[0] = part
        p = forces.drag_parameters
        # lanes begin at their first row, so that the kernel finds the others
        call_kernel(forces.drag_address, begin, end - begin, lanes, p, 0, centre, lanes, a, 0)

    return call


def renew(forces, lanes, relative, centre, t, a):
    """Store in a the whole acceleration of the first lane, at its velocity; nothing where none depends on that."""


@overload(renew, jit_options=COMPILED)
def _renew(forces, lanes, relative, centre, t, a):
    if forces.instance_class is not DraggedForces:
        return lambda forces, lanes, relative, centre, t, a: None

    def call(forces, lanes, relative, centre, t, a):
        add_forces(forces, True, 0, 1, t, lanes, relative, centre, a)
        add_drag(forces, 0.0, 0, 1, lanes, a, centre)

    return call


def drag_centres(forces, n, t, x, u, a, centre):
    """Add to the accelerations a of n centres the host's drag on all but the first, which is the host itself."""


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


@cache
def drag_loop():
    """Return the loop that adds the drag at q, v (3, n) and times t (n,) to out (3, n); compiled when first needed."""

    @cached(types.void(DRAGGED, types.float64[::1], *[types.float64[:, ::1]] * 3))
    def drags(forces, t, q, v, out):
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

    return drags


def with_drag(forces: Forces, address: int, parameters: Array) -> DraggedForces:
    """Return the forces with the kernel of what depends on velocity."""
    return DraggedForces(*forces, address, parameters)
