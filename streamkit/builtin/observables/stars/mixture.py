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

from streamkit import Array, IntArray
from streamkit.builtin.observables.stars.beside import FAR, OVERSHOOT, Beside, beside, near, widths2_of
from streamkit.builtin.observables.stars.catalogue import Catalogue
from streamkit.builtin.observables.stars.model import Model, Settings
from streamkit.engine import StreamCurves, ln_likelihoods

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
    rows
        (r,) the stars that the stream comes near; the others are of the field.
    parts
        The parts of the stream at these stars.
    of_parts
        (r, n) for each part: the probability of a star to be of it.
    """

    rows: IntArray
    parts: list[Beside]
    of_parts: list[Array]


class Slopes(NamedTuple):
    """Of ln L along the numbers of one column at the knots, (K, n) each: slopes, and the information about them."""

    mean: Array
    mean_bend: Array
    spread: Array
    spread_bend: Array


def ln_likelihood(stars: Catalogue, model: Model, settings: Settings) -> Array:
    """(n,) ln likelihood of the stars: that of exact numbers, averaged over their errors at the knots."""
    shared, apart = _split(stars, model, settings)
    widths = [np.sqrt(np.stack(widths2_of(stars, model, part, apart))) for part in settings.parts]
    points = (1, model.mean.shape[2])
    shares = [np.log(np.clip(np.broadcast_to(part.share, points), LEAST, 1.0)) for part in settings.parts]
    fraction = np.clip(settings.fraction, LEAST, 1 - LEAST)
    of_spread = np.zeros_like(shared)
    if model.spread_variance is not None:
        of_spread = np.minimum(model.spread_variance, SHARED * model.spread**2)
    curves = (
        model.mean, model.spread, np.stack(widths), model.ln_coverage,
        model.ln_odds + (np.log(fraction) - np.log1p(-fraction)), np.concatenate(shares), shared, of_spread,
    )  # fmt: skip
    return ln_likelihoods(stars.for_engine, StreamCurves(*map(_by_point, curves)), FAR, OVERSHOOT, LEAST_BEND)


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


def _by_point(numbers: Array) -> Array:
    """(n, ...) Numbers (..., n) in rows without gaps."""
    return np.ascontiguousarray(np.moveaxis(numbers, -1, 0))


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
    """Return the chances of the stars, with the variances ``apart`` (C, K, n) added to the widths."""
    widths2 = [widths2_of(stars, model, part, apart) for part in settings.parts]
    rows = near(stars, model, [np.maximum.reduce(each) for each in zip(*widths2, strict=True)])
    parts = [beside(stars, rows, model, each) for each in widths2]
    ln_of_parts = [each.ln_density for each in parts]
    if len(parts) > 1:
        shares = [np.log(np.clip(part.share, LEAST, 1.0)) for part in settings.parts]
        ln_of_parts = [each + share for each, share in zip(ln_of_parts, shares, strict=True)]
    ln_density = reduce(np.logaddexp, ln_of_parts)
    if stars.ln_background is None:
        ln_chance = np.zeros_like(ln_density)
    else:
        fraction = np.clip(settings.fraction, LEAST, 1 - LEAST)
        ln_odds = stars.knots.linear @ model.ln_odds + (np.log(fraction) - np.log1p(-fraction))
        excess = ln_odds[rows] + ln_density - stars.ln_background[rows, None]
        ln_chance = -np.logaddexp(0.0, -excess)
    return Chances(rows, parts, [np.exp(ln_chance + each - ln_density) for each in ln_of_parts])


def _slopes(stars: Catalogue, chances: Chances) -> list[Slopes]:
    """Return for each column the slopes of ln L along means and spreads at the knots, and their mean squares."""
    cubic, linear = stars.knots.cubic[chances.rows].T, stars.knots.linear[chances.rows].T
    found = []
    for c in range(len(stars.columns)):
        mean: Array = np.zeros((len(chances.rows), 1))
        spread = mean
        for part, chance in zip(chances.parts, chances.of_parts, strict=True):
            mean = mean + chance * part.pulls[c]
            spread = spread + chance * part.spread[c] * (part.pulls[c] ** 2 - part.stiffness[c])
        found.append(Slopes(cubic @ mean, cubic.power(2) @ mean**2, linear @ spread, linear.power(2) @ spread**2))
    return found
