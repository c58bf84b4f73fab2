"""Built-in haloes that are not round: in the potential, where every force is a closed form, or in the density.

Beware: the density is flattened about three times as much as the potential, and turns negative on the short axis of a
potential that is flattened too far (q < 0.71 for `logarithmic_halo`, Binney & Tremaine 2008, section 2.3.2).
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from pydantic import Field

from streamkit import Angle, AxisRatio, Coordinate, G, Mass, Potential, ScaleRadius, Speed, Symbol, log, sqrt

CENTRE = 1e-30  # kpc^2, added to squared radii: the force at the very centre is zero and not 0/0

AxisRatioYX = Annotated[AxisRatio, Symbol("$p$"), Field(description="Axis ratio y/x of the potential.")]
AxisRatioZX = Annotated[AxisRatio, Field(description="Axis ratio z/x of the potential.")]
Direction = Annotated[Angle, Symbol(r"$\phi$"), Field(description="Direction of the first axis, from x towards y.")]

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(20)
SHELLS = tuple(float(v * v) for v in 0.5 + 0.5 * _NODES)
# Gauss-Legendre quadrature from 0 to 1 in the root of the variable: dense near 0, as the centre is from afar.
WIDTHS = tuple(float(w * v) for w, v in zip(_WEIGHTS, 0.5 + 0.5 * _NODES, strict=True))


class NFWTriaxial(Potential):
    """NFW halo flattened in the potential: ``Phi = -G m ln(1 + r/rs) / r``, ``r^2 = x^2 + (y/p)^2 + (z/q)^2``.

    With p = q = 1 it is `nfw`; with p = 1 it is axisymmetric.
    """

    kind = "nfw_triaxial"
    example = {"mass": 3.584843593e11, "rs": 9.370845158, "q": 0.9}
    reference = "Navarro, Frenk & White 1996, ApJ 462, 563"

    mass: Annotated[Mass, Symbol("$M$")] = Field(
        description="Scale mass: without flattening M(r) = mass [ln(1 + r/rs) - r/(r + rs)]."
    )
    rs: ScaleRadius = Field(description="Scale radius along the first axis.")
    p: AxisRatioYX = 1.0
    q: AxisRatioZX = 1.0
    phi: Direction = 0.0

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, mass: Any, rs: Any, p: Any, q: Any, phi: Any) -> Any:
        """Return minus the gradient of the potential."""
        c, s = np.cos(phi), np.sin(phi)
        u, v, w = c * x + s * y, (c * y - s * x) / (p * p), z / (q * q)
        r2 = u * u + v * v * (p * p) + w * z + CENTRE
        r = sqrt(r2)
        k = G * mass * (r / (r + rs) - log(1.0 + r / rs)) / (r2 * r)
        return k * (c * u - s * v), k * (s * u + c * v), k * w

    @staticmethod
    def potential(x: Any, y: Any, z: Any, t: Any, mass: Any, rs: Any, p: Any, q: Any, phi: Any) -> Any:
        """Return -G m ln(1 + r/rs) / r."""
        c, s = np.cos(phi), np.sin(phi)
        r = np.sqrt((c * x + s * y) ** 2 + ((c * y - s * x) / p) ** 2 + (z / q) ** 2 + CENTRE)
        return -G * mass * np.log1p(r / rs) / r


class NFWEllipsoidal(Potential):
    """NFW halo flattened in the density: ``rho = m / [4 pi r (r + rs)^2]``, ``r^2 = x^2 + (y/p)^2 + (z/q)^2``.

    The halo of Bovy+ 2016 for GD-1 and Palomar 5 (p = 1). By quadrature: the force is right to 1e-7 for axis ratios
    from 0.5 to 2 and r < 80 rs, and it is always the gradient of the potential.
    """

    kind = "nfw_ellipsoidal"
    example = {"mass": 4.37e11, "rs": 16.0, "q": 1.05}
    reference = "Binney & Tremaine 2008, eq. 2.140; Bovy et al. 2016, ApJ 833, 31"

    mass: Annotated[Mass, Symbol("$M$")] = Field(
        description="Scale mass: 4 pi rs^3 times the scale density, as in `nfw` if p = q = 1."
    )
    rs: ScaleRadius = Field(description="Scale radius along the first axis.")
    p: AxisRatioYX = Field(default=1.0, ge=0.4, le=2.5, description="Axis ratio y/x of the density.")
    q: AxisRatioZX = Field(default=1.0, ge=0.4, le=2.5, description="Axis ratio z/x of the density.")
    phi: Direction = 0.0

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, mass: Any, rs: Any, p: Any, q: Any, phi: Any) -> Any:
        """Return the sum of the homoeoids' forces."""

        def shells(u2: Any, v2: Any, w2: Any, total: Any, across: Any, up: Any, first: Any) -> Any:
            """Add five shells: the compiler unrolls five, and vectorises the loop over particles only if it does."""
            for i in range(5):
                s = SHELLS[first + i]
                b, c = 1.0 / (1.0 + (p * p - 1.0) * s * s), 1.0 / (1.0 + (q * q - 1.0) * s * s)
                r = sqrt(u2 + v2 * b + w2 * c)
                d = 1.0 + s * r / rs
                k = WIDTHS[first + i] * s * sqrt(b * c) / (r * d * d)
                total = total + k
                across = across + k * b
                up = up + k * c
            return total, across, up

        cos, sin = np.cos(phi), np.sin(phi)
        u, v = cos * x + sin * y, cos * y - sin * x
        u2, v2, w2 = u * u + CENTRE, v * v, z * z
        zero = 0.0 * u2
        total, across, up = shells(u2, v2, w2, zero, zero, zero, 0)
        total, across, up = shells(u2, v2, w2, total, across, up, 5)
        total, across, up = shells(u2, v2, w2, total, across, up, 10)
        total, across, up = shells(u2, v2, w2, total, across, up, 15)
        k = -G * mass * p * q / (rs * rs)
        u, v = k * total * u, k * across * v
        return cos * u - sin * v, sin * u + cos * v, k * up * z

    @staticmethod
    def potential(x: Any, y: Any, z: Any, t: Any, mass: Any, rs: Any, p: Any, q: Any, phi: Any) -> Any:
        """Return -G m p q / rs times the integral of ds / [(1 + r(s)/rs) sqrt((1 + (p^2-1) s^2) (1 + (q^2-1) s^2))]."""
        u, v = np.cos(phi) * x + np.sin(phi) * y, np.cos(phi) * y - np.sin(phi) * x
        total = 0.0
        for s, width in zip(SHELLS, WIDTHS, strict=True):
            b, c = 1.0 / (1.0 + (p * p - 1.0) * s * s), 1.0 / (1.0 + (q * q - 1.0) * s * s)
            r = s * np.sqrt(u * u + v * v * b + z * z * c)
            total = total + width * np.sqrt(b * c) / (1.0 + r / rs)
        return -G * mass * p * q / rs * total


class LogarithmicHalo(Potential):
    """Flattened logarithmic halo: ``Phi = (v0^2/2) ln(x^2 + (y/p)^2 + (z/q)^2 + rc^2)``, with the factor 1/2.

    v0 is the circular speed in the plane far out. `logarithmic` is Law & Majewski's, without that factor.
    """

    kind = "logarithmic_halo"
    example = {"v0": 220.0, "q": 0.9}
    reference = "Binney & Tremaine 2008, eq. 2.71a; Koposov et al. 2010, ApJ 712, 260"

    v0: Annotated[Speed, Symbol("$v_0$")] = Field(gt=0, description="Circular speed in the plane at large radii.")
    rc: Annotated[Coordinate, Symbol(r"$r_{\rm c}$")] = Field(default=0.0, ge=0, description="Core radius.")
    p: AxisRatioYX = 1.0
    q: AxisRatioZX = 1.0

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, v0: Any, rc: Any, p: Any, q: Any) -> Any:
        """Return minus the gradient of the potential."""
        v, w = y / (p * p), z / (q * q)
        k = -v0 * v0 / (x * x + v * y + w * z + rc * rc + CENTRE)
        return k * x, k * v, k * w

    @staticmethod
    def potential(x: Any, y: Any, z: Any, t: Any, v0: Any, rc: Any, p: Any, q: Any) -> Any:
        """Return (v0^2/2) ln(x^2 + (y/p)^2 + (z/q)^2 + rc^2)."""
        return 0.5 * v0**2 * np.log(x * x + (y / p) ** 2 + (z / q) ** 2 + rc**2 + CENTRE)
