"""Dynamical friction in the host, approximated as a sphere: density and velocity dispersion at each time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import CubicSpline

from streamkit.engine import Field, Friction
from streamkit.stream import Array
from streamkit.units import GYR, G

RADII = np.geomspace(0.1, 3000.0, 64)  # where the host is measured, kpc
# Longest interval between two measurements of a host that changes. Between them it is interpolated linearly, as growth.
APART = 0.25 * GYR
# Fractions of the time span at which the host is compared with the host today, to find out whether it changes.
LOOKS = np.array([0.137, 0.41, 0.73, 1.0])


def friction_times(field: Field, changes: Sequence[Array], t1: float) -> Array:
    """(T,) Increasing times from today to t1 at which the host is measured; one time if it does not change.

    ``changes`` are the times of the knots of what changes in it.
    """
    q = np.array([[3.0, -1.0, 9.0, 40.0], [1.0, -7.0, 14.0, -60.0], [0.5, 2.0, -5.0, 20.0]])
    now = np.tile(field.acceleration(0.0, q), len(LOOKS))
    then = field.acceleration(np.repeat(LOOKS, 4) * t1, np.tile(q, len(LOOKS)))
    if not changes and np.allclose(then, now, rtol=1e-9, atol=0, equal_nan=True):
        return np.zeros(1)
    even = np.linspace(t1, 0.0, int(np.ceil(abs(t1) / APART)) + 1)
    knots = np.concatenate([even, *changes])
    return np.unique(knots[(knots >= min(t1, 0.0)) & (knots <= max(t1, 0.0))])


def friction_table(field: Field, directions: Array, weights: Array, times: Array) -> Friction:
    """Return the table for friction on bodies, from the host's mean pull over directions (3, k) at times (T,).

    The density is that of the mean mass inside a radius; the dispersion follows from it by Jeans's equation for
    isotropic velocities (Binney & Tremaine 2008, eq. 4.216), as if the host were in equilibrium at each time.
    """
    ln_r = np.log(RADII)
    places = np.ascontiguousarray(directions[:, None, :] * RADII[:, None])
    count = places[0].size
    a = np.stack(
        [field.acceleration(np.full(count, t), places.reshape(3, -1)).reshape(places.shape) for t in times], axis=1
    )
    with np.errstate(all="ignore"):  # where the host has no mass there is no friction, whatever the dispersion
        mass = np.maximum(-np.einsum("ctrk,ck,k->tr", a, directions, weights) * RADII**2 / G, 1e-30)
        column = np.maximum(CubicSpline(ln_r, mass, axis=1)(ln_r, 1) / (4 * np.pi * RADII), 0.0)  # density times r^2
        push = column * G * mass / RADII**3
        last = push[:, -1:]
        falls = -(np.log(last) - np.log(push[:, -2:-1])) / (ln_r[-1] - ln_r[-2])
        beyond = np.where(falls > 0, last / falls, 0.0)
        inside = CubicSpline(ln_r, push, axis=1).antiderivative()(ln_r)
        dispersion2 = (inside[:, -1:] - inside + beyond) / column * RADII**2
    dispersion2 = np.where(np.isfinite(dispersion2) & (dispersion2 > 0), dispersion2, G * mass / RADII)
    step = ln_r[1] - ln_r[0]
    powers = step ** np.arange(4)
    cubics = [CubicSpline(ln_r, y, axis=1).c[::-1] for y in (column, dispersion2)]  # (4, pieces, T)
    pieces = [c.transpose(2, 1, 0) * powers for c in cubics]
    return Friction(np.ascontiguousarray(np.concatenate(pieces, axis=2)), float(ln_r[0]), float(step), times)
