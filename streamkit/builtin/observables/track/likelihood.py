"""The likelihood of data along a track: means or single stars, extra dispersion and error, outliers, missing debris."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import reduce
from typing import NamedTuple

import numpy as np
from scipy.special import log_ndtr, ndtri_exp

from streamkit import Array
from streamkit.builtin.observables.track.extra_error import ExtraError, whitened

BROAD = 3.0  # errors that are added to the scatter of the data for the width of the Gaussian of outliers


class Side(NamedTuple):
    """Data of one column, with the Gaussians that the stream predicts and the distribution of outliers."""

    value: Array  # (m,) data
    # (..., m) mean and standard deviation of the predicted Gaussian, errors included.
    variance: Array
    mean: Array
    ln_coverage: Array  # (..., m) ln c: zero where the stream has debris, falling with the distance to the nearest
    outliers: float | Array  # f, the fraction of data that are not of the stream: a number, or (..., 1)
    # Mean and standard deviation of the outliers. Hogg, Bovy & Lang 2010, arXiv:1008.4686, equation 17.
    background: tuple[float, float]
    extra: ExtraError | None = None  # what is alike along the track; there are no outliers then


def ln_mixture(side: Side) -> Array:
    """(..., m) Return ln [(1 - f) c N(value; mean, variance) + f N(value; background)] of each datum."""
    value, variance, mean, ln_coverage, outliers, background, _ = side
    stream = ln_gaussian(value - mean, variance) + ln_coverage
    if not np.any(outliers):
        return stream
    other = ln_gaussian(value - background[0], np.full(len(value), background[1] ** 2))
    with np.errstate(divide="ignore"):  # ln 0, for a fraction of zero
        return np.asarray(np.logaddexp(np.log1p(-outliers) + stream, np.log(outliers) + other))


def mixture_residuals(side: Side) -> Array:
    """(m,) Normal scores of data in the distribution of `ln_mixture`.

    The score z of a datum has the same cumulative probability, P(< z) = P(< datum) (Dunn & Smyth 1996). Missing debris
    adds -2 ln(c) to z^2, as it does to -2 ln L.
    """
    value, variance, mean, ln_coverage, outliers, background, _ = side
    score = (value - mean) / np.sqrt(variance)
    ln_weight = ln_coverage
    if np.any(outliers):
        other = (value - background[0]) / background[1]
        ln_stream, ln_other = np.log1p(-outliers) + ln_coverage, np.log(outliers) + np.zeros(len(value))
        ln_weight = np.logaddexp(ln_stream, ln_other)
        below, above = (
            np.logaddexp(ln_stream + log_ndtr(sign * score), ln_other + log_ndtr(sign * other)) - ln_weight
            for sign in (1, -1)
        )
        score = np.where(below < above, ndtri_exp(np.minimum(below, 0.0)), -ndtri_exp(np.minimum(above, 0.0)))
    return np.asarray(np.copysign(np.sqrt(score**2 - 2 * ln_weight), score))


def ln_mixture_of_pairs(one: Side, other: Side, covariance: Array) -> Array:
    """(..., m) The ln density of two data with correlated errors, of each star; the covariance is (m,).

    Either datum may be an outlier. The errors correlate only where neither is one. Without a covariance the density is
    the product of two mixtures, see `ln_mixture`.
    """
    (x, xx, x_mean, coverage, f, x_out), (y, yy, y_mean, y_coverage, g, y_out) = one[:6], other[:6]
    slope = covariance / xx
    given = ln_gaussian(y - y_mean - slope * (x - x_mean), yy - slope * covariance)
    first, second = (ln_gaussian(x - x_mean, xx) + coverage, ln_gaussian(y - y_mean, yy) + y_coverage)
    strange, foreign = (ln_gaussian(v - out[0], np.full(len(v), out[1] ** 2)) for v, out in ((x, x_out), (y, y_out)))
    with np.errstate(divide="ignore"):  # ln 0, without outliers
        ln_f, ln_g, ln_in, ln_too = np.log(f), np.log(g), np.log1p(-f), np.log1p(-g)
    terms = [
        ln_in + ln_too + first + given + y_coverage, ln_in + ln_g + first + foreign,
        ln_f + ln_too + strange + second, ln_f + ln_g + strange + foreign,
    ]  # fmt: skip
    return np.asarray(reduce(np.logaddexp, terms))


def ln_sum(compared: Iterable[tuple[str, Side]], pair: Sequence[str], covariance: Array | None) -> Array:
    """(...) Return the ln likelihood of columns by their names; two of them may have a covariance."""
    sides = dict(compared)
    joint = _ln_joint(sides, pair, covariance)
    plain = {name: side for name, side in sides.items() if name not in joint}
    total = sum(ln_mixture(side).sum(axis=-1) for name, side in plain.items() if name not in pair)
    if covariance is not None and plain.keys() >= {*pair} != set():
        total = total + ln_mixture_of_pairs(plain[pair[0]], plain[pair[1]], covariance).sum(axis=-1)
    return np.asarray(total + sum(terms.sum(axis=-1) for terms in joint.values()))


def ln_of_each(compared: Iterable[tuple[str, Side]], pair: Sequence[str], covariance: Array | None) -> Array:
    """(m,) The terms of `ln_sum` for all data. The second column of a pair is conditional on the first.

    A datum of a column with an extra error is conditional on those before it.
    """
    sides = dict(compared)
    joint = _ln_joint(sides, pair, covariance)
    terms = {name: joint[name] if name in joint else ln_mixture(side) for name, side in sides.items()}
    if covariance is not None and pair and pair[1] not in joint:
        terms[pair[1]] = ln_mixture_of_pairs(sides[pair[0]], sides[pair[1]], covariance) - terms[pair[0]]
    return np.concatenate(list(terms.values()))


def residual_of_each(compared: Iterable[tuple[str, Side]], pair: Sequence[str], covariance: Array | None) -> Array:
    """(m,) The normal scores of all data. A datum of a column with an extra error is conditional on those before it."""
    sides = dict(compared)
    names, white, _ = _joint(sides, pair, covariance)
    scores = {name: mixture_residuals(side) for name, side in sides.items() if name not in names}
    for name, score in zip(names, _parts(sides, names, white), strict=True):
        scores[name] = np.copysign(np.sqrt(score**2 - 2 * sides[name].ln_coverage), score)
    return np.concatenate([scores[name] for name in sides])


def _ln_joint(sides: Mapping[str, Side], pair: Sequence[str], covariance: Array | None) -> dict[str, Array]:
    """Return the terms (..., k) of columns with an extra error, by name."""
    names, white, scale = _joint(sides, pair, covariance)
    parts = _parts(sides, names, -0.5 * (white**2 + np.log(2 * np.pi)) - np.log(scale))
    return {name: part + sides[name].ln_coverage for name, part in zip(names, parts, strict=True)}


def _joint(
    sides: Mapping[str, Side], pair: Sequence[str], covariance: Array | None
) -> tuple[tuple[str, ...], Array, Array]:
    """Return the columns with extra errors: names, white residuals (..., m) and standard deviations (..., m).

    A pair with a covariance comes first, where one of it has an extra error.
    """
    extra = [name for name, side in sides.items() if side.extra is not None]
    paired = covariance is not None and not set(extra).isdisjoint(pair)
    names = (*pair, *(name for name in extra if name not in pair)) if paired else tuple(extra)
    if not names:
        return (), np.empty(0), np.empty(0)
    group = [sides[name] for name in names]
    away, variance = [side.value - side.mean for side in group], [side.variance for side in group]
    return names, *whitened(away, variance, [side.extra for side in group], covariance if paired else None)


def _parts(sides: Mapping[str, Side], names: Sequence[str], joined: Array) -> list[Array]:
    """Return the (..., k) of each column from those of all (..., m)."""
    if not names:
        return []
    return np.split(joined, np.cumsum([len(sides[name].value) for name in names])[:-1], axis=-1)


def ln_gaussian(difference: Array, variance: Array) -> Array:
    """(..., m) ln of a Gaussian density at differences (..., m) from its mean."""
    return np.asarray(-0.5 * (difference**2 / variance + np.log(2 * np.pi * variance)))


def background_of(value: Array, error: Array, outliers: float | Array) -> tuple[float, float]:
    """Return the mean, and a width that holds data and outliers: the data's variance plus (3 errors)^2.

    Where no fraction is of outliers, any Gaussian will do.
    """
    if not np.any(outliers):
        return 0.0, 1.0
    return float(value.mean()), float(np.sqrt(value.var() + (BROAD * error).mean() ** 2))
