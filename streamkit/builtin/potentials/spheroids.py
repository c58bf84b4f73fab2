"""Built-in spheres with free slopes. Enclosed masses are plain arithmetic, so that the force vectorises.

Incomplete beta and gamma functions have no closed form. Here they are a series inside a fixed radius, and another
series or a continued fraction outside it, all of a fixed length. Both are computed for every particle, and one result
is used. Their coefficients depend on the parameters alone, and the compiler moves them out of the loop over the
particles.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field
from scipy.special import exp1, gamma, gammainc, gammaincc, hyp2f1

import streamkit as sk
from streamkit import G, exp, log, sqrt
from streamkit.builtin.potentials.closed_forms import Hernquist


class Dehnen(sk.Spherical):
    """Dehnen sphere: density slope -gamma inside a, -4 outside. gamma = 1 is Hernquist's, gamma = 2 Jaffe's."""

    kind = "dehnen"
    example = {"mass": 1.0e11, "a": 10.0, "gamma": 1.5}
    reference = "Dehnen 1993, MNRAS 265, 250; Tremaine et al. 1994, AJ 107, 634"

    mass: Annotated[sk.Mass, sk.Symbol("$M$")] = Field(description="Total mass: M(r) = mass (r / (r + a))^(3 - gamma).")
    a: Annotated[sk.ScaleRadius, sk.Symbol("$a$")]
    gamma: Annotated[sk.Number, sk.Symbol(r"$\gamma$")] = Field(
        ge=0, lt=3, description="Inner slope: the density falls as r^-gamma."
    )

    @staticmethod
    def pull(r2: Any, mass: Any, a: Any, gamma: Any) -> Any:
        """Return -G M(r) / r^3."""
        r = sqrt(r2)
        s = r + a
        return -G * mass * exp(-gamma * log(r / s)) / (s * s * s)

    @staticmethod
    def well(r2: Any, mass: Any, a: Any, gamma: Any) -> Any:
        """Return -G M / [a (2 - gamma)] [1 - (r / (r + a))^(2 - gamma)], G M / a ln(r / (r + a)) for gamma = 2."""
        r = np.sqrt(r2)
        y = -np.log1p(a / r)
        return G * mass / a * (y if gamma == 2 else np.expm1((2 - gamma) * y) / (2 - gamma))


class HernquistSpeed(sk.Spherical):
    """Hernquist sphere of a given mass that has a given circular speed at a radius: a = sqrt(G M r / v^2) - r.

    A prior on the mass then keeps the observed rotation curve; the defaults are the Large Magellanic Cloud's
    (91.7 km/s at 8.7 kpc). A mass below ``v^2 r / G``, 1.7e10 Msun with these, has no such sphere, and is rejected.
    """

    kind = "hernquist_vcirc"
    example = {"mass": 1.4e11}
    reference = "Hernquist 1990, ApJ 356, 359; Erkal et al. 2019, MNRAS 487, 2685; van der Marel & Kallivayalil 2014"

    mass: sk.TotalMass
    r: Annotated[sk.Length, sk.Symbol("$r$")] = Field(default=8.7, description="Radius of the observed speed.")
    v_circ: Annotated[sk.Speed, sk.Symbol(r"$v_{\rm c}$")] = Field(
        default=91.7, gt=0, description="Circular speed there."
    )

    @property
    def scale_radius(self) -> float:
        """The scale length a in kpc."""
        return self.prepare(self.mass, self.r, self.v_circ)["a"]

    @staticmethod
    def prepare(mass: float, r: float, v_circ: float) -> dict[str, float]:
        """Return the scale length; OutOfDomain if there is none."""
        a = float(np.sqrt(G * mass * r) / v_circ - r)
        if not a > 0:
            raise sk.OutOfDomain("the mass of hernquist_vcirc is too small for its circular speed")
        return {"a": a}

    pull: ClassVar[Any] = staticmethod(Hernquist.pull)
    well: ClassVar[Any] = staticmethod(Hernquist.well)


class Spheroid(sk.Spherical):
    """Double power law (Zhao): ``rho = mass / (4 pi a^3) (r/a)^-gamma [1 + (r/a)^alpha]^((gamma - beta)/alpha)``.

    (alpha, beta, gamma) = (1, 3, 1) is `nfw`, (1, 4, gamma) Dehnen's, (2, 5, 0) Plummer's; the mass is finite if
    beta > 3. Its slopes may have priors. The force is exact to 1e-10, and to 1e-12 for alpha = 1.
    """

    kind = "spheroid"
    example = {"mass": 3.6e11, "a": 12.0, "gamma": 0.7}
    reference = "Zhao 1996, MNRAS 278, 488"

    mass: Annotated[sk.Mass, sk.Symbol("$M$")] = Field(
        description="Scale mass, 4 pi a^3 times the scale density; as in `nfw`, not the total mass."
    )
    a: Annotated[sk.ScaleRadius, sk.Symbol("$a$")]
    alpha: Annotated[sk.Number, sk.Symbol(r"$\alpha$")] = Field(
        default=1.0, ge=0.5, le=4, description="Sharpness of the turn from one slope to the other."
    )
    beta: Annotated[sk.Number, sk.Symbol(r"$\beta$")] = Field(
        default=3.0, ge=2.6, le=8, description="Outer slope: the density falls as r^-beta."
    )
    gamma: Annotated[sk.Number, sk.Symbol(r"$\gamma$")] = Field(
        default=1.0, ge=0, le=2.5, description="Inner slope: the density falls as r^-gamma."
    )

    @staticmethod
    def pull(r2: Any, mass: Any, a: Any, alpha: Any, beta: Any, gamma: Any) -> Any:
        """Return -G M(r) / r^3, M an incomplete beta function of w / (1 + w), w = (r/a)^alpha.

        With c = (3 - gamma) / alpha and d = (beta - 3) / alpha, alpha M / mass is the integral of
        u^(c - 1) (1 - u)^(d - 1) from 0 to w / (1 + w): as a series in u up to 1/2, and in 1 - u from there on, where
        the first term, of (1 - u)^(d - 1), is kept apart: it is a logarithm if d = 0.
        """

        def terms(c: Any, d: Any, u: Any, start: Any, total: Any, factor: Any, power: Any) -> Any:
            """Add eleven terms: the compiler unrolls eleven, and moves the factors out of the loop only if it does."""
            for i in range(11):
                k = start + i
                factor *= (k - d) / k
                power = power * u
                total = total + power * (factor / (c + k))
            return total, factor, power

        def series(c: Any, d: Any, u: Any) -> Any:
            """Sum of (1 - d)_k / k! u^k / (c + k), without its first term."""
            total, factor, power = terms(c, d, u, 1, 0.0 * u, 1.0, 1.0 + 0.0 * u)
            total, factor, power = terms(c, d, u, 12, total, factor, power)
            total, factor, power = terms(c, d, u, 23, total, factor, power)
            return terms(c, d, u, 34, total, factor, power)[0]

        c, d = (3.0 - gamma) / alpha, (beta - 3.0) / alpha
        logr = 0.5 * log(r2 / (a * a))
        w = exp(alpha * logr)
        u, v = w / (1.0 + w), 1.0 / (1.0 + w)
        inside = 1.0 * (w < 1.0)
        inner = exp(c * log(u)) * (1.0 / c + series(c, d, u))
        half = exp(-0.6931471805599453 * c) * (1.0 / c + series(c, d, 0.5))
        tail = exp(-0.6931471805599453 * d)
        ratio = exp(d * log(2.0 * v))
        same = 1.0 * (ratio == 1.0)
        first = -log(2.0 * v) * (ratio - 1.0 + same) / (log(ratio) + same)
        outer = half + tail * (first + series(d, c, 0.5) - ratio * series(d, c, v))
        return -G * mass / alpha * (inside * inner + (1.0 - inside) * outer) / (r2 * sqrt(r2))

    @staticmethod
    def well(r2: Any, mass: Any, a: Any, alpha: Any, beta: Any, gamma: Any) -> Any:
        """Return -G [M(r) / r + 4 pi the integral of rho r from r on], both as hypergeometric functions."""
        r = np.sqrt(r2)
        far = (beta - 2.0) / alpha
        v = 1.0 / (1.0 + (r / a) ** alpha)
        shells = v**far / (beta - 2.0) * hyp2f1(far, 1.0 - (2.0 - gamma) / alpha, far + 1.0, v)
        return Spheroid.pull(r2, mass, a, alpha, beta, gamma) * r2 - G * mass / a * shells


class PowerCutoff(sk.Spherical):
    """Power law with a Gaussian cut-off: ``rho ~ r^-alpha exp(-(r/rc)^2)``. The bulge of galpy's MWPotential2014.

    The force is exact to 1e-12 from r = 0 on.
    """

    kind = "power_cutoff"
    example = {"mass": 4.5e9, "alpha": 1.8, "rc": 1.9}
    reference = "Bovy 2015, ApJS 216, 29"

    mass: sk.TotalMass
    alpha: Annotated[sk.Number, sk.Symbol(r"$\alpha$")] = Field(
        ge=0, le=2.8, description="Slope of the density within the cut-off."
    )
    rc: Annotated[sk.Length, sk.Symbol(r"$r_{\rm c}$")] = Field(description="Cut-off radius.")

    @staticmethod
    def pull(r2: Any, mass: Any, alpha: Any, rc: Any) -> Any:
        """Return -G M(r) / r^3; M / mass is the incomplete gamma function P((3 - alpha)/2, r^2/rc^2).

        Up to r^2 = 5 rc^2 by its series, beyond by the continued fraction of 1 - P.
        """

        def terms(s: Any, u: Any, start: Any, total: Any, factor: Any, power: Any) -> Any:
            """Add eleven terms: the compiler unrolls eleven, and moves the factors out of the loop only if it does."""
            for i in range(11):
                factor /= s + (start + i)
                power = power * u
                total = total + power * factor
            return total, factor, power

        def series(s: Any, u: Any) -> Any:
            """Lower incomplete gamma function over u^s exp(-u): the sum of u^k / [s (s + 1) ... (s + k)]."""
            total, factor, power = terms(s, u, 1, 1.0 / s + 0.0 * u, 1.0 / s, 1.0 + 0.0 * u)
            total, factor, power = terms(s, u, 12, total, factor, power)
            return terms(s, u, 23, total, factor, power)[0]

        def fraction(s: Any, u: Any) -> Any:
            """Upper one over u^s exp(-u): Legendre's fraction 1 / (u + 1 - s - (1 - s) / (u + 3 - s - ...))."""
            before, top = 0.0 * u, 1.0 + 0.0 * u
            under, bottom = 1.0 + 0.0 * u, u + (1.0 - s)
            for k in range(1, 16):
                b, c = u + (2 * k + 1 - s), k * (s - k)
                before, top = top, b * top + c * before
                under, bottom = bottom, b * bottom + c * under
            return top / bottom

        s = 0.5 * (3.0 - alpha)
        u = r2 / (rc * rc)
        inside = 1.0 * (u < 5.0)
        whole = series(s, 5.0) + fraction(s, 5.0)  # Gamma(s) / (5^s exp(-5))
        share = exp(s * log(0.2 * u) - u + 5.0) / whole
        low, high = inside * u, inside * 5.0 + (1.0 - inside) * u  # arguments for which both series converge
        part = inside * share * series(s, low) + (1.0 - inside) * (1.0 - share * fraction(s, high))
        return -G * mass * part / (r2 * sqrt(r2))

    @staticmethod
    def well(r2: Any, mass: Any, alpha: Any, rc: Any) -> Any:
        """Return -G M [P(s, u) / r + Gamma(s - 1/2, u) / (rc Gamma(s))], s = (3 - alpha)/2 and u = (r/rc)^2."""
        s, u = 0.5 * (3.0 - alpha), r2 / rc**2
        e = s - 0.5
        if e > 0:
            shells = gamma(e) * gammaincc(e, u)
        elif e == 0:
            shells = exp1(u)
        else:
            shells = (gamma(e + 1) * gammaincc(e + 1, u) - u**e * np.exp(-u)) / e
        return -G * mass / rc * (gammainc(s, u) / np.sqrt(u) + shells / gamma(s))
