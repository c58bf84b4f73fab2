"""The progenitor as a sphere in equilibrium: its particles drawn from the isotropic distribution function.

The distribution function has a closed form where the potential gives one (`Potential.equilibrium`). Otherwise it
follows from Eddington's formula (Binney & Tremaine 2008, eq. 4.46) on a table of the mass inside radii. With the
relative potential Psi and energy E, let

    I(E) = integral of d rho / d Psi over (E - Psi)^(1/2), from 0 to E.

The distribution function is proportional to dI/dE, so I must not fall. The fraction of particles at a radius that are
slower than V is proportional to the integral of I(Psi - v^2/2) over v from 0 to V, minus V I(Psi - V^2/2).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

from streamkit.components import Potential
from streamkit.errors import OutOfDomain
from streamkit.model.satellite import OUTSIDE, Satellite
from streamkit.stream import Array
from streamkit.units import G

CUT = 20.0  # radius beyond which there are no particles, in units of G M / |Phi(0)|
NODES = 481  # radii of the table
INNERMOST, OUTERMOST = 3e-3, 3e3  # first and last of them, in units of the half-mass radius
SPEEDS = 512  # cells in which the speeds at a radius are tabulated
ROUND = 3e-3  # largest relative difference of the force in two directions in a sphere
ENDS = 3e-3  # largest fraction of a finite mass beyond `OUTSIDE`
FALLS = 1e-3  # largest relative decrease of I between two nodes: the error of its table
NOISE, ROUNDING = 1e-5, 1e-12  # error of a density in units of mass over r^3: by a table of the mass, and by doubles
STENCIL = 0.02  # step in ln r of the derivative of the mass, whose own slope is needed: the result is smooth in r
FIVE_POINTS = (-2, 1 / 12), (-1, -2 / 3), (1, 2 / 3), (2, -1 / 12)
# (3, 3) unit vectors in whose directions the force must be the same.
DIRECTIONS = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.6, 0.64, 0.48]]).T


class Table(NamedTuple):
    """The sphere at increasing radii."""

    # (k,) ln of the radius in kpc, mass inside in Msun, relative potential in (km/s)^2 and density in Msun/kpc^3.
    ln_r: Array
    mass: Array
    depth: Array
    density: Array
    integral: Array  # (k,) I(E) at E = depth, in Msun/kpc^3/(km/s)


@dataclass(frozen=True)
class Equilibrium:
    """A progenitor at the look-back time, see `SatelliteView`."""

    potential: Potential

    def mass_inside(self, r: Array) -> Array:
        """(n,) Mass in Msun inside radii r (n,) in kpc, without a cut."""
        return Satellite(self.potential, 0.0).mass_inside(np.asarray(r, dtype=float))

    @cached_property
    def total(self) -> float:
        """Total mass in Msun. OutOfDomain if it is infinite, or if the potential is no sphere."""
        kind = self.potential.kind
        within, total = self.mass_inside(np.array([0.1 * OUTSIDE, OUTSIDE])).tolist()
        if not (total > 0 and abs(total - within) <= ENDS * total):
            raise OutOfDomain(
                f"the progenitor {kind} has an infinite mass, so no particles can be drawn from it: choose one with a "
                "finite mass, such as nfw_truncated"
            )
        return float(total)

    @cached_property
    def _curve(self) -> tuple[Array, Array, Array]:
        """(k,) ln of radii from deep inside to far outside, the mass inside, and the relative potential."""
        wide = np.geomspace(1e-6, 1e4, 401)
        mass = self.mass_inside(wide)
        if not (np.isfinite(mass).all() and (np.diff(mass) >= -1e-9 * self.total).all()):
            raise OutOfDomain(f"the progenitor {self.potential.kind} has no density: its mass falls with radius")
        half = float(wide[np.searchsorted(mass, 0.5 * self.total)])
        self._must_be_round(half)
        r = half * np.geomspace(INNERMOST, OUTERMOST, NODES)
        ln_r, mass = np.log(r), self.mass_inside(r)
        inside = CubicSpline(ln_r, G * mass / r).antiderivative()(ln_r)
        return ln_r, mass, inside[-1] - inside + G * mass[-1] / r[-1]

    def _must_be_round(self, r: float) -> None:
        from streamkit.components import add_up

        pull = -(add_up("acceleration", [self.potential], r * DIRECTIONS) * DIRECTIONS).sum(axis=0)
        if not np.ptp(pull) <= ROUND * pull.mean():
            raise OutOfDomain(
                f"the progenitor {self.potential.kind} is no sphere, so no particles can be drawn from it: choose one, "
                "such as plummer, hernquist, king or nfw_truncated"
            )

    @cached_property
    def scale(self) -> float:
        """``G M / |Phi(0)|`` in kpc."""
        ln_r, mass, depth = self._curve
        steep = np.log(mass[1] / mass[0]) / (ln_r[1] - ln_r[0])  # inside the first radius the mass is a power of r
        inner = G * mass[0] / np.exp(ln_r[0]) / max(steep - 1, 0.05)
        return float(G * self.total / (depth[0] + inner))

    @property
    def cut(self) -> float:
        """Radius in kpc beyond which there are no particles."""
        return CUT * self.scale

    @cached_property
    def mass(self) -> float:
        """Mass in Msun inside the cut."""
        return float(self.mass_inside(np.array([self.cut]))[0])

    @property
    def half_mass_radius(self) -> float:
        """Radius in kpc that contains half of the mass."""
        ln_r, mass, _ = self._curve
        return float(np.exp(np.interp(0.5 * self.total, mass, ln_r)))

    @cached_property
    def table(self) -> Table:
        """The sphere at radii, with its distribution function; OutOfDomain where that is negative."""
        ln_r, mass, depth = self._curve
        slope = sum(weight * self.mass_inside(np.exp(ln_r + k * STENCIL)) for k, weight in FIVE_POINTS) / STENCIL
        density = slope / (4 * np.pi * np.exp(3 * ln_r))
        mean = mass / np.exp(3 * ln_r)
        if (density < -NOISE * mean).any():
            raise OutOfDomain(f"the progenitor {self.potential.kind} has a negative density")
        density = np.where(density > ROUNDING * mean, density, 0.0)
        integral = eddington(depth, density)
        if (np.diff(integral) > FALLS * np.abs(integral[:-1])).any():
            raise OutOfDomain(
                f"the progenitor {self.potential.kind} has no isotropic equilibrium: its distribution function by "
                "Eddington's formula is negative"
            )
        return Table(ln_r, mass, depth, density, integral)

    def sample(self, points: Array) -> tuple[Array, Array]:
        """Return positions and velocities (3, n) about the centre, from uniform random numbers (6, n)."""
        share = points[0] * (self.mass / self.total)
        made = self.potential.in_engine_units(), type(self.potential)
        if made[1].has_equilibrium():
            r, speed = made[1].equilibrium(share, points[1], *made[0])
        else:
            r, speed = self._drawn(share, points[1])
        return r * directions(points[2], points[3]), speed * directions(points[4], points[5])

    def weigh(self, q: Array, v: Array, density: Callable[[Array], Array]) -> Array:
        """(n,) Number of tracers of a density (k,) at radii (k,) that each particle stands for, see `SatelliteView`."""
        table = self.table
        of_tracers = eddington(table.depth, density(np.exp(table.ln_r)))
        if (np.diff(of_tracers) > FALLS * np.abs(of_tracers[:-1])).any():
            raise OutOfDomain(
                f"the stars have no isotropic equilibrium in the progenitor {self.potential.kind}: their distribution "
                "function by Eddington's formula is negative, as it is for a core in a cusp"
            )
        there = table.integral > 0
        ln_e = np.log(table.depth[there])[::-1]
        functions = [np.gradient(integral[there][::-1], ln_e) for integral in (of_tracers, table.integral)]
        ratio = np.maximum(functions[0], 0.0) / np.maximum(functions[1], 1e-300)
        depth = np.interp(0.5 * np.log((q**2).sum(axis=0)), table.ln_r, table.depth)
        energy = np.maximum(depth - 0.5 * (v**2).sum(axis=0), 1e-300)
        weight = np.interp(np.log(energy), ln_e, ratio)
        return np.asarray(weight / weight.mean())

    def _drawn(self, share: Array, chance: Array) -> tuple[Array, Array]:
        """(n,) Radii inside which ``share`` (n,) of the mass is, and speeds below which ``chance`` (n,) of it is."""
        table = self.table
        ln_r = np.interp(share * self.total, table.mass, table.ln_r)
        quantiles = self._quantiles
        depth = np.interp(ln_r, table.ln_r, table.depth)
        i, s = _cell(np.interp(ln_r, table.ln_r, np.arange(NODES)), NODES - 1)
        k, w = _cell((1 - np.sqrt(np.sqrt(1 - np.cbrt(chance)))) * SPEEDS, SPEEDS)
        below = (1 - w) * quantiles[i, k] + w * quantiles[i, k + 1]
        above = (1 - w) * quantiles[i + 1, k] + w * quantiles[i + 1, k + 1]
        return np.exp(ln_r), ((1 - s) * below + s * above) * np.sqrt(2 * depth)

    @cached_property
    def _quantiles(self) -> Array:
        """(k, SPEEDS + 1) Speeds, in units of the escape speed, below which given fractions of the particles lie.

        The fractions are evenly spaced in 1 - (1 - fraction^(1/3))^(1/4). The fraction of slow particles grows as the
        cube of the speed. Near the escape speed it depends on a high power of the remaining energy.
        """
        table = self.table
        energy, integral = table.depth[::-1], table.integral[::-1]
        bound = integral > 0
        of_energy = PchipInterpolator(np.log(energy[bound]), np.log(integral[bound]))
        lowest = energy[bound][0]
        s = np.linspace(0.0, 1.0, SPEEDS + 1)
        shares = (1 - (1 - s) ** 4) ** 3
        out = np.empty((len(table.depth), SPEEDS + 1))
        speed = np.sqrt(2 * table.depth)
        left = np.maximum(table.depth[:, None] * (1 - s**2), 1e-300)
        here = np.where(left >= lowest, np.exp(of_energy(np.log(np.maximum(left, lowest)))), 0.0)
        step = 0.5 * (here[:, 1:] + here[:, :-1]) * np.diff(s)
        slower = np.concatenate([np.zeros((len(speed), 1)), np.cumsum(step, axis=1)], axis=1) - s * here
        slower = np.maximum.accumulate(np.maximum(slower, 0.0), axis=1)
        for row, rising in zip(out, slower, strict=True):
            if rising[-1] > 0:
                share = rising / rising[-1]
                first = max(int(np.searchsorted(share, 0.0, side="right")) - 1, 0)
                row[:] = np.interp(shares, share[first:], s[first:])
            else:  # no mass there
                row[:] = 0.0
        return out


def eddington(depth: Array, density: Array) -> Array:
    """(k,) I(E) at E = depth (k,), in decreasing order: exact for a density that is linear in depth between nodes."""
    falling = np.concatenate([depth, [0.0]])
    slope = np.diff(np.concatenate([density, [0.0]])) / np.diff(falling)
    away = np.sqrt(np.maximum(depth[:, None] - falling[None, :], 0.0))
    return np.asarray(2.0 * (np.diff(away, axis=1) * slope).sum(axis=1))


def directions(cosine: Array, angle: Array) -> Array:
    """(3, n) isotropic unit vectors from two uniform random numbers (n,)."""
    z = 2.0 * cosine - 1.0
    across = np.sqrt(np.maximum(1.0 - z * z, 0.0))
    turn = 2.0 * np.pi * angle
    return np.stack([across * np.cos(turn), across * np.sin(turn), z])


def _cell(x: Array, count: int) -> tuple[Array, Array]:
    """Indices of the cells of an even grid of ``count`` cells of length 1, and the positions in the cells."""
    i = np.clip(x.astype(int), 0, count - 1)
    return i, x - i
