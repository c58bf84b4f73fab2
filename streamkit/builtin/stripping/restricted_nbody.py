"""Restricted N-body: test particles in the host and in the monopole of those that are still bound."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np
from pydantic import Field

import streamkit as sk
from streamkit import engine  # loaded when it is used: it brings numba, and listing plugins need not wait for it

SHELLS = 64  # in which the bound mass is counted, as `Monopole` takes them
CUSPY = 0.5  # inner slope -d ln rho / d ln r from which on the force is that of a cusp
SOFTENING = 0.02  # of the force of a cusp, in units of the scale radius
REACH = 30.0  # distance beyond which nothing is bound, in units of the scale radius
DYNAMICAL = 0.35  # longest step in units of (a^3 / G M)^(1/2)


class RestrictedNbody(sk.LiveStripping):
    """Restricted N-body: debris leaves a live progenitor where and when the tide takes it. No constant is fitted.

    Particles drawn from the progenitor's isotropic distribution function at the look-back time move as test particles
    in the host and in the monopole of those that are still bound, renewed every 20 to 40 Myr. Bound mass, tidal radius
    and stripping times follow. ``mass`` and the radius of the progenitor are those at the look-back time; the mass that
    is left today is a result. Any sphere with a density and a finite mass will do: in closed form `plummer` and
    `hernquist`, others by Eddington's formula. The progenitor follows the orbit of a point of its whole mass: it loses
    no energy to its debris. That is not offered: it moves the apocentre at the look-back time by 0.7 kpc, and its noise
    by as much with 5000 particles, by 0.3 kpc with 20 000 (tests/benchmarks/README.md).
    """

    kind = "restricted_nbody"
    reference = (
        "Vasiliev 2019, MNRAS 482, 1525 (AGAMA, whose example is called so); Eddington 1916, MNRAS 76, 572 (the "
        "distribution function)"
    )

    stars: Literal["plummer", "hernquist"] = Field(
        default="plummer", description="Density of the stars, where stars_radius is given."
    )
    stars_radius: sk.Length | None = Field(
        default=None,
        description="Scale radius of stars in the progenitor's potential at the look-back time, as a dwarf's in its "
        "dark halo: each particle then counts by the ratio of the distribution functions of stars and mass. Without it "
        "the stars are distributed as the mass is.",
    )

    def populate(self, core: sk.Array, satellite: sk.SatelliteView, points: sk.Array) -> sk.Population:
        """Fill the progenitor, and weigh the particles by their share of stars."""
        people = super().populate(core, satellite, points)
        if self.stars_radius is None:
            return people
        q, v = people.q - core[:3, None], people.v - core[3:6, None]
        density = partial(star_density, self.stars, self.stars_radius)
        return replace(people, weight=satellite.weigh(q, v, density))

    def longest_step(self, satellite: sk.SatelliteView, orbit: sk.Orbit) -> float:
        """Return 0.35 dynamical times (a^3 / G M)^(1/2)."""
        return float(DYNAMICAL * np.sqrt(satellite.scale**3 / (sk.G * satellite.mass)))

    def renew(self, edge: sk.BlockEdge, satellite: sk.SatelliteView, before: sk.Remnant | None) -> sk.Remnant:
        """Return the monopole of all particles that are bound in the one before, judged anew by their energy."""
        last = before.force if before and isinstance(before.force, sk.Monopole) else _whole(satellite)
        reach = REACH * last.b
        bound, shells = engine.bound_shells(edge.q, edge.v, edge.mass, edge.core, last.depth, last.b, reach, SHELLS)
        inside = np.cumsum(shells)
        return sk.Remnant(sk.Monopole.of_shells(inside, last.b, last.e), float(inside[-1]), bound)


def star_density(kind: str, scale: float, r: sk.Array) -> sk.Array:
    """(k,) Density of the stars at radii (k,) in kpc for a scale radius in kpc, in units of its own."""
    s = r / scale
    return (1 + s**2) ** -2.5 if kind == "plummer" else 1 / (s * (1 + s) ** 3)


def _whole(satellite: sk.SatelliteView) -> sk.Monopole:
    """Return the monopole of the progenitor at the look-back time, with a cusp if it has one."""
    b = satellite.scale
    low, high = satellite.mass_inside(b * np.array([0.01, 0.03])).tolist()
    slope = 3 - np.log(high / low) / np.log(3)
    d = b * np.sqrt(np.arange(1, SHELLS) / np.arange(SHELLS - 1, 0, -1))
    inside = np.append(satellite.mass_inside(np.minimum(d, satellite.cut)), satellite.mass)
    return sk.Monopole.of_shells(inside, b, SOFTENING * b if slope > CUSPY else b)
