"""Who is bound to a sphere, and how the mass of the bound lies in it: compiled, in a fixed order of particles."""

from __future__ import annotations

import numpy as np
from numba import types

from streamkit.engine.cache import cached
from streamkit.stream import Array, BoolArray
from streamkit.units import G

CHUNK = 512  # particles whose energies are computed together

_F1, _F2, _F = types.float64[::1], types.float64[:, ::1], types.float64


@cached(types.void(_F2, _F2, _F1, _F1, _F1, _F, _F, types.boolean[::1], _F1))
def _bound_shells(q, v, mass, core, depth, scale, reach, bound, shells):
    """Fill bound (n,) and shells (k,); see `bound_shells`."""
    x, y, z, u, w, s = q[0], q[1], q[2], v[0], v[1], v[2]
    x0, y0, z0, u0, w0, s0 = core[0], core[1], core[2], core[3], core[4], core[5]
    near, energy, deep = np.empty(CHUNK), np.empty(CHUNK), np.empty(CHUNK)
    b2, last, count = scale * scale, depth.shape[0] - 1, shells.shape[0]
    nearest = b2 / (b2 + reach * reach)
    shells[:] = 0.0
    for begin in range(0, mass.shape[0], CHUNK):
        m = min(CHUNK, mass.shape[0] - begin)
        xs, ys, zs = x[begin : begin + m], y[begin : begin + m], z[begin : begin + m]
        us, ws, ss = u[begin : begin + m], w[begin : begin + m], s[begin : begin + m]
        for i in range(m):  # without branches: vectors
            dx, dy, dz = xs[i] - x0, ys[i] - y0, zs[i] - z0
            du, dw, ds = us[i] - u0, ws[i] - w0, ss[i] - s0
            a = 1.0 / (dx * dx + dy * dy + dz * dz + b2)
            near[i] = b2 * a
            energy[i] = 0.5 * (du * du + dw * dw + ds * ds)
        deep[:m] = depth[last]
        for k in range(last - 1, -1, -1):  # the coefficients outside: vectors again
            for i in range(m):
                deep[i] = deep[i] * near[i] + depth[k]
        for i in range(m):
            energy[i] -= G / scale * deep[i] * np.sqrt(near[i])
        for i in range(m):
            holds = energy[i] < 0.0 and near[i] > nearest
            bound[begin + i] = holds
            if holds:
                k = min(int((1.0 - near[i]) * count), count - 1)
                shells[k] += mass[begin + i]


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
        No particle farther away than this is bound, kpc.
    count
        Number of shells: equal ones in ``1 - y``, from the centre to infinity.
    """
    bound, shells = np.empty(len(mass), dtype=bool), np.empty(count)
    _bound_shells(q, v, mass, core, depth, scale, reach, bound, shells)
    return bound, shells
