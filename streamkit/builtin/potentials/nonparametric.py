"""A built-in halo of no family: slopes of its density at knots, axis ratios at radii."""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import Field, field_validator, model_validator
from scipy.interpolate import make_interp_spline

import streamkit as sk
from streamkit import Array, G, cubic, cubic_pieces, log, sqrt

CELLS = 1024  # cells of the even grid in ln r: the force is that of the density to 1e-7
INSIDE, OUTSIDE = 1e-3, 1e2  # the grid goes from this part of the first knot to this multiple of the last one
CENTRE = 1e-30  # kpc^2, added to squared radii: the force at the very centre is zero and not 0/0
NODES, WEIGHTS = (0.5 * (part + shift) for part, shift in zip(np.polynomial.legendre.leggauss(4), (1, 0), strict=True))


class Sums(NamedTuple):
    """Functions of radius on an even grid in ln r from ``low`` to ``high``, as cubics (n, 4).

    ``pull`` is G M(r) / r^3. The potential is ``depth``, that of a sphere, plus ``shape`` times z^2 - R^2 / 2; ``rise``
    is the derivative of ``shape`` by ln r. ``edge`` is the squared last radius.
    """

    low: float
    high: float
    edge: float
    pull: Array
    shape: Array
    rise: Array
    depth: Array


class Nonparametric(sk.Potential):
    """Halo of no family: slopes of its density at knots in radius, and axis ratios z/x at one or more radii.

    d ln rho / d ln r is linear in ln r between the knots, and constant inside the first and beyond the last one. Around
    a sphere the density is its mean times ``1 + a (z^2 - R^2 / 2) / r^2``, with the a for which the surfaces of equal
    density have the axis ratio q: exactly for a power law. The density is positive for all parameters. Surfaces flatter
    than about 0.6 are shaped like a lens. Inside a thousandth of the first knot the density is constant, and beyond a
    hundred times the last knot it is zero.

    Normal priors of ``bend`` are a random walk of the slope, the prior of a smoothing spline, if their standard
    deviations are ``s sqrt(ln(r_k+1 / r_k))`` with the same s for all knots.
    """

    kind = "nonparametric"
    example = {  # an NFW halo of rs = 16 kpc, whose slope is -(1 + 3 r/rs) / (1 + r/rs), and flattened
        "r": [2.0, 5.0, 10.0, 20.0, 40.0, 80.0, 200.0],
        "slope": -1.222222222,
        "bend": [-0.253968254, -0.293040293, -0.341880342, -0.317460317, -0.238095238, -0.185185185],
        "mass_inside": 1.4e11,
        "q": [0.8, 0.9],
        "r_q": [10.0, 60.0],
    }
    reference = "Wahba 1978, J. R. Stat. Soc. B 40, 364 (the prior); Binney & Tremaine 2008, eq. 2.95 (the force)"

    r: Annotated[sk.LengthArray, sk.Increasing(least=2)] = Field(description="Radii of the knots.")
    slope: Annotated[sk.Number, sk.Symbol(r"$\gamma$")] = Field(
        description="Slope d ln rho / d ln r at the first knot and inside it: -1 for a cusp, 0 for a core."
    )
    bend: sk.NumberArray = Field(
        description="Changes of the slope from each knot to the next: negative where the density steepens."
    )
    mass_inside: Annotated[sk.Mass, sk.Symbol("$M$")] = Field(description="Mass inside the radius below.")
    radius: sk.Length = Field(default=20.0, description="Radius of this mass, within the knots.")
    q: sk.NumberArray = Field(
        default=[1.0],  # type: ignore[arg-type]  # read as an array
        description="Axis ratios z/x of the density: one, or one at each radius.",
    )
    r_q: Annotated[sk.LengthArray, sk.Increasing(least=2)] | None = Field(
        default=None, description="Radii of the axis ratios: ln q is linear in ln r between them, constant beyond."
    )

    @field_validator("q")
    @classmethod
    def _positive(cls, q: Array) -> Array:
        if not (q > 0).all():
            raise ValueError(f"an axis ratio must be positive, found {q.min():g}")
        return q

    @model_validator(mode="after")
    def _fits(self) -> Nonparametric:
        knots, bends, ratios = len(self.r), len(self.bend), len(self.q)
        if bends != knots - 1:
            raise ValueError(
                f"bend has {bends} number(s) and r {knots} knots: expected {knots - 1}, one fewer than knots"
            )
        if not self.r[0] <= self.radius <= self.r[-1]:
            raise ValueError(
                f"radius is {self.radius:g} kpc, expected {self.r[0]:g} to {self.r[-1]:g}, within the knots"
            )
        if self.r_q is None and ratios != 1:
            raise ValueError(f"q has {ratios} numbers: expected one, or give their radii r_q")
        if self.r_q is not None and ratios != len(self.r_q):
            raise ValueError(f"q has {ratios} number(s) and r_q {len(self.r_q)} radii: expected as many")
        return self

    @staticmethod
    def prepare(r: Array, slope: Any, bend: Array, mass_inside: Any, radius: Any, q: Array, r_q: Array | None) -> Sums:
        """Return the integrals over the density as cubics."""
        low, high, here = np.log([r[0] * INSIDE, r[-1] * OUTSIDE, radius])
        slopes = slope + np.concatenate([[0.0], np.cumsum(bend)])
        gamma = make_interp_spline([low, *np.log(r), high], [slopes[0], *slopes, slopes[-1]], k=1)
        level = gamma.antiderivative()  # ln rho

        centres = np.log(radius if r_q is None else r_q).reshape(-1)

        def densities(u: Array) -> tuple[Array, Array]:
            """Return the mean density on spheres, and its part with (z^2 - R^2 / 2) / r^2; both times a number."""
            mean = np.exp(level(u) - level(here))
            pole = np.exp(-gamma(u) * np.interp(u, centres, np.log(q)))  # density on the axis over that in the plane
            return mean, mean * 2 * (pole - 1) / (pole + 2)

        u, h = np.linspace(low, high, CELLS + 1, retstep=True)
        inner = u[:-1, None] + h * NODES
        (mean, part), (mean_at, part_at) = densities(inner), densities(u)
        # Of the sphere: M(r) / r^3 and its derivative by ln r, over 4 pi.
        inside = mean_at[0] * np.exp(3 * low) / 3 + _summed(mean * np.exp(3 * inner), h)
        pull = inside * np.exp(-3 * u)
        pulls = cubic_pieces(pull, h * (mean_at - 3 * pull))
        # Of the quadrupole D (z^2 - R^2 / 2) / r^2: -(1/5) (r^-5 int_0^r D s^4 ds + int_r^inf D ds / s), by Poisson.
        rise = _summed(part * np.exp(5 * inner), h) * np.exp(-5 * u)
        shapes = cubic_pieces(-0.2 * (rise + _summed_outside(part, h)), h * rise)
        rises = cubic_pieces(rise, h * (part_at - 5 * rise))
        # Of the potential of the sphere: the integral of its pull.
        climb = _summed_outside((pulls @ NODES ** np.arange(4)[:, None]) * np.exp(2 * inner), h)
        depth = -climb - pull[-1] * np.exp(2 * high)
        depths = cubic_pieces(depth, h * pull * np.exp(2 * u))
        factor = G * mass_inside / (radius**3 * cubic(here, (low, high), pulls))
        return Sums(low, high, np.exp(2 * high), *(factor * pieces for pieces in (pulls, shapes, rises, depths)))

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, low: Any, high: Any, edge: Any, pull: Any, shape: Any, rise: Any,
                     depth: Any) -> Any:  # fmt: skip
        """Return minus the gradient of the potential. Beyond the last radius it falls as outside of all mass."""
        plane, z2 = x * x + y * y, z * z
        r2 = plane + z2 + CENTRE
        u, ends, beyond = 0.5 * log(r2), (low, high), np.minimum(1.0, edge / r2)
        far = beyond * sqrt(beyond)
        k, far = far * cubic(u, ends, pull), far * beyond
        f = far * cubic(u, ends, shape)
        k = -k - far * cubic(u, ends, rise) * (z2 - 0.5 * plane) / r2
        return x * (k + f), y * (k + f), z * (k - 2.0 * f)

    @staticmethod
    def potential(x: Any, y: Any, z: Any, t: Any, low: Any, high: Any, edge: Any, pull: Any, shape: Any, rise: Any,
                  depth: Any) -> Any:  # fmt: skip
        """Return the potential: zero at infinity."""
        plane, z2 = x * x + y * y, z * z
        r2 = plane + z2 + CENTRE
        u, ends, beyond = 0.5 * np.log(r2), (low, high), np.minimum(1.0, edge / r2)
        core = 0.5 * pull[0, 0] * np.minimum(r2 - np.exp(2 * low), 0.0)
        sphere = cubic(u, ends, depth) * np.sqrt(beyond) + core
        return sphere + beyond**2.5 * cubic(u, ends, shape) * (z2 - 0.5 * plane)


def _summed(values: Array, h: float) -> Array:
    """(n + 1,) Integral from the first node to each, of values (n, 4) at the Gauss-Legendre nodes of the cells."""
    return np.concatenate([[0.0], np.cumsum(h * values @ WEIGHTS)])


def _summed_outside(values: Array, h: float) -> Array:
    """(n + 1,) Integral from each node to the last one; from outside, where the values may be far smaller."""
    return _summed(values[::-1], h)[::-1]
