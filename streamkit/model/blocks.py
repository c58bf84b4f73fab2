"""The blocks of time of an integration, and shorter ones about the encounter of a stream with a body."""

from __future__ import annotations

import numpy as np

from streamkit.components import Integrator
from streamkit.stream import Array, Orbit
from streamkit.units import GYR

# Largest turn of the progenitor in a block, radians. A particle of the same angular momentum at half the pericentre
# turns less than four times as much: less than three quarters of a revolution, so that its revolutions are counted
# right.
TURN = 1.2

# Longest block near an encounter, in units of the time since or until it, or of its duration. Integrators with a fixed
# step take a step to a block.
NEAR = 0.5


def block_edges(orbit: Orbit, integrator: Integrator) -> Array:
    """Return the edges of equal blocks over a progenitor's orbit."""
    begin, end = float(orbit.t[0]), float(orbit.t[-1])
    block = min(integrator.longest_block * GYR, TURN / float(orbit.omega.max()))
    edges: Array = np.linspace(begin, end, max(int(np.ceil((end - begin) / block)), 1) + 1)
    return edges


def with_edges(edges: Array, time: float, duration: float) -> Array:
    """Return edges of blocks with more of them about an encounter: the nearer, the shorter the blocks."""
    block = float(np.diff(edges).max())
    since = [0.0]
    while since[-1] < block:
        since.append(since[-1] + NEAR * float(np.hypot(since[-1], duration)))
    away = np.array(since)
    more = np.concatenate([time - away, time + away])
    more = more[(more > edges[0]) & (more < edges[-1])]
    near = (edges > time - away[-1]) & (edges < time + away[-1])
    return np.unique(np.concatenate([edges[:1], edges[~near], edges[-1:], more]))
