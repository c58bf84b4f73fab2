"""A polynomial stand-in for the model, learned from what the walkers tried: what the observables are there."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import combinations_with_replacement
from typing import Any

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.special import expit

from streamkit.observe import Data
from streamkit.stream import Array, BoolArray, IntArray

DEGREES = (3, 2)
"""Polynomials that are tried, if there are enough points for them."""
RIDGES = (1e-5, 1e-3)
"""Ridge penalties that are tried, in units of the mean diagonal of the normal equations."""
POINTS_PER_TERM = 3.0
HELD_OUT = 0.25
"""Fraction of the points, the newest, on which the fits are judged: walkers go on to where they have not been."""
MAX_TERMS = 1000
MAX_POINTS = 20000
FREEDOM, MISFIT = 8.0, 3.0
"""Degrees of freedom of the surrogate's likelihood: the first, plus the second times the chi^2 of the best points.
Where even these are far from the data, a heavier tail would not tell them from worse ones."""
EXTRAPOLATED = 2.0
"""Power of |x|^2 by which the square of the polynomial's error grows beyond the farthest point that it knows."""
LEAST, WILD = 0.25, 25.0
"""Least and largest square of a polynomial's error, in units of the typical one."""
SMOOTH = 1e-2
"""Ridge penalty of the fit of these squares."""
UNLIKELY, ITERATIONS = 0.05, 12
"""Least probability of an observable, as its fit is never trusted to the end, and the iterations of that fit."""
BEST = 0.02
"""Fraction of the points that are the best ones."""
NEAR, FAR = 3.0, 0.02
"""Points with residuals of so many standard errors count half in the fit; those that count less than the second number
say nothing of how far it reaches."""


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
        (m,) of the data, in units of their own: 1, plus the model's noise if added.
    spread, least
        (quadratic terms, m) coefficients of the square of the polynomial's own error, and (m,) the least it is.
    freedom
        Degrees of freedom of its Student's t.
    known
        Largest |x|^2 of the training points but for those with residuals far too large.
    points
        (n, d) training points near the data.
    exists
        (quadratic terms,) coefficients of the log odds that there is an observable.
    """

    centre: Array
    whiten: Array
    degree: int
    coefficients: Array
    variance: Array
    spread: Array
    least: Array
    freedom: float
    known: float
    points: Array
    exists: Array

    def ln_likelihood(self, y: Array) -> Array:
        """(n,) ln likelihood at coordinates y (n, d), times the probability that there is an observable at all.

        Wider where the polynomial errs more, and Student's t in place of the Gaussian: where the surrogate is far too
        low, a walker would stay for good. Far outside the training points a polynomial says nothing; a penalty keeps
        walks on the surrogate from getting lost there.
        """
        x = (y - self.centre) @ self.whiten
        terms = _terms(x, self.degree)
        beyond = np.maximum(np.sum(x**2, axis=1) / self.known, 1.0)
        error2 = np.maximum(terms[:, : len(self.spread)] @ self.spread, self.least) * beyond[:, None] ** EXTRAPOLATED
        variance = self.variance + error2
        chi2 = np.sum((terms @ self.coefficients) ** 2 / variance, axis=1)
        exists = np.log(np.maximum(expit(terms[:, : len(self.exists)] @ self.exists), UNLIKELY))
        tail = 0.5 * (self.freedom + len(self.variance)) * np.log1p(chi2 / self.freedom)
        tail += 0.5 * np.log(variance).sum(axis=1)
        return np.asarray(exists - tail - 0.5 * x.shape[1] * (beyond - 1.0))


def learn(points: Array, mean: Array, variance: Array, data: Data) -> Surrogate | None:
    """Fit the observables; None if there are too few points, or if they do not span the space.

    Degree and ridge are those of which a fit to the older points predicts the newest best.

    Parameters
    ----------
    points
        (n, d) coordinates at which the model was evaluated, the oldest first.
    mean, variance
        (n, m) what the model predicts there, and the variance of that estimate; NaN where there is no observable.
    data
        The m data.
    """
    used = np.isfinite(data.values)
    points, mean, variance = points[-MAX_POINTS:], mean[-MAX_POINTS:, used], variance[-MAX_POINTS:, used]
    there: BoolArray = np.asarray(np.isfinite(mean).all(axis=1), dtype=bool)
    y, sigma = points[there], data.errors[used]
    residual = (mean[there] - data.values[used]) / sigma
    weight = 1 / (1 + np.sum(residual**2, axis=1) / NEAR**2)
    n, d = y.shape
    degrees = [k for k in DEGREES if POINTS_PER_TERM * _count(d, k) <= n and _count(d, k) <= MAX_TERMS]
    choices = [(degree, ridge) for degree in degrees for ridge in RIDGES]
    if not choices:
        return None
    try:
        centre, whiten = _whitening(y, weight)
        x = (points - centre) @ whiten
        terms = {degree: _terms(x, degree) for degree in degrees}
        own = [_error(terms[degree][there], residual, weight, ridge) for degree, ridge in choices]
        best = int(np.argmin([value.sum() for value in own]))
        degree, ridge = choices[best]
        quadratic, found = terms[degree][:, : _count(d, 2)], terms[degree][there]
        coefficients = _fit(found, residual, weight, ridge)
        spread = _spread(quadratic[there], residual - found @ coefficients, weight, own[best])
        exists = _log_odds(quadratic, there.astype(float), RIDGES[0])
    except LinAlgError:  # walkers that hardly moved
        return None
    noise = np.median(variance[there], axis=0) / sigma**2 * data.add_noise
    near = _near(weight)
    known = float(np.max(np.sum(x[there][near | (weight >= FAR)] ** 2, axis=1)))
    least = LEAST * own[best]
    freedom = FREEDOM + MISFIT * float(np.quantile(np.sum(residual**2, axis=1), BEST))
    return Surrogate(centre, whiten, degree, coefficients, 1.0 + noise, spread, least, freedom, known, y[near], exists)


def _whitening(y: Array, weight: Array) -> tuple[Array, Array]:
    """(d,) and (d, d) Centre and matrix of x = (y - centre) @ matrix: half a standard deviation is 1.

    The powers of x then stay of order one.
    """
    covariance = np.atleast_2d(np.cov(y.T, aweights=weight))
    centre = np.asarray(np.average(y, axis=0, weights=weight), dtype=float)
    return centre, np.asarray(0.5 * np.linalg.inv(np.linalg.cholesky(covariance)).T, dtype=float)


def _near(weight: Array) -> BoolArray:
    """(n,) The points near the data, or the nearer half of all."""
    return np.asarray(weight >= min(0.5, float(np.median(weight))), dtype=bool)


def _spread(terms: Array, left: Array, weight: Array, own: Array) -> Array:
    """(terms, m) The squares of what a fit left over (n, m), as a fit, on the scale of its error on new points (m,)."""
    scale = own / np.maximum(_robust(left[_near(weight)]), 1e-12)
    return _fit(terms, np.minimum(left**2 * scale, WILD * own), weight, SMOOTH)


def _robust(left: Array) -> Array:
    """(m,) Variance from the median: that of chi^2 with one degree of freedom is 0.455. Outliers leave it alone."""
    return np.asarray(np.median(left**2, axis=0) / 0.455)


def _log_odds(terms: Array, there: Array, ridge: float) -> Array:
    """(terms,) Coefficients of the log odds of 1 against 0 in there (n,): logistic regression by reweighting."""
    odds = np.zeros(len(there))
    for _ in range(ITERATIONS):
        p = expit(odds)
        weight = np.maximum(p * (1 - p), 1e-4)
        coefficients = _fit(terms, odds + (there - p) / weight, weight, ridge)
        odds = np.clip(terms @ coefficients, -20.0, 20.0)
    return coefficients


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
    return _robust((residual - terms @ coefficients)[old:][near])


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
