"""The galaxies the checks integrate in, and a progenitor's orbit in one of them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from pydantic import Field

from streamkit import GYR, Array, G, Length, Mass, Number, Orbit, Potential, sqrt
from streamkit.engine import build_field


class Isochrone(Potential):
    """Henon's isochrone, whose mass may oscillate: M (1 + swing sin(4 t)). Kepler's problem for b -> 0."""

    kind = "check_isochrone"

    mass: Mass = Field(default=2e11, description="Total mass.")
    b: Length = Field(default=3.0, description="Scale length.")
    swing: Number = Field(default=0.0, description="Relative amplitude of the oscillation of the mass.")

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, mass: Any, b: Any, swing: Any) -> Any:
        """Return -G M(t) r / [s (b + s)^2] along the radius, s = sqrt(b^2 + r^2)."""
        s = sqrt(b * b + x * x + y * y + z * z)
        k = -G * mass * (1.0 + swing * np.sin(4.0 * t)) / (s * (b + s) * (b + s))
        return k * x, k * y, k * z


class Viscous(Potential):
    """A Plummer sphere with a drag that grows with the square of the speed."""

    kind = "check_viscous"

    mass: Mass = Field(default=2e11, description="Total mass.")
    b: Length = Field(default=5.0, description="Scale length.")
    path: Length = Field(default=30.0, description="Length over which a velocity falls by a factor e.")

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, mass: Any, b: Any, path: Any) -> Any:
        """Return -G M r / (r^2 + b^2)^(3/2) along the radius."""
        d2 = x * x + y * y + z * z + b * b
        k = -G * mass / (d2 * sqrt(d2))
        return k * x, k * y, k * z

    @staticmethod
    def drag(x: Any, y: Any, z: Any, vx: Any, vy: Any, vz: Any, t: Any, mass: Any, b: Any, path: Any) -> Any:
        """Return -|v| v / path."""
        k = -sqrt(vx * vx + vy * vy + vz * vz) / path
        return k * vx, k * vy, k * vz


class Satellite(Potential):
    """A Plummer sphere."""

    kind = "check_plummer"

    mass: Mass = Field(default=6.4e8, description="Total mass.")
    radius: Length = Field(default=0.85, description="Scale radius.")

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, mass: Any, radius: Any) -> Any:
        """Return -G M r / (r^2 + radius^2)^(3/2) along the radius."""
        d2 = x * x + y * y + z * z + radius * radius
        k = -G * mass / (d2 * sqrt(d2))
        return k * x, k * y, k * z


# The progenitor today: an inclined, eccentric orbit in the isochrone.
TODAY = (np.array([25.0, 5.0, -12.0]), np.array([20.0, 95.0, 90.0]))

MASS = 6.4e8  # mass of the progenitor in Msun


def progenitor_orbit(
    start: float, end: float = 0.0, max_step: float = 0.01, today: tuple[Array, Array] = TODAY
) -> Orbit:
    """Return the progenitor's track from ``start`` to ``end`` in Gyr, one of them 0 (today).

    Its tidal radii are r_t = [G M / (Omega^2 - d^2 Phi/dr^2)]^(1/3) in the isochrone.
    """
    field = build_field([Isochrone()])
    orbit = field.orbit(*today, 0.0, (start if end == 0.0 else end) * GYR, max_step)
    curvature = field.radial_second_derivative(orbit.t, orbit.q)
    return replace(orbit, r_tidal=np.cbrt(G * MASS / (orbit.omega**2 - curvature)))


def swarm(count: int, seed: int = 1) -> tuple[Array, Array]:
    """Positions and velocities (3, count) near the progenitor of today."""
    rng = np.random.default_rng(seed)
    q = TODAY[0][:, None] + 3.0 * rng.standard_normal((3, count))
    v = TODAY[1][:, None] + 10.0 * rng.standard_normal((3, count))
    return q, v
