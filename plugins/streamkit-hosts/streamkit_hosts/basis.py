"""EXP's basis `sphereSL`: the functions of radius that suit a spherical model, by a Sturm-Liouville equation.

With the model's density rho0 and potential Phi0 < 0 (G = 1), Phi_ln = u Phi0 / sqrt(lambda), where (Weinberg 1999, AJ
117, 629; Petersen, Weinberg & Katz 2022, MNRAS 510, 6201)

    -(r^2 Phi0^2 u')' + (l (l + 1) Phi0 - 4 pi r^2 rho0) Phi0 u = -4 pi lambda r^2 rho0 Phi0 u.

Outside the last radius there is no mass: u Phi0 falls as r^-(l + 1). At the first radius u vanishes, and for l = 0 its
slope is Phi0' / Phi0 times it. EXP takes the model linear between its rows, and so does this: the slope of Phi0 at the
last radius is that of the last rows. The integral of -4 pi r^2 rho0 Phi0 u^2 is 1, and u > 0 near the first radius.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, CubicSpline
from scipy.linalg import LinAlgError, eigh

from streamkit import Array, StreamkitError

DEGREE = 5  # of the splines in ln r by which u is found
PIECES, FOR_EACH = 300, 12  # fewest pieces of them, and pieces for each function
FIDUCIAL = 3  # EXP's fourth node has the sign of a function


@dataclass(frozen=True)
class Model:
    """A spherical model: radii (k,), density and potential, in units of its own with G = 1."""

    radius: Array
    density: Array
    potential: Array

    def slope(self, r: float) -> float:
        """Return the slope of the potential, that of the two rows around a radius."""
        k = min(max(int(np.searchsorted(self.radius, r)) - 1, 0), len(self.radius) - 2)
        rise, run = (values[k + 1] - values[k] for values in (self.potential, self.radius))
        return float(rise / run)


class Basis:
    """Functions Phi_ln of radius between two radii, for all l up to ``l_max`` and the first ``n_max`` n.

    ``eigenvalues`` (l, n) are the lambda. ``node`` is EXP's fourth radius, at which u is positive.

    Raises StreamkitError where the model has no such functions.
    """

    def __init__(self, model: Model, l_max: int, n_max: int, first: float, last: float, node: float) -> None:
        self._potential = CubicSpline(np.log(model.radius), model.potential)
        self.first, self.last = first, last
        pieces = max(PIECES, FOR_EACH * n_max)
        breaks = np.linspace(np.log(first), np.log(last), pieces + 1)
        knots = np.concatenate([[breaks[0]] * DEGREE, breaks, [breaks[-1]] * DEGREE])
        count = len(knots) - DEGREE - 1
        point, weight = np.polynomial.legendre.leggauss(DEGREE + 1)
        step = breaks[1] - breaks[0]
        s = (breaks[:-1, None] + step * (point + 1) / 2).ravel()
        weight, r = np.tile(weight * step / 2, pieces), np.exp(s)
        shape = BSpline.design_matrix(s, knots, DEGREE).toarray()
        bend = BSpline(knots, np.eye(count), DEGREE).derivative()(s)
        phi, rho = (np.interp(r, model.radius, values) for values in (model.potential, model.density))
        source = -4 * np.pi * rho * r**3 * phi  # r^3: one is dr / ds
        stiff = bend.T @ (bend * (weight * r * phi**2)[:, None]) + shape.T @ (shape * (weight * source)[:, None])
        turning = shape.T @ (shape * (weight * phi**2 * r)[:, None])
        norm = shape.T @ (shape * (weight * source)[:, None])
        ends = [(x, float(np.interp(x, model.radius, model.potential)), model.slope(x)) for x in (first, last)]
        (a, at_a, slope_a), (b, at_b, slope_b) = ends
        values, functions = [], []
        for degree in range(l_max + 1):
            form = stiff + degree * (degree + 1) * turning
            form[-1, -1] += ((1 + degree) / b + slope_b / at_b) * b**2 * at_b**2
            form[0, 0] += slope_a * at_a * a**2 if degree == 0 else 0.0
            free = slice(0 if degree == 0 else 1, None)  # without the first spline u vanishes at the first radius
            size = count - (degree > 0)
            try:  # of the inverse: the norm of a model with an edge is singular
                inverse, vectors = eigh(norm[free, free], form[free, free], subset_by_index=[size - n_max, size - 1])
            except (LinAlgError, ValueError):
                inverse, vectors = np.zeros(n_max), np.zeros((size, n_max))
            if not (inverse > 0).all():
                raise StreamkitError(f"the basis has no {n_max} functions of degree {degree}: is its model one body?")
            coefficients = np.zeros((count, n_max))
            coefficients[free] = vectors[:, ::-1]  # of norm 1 in the form: lambda^(-1/2) times u
            function = BSpline(knots, coefficients, DEGREE)
            values.append(1 / inverse[::-1])
            functions.append(BSpline(knots, coefficients * np.where(function(np.log(node)) < 0, -1, 1), DEGREE))
        self.eigenvalues = np.array(values)
        self._functions, self._signs = functions, np.ones((l_max + 1, n_max))

    def turn(self, signs: Array) -> None:
        """Give the functions other signs (l, n): those that are negative change theirs."""
        self._signs = np.where(signs < 0, -self._signs, self._signs)

    def __call__(self, r: Array) -> Array:
        """(l, n, k) Phi_ln at radii (k,) between the first and the last."""
        s = np.log(np.clip(r, self.first, self.last))
        values = np.array([function(s).T for function in self._functions])
        return np.asarray(self._signs[:, :, None] * values * self._potential(s))
