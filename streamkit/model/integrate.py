"""Integrate particles from their release to today, block by block, and keep their records in one place.

An integrator only advances particles over a block; release, winding, phase chi and stripping time are kept here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from streamkit.components import Integrator
from streamkit.engine import Field, record
from streamkit.errors import blamed
from streamkit.model.release import Start
from streamkit.stream import Array, BoolArray, angle_in_plane, orbital_plane
from streamkit.units import GYR

# Largest turn of the progenitor in a block, radians: a particle of the same angular momentum at half its pericentre
# turns less than four times as much, three quarters of a revolution, and its revolutions are counted right.
TURN = 1.2


@dataclass(frozen=True)
class Records:
    """The results of n particles; `streamkit.Stream` describes each."""

    q: Array
    v: Array
    t_strip: Array
    dq_strip: Array
    dv_strip: Array
    winding: Array
    chi: Array
    bound: BoolArray


def integrate(field: Field, integrator: Integrator, start: Start) -> Records:
    """Advance particles from their release, at increasing times, to the end of the progenitor's track."""
    orbit, released = start.orbit, start.at_release
    t_release = released.t
    n = len(t_release)
    q, v, now = start.q.copy(), start.v.copy(), t_release.copy()
    begin, end = float(orbit.t[0]), float(orbit.t[-1])
    block = min(integrator.longest_block * GYR, TURN / float(orbit.omega.max()))
    edges = np.linspace(begin, end, max(int(np.ceil((end - begin) / block)), 1) + 1)
    at_edges = orbit.at(edges)
    states = np.ascontiguousarray(np.concatenate([at_edges.q, at_edges.v, at_edges.a]).T)
    plane = orbital_plane(orbit)
    swept = np.unwrap(angle_in_plane(plane, orbit.q))

    planar = np.ascontiguousarray(plane @ q)
    angle = angle_in_plane(plane, q)
    progenitor_angle = np.interp(t_release, orbit.t, swept)
    lag = angle - progenitor_angle
    offset = lag - 2 * np.pi * np.round(lag / (2 * np.pi)) - angle + progenitor_angle
    revolutions = np.zeros(n, dtype=np.int64)
    chi, gap = np.zeros(n), np.sqrt(((q - released.q) ** 2).sum(axis=0)) - released.r_tidal
    gap = np.minimum(gap, 0.0)  # released at the tidal radius: inside until shown to be outside
    t_strip = t_release.copy()
    dq_strip, dv_strip = q - released.q, v - released.v

    active = np.searchsorted(t_release, edges[1:], side="left")
    for t1, state, r_tidal, m in zip(edges[1:], states[1:], at_edges.r_tidal[1:], active, strict=True):
        with blamed(f"integrator {integrator.kind}"):
            integrator.advance(field, q[:, :m], v[:, :m], now[:m], t1)
        record(m, now, t1, q, v, state, r_tidal, plane, revolutions, planar, chi, gap, t_strip, dq_strip, dv_strip)

    winding = offset + np.arctan2(planar[1], planar[0]) + 2 * np.pi * revolutions - swept[-1]
    return Records(q, v, t_strip, dq_strip, dv_strip, winding, chi, gap <= 0)
