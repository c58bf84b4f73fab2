"""A rough track through the stars themselves, without any model of a stream.

It gives the data of the observable: places and widths at the knots with errors, in whose units a sampler learns, and
which pictures show beside the model. The likelihood of the stars uses of it only how the stream's share of the stars
varies along phi1, unless the run file says otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import lgamma

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import expit, logit, ndtr

from streamkit import Array
from streamkit.builtin.observables.stars.catalogue import Catalogue
from streamkit.builtin.observables.track.lines import gather, local_lines

NEIGHBOURS = 12  # whose distance gives the density at a star
ALONG = 100  # stars whose longitudes give the density along phi1
# Times the field's density that all stars must exceed to be of the stream at first, and its cut ln in a mean.
MARGIN, WILDEST = 2.0, 3.0
STEPS, SETTLED = 60, 1e-3  # of expectation and maximisation; the change of any star's chance that ends them
NARROWEST = 0.01  # least width of the stream, of the standard deviation of all stars in the column
LEAST_CHANCE = 1e-6
LEAST_SHARE, MOST_SHARE = 1e-3, 1 - 1e-3  # of the stars at a knot that are of the stream
FEW = 5.0  # stars at a knot from which its share and its spread are known
BROAD = 0.5  # of the standard deviation of all stars: the error where no star tells


@dataclass(frozen=True, eq=False)
class RoughTrack:
    """A track at K knots, C columns.

    Attributes
    ----------
    mean, mean_error, spread, spread_error
        (C, K) the track, the spread of the stream about it without the errors of the stars, and their errors.
    share
        (K,) fraction of the stars at a knot that are of the stream.
    ln_odds
        (K,) ln of share / (1 - share), less that of all stars.
    ln_field
        (K,) ln density of the field's stars along phi1, up to a number.
    fraction
        Fraction of all stars that are of the stream.
    chance
        (N,) of each star to be of the stream.
    """

    mean: Array
    mean_error: Array
    spread: Array
    spread_error: Array
    share: Array
    ln_odds: Array
    ln_field: Array
    fraction: float
    chance: Array


@lru_cache(maxsize=8)  # a free parameter makes the observable anew at each call, with the same stars
def rough_track_of(stars: Catalogue, kernel: float) -> RoughTrack:
    """Return the track of the stars by expectation and maximisation, with local lines of a kernel in degrees.

    The first chance of a star to be of the stream is how much the density of all stars there exceeds that of the field.
    """
    knots = stars.knots.phi1
    kernel = max(kernel, float(knots[1] - knots[0]))
    chance = np.ones(len(stars))
    if stars.ln_background is not None:
        chance = _first_chance(stars)
        for _ in range(STEPS):
            before, chance = chance, _chance(stars, chance, kernel)
            if np.abs(chance - before).max() < SETTLED:
                break
    mean, variance, spread2, count = _fitted(stars, chance, kernel)
    full = np.array([np.nanstd(column) for column in stars.values.values()])[:, None]
    error = np.sqrt(variance) + BROAD * full * np.exp(-count)
    total = spread2 + np.array([_mean_variance(stars, name, chance) for name in stars.columns])[:, None]
    of_square = total * np.sqrt(2 / np.maximum(count, 1.0))
    spread = np.sqrt(np.maximum(spread2, (NARROWEST * full) ** 2))
    spread_error = np.minimum(of_square / (2 * spread), np.sqrt(of_square))
    share = _share(stars, chance, kernel)
    fraction = float(np.clip(chance.mean(), LEAST_SHARE, MOST_SHARE))
    return RoughTrack(
        mean, error, spread, spread_error, share, logit(share) - float(logit(fraction)),
        np.log(_density(stars, 1 - share_at(stars, share), kernel)), fraction, chance,
    )  # fmt: skip


def share_at(stars: Catalogue, share: Array) -> Array:
    """(N,) The share at the stars, from that at the knots."""
    return np.asarray(stars.knots.linear @ share)


def _first_chance(stars: Catalogue) -> Array:
    """(N,) From the density of all stars, by the distance to a neighbour, in the columns that nearly all stars have."""
    assert stars.ln_background is not None  # noqa: S101  asked for with a background only
    columns = [column for column in stars.values.values() if np.isfinite(column).mean() > 0.9]
    rows = np.flatnonzero(np.logical_and.reduce([np.isfinite(column) for column in columns]))
    places = np.stack([stars.phi1[rows], *(column[rows] for column in columns)], axis=1)
    scale = np.maximum(places.std(axis=0), 1e-12)
    near = min(NEIGHBOURS, len(rows) - 1)
    distance = np.maximum(cKDTree(places / scale).query(places / scale, near + 1)[0][:, -1], 1e-12)
    along = np.sort(places[:, 0])
    per_degree = np.interp(places[:, 0], along, ALONG / np.maximum(_gaps(along), 1e-12))
    d = places.shape[1]
    ln_volume = 0.5 * d * np.log(np.pi) - lgamma(0.5 * d + 1) + d * np.log(distance) + np.log(scale).sum()
    over = stars.ln_background[rows] - (np.log(near) - ln_volume - np.log(per_degree))
    # the mean of field over all is 1 for stars drawn from all, if the field's density has an integral of 1
    middle = np.median(over)
    over -= middle + np.log(np.mean(np.exp(np.minimum(over - middle, WILDEST))))
    chance = np.full(len(stars), LEAST_CHANCE)
    chance[rows] = np.maximum(1 - MARGIN * np.exp(np.minimum(over, 0.0)), LEAST_CHANCE)
    return chance


def _gaps(along: Array) -> Array:
    """(n,) Degrees that `ALONG` neighbours of each of the sorted longitudes take."""
    last, half = len(along) - 1, ALONG // 2
    which = np.arange(len(along))
    low, high = np.maximum(which - half, 0), np.minimum(which + half, last)
    return np.asarray((along[high] - along[low]) * ALONG / (high - low))


def _chance(stars: Catalogue, chance: Array, kernel: float) -> Array:
    """(N,) The chances by the track and the shares that other chances give."""
    mean, _, spread2, _ = _fitted(stars, chance, kernel)
    knots = stars.knots
    assert stars.ln_background is not None  # noqa: S101  asked for with a background only
    ln_odds = logit(share_at(stars, _share(stars, chance, kernel))) + stars.ln_ratio - stars.ln_background
    for c, name in enumerate(stars.columns):
        value = stars.values[name]
        there = np.isfinite(value)
        floor = (NARROWEST * np.nanstd(value)) ** 2
        variance = np.maximum(knots.linear @ spread2[c], floor) + stars.variances[name]
        away = np.where(there, value, 0.0) - knots.cubic @ mean[c]
        ln_odds -= np.where(there, 0.5 * (away**2 / variance + np.log(2 * np.pi * variance)), 0.0)
    return np.asarray(np.maximum(expit(ln_odds), LEAST_CHANCE))


def _fitted(stars: Catalogue, chance: Array, kernel: float) -> tuple[Array, Array, Array, Array]:
    """Return local lines of every column, (C, K) each: the means, their variances, spread^2 without errors, counts."""
    parts = []
    for name in stars.columns:
        value = stars.values[name]
        rows = np.flatnonzero(np.isfinite(value))
        lines = local_lines(gather(stars.phi1[rows], [value[rows]], chance[rows]), stars.knots.phi1, kernel)
        spread2, count = lines.spread[0] ** 2, np.exp(np.minimum(lines.ln_count, 30.0))
        # A few stars near each other would make a narrow stream of their own.
        spread2 += FEW / (count + FEW) * (np.average(spread2, weights=count + 1e-9) - spread2)
        spread2 = np.maximum(spread2 - _mean_variance(stars, name, chance), 0.0)
        parts.append((lines.value[0], lines.variance[0], spread2, count))
    mean, variance, spread2, count = (np.array(part) for part in zip(*parts, strict=True))
    return mean, variance, spread2, count


def _mean_variance(stars: Catalogue, name: str, chance: Array) -> float:
    """Return the mean squared error of the stars of the stream in a column."""
    weight = chance * np.isfinite(stars.values[name])
    return float(weight @ stars.variances[name] / weight.sum())


def _share(stars: Catalogue, chance: Array, kernel: float) -> Array:
    """(K,) The stream's share of the stars under a kernel; that of all stars where there are few."""
    every, of_stream = _under(stars, np.ones(len(stars)), kernel), _under(stars, chance, kernel)
    share = (of_stream + FEW * chance.mean()) / (every + FEW)
    return np.asarray(np.clip(share, LEAST_SHARE, MOST_SHARE))


def _density(stars: Catalogue, weight: Array, kernel: float) -> Array:
    """(K,) The density of weighed stars along phi1, over its mean; the kernels are cut at the ends of the window."""
    knots = stars.knots.phi1
    inside = ndtr((knots[-1] - knots) / kernel) - ndtr((knots[0] - knots) / kernel)
    found = (_under(stars, weight, kernel) + FEW) / inside
    return np.asarray(found / found.mean())


def _under(stars: Catalogue, weight: Array, kernel: float) -> Array:
    """(K,) Sums of weights under a kernel."""
    x = np.subtract.outer(stars.knots.phi1, stars.phi1) / kernel
    return np.asarray(np.exp(-0.5 * x * x) @ weight)
