"""The density of one part of a stream at the stars beside it, and how it changes with the stream."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from streamkit import Array, BoolArray, IntArray
from streamkit.builtin.observables.stars.catalogue import Catalogue
from streamkit.builtin.observables.stars.model import Model, Part
from streamkit.builtin.observables.track.members import MOTIONS

# A star so many standard deviations off the stream in one column, at all of some points, is of the field there.
FAR = 12.0
OVERSHOOT = 0.13  # of the range of four numbers, by which a cubic through them may leave it


class Beside(NamedTuple):
    """One part of a stream at r stars and n points, (r, n) each.

    Attributes
    ----------
    ln_density
        ln S.
    pulls
        By column: residual times the inverse covariance of a star's columns; 0 without a value.
    stiffness, spread
        By column: the diagonal of that inverse; the spread of the debris.
    """

    ln_density: Array
    pulls: list[Array]
    stiffness: list[Array]
    spread: list[Array]


def widths2_of(stars: Catalogue, model: Model, part: Part, apart: Array) -> list[Array]:
    """Return by column (K, n) the variances of a part of the stream at the knots; ``apart`` (C, K, n) is added."""
    return [model.spread[c] ** 2 + np.square(part.dispersions[name]) + apart[c] for c, name in enumerate(stars.columns)]


def near(stars: Catalogue, model: Model, widths2: list[Array]) -> IntArray:
    """(r,) The stars that a stream of these variances comes near at any point; all stars where there is no field."""
    if stars.ln_background is None:
        return np.arange(len(stars))
    found: BoolArray = np.ones(len(stars), dtype=bool)
    for c, name in enumerate(stars.columns):
        least = -stars.knots.largest_about(-model.mean[c].min(axis=1))
        most = stars.knots.largest_about(model.mean[c].max(axis=1))
        widest = np.sqrt(stars.knots.largest_about(widths2[c].max(axis=1)))
        margin = OVERSHOOT * (most - least) + FAR * np.sqrt(widest**2 + stars.variances[name])
        value = stars.values[name]
        found &= ~((value < least - margin) | (value > most + margin))
    return np.flatnonzero(found)


def beside(stars: Catalogue, rows: IntArray, model: Model, widths2: list[Array]) -> Beside:
    """Return a part of the stream of these variances at some stars (r,)."""
    cubic, linear = stars.knots.cubic[rows], stars.knots.linear[rows]
    ln_density = stars.ln_ratio[rows, None] + np.minimum(linear @ model.ln_coverage, 0.0)
    away, variance, spread, there = [], [], [], []
    for c, name in enumerate(stars.columns):
        value = stars.values[name][rows, None]
        is_there = np.isfinite(value)
        residual = np.where(is_there, value, 0.0) - cubic @ model.mean[c]
        away.append(np.where(is_there, residual, 0.0))
        width2 = (linear @ np.sqrt(widths2[c])) ** 2
        variance.append(np.where(is_there, stars.variances[name][rows, None] + width2, 1.0))
        spread.append(linear @ model.spread[c])
        there.append(is_there)
    pulls, stiffness, determinant = _solved(stars, rows, away, variance)
    chi2 = sum(pull * residual for pull, residual in zip(pulls, away, strict=True))
    ln_density = ln_density - 0.5 * (chi2 + np.log(determinant) + sum(there) * np.log(2 * np.pi))
    stiffness = [each * is_there for each, is_there in zip(stiffness, there, strict=True)]
    return Beside(ln_density, pulls, stiffness, spread)


def _solved(
    stars: Catalogue, rows: IntArray, away: list[Array], variance: list[Array]
) -> tuple[list[Array], list[Array], Array]:
    """Return residuals times the inverse covariance, the diagonal of the inverse, and the determinant, (r, n) each."""
    pulls = [residual / each for residual, each in zip(away, variance, strict=True)]
    stiffness = [1 / each for each in variance]
    determinant = np.prod(variance, axis=0)
    if stars.paired:
        i, j = (stars.columns.index(name) for name in MOTIONS)
        cross = stars.covariance[rows, None]
        pair = variance[i] * variance[j] - cross**2
        determinant = determinant * (pair / (variance[i] * variance[j]))
        pulls[i] = (variance[j] * away[i] - cross * away[j]) / pair
        pulls[j] = (variance[i] * away[j] - cross * away[i]) / pair
        stiffness[i], stiffness[j] = variance[j] / pair, variance[i] / pair
    return pulls, stiffness, determinant
