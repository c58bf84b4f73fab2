"""The progenitor's orbital plane today, and angles in it."""

from __future__ import annotations

import numpy as np

from streamkit.stream.arrays import Array
from streamkit.stream.orbit import Orbit


def orbital_plane(orbit: Orbit) -> Array:
    """(2, 3) Basis of the progenitor's orbital plane today: towards it, and 90 degrees ahead along its motion."""
    x, v = orbit.q[:, -1], orbit.v[:, -1]
    first = x / np.sqrt(x @ x)
    second = v - (v @ first) * first
    return np.array([first, second / np.sqrt(second @ second)])


def angle_in_plane(plane: Array, q: Array) -> Array:
    """(n,) Angle of positions (3, n) from the first axis of the plane (2, 3), radians."""
    first, second = plane @ q
    return np.asarray(np.arctan2(second, first))


def lag_in_plane(plane: Array, q: Array, core: Array) -> Array:
    """(n,) Angle ahead of the core (3, 1), within half a turn."""
    angle = angle_in_plane(plane, q) - angle_in_plane(plane, core)
    return np.asarray(angle - 2 * np.pi * np.round(angle / (2 * np.pi)))
