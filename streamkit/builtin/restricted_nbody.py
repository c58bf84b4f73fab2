"""Restricted N-body: test particles in the host and in the monopole of those that are still bound."""

from __future__ import annotations

from functools import cache
from typing import Any, ClassVar

import numpy as np

from streamkit import (
    Array,
    BlockEdge,
    G,
    Length,
    LiveStripping,
    Number,
    Orbit,
    Potential,
    Remnant,
    SatelliteView,
    engine,  # loaded when it is used: it brings numba, and listing plugins need not wait for it
    sqrt,
)

SHELLS = 64  # equal shells in d^2 / (d^2 + b^2) in which the bound mass is counted
DEGREE = 8  # of the polynomial that stands for the mass in them
INNERMOST_WEIGHT, TOTAL_WEIGHT = 0.3, 5.0  # in its fit: few particles are in the first shell, and the last is all mass
CUSPY = 0.5  # inner slope -d ln rho / d ln r from which on the force is that of a cusp
SOFTENING = 0.02  # of the force of a cusp, in units of the scale radius
REACH = 30.0  # distance beyond which nothing is bound, in units of the scale radius
DYNAMICAL = 0.3  # longest step in units of (a^3 / G M)^(1/2)
INSIDE = np.arange(1, SHELLS + 1) / SHELLS  # d^2 / (d^2 + b^2) at the outer edges of the shells


class Monopole(Potential):
    """A sphere whose force is that of a Plummer sphere, or of a cusp, times a polynomial in y = b^2 / (d^2 + b^2).

    It is ``-G F(y) d / [(d^2 + b^2) (d^2 + e^2)^(1/2)]`` with e = b without a cusp, and e = 0.02 b with one: the mass
    of a Plummer sphere, and that of a sphere of density r^-1 deep inside, are then the first coefficient alone.
    """

    kind = "restricted_nbody_monopole"
    example: ClassVar[dict[str, Any]] = {**{f"c{j}": 1e9 * (j == 0) for j in range(DEGREE + 1)}, "b": 1.0, "e": 1.0}

    c0: Number
    c1: Number
    c2: Number
    c3: Number
    c4: Number
    c5: Number
    c6: Number
    c7: Number
    c8: Number
    b: Length
    e: Length

    @staticmethod
    def acceleration(x: Any, y: Any, z: Any, t: Any, c0: Any, c1: Any, c2: Any, c3: Any, c4: Any, c5: Any, c6: Any,
                     c7: Any, c8: Any, b: Any, e: Any) -> Any:  # fmt: skip
        """Return the force; one division and one root serve both factors."""
        d2 = x * x + y * y + z * z
        w, s = d2 + b * b, d2 + e * e
        root = sqrt(s)
        inverse = 1.0 / (w * s)
        u = b * b * s * inverse
        f = c0 + u * (c1 + u * (c2 + u * (c3 + u * (c4 + u * (c5 + u * (c6 + u * (c7 + u * c8)))))))
        k = -G * f * root * inverse
        return k * x, k * y, k * z


class RestrictedNbody(LiveStripping):
    """Restricted N-body: debris leaves a live progenitor where and when the tide takes it. No constant is fitted.

    Particles drawn from the progenitor's isotropic distribution function at the look-back time move as test particles
    in the host and in the monopole of those that are still bound, renewed every 20 Myr. Bound mass, tidal radius and
    stripping times follow. ``mass`` and the radius of the progenitor are those at the look-back time; the mass that is
    left today is a result. Any sphere with a density and a finite mass will do: in closed form `plummer` and
    `hernquist`, others by Eddington's formula. The progenitor follows the orbit of a point of its whole mass: it loses
    no energy to its debris.
    """

    kind = "restricted_nbody"
    reference = (
        "Vasiliev 2019, MNRAS 482, 1525 (AGAMA, whose example is called so); Eddington 1916, MNRAS 76, 572 (the "
        "distribution function)"
    )

    def longest_step(self, satellite: SatelliteView, orbit: Orbit) -> float:
        """Return 0.3 dynamical times (a^3 / G M)^(1/2)."""
        return float(DYNAMICAL * np.sqrt(satellite.scale**3 / (G * satellite.mass)))

    def renew(self, edge: BlockEdge, satellite: SatelliteView, before: Remnant | None) -> Remnant:
        """Return the monopole of all particles that are bound in the one before, judged anew by their energy."""
        last = before.force if before and isinstance(before.force, Monopole) else _whole(satellite)
        reach = REACH * last.b
        bound, shells = engine.bound_shells(edge.q, edge.v, edge.mass, edge.core, _depth(last), last.b, reach, SHELLS)
        inside = np.cumsum(shells)
        return Remnant(_monopole(inside, last.b, last.e), float(inside[-1]), bound)


@cache
def _fit() -> tuple[Array, Array]:
    """(9, 64) matrix of the least squares, to be applied to what the polynomial is at `INSIDE`; and (64, 9) back."""
    powers = np.vander(1 - INSIDE, DEGREE + 1, increasing=True)
    weight = np.ones(SHELLS)
    weight[0], weight[-1] = INNERMOST_WEIGHT, TOTAL_WEIGHT
    return np.linalg.pinv(powers * weight[:, None]) * weight, powers


def _shape(b: float, e: float) -> Array:
    """(64,) Mass over polynomial at `INSIDE`: 1 at infinity, which is the last."""
    softened = np.sqrt(INSIDE + (1 - INSIDE) * (e / b) ** 2)  # (d^2 + e^2)^(1/2) / (d^2 + b^2)^(1/2)
    return np.asarray(INSIDE**1.5 / softened)


def _monopole(inside: Array, b: float, e: float) -> Monopole:
    """Return the monopole of masses (64,) inside the outer edges of the shells."""
    values = (_fit()[0] @ (inside / _shape(b, e))).tolist()
    names = [f"c{j}" for j in range(DEGREE + 1)]
    return Monopole.model_construct(**dict(zip(names, values, strict=True)), b=b, e=e)  # without checks: these are ours


def _whole(satellite: SatelliteView) -> Monopole:
    """Return the monopole of the progenitor at the look-back time, with a cusp if it has one."""
    b = satellite.scale
    low, high = satellite.mass_inside(b * np.array([0.01, 0.03])).tolist()
    slope = 3 - np.log(high / low) / np.log(3)
    d = b * np.sqrt(INSIDE[:-1] / (1 - INSIDE[:-1]))
    inside = np.append(satellite.mass_inside(np.minimum(d, satellite.cut)), satellite.mass)
    return _monopole(inside, b, SOFTENING * b if slope > CUSPY else b)


def _depth(monopole: Monopole) -> Array:
    """(9,) Coefficients of its potential, as `engine.bound_shells` takes them: exact for a core, fitted for a cusp."""
    c = np.array([getattr(monopole, f"c{j}") for j in range(DEGREE + 1)])
    if monopole.e == monopole.b:
        return np.asarray(c / (2 * np.arange(DEGREE + 1) + 1))
    matrix, powers = _fit()
    pull = powers @ c * _shape(monopole.b, monopole.e) / INSIDE**1.5  # d Phi / ds over -G, s = (d^2 + b^2)^(-1/2)
    s = np.sqrt(1 - INSIDE)  # in units of 1 / b
    steps = 0.5 * (pull[1:] + pull[:-1]) * (s[:-1] - s[1:])
    depth = np.append(np.cumsum(steps[::-1])[::-1], 0.0)
    over = np.append(depth[:-1] / s[:-1], pull[-1])
    return np.asarray(matrix @ over)
