"""Particles followed back in the host with the progenitor, to find when they were stripped."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from streamkit.engine import PEFRL, Field, split_step
from streamkit.stream import Array, Orbit, angle_in_plane, lag_in_plane, orbital_plane
from streamkit.units import GYR

# Time between two measurements of the particles on their way back, and steps of the integrator in it.
BLOCK, STEPS = 0.01 * GYR, 5
RETURNED = 3.0  # closest approach on the way back, in tidal radii, of a particle that came from the progenitor


def distances(a: Array, b: Array) -> Array:
    """(n,) Distances between positions a (3, n) and one position b (3,)."""
    return np.asarray(np.sqrt(((a.T - b) ** 2).sum(axis=1)))


@dataclass(frozen=True)
class Past:
    """The past of particles, from their orbits followed back: see `streamkit.Stream`."""

    t_strip: Array
    winding: Array
    chi: Array


def rewind(field: Field, orbit: Orbit, q: Array, v: Array) -> Past:
    """Follow particles q, v (3, n) back along the progenitor's track, each until it enters the tidal radius.

    The last entry on the way back is the stripping time. There the angle to the progenitor is small, which says how
    many turns the particle has made since. Where a particle only comes near, its nearest approach is taken.
    """
    n = q.shape[1]
    q, v, now = q.copy(), v.copy(), np.zeros(n)
    plane = orbital_plane(orbit)
    edges = np.linspace(0.0, orbit.t[0], max(int(np.ceil(-orbit.t[0] / BLOCK)), 1) + 1)
    states = orbit.at(edges)
    today = lag_in_plane(plane, q, states.q[:, :1])
    angle, lag, chi = today.copy(), today.copy(), np.zeros(n)
    nearest, t_strip = np.full(n, np.inf), np.zeros(n)
    before = np.stack([angle_in_plane(plane, q), np.repeat(angle_in_plane(plane, states.q[:, :1]), n)])
    going = np.arange(n)
    for i, t1 in enumerate(edges):
        if i:
            some_q, some_v = np.ascontiguousarray(q[:, going]), np.ascontiguousarray(v[:, going])
            split_step(field, PEFRL, some_q, some_v, now[going], float(t1), STEPS)
            q[:, going], v[:, going], now[going] = some_q, some_v, t1
            new = np.stack(
                [angle_in_plane(plane, some_q), np.repeat(angle_in_plane(plane, states.q[:, i : i + 1]), len(going))]
            )
            turned = new - before[:, going]
            turned -= 2 * np.pi * np.round(turned / (2 * np.pi))
            before[:, going] = new
            angle[going] += turned[0] - turned[1]
            chi[going] += (edges[i - 1] - t1) * (np.sqrt((some_q**2).sum(axis=0)) - states.r[i])
        gap = distances(q[:, going], states.q[:, i]) / states.r_tidal[i]
        nearer = gap < nearest[going]
        nearest[going[nearer]], lag[going[nearer]] = gap[nearer], angle[going[nearer]]
        t_strip[going[nearer]] = t1
        going = going[gap > 1.0]
    turns = np.where(nearest < RETURNED, np.round(lag / (2 * np.pi)), 0.0)
    return Past(t_strip, today - 2 * np.pi * turns, chi)
