"""The host: the sum of the potentials. Mass and circular velocity, energy, escape, tidal radius."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cache

import numpy as np

from streamkit.components import Potential
from streamkit.engine import Field
from streamkit.errors import blamed
from streamkit.spec import Setup
from streamkit.stream import Array, Orbit, Stream
from streamkit.units import G


def energy(potentials: Iterable[Potential], q: Array, v: Array) -> Array | None:
    """(n,) Energy in (km/s)^2 at positions q and velocities v (3, n) today; None where a potential has none."""
    total = 0.5 * (v**2).sum(axis=0)
    for potential in potentials:
        if not potential.has_energy():
            return None
        x, y, z = np.ascontiguousarray(q)
        with blamed(f"potential {potential.kind}"):
            total = total + type(potential).potential(x, y, z, np.zeros_like(x), *potential.in_engine_units().tolist())
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


POLAR = 20
"""Gauss-Legendre nodes per hemisphere."""
AZIMUTH = 16
"""Equal angles: exact for every harmonic below this order."""


@cache
def _sphere() -> tuple[Array, Array]:
    """Directions (3, k) over the sphere and weights (k,) of a mean over it.

    cos(theta) = s^3 crowds the nodes at the plane, where a thin disc pulls within a few degrees.
    """
    s, w = np.polynomial.legendre.leggauss(POLAR)
    s, w = 0.5 * (1 + s), 0.5 * w
    mu = np.concatenate([-(s[::-1] ** 3), s**3])
    weight = np.concatenate([(3 * s**2 * w)[::-1], 3 * s**2 * w])
    phi = (np.arange(AZIMUTH) + 0.5) * 2 * np.pi / AZIMUTH
    sine = np.sqrt(1 - mu**2)
    x, y = np.outer(sine, np.cos(phi)), np.outer(sine, np.sin(phi))
    directions = np.stack([x, y, np.outer(mu, np.ones(AZIMUTH))])
    return directions.reshape(3, -1), np.repeat(weight / weight.sum() / AZIMUTH, AZIMUTH)


@cache
def _circle() -> Array:
    """Directions (3, k) around the plane z = 0."""
    phi = (np.arange(AZIMUTH) + 0.5) * 2 * np.pi / AZIMUTH
    return np.stack([np.cos(phi), np.sin(phi), np.zeros(AZIMUTH)])


def inward(potentials: Sequence[Potential], directions: Array, radii: Array) -> Array:
    """(nr, k) Inward radial acceleration in (km/s)^2/kpc today, at radii (nr,) along directions (3, k)."""
    x, y, z = np.ascontiguousarray(directions[:, None, :] * radii[:, None]).reshape(3, -1)
    total = np.zeros((3, len(x)))
    for potential in potentials:
        parameters = potential.in_engine_units().tolist()
        with blamed(f"potential {potential.kind}"):
            total += np.stack(type(potential).acceleration(x, y, z, np.zeros_like(x), *parameters))
    shape = (3, len(radii), directions.shape[1])
    return np.asarray(-np.einsum("crk,ck->rk", total.reshape(shape), directions))


def mass_inside(potentials: Sequence[Potential], radii: Array) -> Array:
    """(nr,) Mass in Msun inside radii (nr,) in kpc: ``r^2 <-a_r> / G``, the mean taken over the sphere."""
    radii = np.asarray(radii, dtype=float)
    directions, weights = _sphere()
    return np.asarray(radii**2 / G * (inward(potentials, directions, radii) @ weights))


def circular_velocity(potentials: Sequence[Potential], radii: Array) -> Array:
    """(nr,) Circular velocity in km/s at radii (nr,) in kpc in the plane: ``sqrt(R <-a_R>)`` over azimuth."""
    radii = np.asarray(radii, dtype=float)
    pull = inward(potentials, _circle(), radii).mean(axis=1)
    return np.asarray(np.sqrt(np.maximum(radii * pull, 0.0)))


def profiles(models: Iterable[Sequence[Potential]], radii: Array) -> tuple[Array, Array]:
    """Return M (n, nr) in Msun and v_c (n, nr) in km/s of n potentials at radii (nr,) in kpc."""
    both = [(mass_inside(p, radii), circular_velocity(p, radii)) for p in models]
    shape = (-1, len(radii))
    return np.reshape([m for m, _ in both], shape), np.reshape([v for _, v in both], shape)


FAR = 1e100
"""A distance in kpc that stands for infinity: far enough for a logarithm to hold any speed."""


def escapes(setup: Setup) -> bool | None:
    """Say whether the progenitor's energy exceeds the host's potential at infinity; None if unknown."""
    host = list(setup.potentials.values())
    if not all(potential.has_energy() for potential in host):
        return None
    far = setup.q * (FAR / np.sqrt(setup.q @ setup.q))
    here = there = 0.0
    for p in host:
        with blamed(f"potential {p.kind}"):
            here += float(p.potential(*setup.q, 0.0, *p.in_engine_units()))
            there += float(p.potential(*far, 0.0, *p.in_engine_units()))
    return bool(0.5 * setup.v @ setup.v + here > there)


def tidal_radius(host: Field, orbit: Orbit, mass: float | Array) -> Array:
    """(n,) Tidal radius along an orbit; NaN where Omega^2 - d^2 Phi / dr^2 is not positive and there is none."""
    bracket = orbit.omega**2 - host.radial_second_derivative(orbit.t, orbit.q)
    return np.cbrt(G * mass / np.where(bracket > 0, bracket, np.nan))
