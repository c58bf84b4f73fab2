"""The compiled records of each particle during an integration. They need neither forces nor an integrator."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import types

from streamkit.engine.cache import cached
from streamkit.engine.views import row_view, view
from streamkit.stream import Array, IntArray


class ParticleRecords(NamedTuple):
    """The records of n particles at the end of the last block. The compiled functions update the arrays in place.

    Attributes
    ----------
    revolutions
        (n,) crossings of the negative first axis of the orbital plane, so that the swept angle needs no unwrapping.
    planar
        (2, n) projection of the position on the orbital plane.
    chi
        (n,) phase: the integral of the radius minus the progenitor's radius over time.
    gap
        (n,) distance to the progenitor minus the tidal radius.
    t_strip
        (n,) last time inside the tidal radius.
    dq_strip, dv_strip
        (3, n) position and velocity about the progenitor at that time.
    """

    revolutions: IntArray | Array
    planar: Array
    chi: Array
    gap: Array
    t_strip: Array
    dq_strip: Array
    dv_strip: Array


_F1, _F2 = types.float64[::1], types.float64[:, ::1]
_I1, _F, _N = types.int64[::1], types.float64, types.intp
_RECORDS = types.NamedTuple([_I1, _F2, _F1, _F1, _F1, _F2, _F2], ParticleRecords)

CHUNK = 512  # particles whose distances are computed together


@cached(types.void(_N, _N, _F1, _F, _F2, _F2, _F1, _F, _F2, _RECORDS), nogil=True)
def record(first, last, t0, t1, q, v, state, r_tidal, plane, records):
    """Update the records of the particles from ``first`` on, before ``last``, at the end of a block.

    t0 (n,) is the time of each particle's previous sample, and is set to t1. state (9,) is the progenitor at t1,
    r_tidal its tidal radius there. plane (2, 3) spans the orbital plane. A particle that turned by less than 90 degrees
    took the short way. Any other particle took the way of its angular momentum. Where a particle has left the tidal
    radius in this block, time, position and velocity are interpolated to the crossing.
    """
    n, dq_strip, dv_strip = last - first, records.dq_strip, records.dv_strip
    revolutions, chi = view(records.revolutions, first, last), view(records.chi, first, last)
    gap, t_strip, before = view(records.gap, first, last), view(records.t_strip, first, last), view(t0, first, last)
    r_progenitor = math.sqrt(state[0] ** 2 + state[1] ** 2 + state[2] ** 2)
    a0, a1, a2, b0, b1, b2 = plane[0, 0], plane[0, 1], plane[0, 2], plane[1, 0], plane[1, 1], plane[1, 2]
    x, y, z = row_view(q, 0, first, last), row_view(q, 1, first, last), row_view(q, 2, first, last)
    u, w, s = row_view(v, 0, first, last), row_view(v, 1, first, last), row_view(v, 2, first, last)
    planar0, planar1 = row_view(records.planar, 0, first, last), row_view(records.planar, 1, first, last)
    for i in range(n):
        e, f = a0 * x[i] + a1 * y[i] + a2 * z[i], b0 * x[i] + b1 * y[i] + b2 * z[i]
        e0, f0 = planar0[i], planar1[i]
        cross, along = e0 * f - e * f0, e0 * e + f0 * f
        momentum = e * (b0 * u[i] + b1 * w[i] + b2 * s[i]) - f * (a0 * u[i] + a1 * w[i] + a2 * s[i])
        forward = (momentum if along < 0.0 else cross) > 0.0
        changes = (f0 < 0.0) != (f < 0.0)
        grows = (f0 < 0.0) if changes else cross > 0.0  # the angle from -pi to pi at the end above that before
        revolutions[i] += (1 if forward and not grows else 0) - (1 if grows and not forward and cross != 0.0 else 0)
        planar0[i], planar1[i] = e, f
    for i in range(n):
        chi[i] += (t1 - before[i]) * (math.sqrt(x[i] * x[i] + y[i] * y[i] + z[i] * z[i]) - r_progenitor)
    px, py, pz, now = state[0], state[1], state[2], np.empty(CHUNK)
    for begin in range(0, n, CHUNK):
        end = min(begin + CHUNK, n)
        xs, ys, zs = view(x, begin, end), view(y, begin, end), view(z, begin, end)
        for i in range(end - begin):  # a loop without branches becomes vector instructions
            dx, dy, dz = xs[i] - px, ys[i] - py, zs[i] - pz
            now[i] = math.sqrt(dx * dx + dy * dy + dz * dz) - r_tidal
        for i in range(begin, end):
            new, old = now[i - begin], gap[i]
            gap[i] = new
            if new <= 0.0:
                t_strip[i] = t1
                for k in range(3):
                    dq_strip[k, first + i] = q[k, first + i] - state[k]
                    dv_strip[k, first + i] = v[k, first + i] - state[3 + k]
            elif old <= 0.0:
                # left in this block; a linear interpolation of the gap makes the time smooth in the parameters
                t_strip[i] = before[i] + (t1 - before[i]) * (old / (old - new))
                j, h, f = first + i, t1 - before[i], old / (old - new)
                for k in range(3):  # place and velocity then, by the Hermite cubic of both samples
                    a, b = dq_strip[k, j], q[k, j] - state[k]
                    da, db = h * dv_strip[k, j], h * (v[k, j] - state[3 + k])
                    c, d = 3.0 * (b - a) - 2.0 * da - db, 2.0 * (a - b) + da + db
                    dq_strip[k, j] = a + f * (da + f * (c + f * d))
                    dv_strip[k, j] = (da + f * (2.0 * c + 3.0 * f * d)) / h
            before[i] = t1
