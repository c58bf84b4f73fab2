"""The host: the sum of its potentials, and the galaxies beside it. Mass and circular velocity, energy, tidal field."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from streamkit.components import FrameForce, Potential, Total, add_up, sphere, takes_positions
from streamkit.engine import NO_FRICTION, Centre, Field, Friction, build_field, follow_bodies, with_disc
from streamkit.errors import OutOfDomain
from streamkit.model.friction import friction_table, friction_times
from streamkit.runfile import Body, Source, as_spec
from streamkit.stream import Array, Orbit
from streamkit.units import GYR, G

# Spacing of the tracks of the progenitor and of bodies: their interpolation error stays far below a particle's.
NODE = 0.002 * GYR

# Largest angle in radians between two nodes of such a track: revolutions are counted from the nodes.
SHARPEST = 1.5

COARSE = 8, 4  # nodes of a mean over the sphere for friction: the sphere is far outside any disc
INFINITY = 1e100  # kpc, in place of infinity: even a logarithmic potential exceeds any energy there


class Paths(NamedTuple):
    """The orbits of all moving objects."""

    centre: Orbit  # the host's, in the inertial frame in which it rests today
    bodies: dict[str, Orbit]  # the orbits of the bodies about the host, by name
    progenitor: Orbit | None  # the orbit of the progenitor about the host, if it is a body with friction or reflex


@dataclass(frozen=True)
class Host:
    """The galaxy in which everything moves, today at t = 0, and those beside it.

    The origin is the host's centre. The acceleration of a particle is the sum of the accelerations by the host and by
    the bodies, minus the acceleration of the centre: host(x) + sum_k body_k(x - x_k(t)) - a_host(t). Methods of no
    more than positions or radii take one or many, (3, n) and (nr,), in kpc or with a unit; else they raise ValueError.

    Attributes
    ----------
    potentials
        Name -> component, as in the run file; they add up, centred on the origin.
    bodies
        The galaxies that move about the host, by name.
    progenitor
        The progenitor, if it has friction or reflex; its pull on particles is not part of the host.
    numbers
        What data on the host read of the run file, by path: see `HostView.numbers`.
    """

    potentials: Mapping[str, Potential]
    bodies: Mapping[str, Body] = field(default_factory=dict)
    progenitor: Body | None = None
    numbers: Mapping[str, float] = field(default_factory=dict)
    _fields: dict[float, Field] = field(default_factory=dict, init=False, repr=False, compare=False)
    _paths: dict[float, Paths] = field(default_factory=dict, init=False, repr=False, compare=False)

    @classmethod
    def at(cls, source: Source, parameters: Array | Mapping[str, float] | None = None) -> Host:
        """Return the host of a run file at parameters (d,), or a mapping of some; the rest at the prior's centre.

        Raises SpecError for a run file or parameters that are not valid.
        """
        inputs = as_spec(source).bind_all(parameters)
        return cls(inputs.potentials, inputs.bodies)

    @property
    def total(self) -> Total:
        """The sum of its own potentials today, through NumPy, without the force of a frame that moves along."""
        return Total(tuple(p for p in self.potentials.values() if not isinstance(p, FrameForce)))

    @cached_property
    def alone(self) -> Field:
        """The compiled total force of its own potentials."""
        return with_disc(build_field(list(self.potentials.values())))

    def until(self, t1: float) -> Field:
        """Return the compiled total force, with that of the bodies, valid from today to t1 (either direction).

        OutOfDomain if a body cannot be followed so far.
        """
        if not self.bodies and not (self.progenitor and self.progenitor.reflex):
            return self.alone
        if t1 not in self._fields:
            total, paths = self.alone, self.paths(t1 or -NODE)
            for body, orbit in zip(self.bodies.values(), paths.bodies.values(), strict=True):
                total = total.with_moving(build_field([body.potential]), orbit)
            self._fields[t1] = total.seen_from(paths.centre)
        return self._fields[t1]

    def _at(self, times: Array) -> Field:
        """Return a field that is valid from today to a time; a field that was made before is used again."""
        farthest = float(times[np.argmax(np.abs(times))])
        reach = [t1 for t1 in self._fields if t1 * farthest >= farthest**2]
        return self.until(reach[0] if reach else farthest)

    def paths(self, t1: float) -> Paths:
        """Return the orbits of all that move, from today to t1; OutOfDomain if one cannot be followed so far."""
        if t1 not in self._paths:
            self._paths[t1] = self._followed(t1)
        return self._paths[t1]

    def _followed(self, t1: float) -> Paths:
        moving = [*self.bodies.values(), *([self.progenitor] if self.progenitor else [])]
        names = [*(f"body {name}" for name in self.bodies), *(["progenitor"] if self.progenitor else [])]
        centres = [
            Centre(b.potential, b.q, b.v, b.reflex, b.mass if b.friction else 0.0, b.extent) for b in moving
        ]  # fmt: skip
        friction = self._friction(t1) if any(body.friction for body in moving) else NO_FRICTION
        with np.errstate(all="ignore"):  # orbits that are not finite are refused below
            centre, orbits = follow_bodies(list(self.potentials.values()), centres, friction, t1, NODE)
            for name, orbit in zip(names, orbits, strict=True):
                if not (np.isfinite(orbit.q).all() and np.isfinite(orbit.v).all()):
                    raise OutOfDomain(f"the orbit of the {name} is not finite")
                if not (np.sqrt((orbit.v**2).sum(axis=0)) / orbit.r).max() * NODE <= SHARPEST:
                    raise OutOfDomain(f"the {name} passes too near the Galactic centre to be followed")
        last = orbits.pop() if self.progenitor else None
        return Paths(centre, dict(zip(self.bodies, orbits, strict=True)), last)

    def _friction(self, t1: float) -> Friction:
        """Return the table of dynamical friction from today to t1."""
        parts = [p for p in self.potentials.values() if not isinstance(p, FrameForce)]  # which has no mass
        changes = [pieces[1:, 0] for p in parts for _, pieces in p.changes()]
        times = friction_times(self.alone, changes, t1)
        if len(times) > 1:
            return friction_table(self.alone, *sphere(*COARSE), times)
        return self._friction_of_today

    @cached_property
    def _friction_of_today(self) -> Friction:
        return friction_table(self.alone, *sphere(*COARSE), np.zeros(1))

    def acceleration(self, q: ArrayLike) -> Array:
        """(3, n) Acceleration in (km/s)^2/kpc by the host without bodies at positions q (3, n) today, through NumPy."""
        return self.total.acceleration(q)

    @takes_positions
    def potential(self, q: Array) -> Array | None:
        """(n,) Potential in (km/s)^2 at q (3, n) today, with that of the bodies; None where a component gives none."""
        parts = [(each, np.zeros(3)) for each in self.potentials.values()]
        parts += [(body.potential, body.q) for body in self.bodies.values()]
        if not all(part.has_energy() for part, _ in parts):
            return None
        return sum((add_up("potential", [part], q - at[:, None]) for part, at in parts), np.zeros(q.shape[1]))

    def energy(self, q: Array, v: Array) -> Array | None:
        """(n,) Energy in (km/s)^2 at positions q and velocities v (3, n) today; None where a potential has none.

        None too where the centre of a potential moves: v is then not the velocity from it.
        """
        depth = None if self.total.drifts else self.potential(q)
        return None if depth is None else 0.5 * (v**2).sum(axis=0) + depth

    def unbinds(self, q: Array, v: Array) -> bool | None:
        """Return whether the energy at q, v (3,) exceeds the potential at infinity; None if that is unknown."""
        here = self.energy(q[:, None], v[:, None])
        there = self.potential((q * (INFINITY / np.sqrt(q @ q)))[:, None])
        return None if here is None or there is None else bool(here[0] > there[0])

    def mass_inside(self, radii: ArrayLike) -> Array:
        """(nr,) Mass in Msun of the host without bodies inside radii (nr,) in kpc: ``r^2 <-a_r> / G``, a mean."""
        return self.total.mass_inside(radii)

    def circular_velocity(self, radii: ArrayLike) -> Array:
        """(nr,) Circular velocity in km/s at radii (nr,) in kpc in the plane, without bodies: ``sqrt(R <-a_R>)``."""
        return self.total.circular_velocity(radii)

    def flattening(self, radii: ArrayLike, z: ArrayLike) -> Array:
        """(n,) Flattening of the potential at cylindrical radii and heights (n,) in kpc, without bodies."""
        return self.total.flattening(radii, z)

    def density(self, q: ArrayLike) -> Array:
        """(n,) Mass density in Msun/kpc^3 at positions q (3, n) in kpc today, without bodies."""
        return self.total.density(q)

    def escape_speed(self, radii: ArrayLike) -> Array | None:
        """(nr,) Escape speed in km/s at radii (nr,) in kpc in the plane, without bodies; None without a potential."""
        return self.total.escape_speed(radii)

    def tidal_radius(self, mass: float, q: Array, v: Array) -> Array:
        """(n,) Tidal radius in kpc of a point mass in Msun at positions q and velocities v (3, n) today.

        ``(G m / (Omega^2 - d^2 Phi / dr^2))^(1/3)`` (Gibbons+ 2014, eq. 1), bodies included; NaN where the bracket is
        not positive.
        """
        orbit = Orbit(np.zeros(q.shape[1]), q, v, np.zeros_like(q), np.full(q.shape[1], np.nan))
        return np.asarray(np.cbrt(G * mass / self.tidal_bracket(orbit)))

    def orbits(self, lookback: float) -> dict[str, Orbit]:
        """Return the orbits of the bodies about the host by name, over a look-back time in Gyr; empty without bodies.

        Raises OutOfDomain: If an orbit is not finite over this time.
        """
        return dict(self.paths(-lookback * GYR).bodies) if self.bodies else {}

    def tidal_bracket(self, orbit: Orbit) -> Array:
        """(n,) ``Omega^2 - d^2 Phi / dr^2`` along an orbit; NaN where it is not positive, and no tidal radius exists.

        Omega = ``|L|`` / r^2 is instantaneous (Gibbons+ 2014, eq. 1).
        """
        bracket = orbit.omega**2 - self._at(orbit.t).radial_second_derivative(orbit.t, orbit.q)
        return np.where(bracket > 0, bracket, np.nan)
