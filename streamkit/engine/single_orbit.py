"""One orbit in a force that is called through Python, by a method that needs few calls."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from streamkit.stream import Array

EXACT = 1e-9  # tolerance, relative to the position and the velocity: far below the error of a particle


def orbit_states(acceleration: Callable[[Array | float, Array, Array], Array], q: Array, v: Array, t: Array) -> Array:
    """(9, T) Positions, velocities and accelerations at the times t (T,), in either direction, from q, v (3,) at t[0].

    The method is that of Dormand and Prince of order eight, with dense output (Hairer, Norsett & Wanner 1993). It needs
    a third of the calls that steps of fixed length need. States are NaN from the time on at which the force is not
    finite.
    """
    from scipy.integrate import DOP853  # slow to import, and only forces in Python need it

    def slope(now: float, state: Array) -> Array:
        return np.concatenate([state[3:], acceleration(now, state[:3, None], state[3:, None])[:, 0]])

    states = np.full((9, len(t)), np.nan)
    states[:6, 0] = np.concatenate([q, v])
    if np.isfinite(slope(float(t[0]), states[:6, 0])).all():
        scale = EXACT * np.repeat([np.sqrt(q @ q), np.sqrt(v @ v)], 3)
        solver = DOP853(slope, float(t[0]), states[:6, 0], float(t[-1]), rtol=EXACT, atol=scale)
        sign, done = np.sign(t[-1] - t[0]), 1
        while solver.status == "running" and solver.step() is None:
            reached = int(np.searchsorted(sign * t, sign * solver.t, side="right"))
            if reached > done:
                states[:6, done:reached] = solver.dense_output()(t[done:reached])
                done = reached
    states[6:] = acceleration(t, states[:3], states[3:6])
    return states
