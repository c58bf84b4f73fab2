"""Restricted N-body: test particles in the host and in the monopole of the bound particles."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np
from pydantic import Field

import streamkit as sk
from streamkit import engine  # loaded when it is used: it brings numba, and listing plugins need not wait for it

SHELLS = 64  # number of shells in which the bound mass is counted, as `Monopole.of_shells` expects them
CUSP_SLOPE = 0.5  # a steeper inner slope -d ln rho / d ln r than this is a cusp
CUSP_SOFTENING = 0.02  # softening of the force of a cusp, in units of the scale radius
MAX_RADIUS = 30.0  # distance beyond which no particle is bound, in units of the scale radius
LONGEST_STEP = 0.35  # in units of (a^3 / G M)^(1/2)


class RestrictedNbody(sk.LiveStripping):
    """Restricted N-body: the tide strips the debris of a live progenitor. No constant is fitted.

    The particles are drawn from the progenitor's isotropic distribution function at the look-back time. They move as
    test particles in the host and in the monopole of the particles that are still bound, which is updated every 20 to
    40 Myr. Bound mass, tidal radius and stripping times follow. A dwarf that keeps 0.43 of its mass in N-body of 10^5
    particles keeps 0.47 here (tests/benchmarks/README.md). ``mass`` and the radius of the progenitor are those at the
    look-back time; the remaining mass today is a result. The progenitor is any sphere with a density and a finite mass:
    `plummer` and `hernquist` have a distribution function in closed form, others one by Eddington's formula. The
    progenitor follows the orbit of a point of its whole initial mass. Its loss of energy to the debris is not modelled:
    the loss would move the apocentre at the look-back time by 0.7 kpc, and its noise would move the apocentre by 0.7
    kpc with 5000 particles and by 0.3 kpc with 20 000 (tests/benchmarks/README.md).
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
        description="Scale radius of the stars in the progenitor's potential at the look-back time, such as a dwarf's "
        "stars in its dark halo. The weight of a particle is then the ratio of the distribution functions of stars and "
        "mass. Without it the stars are distributed as the mass is.",
    )

    def populate(self, core: sk.Array, satellite: sk.SatelliteView, points: sk.Array) -> sk.Population:
        """Fill the progenitor, and give each particle the weight of its stars."""
        population = super().populate(core, satellite, points)
        if self.stars_radius is None:
            return population
        q, v = population.q - core[:3, None], population.v - core[3:6, None]
        density = partial(star_density, self.stars, self.stars_radius)
        return replace(population, weight=satellite.weigh(q, v, density))

    def longest_step(self, satellite: sk.SatelliteView, orbit: sk.Orbit) -> float:
        """Return 0.35 dynamical times (a^3 / G M)^(1/2)."""
        return float(LONGEST_STEP * np.sqrt(satellite.scale**3 / (sk.G * satellite.mass)))

    def update_remnant(
        self, edge: sk.BlockEdge, satellite: sk.SatelliteView, previous: sk.Remnant | None
    ) -> sk.Remnant:
        """Return the monopole of all particles whose energy in the previous monopole is negative."""
        last = previous.force if previous and isinstance(previous.force, sk.Monopole) else _whole(satellite)
        reach = MAX_RADIUS * last.b
        bound, shells = engine.bound_shells(edge.q, edge.v, edge.mass, edge.core, last.depth, last.b, reach, SHELLS)
        inside = np.cumsum(shells)
        return sk.Remnant(sk.Monopole.of_shells(inside, last.b, last.e), float(inside[-1]), bound)


def star_density(kind: str, scale: float, r: sk.Array) -> sk.Array:
    """(k,) Density of the stars at radii (k,) in kpc for a scale radius in kpc, in arbitrary units."""
    s = r / scale
    return (1 + s**2) ** -2.5 if kind == "plummer" else 1 / (s * (1 + s) ** 3)


def _whole(satellite: sk.SatelliteView) -> sk.Monopole:
    """Return the monopole of the whole progenitor at the look-back time, with a cusp if it has one."""
    b = satellite.scale
    low, high = satellite.mass_inside(b * np.array([0.01, 0.03])).tolist()
    slope = 3 - np.log(high / low) / np.log(3)  # M(<r) grows as r^(3 - slope)
    k = np.arange(1, SHELLS)
    edges = b * np.sqrt(k / k[::-1])  # outer edges of the shells: d^2 / (d^2 + b^2) = k / SHELLS; the last has no edge
    inside = np.append(satellite.mass_inside(np.minimum(edges, satellite.cut)), satellite.mass)
    return sk.Monopole.of_shells(inside, b, CUSP_SOFTENING * b if slope > CUSP_SLOPE else b)
