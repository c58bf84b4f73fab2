"""Built-in potentials. Formulas: Binney & Tremaine 2008 unless a class names its paper."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from pydantic import Field
from scipy.special import hyp2f1

import streamkit as sk
from streamkit import Array, G, exp, log, power, sqrt
from streamkit.builtin.potentials.equilibria import hernquist_speeds, plummer_speeds


class TruncatedFlat(sk.Spherical):
    """Truncated flat rotation curve: ``v_c^2 = v0^2 rs^alpha / (rs^2 + r^2)^(alpha/2)``.

    The model that Gibbons, Belokurov & Evans 2014 fit (their eq. 2); alpha = 0 is the singular isothermal sphere.
    """

    kind = "tf"
    example = {"v0": 210.0, "rs": 12.0, "alpha": 0.45}
    reference = "Gibbons, Belokurov & Evans 2014, MNRAS 445, 3788"

    v0: Annotated[sk.Speed, sk.Symbol("$v_0$")] = Field(gt=0, description="Circular velocity at the centre.")
    rs: sk.ScaleRadius = Field(description="Radius where the rotation curve turns over.")
    alpha: Annotated[sk.Number, sk.Symbol(r"$\alpha$")] = Field(
        ge=0, le=1, description="Outer slope: v_c falls as r^(-alpha/2)."
    )

    @staticmethod
    def pull(r2: Any, v0: Any, rs: Any, alpha: Any) -> Any:
        """Return -v_c^2 / r^2."""
        return -v0 * v0 * exp(-0.5 * alpha * log(1.0 + r2 / (rs * rs))) / r2

    @staticmethod
    def well(r2: Any, v0: Any, rs: Any, alpha: Any) -> Any:
        """Return -(v0^2/alpha) u^(alpha/2) 2F1(1, alpha/2; 1 + alpha/2; u), u = rs^2 / (rs^2 + r^2)."""
        if alpha == 0:
            return 0.5 * v0**2 * np.log(r2)
        u = rs**2 / (rs**2 + r2)
        return -(v0**2 / alpha) * u ** (0.5 * alpha) * hyp2f1(1.0, 0.5 * alpha, 1.0 + 0.5 * alpha, u)


class NFW(sk.Spherical):
    """Navarro, Frenk & White halo by scale mass and radius: ``Phi = -G m ln(1 + r/rs) / r``."""

    kind = "nfw"
    example = {"mass": 3.584843593e11, "rs": 9.370845158}
    reference = "Navarro, Frenk & White 1996, ApJ 462, 563"

    mass: Annotated[sk.Mass, sk.Symbol("$M$")] = Field(
        description="Scale mass: M(r) = mass [ln(1 + r/rs) - r/(r + rs)]."
    )
    rs: sk.ScaleRadius

    @staticmethod
    def pull(r2: Any, mass: Any, rs: Any) -> Any:
        """Return -G M(r) / r^3."""
        r = sqrt(r2)
        return G * mass * (r / (r + rs) - log(1.0 + r / rs)) / (r2 * r)

    @staticmethod
    def well(r2: Any, mass: Any, rs: Any) -> Any:
        """Return -G m ln(1 + r/rs) / r."""
        r = np.sqrt(r2)
        return -G * mass * np.log1p(r / rs) / r


class NFWVirial(sk.Spherical):
    """The NFW halo by M200 and concentration, for the critical density of the Hubble constant ``h0``."""

    kind = "nfw_m200"
    example = {"m200": 7.5e11, "c200": 20.0}
    reference = "Navarro, Frenk & White 1996, ApJ 462, 563"

    m200: Annotated[sk.Mass, sk.Symbol("$M_{200}$")] = Field(
        description="Mass within r200, where the mean density is 200 times critical."
    )
    c200: Annotated[sk.PositiveNumber, sk.Symbol("$c_{200}$")] = Field(description="Concentration r200 / rs.")
    h0: Annotated[sk.PositiveNumber, sk.Symbol("$H_0$")] = Field(
        default=70.0, description="Hubble constant in km/s/Mpc."
    )

    @staticmethod
    def pull(r2: Any, m200: Any, c200: Any, h0: Any) -> Any:
        """Return the NFW pull with m = M200 / [ln(1 + c) - c/(1 + c)], rs = r200 / c."""
        mass = m200 / (log(1.0 + c200) - c200 / (1.0 + c200))
        rs = power(G * m200 / (100.0 * (1e-3 * h0) * (1e-3 * h0)), 1.0 / 3.0) / c200
        r = sqrt(r2)
        return G * mass * (r / (r + rs) - log(1.0 + r / rs)) / (r2 * r)

    @staticmethod
    def well(r2: Any, m200: Any, c200: Any, h0: Any) -> Any:
        """Return the NFW potential of the same mass and radius."""
        mass = m200 / (np.log1p(c200) - c200 / (1.0 + c200))
        rs = np.cbrt(G * m200 / (100.0 * (1e-3 * h0) ** 2)) / c200
        return NFW.well(r2, mass, rs)


class Hernquist(sk.Spherical):
    """Hernquist bulge or halo: ``Phi = -G M / (r + a)``."""

    kind = "hernquist"
    example = {"mass": 3.4e10, "a": 0.7}
    reference = "Hernquist 1990, ApJ 356, 359"

    mass: sk.TotalMass
    a: Annotated[sk.Length, sk.Symbol("$a$")] = Field(description="Scale length.")

    @staticmethod
    def pull(r2: Any, mass: Any, a: Any) -> Any:
        """Return -G M / [r (r + a)^2]."""
        r = sqrt(r2)
        return -G * mass / (r * (r + a) * (r + a))

    @staticmethod
    def well(r2: Any, mass: Any, a: Any) -> Any:
        """Return -G M / (r + a)."""
        return -G * mass / (np.sqrt(r2) + a)

    @staticmethod
    def equilibrium(share: Array, chance: Array, mass: Any, a: Any) -> tuple[Array, Array]:
        """Return radii from the mass inside, and speeds from Hernquist's distribution function."""
        root = np.sqrt(share)
        radius = root / (1 - root)
        return a * radius, hernquist_speeds(radius, chance) * np.sqrt(2 * G * mass / (a * (1 + radius)))


class MiyamotoNagai(sk.Potential):
    """Miyamoto & Nagai disc: ``Phi = -G M / sqrt(R^2 + (a + sqrt(z^2 + b^2))^2)``."""

    kind = "miyamoto_nagai"
    example = {"mass": 1.0e11, "a": 6.5, "b": 0.26}
    reference = "Miyamoto & Nagai 1975, PASJ 27, 533"

    mass: sk.TotalMass
    a: Annotated[sk.Length, sk.Symbol("$a$")] = Field(description="Scale length.")
    b: Annotated[sk.Length, sk.Symbol("$b$")] = Field(description="Scale height.")

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, mass: Any, a: Any, b: Any) -> Any:
        """Return minus the gradient of the potential."""
        s = sqrt(z * z + b * b)
        h = a + s
        d2 = x * x + y * y + h * h
        k = -G * mass / (d2 * sqrt(d2))
        return k * x, k * y, k * z * h / s

    @staticmethod
    def potential(x: Any, y: Any, z: Any, t: Any, mass: Any, a: Any, b: Any) -> Any:
        """Return -G M / sqrt(R^2 + (a + sqrt(z^2 + b^2))^2)."""
        return -G * mass / np.sqrt(x * x + y * y + (a + np.sqrt(z * z + b * b)) ** 2)


class Plummer(sk.Spherical):
    """Plummer sphere: ``Phi = -G M / sqrt(r^2 + radius^2)``. The progenitor of Gibbons+ 2014."""

    kind = "plummer"
    example = {"mass": 6.4e8, "radius": 0.85}
    reference = "Plummer 1911, MNRAS 71, 460"

    mass: sk.TotalMass
    radius: Annotated[sk.ScaleRadius, sk.Symbol("$a$")]

    @staticmethod
    def pull(r2: Any, mass: Any, radius: Any) -> Any:
        """Return -G M / (r^2 + radius^2)^(3/2)."""
        d2 = r2 + radius * radius
        return -G * mass / (d2 * sqrt(d2))

    @staticmethod
    def well(r2: Any, mass: Any, radius: Any) -> Any:
        """Return -G M / sqrt(r^2 + radius^2)."""
        return -G * mass / np.sqrt(r2 + radius * radius)

    @staticmethod
    def equilibrium(share: Array, chance: Array, mass: Any, radius: Any) -> tuple[Array, Array]:
        """Return radii from the mass inside, and speeds from the distribution function E^(7/2)."""
        rho = 1 / np.sqrt(share ** (-2 / 3) - 1)
        escape = np.sqrt(2 * G * mass / radius) * (1 + rho * rho) ** -0.25
        return radius * rho, plummer_speeds(chance) * escape


class Kepler(sk.Potential):
    """Point mass: ``Phi = -G M / r``.

    It does not derive from `Spherical`: its force at the centre is infinite, and an orbit through the centre is
    refused.
    """

    kind = "kepler"
    example = {"mass": 1.0e11}

    mass: Annotated[sk.Mass, sk.Symbol("$M$")] = Field(description="Mass.")

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, mass: Any) -> Any:
        """Return -G M / r^2 along the radius."""
        r2 = x * x + y * y + z * z
        k = -G * mass / (r2 * sqrt(r2))
        return k * x, k * y, k * z

    @staticmethod
    def potential(x: Any, y: Any, z: Any, t: Any, mass: Any) -> Any:
        """Return -G M / r."""
        return -G * mass / np.sqrt(x * x + y * y + z * z)


class Isochrone(sk.Potential):
    """Henon's isochrone: ``Phi = -G M / (b + sqrt(b^2 + r^2))``. Its orbits are known in closed form."""

    # Not derived from `Spherical`: b^2 is first in this sum of squares, and another order would change the last bits.

    kind = "isochrone"
    example = {"mass": 2.0e11, "b": 3.0}
    reference = "Henon 1959, AnAp 22, 126"

    mass: sk.TotalMass
    b: Annotated[sk.Length, sk.Symbol("$b$")] = Field(description="Scale length.")

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, mass: Any, b: Any) -> Any:
        """Return -G M r / [s (b + s)^2] along the radius, s = sqrt(b^2 + r^2)."""
        s = sqrt(b * b + x * x + y * y + z * z)
        k = -G * mass / (s * (b + s) * (b + s))
        return k * x, k * y, k * z

    @staticmethod
    def potential(x: Any, y: Any, z: Any, t: Any, mass: Any, b: Any) -> Any:
        """Return -G M / (b + sqrt(b^2 + r^2))."""
        return -G * mass / (b + np.sqrt(b * b + x * x + y * y + z * z))


class Logarithmic(sk.Potential):
    """Triaxial logarithmic halo turned by phi: ``Phi = v_h^2 ln(C1 x^2 + C2 y^2 + C3 x y + (z/qz)^2 + r_h^2)``.

    The halo of Law & Majewski 2010 (their eqs. 3-6); note v_h^2 without the factor 1/2.
    """

    kind = "logarithmic"
    example = {"v_h": 121.858, "r_h": 12.0, "q1": 1.38, "q2": 1.0, "qz": 1.36, "phi": 97.0}
    reference = "Law & Majewski 2010, ApJ 714, 229"

    v_h: Annotated[sk.Speed, sk.Symbol(r"$v_{\rm h}$")] = Field(gt=0, description="Velocity scale.")
    r_h: Annotated[sk.Length, sk.Symbol(r"$r_{\rm h}$")] = Field(description="Core radius.")
    q1: Annotated[sk.AxisRatio, sk.Symbol("$q_1$")] = Field(default=1.0, description="Axis ratio along phi.")
    q2: Annotated[sk.AxisRatio, sk.Symbol("$q_2$")] = Field(
        default=1.0, description="Axis ratio in the plane, perpendicular to phi."
    )
    qz: Annotated[sk.AxisRatio, sk.Symbol("$q_z$")] = Field(default=1.0, description="Axis ratio along z.")
    phi: Annotated[sk.Angle, sk.Symbol(r"$\phi$")] = Field(
        default=0.0, description="Direction of the first axis, from x towards y."
    )

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, v_h: Any, r_h: Any, q1: Any, q2: Any, qz: Any, phi: Any) -> Any:
        """Return minus the gradient of the potential."""
        c, s = np.cos(phi), np.sin(phi)
        p, q = 1.0 / (q1 * q1), 1.0 / (q2 * q2)
        c1 = c * c * p + s * s * q
        c2 = c * c * q + s * s * p
        c3 = 2.0 * s * c * (p - q)
        w = 1.0 / (qz * qz)
        k = -v_h * v_h / (c1 * x * x + c2 * y * y + c3 * x * y + w * z * z + r_h * r_h)
        return k * (2.0 * c1 * x + c3 * y), k * (2.0 * c2 * y + c3 * x), k * 2.0 * w * z

    @staticmethod
    def potential(x: Any, y: Any, z: Any, t: Any, v_h: Any, r_h: Any, q1: Any, q2: Any, qz: Any, phi: Any) -> Any:
        """Return v_h^2 ln(C1 x^2 + C2 y^2 + C3 x y + (z/qz)^2 + r_h^2)."""
        c, s = np.cos(phi), np.sin(phi)
        c1 = (c / q1) ** 2 + (s / q2) ** 2
        c2 = (c / q2) ** 2 + (s / q1) ** 2
        c3 = 2.0 * s * c * (1.0 / q1**2 - 1.0 / q2**2)
        return v_h**2 * np.log(c1 * x * x + c2 * y * y + c3 * x * y + (z / qz) ** 2 + r_h**2)
