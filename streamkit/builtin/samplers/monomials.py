"""The monomials of several coordinates up to a degree, for the polynomials of both surrogates."""

from __future__ import annotations

from functools import cache
from itertools import combinations_with_replacement
from typing import Any

import numpy as np

from streamkit import Array, IntArray


def monomials(x: Array, degree: int) -> Array:
    """(n, terms) All monomials of x (n, d) up to the degree, each made from one of a degree less."""
    blocks = [np.ones((len(x), 1)), *([x] if degree > 0 else [])]
    for k in range(2, degree + 1):
        parent, factor = _recipe(x.shape[1], k)
        blocks.append(blocks[-1][:, parent] * x[:, factor])
    return np.concatenate(blocks, axis=1)


def differentiated(coefficients: Array, d: int, degree: int) -> Array:
    """(terms, d, k) Coefficients of the slopes along each of d coordinates: polynomials of one degree less.

    Parameters
    ----------
    coefficients
        (terms, k) of polynomials of this degree.
    """
    parents, powers = _derivatives(d, degree)
    found = np.zeros((count(d, max(degree - 1, 0)), d, coefficients.shape[1]))
    for i in range(d):
        mine = np.flatnonzero(powers[:, i])  # their parents differ
        found[parents[mine, i], i] = powers[mine, [i]][:, None] * coefficients[mine]
    return found


@cache
def _derivatives(d: int, degree: int) -> tuple[IntArray, IntArray]:
    """Return of each monomial (terms, d) that with one factor x_i less, and the power of x_i."""
    all_of_it = [c for k in range(degree + 1) for c in combinations_with_replacement(range(d), k)]
    index = {c: i for i, c in enumerate(all_of_it)}
    powers = np.array([[c.count(i) for i in range(d)] for c in all_of_it], dtype=np.int64).reshape(-1, d)
    parents = np.zeros_like(powers)
    for row, c in enumerate(all_of_it):
        for i in set(c):
            at = c.index(i)
            parents[row, i] = index[c[:at] + c[at + 1 :]]
    return parents, powers


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
