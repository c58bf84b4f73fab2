"""A small stream for the checks of observables: plain NumPy bookkeeping, no stripping scheme, no model."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from streamkit import GYR, LEADING, TRAILING, Array, Stream
from streamkit.testing.hosts import MASS, Isochrone, progenitor_orbit
from streamkit.testing.reference import acceleration

LOOKBACK = -3.0
BLOCK = 0.02  # Gyr

# The arrays of a stream with one entry per particle.
PARTICLES = (
    "q", "v", "t_release", "t_strip", "dq_galactocentric", "dv_galactocentric", "tail", "winding", "chi", "bound",
    "weight",
)  # fmt: skip


@cache
def example_stream(count: int = 4000, seed: int = 3) -> Stream:
    """Release particles at the Lagrange points over 3 Gyr and follow them in the host alone.

    The progenitor is just past a pericentre, with an apocentre well behind and one well ahead of it.
    """
    past = progenitor_orbit(LOOKBACK)
    here = past.at(past.pericentres()[-1:] + 0.03 * GYR)
    today = here.q[:, 0], here.v[:, 0]
    orbit, future = progenitor_orbit(LOOKBACK, today=today), progenitor_orbit(0.0, 2.0, today=today)
    e_r, e_phi, _ = orbit.frame

    def angle(x: Array) -> Array:
        """Angle in the orbital plane, which the spherical host keeps."""
        return np.asarray(np.arctan2(e_phi[:, 0] @ x, e_r[:, 0] @ x))

    blocks = round(-LOOKBACK / BLOCK)
    edges = np.linspace(LOOKBACK * GYR, 0.0, blocks + 1)
    track = orbit.at(edges)
    born = np.arange(count) * blocks // count  # the block at whose start each particle is released
    tail = np.where(np.arange(count) % 2, TRAILING, LEADING).astype(np.int64)
    release = orbit.at(edges[born])
    q = release.q + tail * release.r_tidal * release.frame[0]
    v = release.v + 10.0 * np.random.default_rng(seed).standard_normal((3, count))
    winding, chi, inside = np.zeros(count), np.zeros(count), edges[born]
    for k in range(blocks):
        out = np.flatnonzero(born <= k)
        x, u = q[:, out].copy(), v[:, out].copy()
        before = angle(x) - angle(track.q[:, k])
        _leapfrog(x, u, edges[k + 1] - edges[k])
        after = angle(x) - angle(track.q[:, k + 1])
        winding[out] += (after - before + np.pi) % (2 * np.pi) - np.pi
        chi[out] += (edges[k + 1] - edges[k]) * (np.sqrt((x**2).sum(axis=0)) - track.r[k + 1])
        within = np.sqrt(((x - track.q[:, k + 1 : k + 2]) ** 2).sum(axis=0)) < track.r_tidal[k + 1]
        inside[out[within]] = edges[k + 1]
        q[:, out], v[:, out] = x, u
    zero = np.zeros((3, count))
    return Stream(
        q=q, v=v, t_release=edges[born], t_strip=inside, dq_galactocentric=zero, dv_galactocentric=zero.copy(),
        tail=tail, winding=winding, chi=chi, bound=inside == edges[-1], weight=np.ones(count), orbit=orbit,
        ahead=lambda: future, mass=MASS,
    )  # fmt: skip


def _leapfrog(q: Array, v: Array, span: float, steps: int = 10) -> None:
    """Drift, kick, drift in the host, in place."""
    h = span / steps
    for _ in range(steps):
        q += 0.5 * h * v
        v += h * acceleration([Isochrone()], 0.0, q)
        q += 0.5 * h * v


def select(stream: Stream, some: Any) -> Stream:
    """Return the stream of the particles ``some`` (indices or a mask), in that order."""
    chosen: dict[str, Any] = {name: getattr(stream, name)[..., some].copy() for name in PARTICLES}
    return replace(stream, **chosen)
