"""Polynomials of whitened coordinates, fitted by weighted ridge regression."""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.special import expit

from streamkit import Array

ITERATIONS = 12  # iterations of the fit of a probability


def whitening(y: Array, weight: Array) -> tuple[Array, Array]:
    """(d,) and (d, d) Centre and matrix of x = (y - centre) @ matrix: half a standard deviation is 1.

    The powers of x then stay of order one.
    """
    covariance = np.atleast_2d(np.cov(y.T, aweights=weight))
    centre = np.asarray(np.average(y, axis=0, weights=weight), dtype=float)
    return centre, np.asarray(0.5 * np.linalg.inv(np.linalg.cholesky(covariance)).T, dtype=float)


def log_odds(terms: Array, there: Array, ridge: float) -> Array:
    """(terms,) Coefficients of the log odds of 1 against 0 in there (n,): logistic regression by reweighting."""
    odds = np.zeros(len(there))
    for _ in range(ITERATIONS):
        p = expit(odds)
        weight = np.maximum(p * (1 - p), 1e-4)
        coefficients = fit(terms, odds + (there - p) / weight, weight, ridge)
        odds = np.clip(terms @ coefficients, -20.0, 20.0)
    return coefficients


def fit(terms: Array, residual: Array, weight: Array, ridge: float) -> Array:
    """(terms, m) Coefficients of the weighted ridge regression."""
    a = terms * weight[:, None]
    normal = a.T @ terms
    normal[np.diag_indices_from(normal)] += ridge * np.trace(normal) / len(normal)
    return np.asarray(cho_solve(cho_factor(normal, lower=True), a.T @ residual))
