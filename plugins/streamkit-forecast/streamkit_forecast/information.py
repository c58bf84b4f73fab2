"""Gaussian information of data and priors, and the bounds that follow from it.

A datum of mean mu and variance s2 has the information dmu dmu / s2 + ds2 ds2 / (2 s2^2) about the parameters that move
both (Kay 1993, section 3.9). Errors that correlate have a constant covariance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from streamkit import Array, BoolArray, IntArray
from streamkit_forecast.slopes import Slopes


def whitened(slopes: Slopes) -> Array:
    """(seeds, 2 m, k) Slopes of the data and of their variances, in units of their errors; zeros without a datum."""
    seeds, m, k = slopes.of_mean.shape
    means, variances = np.zeros((seeds, m, k)), np.zeros((seeds, m, k))
    start = 0
    for part in slopes.parts:
        rows = np.arange(start, start := start + len(part.used))[part.used.astype(bool)]
        s2 = slopes.variance[rows]
        if part.covariance is None:
            means[:, rows] = slopes.of_mean[:, rows] / np.sqrt(s2)[:, None]
            variances[:, rows] = slopes.of_variance[:, rows] / (np.sqrt(2) * s2)[:, None]
            continue
        inside = np.ix_(part.used.astype(bool), part.used.astype(bool))
        covariance = part.covariance[inside]
        covariance = covariance + np.diag(np.maximum(s2 - np.diag(covariance), 0.0))
        means[:, rows] = np.linalg.solve(np.linalg.cholesky(covariance)[None], slopes.of_mean[:, rows])
    return np.concatenate([means, variances], axis=1)


def product(white: Array, seeds: Sequence[int]) -> Array:
    """(k, k) Information of whitened slopes (all, n, k), by products of different seeds: their noise cancels."""
    some = white[list(seeds)]
    whole = some.sum(axis=0)
    same = np.einsum("sna,snb->ab", some, some)
    if len(some) == 1:
        return np.asarray(same)
    return np.asarray((whole.T @ whole - same) / (len(some) * (len(some) - 1)))


@dataclass(frozen=True, eq=False)
class Source:
    """The whitened slopes (seeds, 2 m, k) of one stream, or of the host, in the parameters ``which`` (k,)."""

    white: Array
    which: IntArray

    def information(self, rows: BoolArray, seeds: Sequence[int], d: int) -> Array:
        """(d, d) Return the information of some of the data (m,) about all d parameters."""
        out = np.zeros((d, d))
        out[np.ix_(self.which, self.which)] = product(self.white[:, np.tile(rows, 2)], seeds)
        return out


def covariance(information: Array, sd: Array) -> Array:
    """(d, d) The covariance of parameters by information (d, d) and priors with standard deviations (d,).

    Negative eigenvalues of the information, which the noise of the slopes leaves, are none.
    """
    value, vector = np.linalg.eigh(information * np.outer(sd, sd))
    shrunk = vector / (1.0 + np.maximum(value, 0.0)) @ vector.T
    return np.asarray(shrunk * np.outer(sd, sd))
