"""Integrators with a fixed step: leapfrog and PEFRL."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from pydantic import Field

import streamkit as sk
from streamkit import engine  # loaded when it is used: it brings numba, and listing plugins need not wait for it


def _fixed(
    method: engine.Splitting, step: float, field: engine.Field, q: sk.Array, v: sk.Array, t0: sk.Array, t1: float
) -> None:
    """Take equal steps of at most ``step`` Gyr. Particles released inside the block take fewer."""
    counts = np.maximum(np.ceil((t1 - t0) / (step * sk.GYR) - 1e-9), 1).astype(int)
    edges = [0, *(np.flatnonzero(np.diff(counts)) + 1), len(t0)]
    for begin, end in pairwise(edges):
        if end > begin:
            part = slice(begin, end)
            engine.split_step(field, method, q[:, part], v[:, part], t0[part], t1, int(counts[begin]))


class Leapfrog(sk.Integrator):
    """Drift-kick-drift leapfrog with a fixed step: symplectic, second order."""

    kind = "leapfrog"
    order = 2
    drag = True

    step: sk.Duration = Field(default=0.001, description="Longest step.")

    def advance(self, field: engine.Field, q: sk.Array, v: sk.Array, t0: sk.Array, t1: float) -> None:
        """Advance in place."""
        _fixed(engine.LEAPFROG, self.step, field, q, v, t0, t1)


class ForestRuth(sk.Integrator):
    """Position-extended Forest-Ruth-like method (PEFRL) with a fixed step: symplectic, fourth order."""

    kind = "pefrl"
    reference = "Omelyan, Mryglod & Folk 2002, Comput. Phys. Commun. 146, 188"
    order = 4
    drag = True

    step: sk.Duration = Field(default=0.004, description="Longest step.")

    def advance(self, field: engine.Field, q: sk.Array, v: sk.Array, t0: sk.Array, t1: float) -> None:
        """Advance in place."""
        _fixed(engine.PEFRL, self.step, field, q, v, t0, t1)
