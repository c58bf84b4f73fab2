"""Gaussian information of data and priors, and the bounds that follow from it.

A datum of mean mu and variance s2 has the information dmu dmu / s2 + ds2 ds2 / (2 s2^2) about the parameters that move
both (Kay 1993, section 3.9). Errors that correlate have a constant covariance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from streamkit import Array, BoolArray, IntArray, Prediction
from streamkit.components import Measurement
from streamkit_forecast.predict import Part
from streamkit_forecast.slopes import Slopes


def whitened(slopes: Slopes, noise: bool) -> Array:
    """(seeds, 2 m, k) Slopes of the data and of their variances, in units of their errors; zeros without a datum.

    ``noise`` says whether the likelihood adds the noise of the particles.
    """
    seeds, m, k = slopes.of_mean.shape
    means, variances = np.zeros((seeds, m, k)), np.zeros((seeds, m, k))
    start = 0
    for part in slopes.parts:
        rows = np.arange(start, start := start + len(part.used))[part.used.astype(bool)]
        s2 = slopes.variance[rows]
        if is_coupled(part, noise):
            whole = slopes.of_mean[:, start - len(part.used) : start]
            means[:, rows] = np.array([_residuals_of(part, one, noise) for one in whole])[:, part.used.astype(bool)]
            variances[:, rows] = slopes.of_variance[:, rows] / (np.sqrt(2) * s2)[:, None]
            continue
        if part.covariance is None:
            means[:, rows] = slopes.of_mean[:, rows] / np.sqrt(s2)[:, None]
            variances[:, rows] = slopes.of_variance[:, rows] / (np.sqrt(2) * s2)[:, None]
            continue
        inside = np.ix_(part.used.astype(bool), part.used.astype(bool))
        covariance = part.covariance[inside]
        covariance = covariance + np.diag(np.maximum(s2 - np.diag(covariance), 0.0))
        means[:, rows] = np.linalg.solve(np.linalg.cholesky(covariance)[None], slopes.of_mean[:, rows])
    return np.concatenate([means, variances], axis=1)


def is_coupled(part: Part, noise: bool) -> bool:
    """Return whether the residual of a datum depends on others: its likelihood has correlations of its own."""
    prediction, measurement = part.prediction, part.measurement
    if prediction is None or type(measurement).residuals is Measurement.residuals:
        return False
    before = measurement.residuals(prediction, noise)
    moved, first = prediction.mean.copy(), np.zeros(len(part.used), dtype=bool)
    first[[rows[0] for rows in measurement.quantities().values()]] = True
    moved[first] += np.asarray(measurement.scatter(prediction))[first]
    after = measurement.residuals(replace(prediction, mean=moved), noise)
    if before is None or after is None:
        return False
    return not np.allclose(before[~first], after[~first], equal_nan=True)


def _residuals_of(part: Part, slopes: Array, noise: bool) -> Array:
    """(m, k) Return the slopes of the residuals, which are independent and of variance 1, by slopes (m, k) of means."""
    prediction, columns = cast(Prediction, part.prediction), []
    sd = np.asarray(part.measurement.scatter(prediction))
    for slope in slopes.T:
        step = 1.0 / max(float(np.nanmax(np.abs(slope) / sd)), 1e-300)
        low, high = (
            cast(
                Array,
                part.measurement.residuals(replace(prediction, mean=prediction.mean + sign * step * slope), noise),
            )
            for sign in (-1, 1)
        )
        columns.append((low - high) / (2 * step))
    return np.stack(columns, axis=1)


def product(white: Array, seeds: Sequence[int]) -> Array:
    """(k, k) Information of whitened slopes (all, n, k), by products of different seeds: their noise cancels."""
    some = white[list(seeds)]
    whole = some.sum(axis=0)
    return without_noise(whole.T @ whole, np.einsum("sna,snb->ab", some, some), len(some))


def without_noise(whole: Array, same: Array, seeds: int) -> Array:
    """Return the mean product of different seeds, by the product of the sums and the sum of the products of each."""
    return np.asarray(same if seeds == 1 else (whole - same) / (seeds * (seeds - 1)))


@dataclass(frozen=True, eq=False)
class Source:
    """The whitened slopes (seeds, 2 m, k) of one stream, or of the host, in the parameters ``which`` (k,).

    ``sd`` (k,) are the standard deviations of their priors.
    """

    white: Array
    which: IntArray
    sd: Array

    def information(self, rows: BoolArray, seeds: Sequence[int], d: int) -> Array:
        """(d, d) Return the information of some of the data (m,) about all d parameters.

        Negative eigenvalues, which the noise of the slopes leaves, are none: more data never tell less.
        """
        scale = np.outer(self.sd, self.sd)
        value, vector = np.linalg.eigh(product(self.white[:, np.tile(rows, 2)], seeds) * scale)
        out = np.zeros((d, d))
        out[np.ix_(self.which, self.which)] = (vector * np.maximum(value, 0.0)) @ vector.T / scale
        return out


def covariance(information: Array, sd: Array) -> Array:
    """(d, d) The covariance of parameters by information (d, d) and priors with standard deviations (d,)."""
    scale = np.outer(sd, sd)
    return np.asarray(np.linalg.inv(np.eye(len(sd)) + information * scale) * scale)
