"""The host: the sum of its potentials. Mass and circular velocity, energy, escape, tidal field."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from streamkit.components import Potential
from streamkit.engine import Field, build_field
from streamkit.errors import blamed
from streamkit.stream import Array, Orbit, read_only
from streamkit.units import G

POLAR = 20
"""Gauss-Legendre nodes per hemisphere."""
AZIMUTH = 16
"""Equal angles: exact for every harmonic below this order."""
FAR = 1e100
"""A distance in kpc that stands for infinity: far enough for a logarithm to hold any speed."""


@dataclass(frozen=True)
class Host:
    """The galaxy in which everything moves, today at t = 0.

    Attributes
    ----------
    potentials
        Name -> component, as in the run file; they add up, centred on the origin.
    """

    potentials: Mapping[str, Potential]

    @cached_property
    def field(self) -> Field:
        """The compiled total force."""
        return build_field(list(self.potentials.values()))

    def acceleration(self, q: Array) -> Array:
        """(3, n) Acceleration in (km/s)^2/kpc at positions q (3, n) today, through NumPy: no compiler is needed."""
        return self._sum("acceleration", q)

    def potential(self, q: Array) -> Array | None:
        """(n,) Potential in (km/s)^2 at positions q (3, n) today; None where a component gives none."""
        return self._sum("potential", q) if all(p.has_energy() for p in self.potentials.values()) else None

    def _sum(self, what: str, q: Array) -> Array:
        """Add up a static method of all components, called with whole arrays."""
        x, y, z = read_only(np.ascontiguousarray(q))
        t = read_only(np.zeros_like(x))
        total: Array = np.zeros(())
        for potential in self.potentials.values():
            with blamed(f"potential {potential.kind}"):
                parameters = potential.in_engine_units().tolist()
                total = total + np.stack(getattr(type(potential), what)(x, y, z, t, *parameters))
        return total

    def energy(self, q: Array, v: Array) -> Array | None:
        """(n,) Energy in (km/s)^2 at positions q and velocities v (3, n) today; None where a potential has none."""
        depth = self.potential(q)
        return None if depth is None else 0.5 * (v**2).sum(axis=0) + depth

    def unbinds(self, q: Array, v: Array) -> bool | None:
        """Say whether the energy at q, v (3,) exceeds the potential at infinity; None if that is unknown."""
        here = self.energy(q[:, None], v[:, None])
        there = self.potential((q * (FAR / np.sqrt(q @ q)))[:, None])
        return None if here is None or there is None else bool(here[0] > there[0])

    def mass_inside(self, radii: Array) -> Array:
        """(nr,) Mass in Msun inside radii (nr,) in kpc: ``r^2 <-a_r> / G``, the mean taken over the sphere."""
        radii = np.asarray(radii, dtype=float)
        directions, weights = _sphere()
        return np.asarray(radii**2 / G * (self._inward(directions, radii) @ weights))

    def circular_velocity(self, radii: Array) -> Array:
        """(nr,) Circular velocity in km/s at radii (nr,) in kpc in the plane: ``sqrt(R <-a_R>)`` over azimuth."""
        radii = np.asarray(radii, dtype=float)
        pull = self._inward(_circle(), radii).mean(axis=1)
        return np.asarray(np.sqrt(np.maximum(radii * pull, 0.0)))

    def _inward(self, directions: Array, radii: Array) -> Array:
        """(nr, k) Inward radial acceleration at radii (nr,) along directions (3, k)."""
        places = np.ascontiguousarray(directions[:, None, :] * radii[:, None])
        total = self.acceleration(places.reshape(3, -1)).reshape(places.shape)
        return np.asarray(-np.einsum("crk,ck->rk", total, directions))

    def tidal_bracket(self, orbit: Orbit) -> Array:
        """(n,) ``Omega^2 - d^2 Phi / dr^2`` along an orbit; NaN where it is not positive, and no tidal radius exists.

        Omega = |L| / r^2 is instantaneous (Gibbons+ 2014, eq. 1).
        """
        bracket = orbit.omega**2 - self.field.radial_second_derivative(orbit.t, orbit.q)
        return np.where(bracket > 0, bracket, np.nan)


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
