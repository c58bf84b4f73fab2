"""The likelihood of stars, of which some are of the stream and the others of the field.

At its phi1 a star is of the stream with the probability f, and ln L is the sum of ln[f S + (1 - f) B] over the stars: S
and B are the densities of stream and field in the columns that the star has. All is conditional on phi1. So it does not
matter how the survey selects by place along the stream.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from streamkit import Array, BoolArray, IntArray
from streamkit.builtin.observables.stars.catalogue import Catalogue
from streamkit.builtin.observables.track.members import MOTIONS

# A star so many standard deviations off the stream in one column, at all of some points, is of the field there.
FAR = 12.0
# Most numbers of one array: stars times points.
AT_A_TIME = 400_000
# The part of a model's own variance, in squared widths of the stream, that is one error for all stars about a knot. The
# rest widens the stream star by star: where so little is known, a stream that is near its stars must not be excluded.
SHARED = 0.1
LEAST = 1e-12  # least fraction of stream or field
# Least curvature of ln L along a number, of that of known members: no average over an error gains without limit.
LEAST_BEND = 0.5
OVERSHOOT = 0.13  # of the range of four numbers, by which a cubic through them may leave it


class Model(NamedTuple):
    """What is predicted at K knots for n points, C columns.

    Attributes
    ----------
    mean, spread
        (C, K, n) of the debris, in the units of the columns.
    mean_variance, spread_variance
        (C, K, n) of these estimates; None where they count as exact.
    ln_coverage, ln_odds
        (K, n) ln of the chance of any debris; ln of the odds of a star to be of the stream, over those of the fraction.
    """

    mean: Array
    spread: Array
    mean_variance: Array | None
    spread_variance: Array | None
    ln_coverage: Array
    ln_odds: Array

    def take(self, points: slice) -> Model:
        """Return those of some points."""
        return Model(*(None if part is None else part[..., points] for part in self))  # type: ignore[arg-type]


class Settings(NamedTuple):
    """What the run file says: numbers, or (1, n) at n points.

    Attributes
    ----------
    fraction
        The fraction f of the stars that are of the stream.
    dispersions
        By column, added in squares to the spread of the debris.
    """

    fraction: float | Array
    dispersions: Mapping[str, float | Array]

    def take(self, points: slice) -> Settings:
        """Return those of some points."""
        dispersions = {name: each if np.ndim(each) == 0 else np.asarray(each)[:, points]
                       for name, each in self.dispersions.items()}  # fmt: skip
        fraction = self.fraction if np.ndim(self.fraction) == 0 else np.asarray(self.fraction)[:, points]
        return Settings(fraction, dispersions)


class Stream(NamedTuple):
    """Some stars beside the stream, (r, n) each for r stars: see `_beside`.

    Attributes
    ----------
    rows
        (r,) which stars; the others are far off at all points.
    ln_density
        ln S.
    pulls
        By column: residual times the inverse covariance of a star's columns; 0 without a value.
    stiffness, width
        By column: the diagonal of that inverse; the standard deviation of the stream, without the error of the star.
    """

    rows: IntArray
    ln_density: Array
    pulls: list[Array]
    stiffness: list[Array]
    width: list[Array]


def ln_likelihood(stars: Catalogue, model: Model, settings: Settings) -> Array:
    """(n,) ln likelihood of the stars."""
    return np.concatenate([_ln_likelihood(stars, *part) for part in _parts(stars, model, settings)])


def membership(stars: Catalogue, model: Model, settings: Settings) -> Array:
    """(N, n) Probability of each star to be of the stream."""
    found = []
    for part, some in _parts(stars, model, settings):
        chance = np.zeros((len(stars), part.mean.shape[2]))
        stream = _beside(stars, part, some, _split(part, some, stars)[1])
        chance[stream.rows] = np.exp(_ln_chance(stars, part, some, stream)[1])
        found.append(chance)
    return np.concatenate(found, axis=1)


def residuals(stars: Catalogue, model: Model, settings: Settings) -> tuple[Array, Array]:
    """(C, K) each: normal scores of means and of widths at the knots, for one point; 0 where no star tells.

    A score is the slope of ln L along a number at a knot over its standard deviation, the root of the information.
    The model's own noise adds to the variance of the number.
    """
    ((part, some),) = _parts(stars, model, settings)
    stream = _beside(stars, part, some, _split(part, some, stars)[1])
    chance = np.exp(_ln_chance(stars, part, some, stream)[1])
    slopes = _slopes(stars, stream, chance, expected=True)
    scores = []
    for j, noise in enumerate((part.mean_variance, part.spread_variance)):
        rows = []
        for c, each in enumerate(slopes):
            slope, bend = each[2 * j][:, 0], each[2 * j + 1][:, 0]
            of_model = 0.0 if noise is None else noise[c, :, 0]
            rows.append(slope / np.sqrt(np.maximum(bend + bend**2 * of_model, 1e-300)) * (bend > 0))
        scores.append(np.array(rows))
    return scores[0], scores[1]


def _parts(stars: Catalogue, model: Model, settings: Settings) -> Iterator[tuple[Model, Settings]]:
    """Yield the points in parts, so that arrays stay small."""
    n = model.mean.shape[2]
    step = max(1, AT_A_TIME // len(stars))
    for i in range(0, n, step):
        yield model.take(slice(i, i + step)), settings.take(slice(i, i + step))


def _ln_likelihood(stars: Catalogue, model: Model, settings: Settings) -> Array:
    """(n,) ln likelihood for a few points: that of exact numbers, averaged over their errors at the knots."""
    shared, apart = _split(model, settings, stars)
    stream = _beside(stars, model, settings, apart)
    lnl, ln_chance = _ln_chance(stars, model, settings, stream)
    if model.mean_variance is None:
        return lnl
    slopes = _slopes(stars, stream, np.exp(ln_chance))
    assert model.spread_variance is not None  # noqa: S101  both or none
    for c, (slope, bend, of_width, bend_of_width) in enumerate(slopes):
        lnl = lnl + _averaged(slope, bend, shared[c])
        least = np.minimum(model.spread_variance[c], SHARED * model.spread[c] ** 2)
        lnl = lnl + _averaged(of_width, bend_of_width, least)
    return lnl


def _averaged(slope: Array, bend: Array, variance: Array) -> Array:
    """(n,) What ln L gains by the average over Gaussian errors at the knots: exact for a parabola.

    The slope of ln L, minus its curvature, and the variance of a number are (K, n).
    """
    stiff = 1 + np.maximum(bend, 0.0) * variance
    return np.asarray((0.5 * slope**2 * variance / stiff - 0.5 * np.log(stiff)).sum(axis=0))


def _split(model: Model, settings: Settings, stars: Catalogue) -> tuple[Array, Array]:
    """(C, K, n) each: the model's own variances of the means that stars share, and that widen the stream."""
    if model.mean_variance is None:
        none = np.zeros_like(model.mean)
        return none, none
    widths2 = np.stack([
        model.spread[c] ** 2 + np.square(settings.dispersions[name]) + float(np.median(stars.variances[name]))
        for c, name in enumerate(stars.columns)
    ])  # fmt: skip
    shared = np.minimum(model.mean_variance, SHARED * widths2)
    return shared, model.mean_variance - shared


def _beside(stars: Catalogue, model: Model, settings: Settings, apart: Array) -> Stream:
    """Return the density of the stream at the stars that it comes near."""
    width2 = [model.spread[c] ** 2 + np.square(settings.dispersions[name]) + apart[c]
              for c, name in enumerate(stars.columns)]  # fmt: skip
    rows = np.flatnonzero(_is_near(stars, model, width2))
    cubic, linear = stars.knots.cubic[rows], stars.knots.linear[rows]
    ln_density = stars.ln_ratio[rows, None] + np.minimum(linear @ model.ln_coverage, 0.0)
    away, variance, widths, there = [], [], [], []
    for c, name in enumerate(stars.columns):
        value = stars.values[name][rows, None]
        is_there = np.isfinite(value)
        spread = linear @ np.sqrt(width2[c])
        residual = np.where(is_there, value, 0.0) - cubic @ model.mean[c]
        away.append(np.where(is_there, residual, 0.0))
        variance.append(np.where(is_there, stars.variances[name][rows, None] + spread**2, 1.0))
        widths.append(spread)
        there.append(is_there)
    pulls, stiffness, determinant = _solved(stars, rows, away, variance)
    chi2 = sum(pull * residual for pull, residual in zip(pulls, away, strict=True))
    count = sum(there)
    ln_density = ln_density - 0.5 * (chi2 + np.log(determinant) + count * np.log(2 * np.pi))
    stiffness = [each * is_there for each, is_there in zip(stiffness, there, strict=True)]
    return Stream(rows, ln_density, pulls, stiffness, widths)


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


def _is_near(stars: Catalogue, model: Model, width2: list[Array]) -> BoolArray:
    """(N,) Whether the stream comes near a star at any point; all stars where there is no field."""
    near = np.ones(len(stars), dtype=bool)
    if stars.ln_background is None:
        return near
    for c, name in enumerate(stars.columns):
        least = -stars.knots.largest_about(-model.mean[c].min(axis=1))
        most = stars.knots.largest_about(model.mean[c].max(axis=1))
        widest = np.sqrt(stars.knots.largest_about(width2[c].max(axis=1)))
        margin = OVERSHOOT * (most - least) + FAR * np.sqrt(widest**2 + stars.variances[name])
        value = stars.values[name]
        near &= ~((value < least - margin) | (value > most + margin))
    return near


def _ln_chance(stars: Catalogue, model: Model, settings: Settings, stream: Stream) -> tuple[Array, Array]:
    """(n,) ln likelihood, and (r, n) ln of the chance to be of the stream of the stars beside it."""
    if stars.ln_background is None:
        return stream.ln_density.sum(axis=0), np.zeros_like(stream.ln_density)
    fraction = np.clip(settings.fraction, LEAST, 1 - LEAST)
    ln_odds = stars.knots.linear @ model.ln_odds + (np.log(fraction) - np.log1p(-fraction))
    field = stars.ln_background[:, None] - np.logaddexp(0.0, ln_odds)
    excess = ln_odds[stream.rows] + stream.ln_density - stars.ln_background[stream.rows, None]
    more = np.logaddexp(0.0, excess)
    return field.sum(axis=0) + more.sum(axis=0), excess - more


def _slopes(
    stars: Catalogue, stream: Stream, chance: Array, expected: bool = False
) -> list[tuple[Array, Array, Array, Array]]:
    """Return for each column, (K, n) each: slope of ln L along the means at the knots, minus its curvature; of widths.

    The curvature is that of the mixture, but at least `LEAST_BEND` of what it were if all were known of who is a
    member; or, if ``expected``, the mean square of the slope.
    """
    cubic, linear = stars.knots.cubic[stream.rows].T, stars.knots.linear[stream.rows].T
    cubic2, linear2 = cubic.power(2), linear.power(2)
    found = []
    for pull, stiff, width in zip(stream.pulls, stream.stiffness, stream.width, strict=True):
        square = pull**2
        of_width = width * (square - stiff)
        if expected:
            bends = (chance * pull) ** 2, (chance * of_width) ** 2
        else:
            known = stiff, stiff - square + width**2 * stiff * (4 * square - 2 * stiff)
            bends = tuple(  # type: ignore[assignment]
                np.maximum(chance * bend - chance * (1 - chance) * slope2, LEAST_BEND * chance * bend)
                for bend, slope2 in zip(known, (square, of_width**2), strict=True)
            )
        slopes = chance * pull, chance * of_width
        found.append((cubic @ slopes[0], cubic2 @ bends[0], linear @ slopes[1], linear2 @ bends[1]))
    return found
