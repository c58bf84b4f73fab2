"""The likelihood of stars, of which some are of the stream and the others of the field.

At its phi1 a star is of the stream with the probability f, and ln L is the sum of ln[f S + (1 - f) B] over the stars: S
and B are the densities of stream and field in the columns that the star has. The stream may have two parts. All is
conditional on phi1. So it does not matter how the survey selects by place along the stream.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import reduce
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from streamkit import Array, IntArray
from streamkit.builtin.observables.stars.beside import Beside, beside, near, widths2_of
from streamkit.builtin.observables.stars.catalogue import Catalogue
from streamkit.builtin.observables.stars.model import Model, Settings

# Most numbers of one array: stars times points.
AT_A_TIME = 400_000
# The part of a model's own variance, in squared widths of the stream, that is one error for all stars about a knot. The
# rest widens the stream star by star: where so little is known, a stream that is near its stars must not be excluded.
SHARED = 0.1
LEAST = 1e-12  # least fraction of stream or field, and of a part
# Least curvature of ln L along a number, of that of known members: no average over an error gains without limit.
LEAST_BEND = 0.5


class Chances(NamedTuple):
    """How likely the stars are of the stream, at n points.

    Attributes
    ----------
    ln_likelihood
        (n,) of all stars.
    rows
        (r,) the stars that the stream comes near; the others are of the field.
    parts
        The parts of the stream at these stars.
    of_parts
        (r, n) for each part: the probability of a star to be of it.
    """

    ln_likelihood: Array
    rows: IntArray
    parts: list[Beside]
    of_parts: list[Array]


class Slopes(NamedTuple):
    """Of ln L along the numbers of one column at the knots, (K, n) each: slopes, and minus the curvatures."""

    mean: Array
    mean_bend: Array
    spread: Array
    spread_bend: Array


def ln_likelihood(stars: Catalogue, model: Model, settings: Settings) -> Array:
    """(n,) ln likelihood of the stars."""
    return np.concatenate([_ln_likelihood(stars, *some) for some in _points(stars, model, settings)])


def membership(stars: Catalogue, model: Model, settings: Settings) -> Array:
    """(P, N, n) Probability of each of N stars to be of each part of the stream."""
    found = []
    for some in _points(stars, model, settings):
        chances = _chances(stars, *some, _split(stars, *some)[1])
        of_all = np.zeros((len(settings.parts), len(stars), some[0].mean.shape[2]))
        of_all[:, chances.rows] = chances.of_parts
        found.append(of_all)
    return np.concatenate(found, axis=2)


def residuals(stars: Catalogue, model: Model, settings: Settings) -> tuple[Array, Array]:
    """(C, K) each: normal scores of means and of spreads at the knots, for one point; 0 where no star tells.

    A score is the slope of ln L along a number at a knot over its standard deviation, the root of the information.
    The model's own noise adds to the variance of the number.
    """
    slopes = _slopes(stars, _chances(stars, model, settings, _split(stars, model, settings)[1]))
    noise = [np.zeros_like(model.mean) if each is None else each for each in model[2:4]]
    means = [_score(each.mean, each.mean_bend, noise[0][c]) for c, each in enumerate(slopes)]
    spreads = [_score(each.spread, each.spread_bend, noise[1][c]) for c, each in enumerate(slopes)]
    return np.array(means), np.array(spreads)


def _score(slope: Array, bend: Array, noise: Array) -> Array:
    """(K,) Slopes over their standard deviations at one point."""
    variance = bend[:, 0] + bend[:, 0] ** 2 * noise[:, 0]
    return np.where(variance > 0, slope[:, 0] / np.sqrt(np.where(variance > 0, variance, 1.0)), 0.0)


def _points(stars: Catalogue, model: Model, settings: Settings) -> Iterator[tuple[Model, Settings]]:
    """Yield some points at a time, so that arrays stay small."""
    step = max(1, AT_A_TIME // len(stars))
    for i in range(0, model.mean.shape[2], step):
        yield model.take(slice(i, i + step)), settings.take(slice(i, i + step))


def _ln_likelihood(stars: Catalogue, model: Model, settings: Settings) -> Array:
    """(n,) ln likelihood for a few points: that of exact numbers, averaged over their errors at the knots."""
    shared, apart = _split(stars, model, settings)
    chances = _chances(stars, model, settings, apart)
    lnl = chances.ln_likelihood
    if model.spread_variance is None:
        return lnl
    for c, slopes in enumerate(_slopes(stars, chances, shared)):
        lnl = lnl + _averaged(slopes.mean, slopes.mean_bend, shared[c])
        least = np.minimum(model.spread_variance[c], SHARED * model.spread[c] ** 2)
        lnl = lnl + _averaged(slopes.spread, slopes.spread_bend, least)
    return lnl


def _averaged(slope: Array, bend: Array, variance: Array) -> Array:
    """(n,) What ln L gains by the average over Gaussian errors at the knots: exact for a parabola.

    The slope of ln L, minus its curvature, and the variance of a number are (K, n).
    """
    stiff = 1 + np.maximum(bend, 0.0) * variance
    return np.asarray((0.5 * slope**2 * variance / stiff - 0.5 * np.log(stiff)).sum(axis=0))


def _split(stars: Catalogue, model: Model, settings: Settings) -> tuple[Array, Array]:
    """(C, K, n) each: the model's own variances of the means that stars share, and that widen the stream."""
    if model.mean_variance is None:
        none = np.zeros_like(model.mean)
        return none, none
    of_stream = widths2_of(stars, model, settings.parts[0], np.zeros_like(model.mean))
    errors2 = [float(np.median(stars.variances[name])) for name in stars.columns]
    shared = np.minimum(model.mean_variance, SHARED * (np.stack(of_stream) + np.reshape(errors2, (-1, 1, 1))))
    assert model.spread_variance is not None  # noqa: S101  both or none
    # the mean of a squared spread is its squared mean and its variance
    of_spread = np.maximum(model.spread_variance - SHARED * model.spread**2, 0.0)
    return shared, model.mean_variance - shared + of_spread


def _chances(stars: Catalogue, model: Model, settings: Settings, apart: Array) -> Chances:
    """Return ln likelihood and the chances of the stars, with the variances ``apart`` (C, K, n) added to the widths."""
    widths2 = [widths2_of(stars, model, part, apart) for part in settings.parts]
    rows = near(stars, model, [np.maximum.reduce(each) for each in zip(*widths2, strict=True)])
    parts = [beside(stars, rows, model, each) for each in widths2]
    ln_of_parts = [each.ln_density for each in parts]
    if len(parts) > 1:
        shares = [np.log(np.clip(part.share, LEAST, 1.0)) for part in settings.parts]
        ln_of_parts = [each + share for each, share in zip(ln_of_parts, shares, strict=True)]
    ln_density = reduce(np.logaddexp, ln_of_parts)
    if stars.ln_background is None:
        lnl, ln_chance = ln_density.sum(axis=0), np.zeros_like(ln_density)
    else:
        fraction = np.clip(settings.fraction, LEAST, 1 - LEAST)
        ln_odds = stars.knots.linear @ model.ln_odds + (np.log(fraction) - np.log1p(-fraction))
        excess = ln_odds[rows] + ln_density - stars.ln_background[rows, None]
        more = _softplus(excess)
        lnl = stars.ln_background.sum() - _softplus(ln_odds).sum(axis=0) + more.sum(axis=0)
        ln_chance = excess - more
    return Chances(lnl, rows, parts, [np.exp(ln_chance + each - ln_density) for each in ln_of_parts])


def _softplus(x: Array) -> Array:
    """ln(1 + e^x)."""
    return np.asarray(np.maximum(x, 0.0) + np.log1p(np.exp(-np.abs(x))))


def _slopes(stars: Catalogue, chances: Chances, shared: Array | None = None) -> list[Slopes]:
    """Return for each column the slopes of ln L along means and spreads at the knots, and minus its curvatures.

    Without ``shared`` the curvature is the mean square of the slope. With the variances (C, K, n) of the means it is
    that of the mixture, but at least `LEAST_BEND` of what it were if all were known of who is a member. What the errors
    of the means explain of the stars is then not explained by the spreads again.
    """
    expected = shared is None
    cubic, linear = stars.knots.cubic[chances.rows].T, stars.knots.linear[chances.rows].T
    stiff_cubic, stiff_linear = (each.power(2) if expected else _lumped(each) for each in (cubic, linear))
    found = []
    for c in range(len(stars.columns)):
        of_mean = [(chance, part.pulls[c], part.stiffness[c])
                   for part, chance in zip(chances.parts, chances.of_parts, strict=True)]  # fmt: skip
        slope, curve = _joined(of_mean, expected)
        mean, mean_bend = cubic @ slope, stiff_cubic @ curve
        moved: Array | float = 0.0
        if shared is not None:
            moved = cubic.T @ (mean * shared[c] / (1 + np.maximum(mean_bend, 0.0) * shared[c]))
        of_spread = []
        for part, chance in zip(chances.parts, chances.of_parts, strict=True):
            stiff, spread = part.stiffness[c], part.spread[c]
            square = (part.pulls[c] - stiff * moved) ** 2
            # where the stars are far off, ln L is convex in the spread: this has the same mean, and is never below zero
            of_spread.append((chance, spread * (square - stiff), 2 * spread**2 * stiff * square))
        spread_slope, spread_curve = _joined(of_spread, expected)
        found.append(Slopes(mean, mean_bend, linear @ spread_slope, stiff_linear @ spread_curve))
    return found


def _lumped(weights: csr_array) -> csr_array:
    """(K, r) Weights of the stars' curvatures, from those of the knots, with which knots count as independent.

    The numbers at neighbouring knots move a star together. The sums of the absolute rows of the whole curvature are at
    least as stiff as it is (Gershgorin 1931): an average over the errors never gains more than the whole one.
    """
    sizes = abs(weights)
    return csr_array(sizes.multiply(np.asarray(sizes.sum(axis=0))[None, :]))


def _joined(parts: list[tuple[Array, Array, Array]], expected: bool) -> tuple[Array, Array]:
    """Return slope and minus curvature of each star's ln L, (r, n), from chance, slope and minus curvature of parts."""
    slope = sum(chance * each for chance, each, _ in parts)
    if expected:
        return np.asarray(slope), np.asarray(slope**2)
    known = sum(chance * bend for chance, _, bend in parts)
    squares = sum(chance * each**2 for chance, each, _ in parts)
    return np.asarray(slope), np.maximum(known - squares + slope**2, LEAST_BEND * known)
