"""Which particles are bound to the satellite, and where it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from streamkit import Array, BoolArray
from streamkit_nbody.gravity import Gravity

FEWEST = 20  # a satellite with fewer bound particles counts as destroyed
CORE = 0.5  # fraction of the bound particles, the most bound ones, whose mean is the satellite's position
FRAMES = 3  # iterations of the core for the same potential


@dataclass(frozen=True)
class Remnant:
    """The remnant of the satellite: which particles are bound (n,), and position and velocity (3,) of its core."""

    bound: BoolArray
    q: Array
    v: Array


def remnant(gravity: Gravity, q: Array, v: Array, candidates: BoolArray) -> Remnant | None:
    """Return the self-bound part of the candidates (n,) among particles at q, v (3, n); None if there is none.

    Iterative unbinding: of the present set, the particles whose kinetic energy in the frame of its core exceeds
    minus their potential in the set alone are taken out, until none is left to take out. The core is the most bound
    half. (As the substructure finders do: Tormen, Diaferio & Syer 1998, MNRAS 299, 728; Springel+ 2001, MNRAS 328,
    726. The host's tide is left out, as there.)
    """
    members = np.flatnonzero(candidates)
    core = members
    while len(members) >= FEWEST:
        potential = gravity.potential(np.ascontiguousarray(q[:, members]))
        for _ in range(FRAMES):  # its own mean motion is a core's only where few are leaving
            place, motion = q[:, core].mean(axis=1), v[:, core].mean(axis=1)
            energy = potential + 0.5 * ((v[:, members] - motion[:, None]) ** 2).sum(axis=0)
            inside = energy < 0.0
            core = members[np.argsort(energy, kind="stable")[: max(int(CORE * inside.sum()), FEWEST)]]
        if inside.all():
            bound = np.zeros(q.shape[1], dtype=bool)
            bound[members] = True
            return Remnant(bound, place, motion)
        members = members[inside]
        core = core[np.isin(core, members)] if inside.any() else members
    return None
