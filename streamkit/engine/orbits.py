"""The compiled loops of orbits on a grid of times: one orbit, or many at a time."""

from __future__ import annotations

import numpy as np
from numba import types

from streamkit.engine.cache import cached
from streamkit.engine.forces import FORCES, ROW, add_forces
from streamkit.engine.steps import METHOD, ROWS, A, H, T, compose
from streamkit.engine.velocity_forces import DRAGGED, is_dragged, renew
from streamkit.engine.views import fill

_F1, _F2, _F = types.float64[::1], types.float64[:, ::1], types.float64
_ORBIT = METHOD, _F1, _F1, _F, _F, _F2
_ORBITS = METHOD, _F1, _F2, _F1, types.float64[:, :, ::1]


@cached(types.void(FORCES, *_ORBIT), types.void(DRAGGED, *_ORBIT))
def integrate_orbit(forces, method, q0, v0, t0, step, out):
    """Integrate one orbit and write its states (T, 9) at t0 + k * step (step may be negative).

    The method must begin and end with a kick: the force at the end of a step is then that of the next state.
    """
    lanes, relative, centre = np.zeros(ROWS * ROW), np.zeros(3 * ROW), np.empty(3)
    for k in range(3):
        lanes[k * ROW], lanes[(3 + k) * ROW] = q0[k], v0[k]
    lanes[T], lanes[H] = t0, step
    add_forces(forces, True, 0, 1, lanes[T:], lanes, relative, centre, lanes[A:])
    for node in range(out.shape[0]):
        renew(forces, 1, lanes, relative, centre, lanes[T:], lanes[A:])
        for k in range(3):
            out[node, k], out[node, 3 + k], out[node, 6 + k] = lanes[k * ROW], lanes[(3 + k) * ROW], lanes[A + k * ROW]
        if node == out.shape[0] - 1:
            break  # no force is evaluated beyond the last state
        lanes[T] = t0 + node * step
        compose(forces, method, True, 0, 1, 1, not is_dragged(forces), lanes, relative, centre)


@cached(types.void(FORCES, *_ORBITS), types.void(DRAGGED, *_ORBITS))
def integrate_orbits(forces, method, t0, states, grid, out):
    """Integrate n orbits and write their states (n, T, 9) at those times of a grid (T,) that come after their own t0.

    The grid increases or decreases, and so do t0 (n,), in the same way. states (n, 6) are those at t0; at most BATCH
    orbits. The method must begin and end with a kick.
    """
    lanes, relative, centre = np.zeros(ROWS * ROW), np.zeros(3 * ROW), np.empty(3)
    sign = 1.0 if grid[grid.shape[0] - 1] > grid[0] else -1.0
    m = 0
    for node in range(grid.shape[0]):
        before = m
        while m < t0.shape[0] and sign * (grid[node] - t0[m]) >= 0.0:
            for k in range(6):
                lanes[k * ROW + m] = states[m, k]
            lanes[T + m] = t0[m]
            m += 1
        if m == 0:
            continue
        for i in range(m):
            lanes[H + i] = grid[node] - lanes[T + i]
        known = before == m and not is_dragged(forces)
        compose(forces, method, False, 0, m, 1, known, lanes, relative, centre)
        fill(lanes, T, T + m, grid[node])
        renew(forces, m, lanes, relative, centre, lanes[T:], lanes[A:])
        for i in range(m):
            for k in range(6):
                out[i, node, k] = lanes[k * ROW + i]
            for k in range(3):
                out[i, node, 6 + k] = lanes[A + k * ROW + i]
