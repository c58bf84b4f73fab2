"""Compiled code for the particles that are bound to a sphere, and for their mass in its shells.

The order of the sums is fixed.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from streamkit.engine.cache import cached
from streamkit.stream import Array, BoolArray
from streamkit.units import G

CHUNK = 256  # particles whose energies are computed together
# Where in the scratch y = b^2 / (d^2 + b^2), the energy, the polynomial of the potential and the bound mass begin.
Y, ENERGY, DEPTH, MASS = 0, CHUNK, 2 * CHUNK, 3 * CHUNK

_F1, _F2, _F = types.float64[::1], types.float64[:, ::1], types.float64


@cached(types.void(_F2, _F2, _F1, _F1, _F1, _F, _F, types.boolean[::1], _F1))
def _bound_shells(q, v, mass, core, depth, scale, reach, bound, shells):
    """Fill bound (n,) and shells (k,); see `bound_shells`.

    Loops without branches over one array of scratch become vector instructions. The sums into shells have the order of
    the particles.
    """
    x0, y0, z0, u0, w0, s0 = core[0], core[1], core[2], core[3], core[4], core[5]
    scratch, shell = np.empty(4 * CHUNK), np.empty(CHUNK, dtype=np.int64)
    b2, last, count = scale * scale, depth.shape[0] - 1, shells.shape[0]
    nearest, unit, outermost = b2 / (b2 + reach * reach), G / scale, count - 1.0
    shells[:] = 0.0
    for begin in range(0, mass.shape[0], CHUNK):
        end = min(begin + CHUNK, mass.shape[0])
        x, y, z = q[0, begin:end], q[1, begin:end], q[2, begin:end]
        u, w, s = v[0, begin:end], v[1, begin:end], v[2, begin:end]
        here, holds = mass[begin:end], bound[begin:end]
        for i in range(x.shape[0]):
            dx, dy, dz = x[i] - x0, y[i] - y0, z[i] - z0
            scratch[Y + i] = b2 * (1.0 / (dx * dx + dy * dy + dz * dz + b2))
        for i in range(x.shape[0]):
            du, dw, ds = u[i] - u0, w[i] - w0, s[i] - s0
            scratch[ENERGY + i] = 0.5 * (du * du + dw * dw + ds * ds)
        scratch[DEPTH : DEPTH + CHUNK] = depth[last]
        for k in range(last - 1, -1, -1):  # the coefficients outside
            c = depth[k]
            for i in range(x.shape[0]):
                scratch[DEPTH + i] = scratch[DEPTH + i] * scratch[Y + i] + c
        for i in range(x.shape[0]):
            scratch[ENERGY + i] -= unit * scratch[DEPTH + i] * math.sqrt(scratch[Y + i])
        for i in range(x.shape[0]):
            inside = here[i] if scratch[Y + i] > nearest else 0.0
            scratch[MASS + i] = inside if scratch[ENERGY + i] < 0.0 else 0.0
        for i in range(x.shape[0]):
            shell[i] = int(min((1.0 - scratch[Y + i]) * count, outermost))
        for i in range(x.shape[0]):
            holds[i] = scratch[ENERGY + i] < 0.0 and scratch[Y + i] > nearest
        for i in range(x.shape[0]):
            shells[shell[i]] += scratch[MASS + i]


def bound_shells(
    q: Array, v: Array, mass: Array, core: Array, depth: Array, scale: float, reach: float, count: int
) -> tuple[BoolArray, Array]:
    """Return which particles are bound to a sphere (n,), and the mass of these in each shell (count,).

    Parameters
    ----------
    q, v
        (3, n) positions and velocities, in rows without gaps.
    mass
        (n,) of each particle in Msun.
    core
        (9,) position, velocity and acceleration of the centre.
    depth
        (k,) the potential of the sphere at distance d: ``-G (d^2 + b^2)^(-1/2) sum_j depth_j y^j`` with
        ``y = b^2 / (d^2 + b^2)``.
    scale
        b in kpc.
    reach
        Distance in kpc beyond which no particle is bound.
    count
        Number of shells, of equal size in ``1 - y``, from the centre to infinity.
    """
    bound, shells = np.empty(len(mass), dtype=bool), np.empty(count)
    _bound_shells(q, v, mass, core, depth, scale, reach, bound, shells)
    return bound, shells
