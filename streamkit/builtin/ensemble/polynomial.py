"""Polynomials of whitened coordinates, fitted by weighted ridge regression."""

from __future__ import annotations

from functools import cache
from itertools import combinations_with_replacement
from typing import Any

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.special import expit

from streamkit import Array, IntArray

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


def monomials(x: Array, degree: int) -> Array:
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


def count(d: int, degree: int) -> int:
    """Return the number of monomials up to a degree."""
    total = term = 1
    for k in range(1, degree + 1):
        term = term * (d + k - 1) // k
        total += term
    return total
