"""The extra error of a track: alike at near longitudes, so that all data of a column have one joint Gaussian."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from streamkit import Array, engine

# Most data of all columns whose covariances are factorised side by side for many points. Beyond, LAPACK is quicker: of
# each column, and of so many numbers at a time.
FEW, AT_A_TIME = 100, 2**22
# A residual beyond which there is no likelihood.
FARTHEST = 1e100


class ExtraError(NamedTuple):
    """A Gaussian process along the track of one column.

    Attributes
    ----------
    squares
        (k, k) squared differences of the longitudes of its data.
    size, length
        Standard deviation, and the longitude over which it is alike: numbers, or (n, 1) for n points.
    """

    squares: Array
    size: float | Array
    length: float | Array

    def covariance(self, rows: slice = slice(None)) -> Array:
        """Return size^2 exp(-d^2 / (2 length^2)) of data at longitudes that differ by d: (k, k), or of some points."""
        size, length = (each if np.ndim(each) == 0 else np.asarray(each)[rows, :, None] for each in self[1:])
        return np.asarray(size**2 * np.exp(-self.squares / (2 * length**2)))

    def drawn(self, rng: np.random.Generator) -> Array:
        """(k,) Draw the error of each datum."""
        values, vectors = np.linalg.eigh(self.covariance())  # of smooth functions: some are zero, up to rounding
        return np.asarray(vectors @ (np.sqrt(np.maximum(values, 0.0)) * rng.standard_normal(len(values))))


def squares_of(phi1: Array) -> Array:
    """(k, k) Squared differences of longitudes (k,)."""
    return np.subtract.outer(phi1, phi1) ** 2


def whitened(
    away: Sequence[Array], variance: Sequence[Array], extra: Sequence[ExtraError | None], pairs: Array | None
) -> tuple[Array, Array]:
    """Return the residuals (..., m) of columns with extra errors, each given those before it, and their deviations.

    The residuals are in units of the standard deviations (..., m). So they are independent, and of variance 1.

    Parameters
    ----------
    away, variance
        (..., k) of each column: data minus model, and the variances of errors that are independent along the track.
    extra
        The extra error of each column.
    pairs
        (k,) covariances of the errors of the first two columns, datum by datum.
    """
    if sum(np.shape(part)[-1] for part in away) <= FEW:
        return _side_by_side(away, variance, extra, pairs)
    together = 1 if pairs is None else 2
    groups = [slice(together), *(slice(i, i + 1) for i in range(together, len(away)))]
    found = [_factorised(away[each], variance[each], extra[each], pairs if each.start is None else None)
             for each in groups]  # fmt: skip
    white, scale = (np.concatenate(parts, axis=-1) for parts in zip(*found, strict=True))
    return white, scale


def _joined(away: Sequence[Array], variance: Sequence[Array]) -> tuple[Array, Array, tuple[int, ...]]:
    """Return the residuals and variances of all columns, (n, m) each, and the shape (..., m) of the points."""
    joined, diagonal = np.broadcast_arrays(np.concatenate(away, axis=-1), np.concatenate(variance, axis=-1))
    m = joined.shape[-1]
    return joined.reshape(-1, m), diagonal.reshape(-1, m), joined.shape


def _side_by_side(
    away: Sequence[Array], variance: Sequence[Array], extra: Sequence[ExtraError | None], pairs: Array | None
) -> tuple[Array, Array]:
    """Return what `whitened` does, for few data and many points."""
    joined, diagonal, shape = _joined(away, variance)
    m = shape[-1]
    size, length = np.zeros((2, len(joined), len(extra)))
    squares, column, first = np.zeros((m, m)), np.full(m, -1), np.zeros(m, dtype=np.int64)
    begin = 0
    for i, (part, error) in enumerate(zip(away, extra, strict=True)):
        end = begin + np.shape(part)[-1]
        if pairs is None or i > 1:
            first[begin:end] = begin
        if error is not None:
            squares[begin:end, begin:end], column[begin:end] = error.squares, i
            size[:, [i]], length[:, [i]] = error.size, error.length
        begin = end
    none = np.empty(0) if pairs is None else pairs
    white, scale = engine.whiten(joined, diagonal, squares, column, first, size, length, none, FARTHEST)
    return white.reshape(shape), scale.reshape(shape)


def _factorised(
    away: Sequence[Array], variance: Sequence[Array], extra: Sequence[ExtraError | None], pairs: Array | None
) -> tuple[Array, Array]:
    """Return what `whitened` does, of one column or of two with a covariance, for many data."""
    joined, diagonal, shape = _joined(away, variance)
    m = shape[-1]
    white, scale = np.full((2, *joined.shape), np.nan)
    least = diagonal  # no eigenvalue of the covariance is smaller
    if pairs is not None:
        one, other = np.split(diagonal, 2, axis=1)
        least = np.tile((one * other - pairs**2) / (one + other), 2)
    known = np.asarray((np.abs(joined) < FARTHEST).all(axis=1) & np.isfinite(diagonal).all(axis=1))
    for i in range(0, len(joined), step := max(1, AT_A_TIME // m**2)):
        rows = slice(i, i + step)
        # the root of the covariance with one more row, the residuals, has the white ones there
        matrix = np.zeros((len(joined[rows]), m + 1, m + 1))
        first = 0
        for column, error in zip(away, extra, strict=True):
            last = first + np.shape(column)[-1]
            if error is not None:
                matrix[:, first:last, first:last] = error.covariance(rows)
            first = last
        if pairs is not None:
            k = len(pairs)
            matrix[:, k + np.arange(k), np.arange(k)] = pairs
        matrix[:, np.arange(m), np.arange(m)] += np.where(known[rows, None], diagonal[rows], 1.0)
        matrix[:, m, :m] = np.where(known[rows, None], joined[rows], 0.0)
        # more than the squared length of the white row, so that the root exists
        matrix[:, m, m] = 1 + 2 * np.sum(matrix[:, m, :m] ** 2 / np.where(known[rows, None], least[rows], 1.0), axis=1)
        roots = np.linalg.cholesky(matrix)
        white[rows] = np.where(known[rows, None], roots[:, m, :m], np.nan)
        scale[rows] = np.diagonal(roots, axis1=1, axis2=2)[:, :m]
    return white.reshape(shape), scale.reshape(shape)
