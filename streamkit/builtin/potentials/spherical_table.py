"""A built-in spherical host from a table: a spline between the knots, power laws beyond them."""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import Field, model_validator
from scipy.interpolate import CubicSpline

import streamkit as sk
from streamkit import Array, G, cubic, cubic_pieces, exp, log

CELLS = 1024  # approximate number of cells of the even grid: the force is the spline's to 1e-9 for ten knots a decade
FLAT = 1e-6  # smaller slopes of v_c^2 count as zero beyond the last knot: the potential is then a logarithm


class Spline(NamedTuple):
    """The squared circular speed on an even grid in ln r.

    ``low`` and ``high`` are ln r of the first and last knot, ``inner`` and ``outer`` the slopes of ln v_c^2 there,
    ``pieces`` (n, 4) its cubics, ``depth`` (n + 1,) the potential at the nodes.
    """

    low: float
    high: float
    inner: float
    outer: float
    pieces: Array
    depth: Array


class SphericalTable(sk.Spherical):
    """Spherical host from a table of circular speeds, or of masses inside radii, each of which may have a prior.

    ``ln v_c`` (or ``ln M``) is a natural cubic spline in ``ln r``: twice differentiable, and exact for a power law.
    Inside the first and beyond the last knot it is a power law with the slope of that knot. Parameters are rejected if
    the mass falls with radius somewhere. The potential is zero at infinity if v_c falls beyond the last knot, else at
    that knot.
    """

    kind = "spherical_table"
    example = {"r": [2.0, 8.0, 30.0, 100.0, 300.0], "v_c": [220.0, 237.0, 205.0, 155.0, 115.0]}
    reference = "Gibbons, Belokurov & Evans 2014, MNRAS 445, 3788, who fit M(r) instead by a closed form"

    r: Annotated[sk.LengthArray, sk.Increasing(least=2)] = Field(description="Radii of the knots.")
    v_c: sk.SpeedArray | None = Field(default=None, description="Circular speeds at the knots; or give the masses.")
    mass: sk.MassArray | None = Field(default=None, description="Masses inside the knots; or give the circular speeds.")

    @model_validator(mode="after")
    def _one_of_two(self) -> SphericalTable:
        given = {name: value for name, value in (("v_c", self.v_c), ("mass", self.mass)) if value is not None}
        if len(given) != 1:
            raise ValueError(f"expected one of v_c and mass, found {' and '.join(given) or 'neither'}")
        ((name, values),) = given.items()
        if len(values) != len(self.r):
            raise ValueError(f"r has {len(self.r)} knots and {name} {len(values)}: expected as many")
        if not (values > 0).all():
            raise ValueError(f"{name} must be positive, found {values.min():g}")
        return self

    @staticmethod
    def prepare(r: Array, v_c: Array | None, mass: Array | None) -> Spline:
        """Return the spline on its even grid. OutOfDomain if the mass falls somewhere."""
        u = np.log(r)
        squared = v_c**2 if mass is None else G * mass / r  # type: ignore[operator]  # one of the two is given
        spline = CubicSpline(u, np.log(squared), bc_type="natural")
        count = (len(r) - 1) * max(CELLS // (len(r) - 1), 1)  # nodes meet the knots of an even table
        nodes = np.linspace(u[0], u[-1], count + 1)
        v2, slope = np.exp(spline(nodes)), spline(nodes, 1)
        if slope.min() < -1 - 1e-9:
            raise sk.OutOfDomain("the mass of the spherical_table falls with radius somewhere")
        h = (u[-1] - u[0]) / count
        pieces = cubic_pieces(v2, v2 * slope * h)
        risen = np.concatenate([[0.0], np.cumsum(h * pieces @ [1, 1 / 2, 1 / 3, 1 / 4])])
        outer = float(slope[-1])
        at_last = v2[-1] / outer if outer < -FLAT else 0.0
        return Spline(u[0], u[-1], float(slope[0]), outer, pieces, at_last + risen - risen[-1])

    @staticmethod
    def pull(r2: Any, low: Any, high: Any, inner: Any, outer: Any, pieces: Any, depth: Any) -> Any:
        """Return -v_c^2 / r^2."""
        u = 0.5 * log(r2)
        beyond = inner * np.minimum(u - low, 0.0) + outer * np.maximum(u - high, 0.0)
        return -cubic(u, (low, high), pieces) * exp(beyond) / r2

    @staticmethod
    def well(r2: Any, low: Any, high: Any, inner: Any, outer: Any, pieces: Any, depth: Any) -> Any:
        """Return the integral of v_c^2 over ln r, exact for the pieces."""
        u = 0.5 * np.log(r2)
        h = (high - low) / len(pieces)
        s = np.clip((u - low) / h, 0, len(pieces))
        k = np.minimum(s.astype(int), len(pieces) - 1)
        s, (a, b, c, d) = s - k, pieces[k].T
        within = depth[k] + h * s * (a + s * (b / 2 + s * (c / 3 + s * d / 4)))
        v2 = pieces[0, 0], pieces[-1].sum()
        return within + v2[0] * _power(u - low, inner, -1) + v2[1] * _power(u - high, outer, 1)


def _power(u: Any, slope: Any, side: int) -> Any:
    """Integral from 0 to u of exp(slope u), zero on the other side of 0."""
    u = np.maximum(u, 0.0) if side > 0 else np.minimum(u, 0.0)
    return u if abs(slope) < FLAT else np.expm1(slope * u) / slope
