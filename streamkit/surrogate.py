"""A polynomial stand-in for the model, learned from what the walkers tried: what the observables are there."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import combinations_with_replacement
from typing import Any

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from streamkit.phase import Array, BoolArray, IntArray

DEGREES = (3, 2)
"""Polynomials that are tried, if there are enough points for them."""
RIDGES = (1e-5, 1e-3)
"""Ridge penalties that are tried, in units of the mean diagonal of the normal equations."""
POINTS_PER_TERM = 3.0
HELD_OUT = 0.25
"""Fraction of the points, the newest, on which the fits are judged: walkers go on to where they have not been."""
MAX_TERMS = 1000
MAX_POINTS = 20000
FREEDOM = 8.0
"""Degrees of freedom of the surrogate's likelihood."""
NEAR = 3.0
"""Points with residuals of so many standard errors count half in the fit."""


@dataclass(frozen=True)
class Data:
    """What the observables are compared with: (m,) values, NaN where there is none, and their standard errors."""

    values: Array
    errors: Array
    add_noise: bool = False


@dataclass(frozen=True)
class Surrogate:
    """Residuals (prediction - datum) / error as polynomials of the whitened coordinates.

    Attributes
    ----------
    centre, whiten
        (d,) and (d, d): x = (y - centre) @ whiten.
    coefficients
        (terms, m).
    variance
        (m,) of the residuals: 1, plus the polynomial's own error on new points, plus the model's noise if added.
    reach
        Largest |x|^2 of the training points near the data.
    points
        (n, d) those points.
    """

    centre: Array
    whiten: Array
    degree: int
    coefficients: Array
    variance: Array
    reach: float
    points: Array

    def ln_likelihood(self, y: Array) -> Array:
        """(n,) ln likelihood at coordinates y (n, d), less what grows outside the training points.

        Student's t in place of the Gaussian: where the polynomial errs, and the surrogate is far too low, a walker
        would stay for good. Outside the training points a polynomial says nothing; the penalty keeps walks on the
        surrogate from getting lost.
        """
        x = (y - self.centre) @ self.whiten
        chi2 = np.sum((_terms(x, self.degree) @ self.coefficients) ** 2 / self.variance, axis=1)
        outside = np.maximum(np.sum(x**2, axis=1) / self.reach - 1.0, 0.0)
        tail = 0.5 * (FREEDOM + len(self.variance)) * np.log1p(chi2 / FREEDOM)
        return np.asarray(-tail - 0.5 * x.shape[1] * outside)


def learn(points: Array, mean: Array, variance: Array, data: Data) -> Surrogate | None:
    """Fit the observables; None if there are too few points, or if they do not span the space.

    Degree and ridge are those of which a fit to the older points predicts the newest best.

    Parameters
    ----------
    points
        (n, d) coordinates at which the model was evaluated, the oldest first.
    mean, variance
        (n, m) what the model predicts there, and the variance of that estimate.
    data
        The m data.
    """
    used = np.isfinite(data.values)
    y, sigma = points[-MAX_POINTS:], data.errors[used]
    residual = (mean[-MAX_POINTS:, used] - data.values[used]) / sigma
    weight = 1 / (1 + np.sum(residual**2, axis=1) / NEAR**2)
    n, d = y.shape
    degrees = [k for k in DEGREES if POINTS_PER_TERM * _count(d, k) <= n and _count(d, k) <= MAX_TERMS]
    choices = [(degree, ridge) for degree in degrees for ridge in RIDGES]
    if not choices:
        return None
    try:
        centre, whiten = _whitening(y, weight)
        x = (y - centre) @ whiten
        own = [_error(_terms(x, degree), residual, weight, ridge) for degree, ridge in choices]
        best = int(np.argmin([value.sum() for value in own]))
        degree, ridge = choices[best]
        coefficients = _fit(_terms(x, degree), residual, weight, ridge)
    except LinAlgError:  # walkers that hardly moved
        return None
    noise = np.median(variance[-MAX_POINTS:, used], axis=0) / sigma**2 * data.add_noise
    near = _near(weight)
    reach = float(np.max(np.sum(x[near] ** 2, axis=1)))
    return Surrogate(centre, whiten, degree, coefficients, 1.0 + own[best] + noise, reach, y[near])


def _whitening(y: Array, weight: Array) -> tuple[Array, Array]:
    """(d,) and (d, d) Centre and matrix of x = (y - centre) @ matrix: half a standard deviation is 1.

    The powers of x then stay of order one.
    """
    covariance = np.atleast_2d(np.cov(y.T, aweights=weight))
    centre = np.asarray(np.average(y, axis=0, weights=weight), dtype=float)
    return centre, np.asarray(0.5 * np.linalg.inv(np.linalg.cholesky(covariance)).T, dtype=float)


def _near(weight: Array) -> BoolArray:
    """(n,) The points near the data, or the nearer half of all."""
    return np.asarray(weight >= min(0.5, float(np.median(weight))))


def _fit(terms: Array, residual: Array, weight: Array, ridge: float) -> Array:
    """(terms, m) Coefficients of the weighted ridge regression."""
    a = terms * weight[:, None]
    normal = a.T @ terms
    normal[np.diag_indices_from(normal)] += ridge * np.trace(normal) / len(normal)
    return np.asarray(cho_solve(cho_factor(normal, lower=True), a.T @ residual))


def _error(terms: Array, residual: Array, weight: Array, ridge: float) -> Array:
    """(m,) Variance about a fit to the older points, at the newest points near the data."""
    old = int((1 - HELD_OUT) * len(terms))
    coefficients = _fit(terms[:old], residual[:old], weight[:old], ridge)
    near = _near(weight[old:])
    # the median of chi^2 with one degree of freedom is 0.455: a variance that outliers leave alone
    return np.asarray(np.median((residual - terms @ coefficients)[old:][near] ** 2, axis=0) / 0.455)


def _terms(x: Array, degree: int) -> Array:
    """(n, terms) All monomials of x (n, d) up to the degree, each made from one of a degree less."""
    blocks = [np.ones((len(x), 1)), x]
    for k in range(2, degree + 1):
        parent, factor = _recipe(x.shape[1], k)
        blocks.append(blocks[-1][:, parent] * x[:, factor])
    return np.concatenate(blocks, axis=1)


@cache
def _recipe(d: int, degree: int) -> tuple[IntArray, IntArray]:
    """Return the monomials of a degree as (monomial of one degree less, one more coordinate)."""
    lower: dict[Any, int] = {c: i for i, c in enumerate(combinations_with_replacement(range(d), degree - 1))}
    all_of_it = list(combinations_with_replacement(range(d), degree))
    return np.array([lower[c[:-1]] for c in all_of_it]), np.array([c[-1] for c in all_of_it])


def _count(d: int, degree: int) -> int:
    """Return the number of monomials up to a degree."""
    total = term = 1
    for k in range(1, degree + 1):
        term = term * (d + k - 1) // k
        total += term
    return total
