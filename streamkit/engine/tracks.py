"""The compiled interpolation of the progenitor's states between the nodes of its track."""

from __future__ import annotations

from numba import types

from streamkit.engine.cache import cached
from streamkit.engine.forces import quintic

_F1, _F2, _I1 = types.float64[::1], types.float64[:, ::1], types.int64[::1]


@cached(types.void(_F1, _F2, _I1, _F1, _F2))
def states_at(nodes, rows, node, t, out):
    """Quintic Hermite position, velocity and acceleration at times t (m,), into out (9, m).

    rows (T, 9) are the states at the times nodes (T,); node (m,) is the one before each time.
    """
    for j in range(t.shape[0]):
        i = node[j]
        h = nodes[i + 1] - nodes[i]
        s = (t[j] - nodes[i]) / h
        for k in range(3):
            q0, v0, a0 = rows[i, k], rows[i, 3 + k] * h, rows[i, 6 + k] * h * h
            q1, v1, a1 = rows[i + 1, k], rows[i + 1, 3 + k] * h, rows[i + 1, 6 + k] * h * h
            c3, c4, c5 = quintic(q0, v0, a0, q1, v1, a1)
            out[k, j] = q0 + s * (v0 + s * (0.5 * a0 + s * (c3 + s * (c4 + s * c5))))
            out[3 + k, j] = (v0 + s * (a0 + s * (3.0 * c3 + s * (4.0 * c4 + s * 5.0 * c5)))) / h
            out[6 + k, j] = (a0 + s * (6.0 * c3 + s * (12.0 * c4 + s * 20.0 * c5))) / (h * h)
