"""The compiled records of particles that are all at the same time, as those of a live progenitor are.

The loops do the same as `streamkit.engine.records`, for a few particles at a time. They have no branches and share one
array of scratch, so they become vector instructions. Sums and choices are those of `record`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from streamkit.engine.cache import cached
from streamkit.engine.records import ParticleRecords

CHUNK = 256  # particles taken together
# Where in the scratch the projections on the plane, the momentum, the change of revolutions and the distance begin.
E, F, M, D, R = 0, CHUNK, 2 * CHUNK, 3 * CHUNK, 4 * CHUNK

_F1, _F2, _F = types.float64[::1], types.float64[:, ::1], types.float64
_RECORDS = types.NamedTuple([_F1, _F2, _F1, _F1, _F1, _F2, _F2], ParticleRecords)


@cached(types.void(_F, _F, _F2, _F2, _F1, _F, _F2, _RECORDS))
def record_together(t0, t1, q, v, state, r_tidal, plane, records):
    """Update the records of all particles at the end of a block from t0 to t1.

    The arguments are those of `streamkit.engine.records.record`, with two exceptions: the revolutions (n,) are floats,
    and t0 is the time of every particle's previous sample.
    """
    revolutions, planar, chi, gap, t_strip, dq_strip, dv_strip = records
    h = t1 - t0
    r_progenitor = math.sqrt(state[0] ** 2 + state[1] ** 2 + state[2] ** 2)
    px, py, pz = state[0], state[1], state[2]
    a0, a1, a2, b0, b1, b2 = plane[0, 0], plane[0, 1], plane[0, 2], plane[1, 0], plane[1, 1], plane[1, 2]
    scratch = np.empty(5 * CHUNK)
    for begin in range(0, q.shape[1], CHUNK):
        end = min(begin + CHUNK, q.shape[1])
        x, y, z = q[0, begin:end], q[1, begin:end], q[2, begin:end]
        u, w, s = v[0, begin:end], v[1, begin:end], v[2, begin:end]
        e_old, f_old = planar[0, begin:end], planar[1, begin:end]
        for i in range(x.shape[0]):
            scratch[E + i] = a0 * x[i] + a1 * y[i] + a2 * z[i]
            scratch[F + i] = b0 * x[i] + b1 * y[i] + b2 * z[i]
        for i in range(x.shape[0]):
            turned = scratch[E + i] * (b0 * u[i] + b1 * w[i] + b2 * s[i])
            scratch[M + i] = turned - scratch[F + i] * (a0 * u[i] + a1 * w[i] + a2 * s[i])
        for i in range(x.shape[0]):  # as in `record`, with the numbers 0 and 1 in place of truth values
            e, f, e0, f0 = scratch[E + i], scratch[F + i], e_old[i], f_old[i]
            cross, along = e0 * f - e * f0, e0 * e + f0 * f
            turn = scratch[M + i] if along < 0.0 else cross
            forward = 1.0 if turn > 0.0 else 0.0
            was, now = 1.0 if f0 < 0.0 else 0.0, 1.0 if f < 0.0 else 0.0
            upward = 1.0 if cross > 0.0 else 0.0
            grows = was if was != now else upward
            moved = 0.0 if cross == 0.0 else 1.0
            scratch[D + i] = forward * (1.0 - grows) - grows * (1.0 - forward) * moved
        turns = revolutions[begin:end]
        for i in range(x.shape[0]):
            turns[i] += scratch[D + i]
        for i in range(x.shape[0]):
            e_old[i] = scratch[E + i]
        for i in range(x.shape[0]):
            f_old[i] = scratch[F + i]
        phase = chi[begin:end]
        for i in range(x.shape[0]):
            phase[i] += h * (math.sqrt(x[i] * x[i] + y[i] * y[i] + z[i] * z[i]) - r_progenitor)
        for i in range(x.shape[0]):
            dx, dy, dz = x[i] - px, y[i] - py, z[i] - pz
            scratch[R + i] = math.sqrt(dx * dx + dy * dy + dz * dz) - r_tidal
        before, left = gap[begin:end], t_strip[begin:end]
        for i in range(x.shape[0]):
            if before[i] <= 0.0 < scratch[R + i]:  # rare: the particle left in this block, see `record`
                new, old = scratch[R + i], before[i]
                fraction = old / (old - new)
                left[i] = t0 + h * fraction
                for k in range(3):
                    a, b = dq_strip[k, begin + i], q[k, begin + i] - state[k]
                    da, db = h * dv_strip[k, begin + i], h * (v[k, begin + i] - state[3 + k])
                    c, d = 3.0 * (b - a) - 2.0 * da - db, 2.0 * (a - b) + da + db
                    dq_strip[k, begin + i] = a + fraction * (da + fraction * (c + fraction * d))
                    dv_strip[k, begin + i] = (da + fraction * (2.0 * c + 3.0 * fraction * d)) / h
        for i in range(x.shape[0]):
            before[i] = scratch[R + i]
        for i in range(x.shape[0]):
            left[i] = t1 if scratch[R + i] <= 0.0 else left[i]
        for k in range(3):
            of_q, of_v = q[k, begin:end], v[k, begin:end]
            place, speed, q0, v0 = dq_strip[k, begin:end], dv_strip[k, begin:end], state[k], state[3 + k]
            for i in range(x.shape[0]):
                place[i] = of_q[i] - q0 if scratch[R + i] <= 0.0 else place[i]
            for i in range(x.shape[0]):
                speed[i] = of_v[i] - v0 if scratch[R + i] <= 0.0 else speed[i]
