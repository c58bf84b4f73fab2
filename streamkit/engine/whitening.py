"""Compiled code for data with one joint Gaussian: the residual of each datum, given those before it."""

from __future__ import annotations

import math

import numpy as np
from numba import types

from streamkit.engine.cache import cached
from streamkit.stream import Array, IntArray

ROWS = 16  # points that are computed side by side
_F1, _F2, _I1, _F = types.float64[::1], types.float64[:, ::1], types.int64[::1], types.float64


@cached(types.void(_F2, _F2, _F2, _I1, _I1, _F2, _F2, _F1, _F, _F2, _F2))
def _whiten(away, diagonal, squares, column, first, size, length, pairs, farthest, white, scale):
    """Fill white and scale (n, m); see `whiten`."""
    n, m = away.shape
    k, columns = pairs.shape[0], size.shape[1]
    root, alike, sum_of = np.empty((m, m, ROWS)), np.zeros((m, m, ROWS)), np.empty(ROWS)
    given, own, last = np.empty((m, ROWS)), np.empty((m, ROWS)), np.full((columns, ROWS), np.nan)
    for begin in range(0, n, ROWS):
        rows = min(ROWS, n - begin)
        for r in range(rows):
            known = True
            for i in range(m):
                known = known and abs(away[begin + r, i]) < farthest and math.isfinite(diagonal[begin + r, i])
            for i in range(m):
                given[i, r], own[i, r] = (away[begin + r, i], diagonal[begin + r, i]) if known else (np.nan, 1.0)
            for c in range(columns):
                if length[begin + r, c] != last[c, r]:
                    last[c, r] = length[begin + r, c]
                    for i in range(m):
                        for j in range(first[i], i + 1):
                            if column[i] == c and column[j] == c:
                                alike[i, j, r] = math.exp(-squares[i, j] / (2 * last[c, r] ** 2))
        for i in range(m):  # a row of the root of the covariance (Cholesky), and of its inverse diagonal
            for j in range(first[i], i + 1):
                c, pair = column[i], pairs[j] if j < k and i == j + k else 0.0
                for r in range(rows):
                    sum_of[r] = pair + (own[i, r] if i == j else 0.0)
                if c >= 0 and c == column[j]:
                    for r in range(rows):
                        sum_of[r] += size[begin + r, c] ** 2 * alike[i, j, r]
                for p in range(first[i], j):
                    for r in range(rows):
                        sum_of[r] -= root[i, p, r] * root[j, p, r]
                if i > j:
                    for r in range(rows):
                        root[i, j, r] = sum_of[r] * root[j, j, r]
                        given[i, r] -= root[i, j, r] * given[j, r]
            for r in range(rows):
                least = own[i, r]  # no eigenvalue of the covariance is smaller
                if i < 2 * k:
                    other = own[i - k if i >= k else i + k, r]
                    least = (least * other - pairs[i % k] ** 2) / (least + other)
                scale[begin + r, i] = math.sqrt(max(sum_of[r], least))
                root[i, i, r] = 1.0 / scale[begin + r, i]
                given[i, r] *= root[i, i, r]
                white[begin + r, i] = given[i, r]


def whiten(
    away: Array,
    diagonal: Array,
    squares: Array,
    column: IntArray,
    first: IntArray,
    size: Array,
    length: Array,
    pairs: Array,
    farthest: float,
) -> tuple[Array, Array]:
    """Return residuals (n, m), each given those before it, in units of their standard deviations (n, m).

    NaN at points with a residual beyond ``farthest``, or without a finite variance.

    Parameters
    ----------
    away, diagonal
        (n, m) residuals, and variances of errors that are independent.
    squares
        (m, m) squared distances of the data.
    column
        (m,) which of c errors a datum shares with others, -1 for none.
    first
        (m,) the first datum that each may share an error with: those between have the same first one.
    size, length
        (n, c) of these errors: two data at distance d have the covariance size^2 exp(-d^2 / (2 length^2)).
    pairs
        (k,) covariances of the errors of each of the first k data and its fellow among the next k.
    """
    white, scale = np.full((2, *away.shape), np.nan)
    numbers = [np.ascontiguousarray(each, dtype=float) for each in (away, diagonal, squares, size, length, pairs)]
    which = [np.ascontiguousarray(each, dtype=np.int64) for each in (column, first)]
    _whiten(*numbers[:3], *which, *numbers[3:], farthest, white, scale)
    return white, scale
