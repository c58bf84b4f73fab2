"""Dynamical friction in the host: its density and velocity dispersion, as if it were a sphere."""

from __future__ import annotations

import numpy as np

from streamkit.engine import Drag, Field
from streamkit.stream import Array
from streamkit.units import G

RADII = np.geomspace(0.1, 3000.0, 64)
"""Where the host is measured, kpc."""


def friction_table(field: Field, directions: Array, weights: Array) -> Drag:
    """Return the host as a body feels it that is slowed down: from its mean pull today over directions (3, k).

    The density is that of the mean mass inside a radius; the dispersion follows from it by Jeans's equation for
    isotropic velocities (Binney & Tremaine 2008, eq. 4.216).
    """
    from scipy.interpolate import CubicSpline  # slow to import

    ln_r = np.log(RADII)
    places = np.ascontiguousarray(directions[:, None, :] * RADII[:, None])
    a = field.acceleration(0.0, places.reshape(3, -1)).reshape(places.shape)
    with np.errstate(all="ignore"):  # where the host has no mass there is no friction, whatever the dispersion
        mass = np.maximum(-np.einsum("crk,ck,k->r", a, directions, weights) * RADII**2 / G, 1e-30)
        column = np.maximum(CubicSpline(ln_r, mass)(ln_r, 1) / (4 * np.pi * RADII), 0.0)  # density times r^2
        push = column * G * mass / RADII**3
        falls = -(np.log(push[-1]) - np.log(push[-2])) / (ln_r[-1] - ln_r[-2])
        beyond = push[-1] / falls if falls > 0 else 0.0
        inside = CubicSpline(ln_r, push).antiderivative()(ln_r)
        dispersion2 = (inside[-1] - inside + beyond) / column * RADII**2
    dispersion2 = np.where(np.isfinite(dispersion2) & (dispersion2 > 0), dispersion2, G * mass / RADII)
    step = ln_r[1] - ln_r[0]
    powers = step ** np.arange(4)
    pieces = [CubicSpline(ln_r, y).c[::-1].T * powers for y in (column, dispersion2)]
    return Drag(np.ascontiguousarray(np.hstack(pieces)), float(ln_r[0]), float(step))
