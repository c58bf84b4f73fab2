"""Built-in spheres of finite mass, as progenitors whose particles are drawn from a distribution function need it."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from pydantic import Field
from scipy.special import erf

from streamkit import Array, G, Length, Mass, Number, Potential, Symbol, cubic, cubic_pieces, log, sqrt
from streamkit.builtin.potentials.halos import CENTRE

CELLS = 2048  # cells of the table of King's mass, even in the radius
SERIES = 0.02  # r / rs below which the mass of a truncated NFW is a series: the terms of the closed form cancel


class TruncatedNFW(Potential):
    """NFW halo with a finite mass: ``rho ~ 1 / [r (1 + r/rs)^2 (1 + r^2/rt^2)]``.

    It serves as the halo of a dwarf before it is stripped, with a live progenitor.
    """

    kind = "nfw_truncated"
    example = {"mass": 1e9, "rs": 1.0, "rt": 10.0}
    reference = "Baltz, Marshall & Oguri 2009, JCAP 01, 015, eq. A3 (n = 1)"

    mass: Annotated[Mass, Symbol("$M$")] = Field(description="Total mass.")
    rs: Annotated[Length, Symbol(r"$r_{\rm s}$")] = Field(description="Scale radius.")
    rt: Annotated[Length, Symbol(r"$r_{\rm t}$")] = Field(description="Radius beyond which the density falls as r^-5.")

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, mass: Any, rs: Any, rt: Any) -> Any:
        """Return -G M(r) / r^2 along the radius.

        With s = r/rs, c = rt/rs and k = c^2 + 1 the mass inside is proportional to
        (c^2 - 1) [ln(1 + s) - ln(1 + s^2/c^2) / 2] + 2 c arctan(s/c) - k s / (1 + s),
        and to (k^2/c^2) (s^2/2 - 2 s^3/3 + (3 - 1/c^2) s^4/4) for small s.
        """
        c = rt / rs
        c2 = c * c
        k = c2 + 1.0
        whole = (c2 - 1.0) * log(c) + np.pi * c - k
        r2 = x * x + y * y + z * z + CENTRE
        s = sqrt(r2) / rs
        formula = (c2 - 1.0) * (log(1.0 + s) - 0.5 * log(1.0 + s * s / c2))
        formula = formula + 2.0 * c * np.arctan(s / c) - k * s / (1.0 + s)
        i2 = 1.0 / c2
        series = 0.4 * (2.0 - i2) - s * (5.0 - 3.0 * i2 + i2 * i2) / 6.0
        series = 0.5 - s * (2.0 / 3.0 - s * (0.25 * (3.0 - i2) - s * series))
        expanded = k * k * i2 * s * s * series
        inner = 1.0 * (s < SERIES)
        f = -G * mass * (inner * expanded + (1.0 - inner) * formula) / (whole * r2 * rs * s)
        return f * x, f * y, f * z


class King(Potential):
    """King sphere of a given concentration: a lowered isothermal sphere, the profile of globular clusters."""

    kind = "king"
    example = {"mass": 2e4, "rc": 0.005, "w0": 6.0}
    reference = "King 1966, AJ 71, 64"

    mass: Annotated[Mass, Symbol("$M$")] = Field(description="Total mass.")
    rc: Annotated[Length, Symbol(r"$r_{\rm c}$")] = Field(description="King's core radius.")
    w0: Annotated[Number, Symbol("$W_0$")] = Field(
        default=6.0, ge=0.5, le=9, description="Central potential over the squared dispersion: the concentration."
    )

    @staticmethod
    def prepare(mass: float, rc: float, w0: float) -> dict[str, Any]:
        """Return the cubics of G M(r) / r^3 on an even grid in r, by Poisson's equation from the centre to the edge."""
        from scipy.integrate import solve_ivp  # slow to import

        def slope(s: float, w: Array) -> Array:
            """Return d/ds of W and of m = -s^2 dW/ds, s in core radii: dm/ds = 9 s^2 rho/rho_0."""
            return np.array([-w[1] / s**2, 9 * s * s * _king_density(w[0]) / central])

        def edge(_: float, w: Array) -> float:
            return float(w[0])

        edge.terminal = True  # type: ignore[attr-defined]  # scipy reads it from the function
        central, first = float(_king_density(w0)), 1e-4
        start = np.array([w0 - 1.5 * first**2, 3 * first**3])
        done = solve_ivp(slope, (first, 1e4), start, rtol=1e-11, atol=1e-13, events=edge, dense_output=True)
        last = float(done.t[-1])
        s = np.linspace(0.0, last, CELLS + 1)
        w, inside = done.sol(np.maximum(s, first))
        safe = np.maximum(s, first)
        mean = inside / safe**3
        mean[0] = 3.0
        change = (9 * _king_density(w) / central - 3 * mean) / safe  # d/ds of m / s^3
        change[0] = 0.0
        scale = G * mass / (done.y[1, -1] * rc**3)
        pieces = cubic_pieces(scale * mean, scale * change * (last / CELLS))
        return {"pieces": pieces, "edge": last * rc}

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, mass: Any, pieces: Any, edge: Any) -> Any:
        """Return -G M(r) / r^2 along the radius: the force of a point mass beyond the edge."""
        r2 = x * x + y * y + z * z + CENTRE
        r = sqrt(r2)
        outside = 1.0 * (r >= edge)
        k = -(1.0 - outside) * cubic(r, (0.0, edge), pieces) - outside * G * mass / (r2 * r)
        return k * x, k * y, k * z


def _king_density(w: Any) -> Any:
    """King's density exp(W) erf(W^(1/2)) - (4 W / pi)^(1/2) (1 + 2 W / 3), in the unit of this formula."""
    w = np.maximum(w, 0.0)
    return np.exp(w) * erf(np.sqrt(w)) - np.sqrt(4 * w / np.pi) * (1 + 2 * w / 3)
