"""The progenitor's own mass, and the tidal radius that it has in a host."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from streamkit.components import Potential
from streamkit.model.host import Host
from streamkit.stream import Array
from streamkit.units import G

OUTSIDE = 1e6  # a radius in kpc that contains every satellite of finite mass
TOTAL = 1e-3  # a field ``mass`` is the total mass if at most this fraction of it is missing at `OUTSIDE`
# (3, 6) Directions over which the pull of a satellite is averaged.
AXES = np.concatenate([np.eye(3), -np.eye(3)], axis=1)
SETTLED, STEPS = 1e-12, 200  # relative change at which the tidal radius has converged, and largest number of steps


@dataclass(frozen=True)
class Satellite:
    """The progenitor as a mass.

    If ``mass`` is the total mass (Plummer, Hernquist), the tidal radius is that of a point mass, as in Gibbons+ 2014.
    If it is a scale mass (NFW), the tidal radius is that of the mass inside it.
    """

    potential: Potential
    mass: float

    def mass_inside(self, r: Array) -> Array:
        """(n,) Mass in Msun inside radii r (n,) in kpc: ``r^2 <-a_r> / G``, the mean taken over the six half axes."""
        places = (AXES[:, :, None] * r).reshape(3, -1)
        pull = -Host({"progenitor": self.potential}).acceleration(places).reshape(3, 6, -1)
        return np.asarray(r**2 / G * np.einsum("ck,ckr->r", AXES, pull) / 6)

    @cached_property
    def is_finite(self) -> bool:
        """Whether ``mass`` is the total mass."""
        return bool(abs(self.mass_inside(np.array([OUTSIDE]))[0] - self.mass) <= TOTAL * self.mass)

    def tidal_radius(self, bracket: Array) -> Array:
        """(n,) ``[G M / bracket]^(1/3)`` in kpc for `Host.tidal_bracket` (n,); NaN where that is NaN.

        M is the total mass, or the mass inside the tidal radius itself.
        """
        point = np.asarray(np.cbrt(G * self.mass / bracket))
        return point if self.is_finite else self._settled(point, bracket)

    def shrunk(self, r_tidal: Array, left: Array) -> Array:
        """(n,) Tidal radii (n,) in the same tidal field once the fractions ``left`` (n,) remain, at every radius."""
        smaller = np.asarray(r_tidal * np.cbrt(left))
        return smaller if self.is_finite else self._settled(smaller, G * self.mass_inside(r_tidal) / r_tidal**3 / left)

    def _settled(self, r: Array, bracket: Array) -> Array:
        """Iterate r = [G M(<r) / bracket]^(1/3): it contracts, as the mean density falls outwards."""
        for _ in range(STEPS):
            before, r = r, np.cbrt(G * self.mass_inside(r) / bracket)
            if not (np.abs(r - before) > SETTLED * r).any():
                break
        return np.asarray(r)
