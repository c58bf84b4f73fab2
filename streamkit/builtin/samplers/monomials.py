"""The monomials of several coordinates up to a degree, for the polynomials of both surrogates."""

from __future__ import annotations

from functools import cache
from itertools import combinations_with_replacement
from math import comb

import numpy as np

from streamkit import Array, IntArray


def monomials(x: Array, degree: int) -> Array:
    """(n, terms) All monomials of x (n, d) up to the degree, in order of degree; each term is contiguous in memory.

    Those of a degree whose first factor is x_i are x_i times the last of a degree less: all without x_j, j < i.
    """
    d, found = x.shape[1], np.empty((count(x.shape[1], degree), len(x)))
    found[0] = 1.0
    if degree > 0:
        found[1 : d + 1] = x.T
    end = d + 1
    for k in range(2, degree + 1):
        at = end
        for i in range(d):
            rest = comb(d - i + k - 2, k - 1)
            np.multiply(found[end - rest : end], found[1 + i], out=found[at : at + rest])
            at += rest
        end = at
    return found.T


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


def count(d: int, degree: int) -> int:
    """Return the number of monomials of d coordinates up to a degree."""
    return comb(d + degree, degree)
