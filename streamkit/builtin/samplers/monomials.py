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
