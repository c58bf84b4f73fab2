"""The compiled bookkeeping of the march; independent of every force and integrator."""

from __future__ import annotations

import math

from numba import types

from streamkit.engine.cache import cached

_F1, _F2, _S2 = types.float64[::1], types.float64[:, ::1], types.float64[:, :]
_I1, _F = types.int64[::1], types.float64


@cached(types.void(_F1, _F, _S2, _S2, _F1, _F, _F2, _I1, _S2, _F1, _F1, _F1, _S2, _S2))
def record(t0, t1, q, v, state, r_tidal, plane, revolutions, planar, chi, gap, t_strip, dq_strip, dv_strip):
    """Update the particles' records at the end of a block: revolutions, phase chi, last time inside r_t.

    t0 (n,) is the time of each particle's previous sample, state (9,) the progenitor at t1, r_tidal its tidal
    radius there. plane (2, 3) spans the orbital plane; planar (2, n) holds the previous projection on it.
    revolutions (n,) counts crossings of the negative first axis, so that the angle swept needs no unwrapping.
    gap (n,) is the previous distance to the progenitor minus the tidal radius.
    """
    r_progenitor = math.sqrt(state[0] ** 2 + state[1] ** 2 + state[2] ** 2)
    for i in range(q.shape[1]):
        x, y, z = q[0, i], q[1, i], q[2, i]
        e = plane[0, 0] * x + plane[0, 1] * y + plane[0, 2] * z
        f = plane[1, 0] * x + plane[1, 1] * y + plane[1, 2] * z
        e0, f0 = planar[0, i], planar[1, i]
        if f0 >= 0.0 and f < 0.0 and e0 * f - e * f0 > 0.0:
            revolutions[i] += 1  # the chord crosses the axis at a negative first coordinate
        elif f0 < 0.0 and f >= 0.0 and e0 * f - e * f0 < 0.0:
            revolutions[i] -= 1
        planar[0, i], planar[1, i] = e, f
        chi[i] += (t1 - t0[i]) * (math.sqrt(x * x + y * y + z * z) - r_progenitor)
        dx, dy, dz = x - state[0], y - state[1], z - state[2]
        new = math.sqrt(dx * dx + dy * dy + dz * dz) - r_tidal
        old = gap[i]
        if new <= 0.0:
            t_strip[i] = t1
        elif old <= 0.0:
            # left during this block: the crossing by linear interpolation of the gap, smooth in the parameters
            t_strip[i] = t0[i] + (t1 - t0[i]) * (old / (old - new))
            dq_strip[0, i], dq_strip[1, i], dq_strip[2, i] = dx, dy, dz
            for k in range(3):
                dv_strip[k, i] = v[k, i] - state[3 + k]
        gap[i] = new
