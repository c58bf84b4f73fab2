"""Accelerations of galpy's potentials in Cartesian coordinates."""

import numpy as np
from galpy import potential as gp


def galpy_acceleration(potential, q, t=0.0):
    """(3, n) of a galpy potential at q (3, n), in units where its G is 1: amplitudes carry ours."""
    out = []
    for x, y, z in q.T:
        where = {"phi": np.arctan2(y, x), "t": t, "use_physical": False}
        r = np.hypot(x, y)
        radial = gp.evaluateRforces(potential, r, z, **where)
        torque = gp.evaluatephitorques(potential, r, z, **where) / r
        up = gp.evaluatezforces(potential, r, z, **where)
        out.append([(radial * x - torque * y) / r, (radial * y + torque * x) / r, up])
    return np.array(out, dtype=float).T
