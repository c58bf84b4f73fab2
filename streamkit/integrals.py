"""Energy and angular momentum of a stream's particles, in the host alone."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from streamkit.components import Potential
from streamkit.errors import blamed
from streamkit.phase import Array, Stream


def energy(potentials: Iterable[Potential], q: Array, v: Array) -> Array | None:
    """(n,) Energy in (km/s)^2 at positions q and velocities v (3, n) today; None where a potential has none."""
    total = 0.5 * (v**2).sum(axis=0)
    for potential in potentials:
        if not potential.has_energy():
            return None
        x, y, z = np.ascontiguousarray(q)
        with blamed(f"potential {potential.kind}"):
            total = total + type(potential).potential(x, y, z, np.zeros_like(x), *potential.internal().tolist())
    return np.asarray(total)


def angular_momentum(q: Array, v: Array) -> Array:
    """(n,) Total angular momentum in kpc km/s."""
    return np.asarray(np.sqrt((np.cross(q.T, v.T) ** 2).sum(axis=1)))


def offsets(stream: Stream, potentials: Iterable[Potential]) -> tuple[Array | None, Array]:
    """Return E (n,) and L (n,) of the particles minus those of the progenitor: the axes of the bow-tie."""
    core = stream.orbit.q[:, -1:], stream.orbit.v[:, -1:]
    potentials = list(potentials)
    own = energy(potentials, stream.q, stream.v)
    of_core = energy(potentials, *core)
    dE = None if own is None or of_core is None else own - of_core[0]
    return dE, angular_momentum(stream.q, stream.v) - angular_momentum(*core)[0]
