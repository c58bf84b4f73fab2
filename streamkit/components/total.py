"""The sum of potentials through NumPy: its force, masses, circular velocities, flattening."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import ArrayLike

from streamkit import engine
from streamkit.components.places import in_kpc, takes_positions, takes_radii
from streamkit.errors import blamed
from streamkit.stream import Array, from_axes, read_only
from streamkit.units import G, Unit

DISTANT = 1e5, 1e6  # radii in kpc beyond every galaxy: the outer part of a finite mass falls there at least as 1/r
ENDS = 3e-3  # largest relative growth of a finite mass between these radii
AZIMUTH = 16  # equal angles: exact for every harmonic below this order
STEP, SHELL = 1e-4, 1e-2  # steps in units of the radius: for the density at a position, and for the density of a shell
FAR_AWAY = np.array([1e50]), np.array([1e100])  # kpc: a potential that differs between these radii has no limit
POLAR = 20  # Gauss-Legendre nodes per hemisphere


class Part(Protocol):
    """The parts of a potential that this module uses."""

    kind: ClassVar[str]
    is_spherical: ClassVar[bool]  # about its centre

    @classmethod
    def parameters(cls) -> dict[str, Unit]:
        """Return the fields that are physical numbers, with their units."""

    def in_engine_units(self) -> tuple[Any, ...]:
        """Return the arguments of its `acceleration` after t."""

    def rotation(self) -> tuple[float, ...] | None:
        """Return the rotation matrix of its axes, row by row (9,); None if they are those of the Galaxy."""

    def motion(self) -> engine.Motion:
        """Return how its centre moves and its axes turn in time."""

    @property
    def drifts(self) -> bool:
        """Whether its centre moves."""

    @classmethod
    def has_energy(cls) -> bool:
        """Return whether it gives a potential."""


@dataclass(frozen=True)
class Total:
    """The sum of potentials today, called through NumPy: a host without the bodies that move about it.

    Positions are (3, n), or (3,) for one; radii are (nr,), or one. They are in kpc, or have an astropy unit of length.
    Raises ValueError otherwise.
    """

    potentials: tuple[Part, ...]

    @takes_positions
    def acceleration(self, q: Array) -> Array:
        """(3, n) Acceleration in (km/s)^2/kpc at positions q (3, n) in kpc."""
        return add_up("acceleration", self.potentials, q)

    @takes_positions
    def potential(self, q: Array) -> Array | None:
        """(n,) Potential in (km/s)^2 at positions q (3, n) in kpc; None where a component gives none."""
        return add_up("potential", self.potentials, q) if all(p.has_energy() for p in self.potentials) else None

    @property
    def drifts(self) -> bool:
        """Whether the centre of a part moves. Nothing is then known to be bound."""
        return any(p.drifts for p in self.potentials)

    @takes_radii
    def mass_inside(self, radii: Array) -> Array:
        """(nr,) Mass in Msun inside radii (nr,) in kpc: ``r^2 <-a_r> / G``, a mean."""
        directions, weights = sphere(POLAR, AZIMUTH)
        pull = np.broadcast_to(self._inward(directions, radii), (len(radii), len(weights)))
        return np.asarray(radii**2 / G * (pull @ weights))

    @takes_radii
    def circular_velocity(self, radii: Array) -> Array:
        """(nr,) Circular velocity in km/s at radii (nr,) in kpc in the plane: ``sqrt(R <-a_R>)``."""
        pull = self._inward(circle(), radii).mean(axis=1)
        return np.asarray(np.sqrt(np.maximum(radii * pull, 0.0)))

    def flattening(self, radii: ArrayLike, z: ArrayLike) -> Array:
        """(n,) Flattening of the potential at cylindrical radii and heights (n,) in kpc.

        ``sqrt(z <a_R> / (R <a_z>))``, means around the axis (Bovy+ 2016, ApJ 833, 31): the axis ratio of a potential of
        R^2 + z^2 / q^2. NaN where a force points outwards.
        """
        radii, z = np.broadcast_arrays(in_kpc(radii, "radii"), in_kpc(z, "heights"))
        around = circle()
        places = around[:, None, :] * radii.reshape(-1, 1) + np.array([[[0.0]], [[0.0]], [[1.0]]]) * z.reshape(-1, 1)
        force = self.acceleration(np.ascontiguousarray(places.reshape(3, -1))).reshape(places.shape)
        outwards, upwards = np.einsum("crk,ck->rk", force, around).mean(axis=1), force[2].mean(axis=1)
        with np.errstate(all="ignore"):
            ratio = z.reshape(-1) * outwards / (radii.reshape(-1) * upwards)
            return np.asarray(np.sqrt(ratio)).reshape(radii.shape)

    @takes_positions
    def density(self, q: Array) -> Array:
        """(n,) Mass density in Msun/kpc^3 at positions q (3, n) in kpc: minus the divergence of the force, over 4 pi G.

        By central differences over 1e-4 of the radius: a disc must be thicker than a thousandth of it.
        """
        step = STEP * np.maximum(np.sqrt((q**2).sum(axis=0)), 1e-3)
        divergence = np.zeros(q.shape[1])
        for axis in np.eye(3):
            ahead, behind = (self.acceleration(q + sign * axis[:, None] * step) for sign in (1.0, -1.0))
            divergence += axis @ (ahead - behind) / (2 * step)
        return np.asarray(-divergence / (4 * np.pi * G))

    def mean_density(self, radii: Array) -> Array:
        """(nr,) Mean density in Msun/kpc^3 on spheres of radii (nr,) in kpc: ``dM / dr / (4 pi r^2)``."""
        radii = np.asarray(radii, dtype=float)
        ahead, behind = (self.mass_inside(radii * np.exp(sign * SHELL)) for sign in (1.0, -1.0))
        return np.asarray((ahead - behind) / (2 * SHELL * 4 * np.pi * radii**3))

    @takes_radii
    def escape_speed(self, radii: Array) -> Array | None:
        """(nr,) Escape speed in km/s to infinity at radii (nr,) in kpc in the plane; None without a potential.

        ``sqrt(2 (Phi(infinity) - Phi))`` with the mean potential around the axis. It is infinite where the potential
        has no limit, as in a logarithmic halo. None too where the centre of a part moves.
        """
        if self.drifts:
            return None
        around = circle()
        with np.errstate(all="ignore"):
            depths = []
            for r in (radii, *FAR_AWAY):
                depth = self.potential((around[:, None, :] * r[:, None]).reshape(3, -1))
                if depth is None:
                    return None
                depths.append(depth.reshape(-1, around.shape[1]).mean(axis=1))
            here, far, farther = depths
            limit = np.abs(farther - far) < 1e-6 * np.abs(farther - here)
            return np.asarray(np.where(limit, np.sqrt(2 * np.maximum(farther - here, 0.0)), np.inf))

    def _inward(self, directions: Array, radii: Array) -> Array:
        """(nr, k) Inward radial acceleration at radii (nr,) along directions (3, k).

        Where all potentials are spherical, about the origin, one direction is as good as all, and is the only one.
        """
        if all(each.is_spherical and not each.motion().moves[1] for each in self.potentials):
            directions = directions[:, :1]
        places = np.ascontiguousarray(directions[:, None, :] * radii[:, None])
        total = self.acceleration(places.reshape(3, -1)).reshape(places.shape)
        return np.asarray(-np.einsum("crk,ck->rk", total, directions))


def add_up(what: str, potentials: Iterable[Part], q: Array) -> Array:
    """Add up a static method of potentials at positions q (3, n) in kpc today, called with whole arrays.

    It is "acceleration", (3, n) in (km/s)^2/kpc, or "potential", (n,) in (km/s)^2; the potentials are centred on the
    origin. Raises ComponentError if one of them fails.
    """
    t = read_only(np.zeros(q.shape[1:]))
    total: Array = np.zeros(q.shape if what == "acceleration" else q.shape[1:])
    for potential in potentials:
        with blamed(f"potential {potential.kind}"):
            total = total + along_axes(what, potential, q, t)
    return total


def along_axes(what: str, potential: Part, q: Array, t: Array) -> Array:
    """Return "acceleration" (3, n) or "potential" (n,) of a potential at positions q (3, n) and times t (n,)."""
    parameters = potential.in_engine_units()
    place, rotation = potential.motion().seen(q, t, potential.rotation())
    values = getattr(type(potential), what)(*read_only(place), t, *parameters)
    if rotation is not None and what == "acceleration":
        values = from_axes(rotation, *values)
    return np.stack(values)


def circular_speed(potentials: Iterable[Part], radius: float) -> float:
    """Return ``sqrt(R <-a_R>)`` in km/s at a radius in kpc in the plane z = 0, the mean over the azimuth.

    Zero where the mean force is outward; NaN where there is no force.
    """
    around = circle()
    with np.errstate(all="ignore"):
        outward = (add_up("acceleration", potentials, radius * around) * around).sum(axis=0).mean()
    return float(np.sqrt(np.maximum(-radius * outward, 0.0)))


def total_mass(potential: Part) -> float:
    """Return the total mass of one potential in Msun: its field ``mass``, else from its force at great distances.

    NaN where the mass is infinite. A field ``mass`` may be a scale mass, as that of an NFW halo.
    """
    unit = potential.parameters().get("mass")
    if unit is not None and unit.name == "Msun":
        return float(getattr(potential, "mass"))  # noqa: B009  a field of this class, not of all
    axes = np.concatenate([np.eye(3), -np.eye(3)], axis=1)
    with np.errstate(all="ignore"):
        inner, outer = (-(r**2) / G * (add_up("acceleration", [potential], r * axes) * axes).sum() / 6 for r in DISTANT)
        share = DISTANT[0] / (DISTANT[1] - DISTANT[0])  # mass outside the outer radius over the mass between the two
        finite = outer > 0 and abs(outer - inner) <= ENDS * outer
    return float(outer + share * (outer - inner)) if finite else float("nan")


@cache
def circle() -> Array:
    """Directions (3, k) around the plane z = 0."""
    phi = (np.arange(AZIMUTH) + 0.5) * 2 * np.pi / AZIMUTH
    return np.stack([np.cos(phi), np.sin(phi), np.zeros(AZIMUTH)])


@cache
def sphere(polar: int, azimuth: int) -> tuple[Array, Array]:
    """Directions (3, k) over the sphere and weights (k,) of a mean over it.

    cos(theta) = s^3 crowds the nodes at the plane, where a thin disc pulls within a few degrees.
    """
    s, w = np.polynomial.legendre.leggauss(polar)
    s, w = 0.5 * (1 + s), 0.5 * w
    mu = np.concatenate([-(s[::-1] ** 3), s**3])
    weight = np.concatenate([(3 * s**2 * w)[::-1], 3 * s**2 * w])
    phi = (np.arange(azimuth) + 0.5) * 2 * np.pi / azimuth
    sine = np.sqrt(1 - mu**2)
    x, y = np.outer(sine, np.cos(phi)), np.outer(sine, np.sin(phi))
    directions = np.stack([x, y, np.outer(mu, np.ones(azimuth))])
    return directions.reshape(3, -1), np.repeat(weight / weight.sum() / azimuth, azimuth)
