"""The blocks of time of an integration: they are shorter about the encounter of a stream with a body."""

from __future__ import annotations

import numpy as np

from streamkit.stream import Array

# Longest block near an encounter, in units of the time since or until it, or of its duration. Integrators with a fixed
# step take a step to a block.
NEAR = 0.5


def with_edges(edges: Array, time: float, duration: float, block: float) -> Array:
    """Return edges of blocks with more of them about an encounter: the nearer, the shorter the blocks."""
    since = [0.0]
    while since[-1] < block:
        since.append(since[-1] + NEAR * float(np.hypot(since[-1], duration)))
    away = np.array(since)
    more = np.concatenate([time - away, time + away])
    more = more[(more > edges[0]) & (more < edges[-1])]
    near = (edges > time - away[-1]) & (edges < time + away[-1])
    return np.unique(np.concatenate([edges[:1], edges[~near], edges[-1:], more]))
