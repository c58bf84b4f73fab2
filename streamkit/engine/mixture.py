"""Compiled code for the likelihood of single stars, of which some lie along curves and the others are of a field.

The order of the sums is fixed: a point has the same ln L among others as by itself.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import types

from streamkit.engine.cache import cached
from streamkit.stream import Array, IntArray

LN_2PI = math.log(2 * math.pi)
HUGE = 1e300
WEIGHTS = 4  # knots that a cubic curve at a star depends on
LARGE = 30.0  # ln of odds beyond which ln(1 + odds) is their logarithm
TOGETHER, FEW = 8, 32  # factors below 1 + e^LARGE, and of 2 at most, whose product loses no digits


class SingleStars(NamedTuple):
    """N stars with C columns, between K knots.

    Attributes
    ----------
    left, first
        (N,) the knot before each star, and the first of the four knots that a cubic curve there depends on.
    linear, cubic
        (N, 2) weights of the knots ``left`` and ``left + 1``, and (N, 4) of the knots from ``first`` on.
    value, variance
        (N, C) measured values, NaN where there is none, and their squared errors.
    covariance
        (N,) of the errors of the columns ``pair``; 0 where one has no value.
    ln_field, ln_ratio
        (N,) ln density of the field, and what is added to that of the stream.
    pair
        (2,) two columns whose errors are correlated; [-1, -1] without any.
    has_field
        Whether there is a field: without it all stars are of the stream.
    """

    left: IntArray
    first: IntArray
    linear: Array
    cubic: Array
    value: Array
    variance: Array
    covariance: Array
    ln_field: Array
    ln_ratio: Array
    pair: IntArray
    has_field: bool


class StreamCurves(NamedTuple):
    """What a model says at K knots, for n points; all arrays in rows without gaps.

    Attributes
    ----------
    mean, spread, width
        (n, C, K), (n, C, K) and (n, P, C, K): of the debris, and the widths of P parts of the stream.
    ln_coverage, ln_odds
        (n, K) what is added to the ln density of the stream, at most 0, and ln odds of a star to be of the stream.
    ln_share
        (n, P) of the parts.
    mean_variance, spread_variance
        (n, C, K) squared errors over which the likelihood is averaged; zeros for none.
    """

    mean: Array
    spread: Array
    width: Array
    ln_coverage: Array
    ln_odds: Array
    ln_share: Array
    mean_variance: Array
    spread_variance: Array


_F1, _F2, _F3, _F4 = types.float64[::1], types.float64[:, ::1], types.float64[:, :, ::1], types.float64[:, :, :, ::1]
_I1, _F = types.int64[::1], types.float64


@cached(
    types.void(
        _I1, _I1, _F2, _F2, _F2, _F2, _F1, _F1, _F1, _I1, types.boolean,
        _F3, _F3, _F4, _F2, _F2, _F2, _F3, _F3, types.boolean, _F, _F, _F, _F1,
    )
)  # fmt: skip
def _ln_likelihoods(
    left, first, linear, cubic, value, variance, covariance, ln_field, ln_ratio, pair, has_field,
    mean, spread, width, ln_coverage, ln_odds, ln_share, mean_variance, spread_variance, averaged,
    far, overshoot, least_bend, found,
):  # fmt: skip
    """Fill found (n,); see `ln_likelihoods`."""
    count, columns = value.shape
    parts, knots = width.shape[1], mean.shape[2]
    # by star that the stream comes near: its row; then the chance, pulls and stiffnesses of each part
    rows = np.empty(count, dtype=np.int64)
    chance, pull, stiff = np.empty((count, parts)), np.empty((count, parts, columns)), np.empty((count, parts, columns))
    low, high, wide2 = np.empty((columns, knots)), np.empty((columns, knots)), np.empty((columns, knots))
    slope, bend = np.empty((2, columns, knots)), np.empty((2, columns, knots))
    ln_part, away, v = np.empty(parts), np.empty(columns), np.empty(columns)
    i, j = pair[0], pair[1]
    for p in range(found.shape[0]):
        for c in range(columns):  # where the stream may be between a knot and the next
            for k in range(knots - 1):
                a, b, w = np.inf, -np.inf, 0.0
                for m in range(max(k - 2, 0), min(k + 4, knots)):
                    a, b = min(a, mean[p, c, m]), max(b, mean[p, c, m])
                    for q in range(parts):
                        w = max(w, width[p, q, c, m])
                low[c, k], high[c, k] = a - overshoot * (b - a), b + overshoot * (b - a)
                wide2[c, k] = far * far * w * w
        total, near = 0.0, 0
        product, factors, near_product, near_factors = 1.0, 0, 1.0, 0
        for r in range(count):
            k, w0, w1 = left[r], linear[r, 0], linear[r, 1]
            odds = w0 * ln_odds[p, k] + w1 * ln_odds[p, k + 1]
            if has_field:
                total += ln_field[r]
                if odds > LARGE:
                    total -= odds
                else:
                    product *= 1.0 + math.exp(odds)
                    factors += 1
                    if factors == TOGETHER:
                        total -= math.log(product)
                        product, factors = 1.0, 0
                is_near = True
                for c in range(columns):
                    y = value[r, c]
                    beyond = low[c, k] - y if y < low[c, k] else (y - high[c, k] if y > high[c, k] else 0.0)
                    if beyond * beyond > wide2[c, k] + far * far * variance[r, c]:
                        is_near = False
                        break
                if not is_near:
                    continue
            base = ln_ratio[r] + min(w0 * ln_coverage[p, k] + w1 * ln_coverage[p, k + 1], 0.0)
            f = first[r]
            for c in range(columns):
                away[c] = 0.0
                if not math.isnan(value[r, c]):
                    line = 0.0
                    for m in range(WEIGHTS):
                        line += cubic[r, m] * mean[p, c, f + m]
                    away[c] = value[r, c] - line
            for q in range(parts):
                ln_q, det = base, 1.0
                for c in range(columns):
                    if math.isnan(value[r, c]):
                        v[c], stiff[near, q, c], pull[near, q, c] = 1.0, 0.0, 0.0
                        continue
                    here = w0 * width[p, q, c, k] + w1 * width[p, q, c, k + 1]
                    v[c] = variance[r, c] + here * here
                    det *= v[c]
                    stiffness = 1.0 / v[c]
                    stiff[near, q, c] = stiffness
                    pull[near, q, c] = away[c] * stiffness
                    ln_q -= 0.5 * LN_2PI
                if i >= 0 and covariance[r] != 0.0:
                    cross = covariance[r]
                    both = v[i] * v[j] - cross * cross
                    det *= both * stiff[near, q, i] * stiff[near, q, j]
                    both = 1.0 / both
                    stiff[near, q, i], stiff[near, q, j] = v[j] * both, v[i] * both
                    pull[near, q, i] = (v[j] * away[i] - cross * away[j]) * both
                    pull[near, q, j] = (v[i] * away[j] - cross * away[i]) * both
                chi2 = math.log(det)
                for c in range(columns):
                    chi2 += pull[near, q, c] * away[c]
                ln_part[q] = ln_q - 0.5 * chi2 + ln_share[p, q]
            ln_stream, sum_parts = ln_part[0], 1.0
            chance[near, 0] = 1.0
            if parts > 1:
                most, sum_parts = max(ln_part[0], -HUGE), 1.0 / HUGE  # finite also where a part has no density
                for q in range(1, parts):
                    most = max(most, ln_part[q])
                for q in range(parts):
                    chance[near, q] = math.exp(ln_part[q] - most)
                    sum_parts += chance[near, q]
                ln_stream = most + math.log(sum_parts)
            of_stream = 1.0
            if has_field:
                excess = odds + ln_stream - ln_field[r]
                tail = math.exp(-abs(excess))
                total += max(excess, 0.0)
                near_product *= 1.0 + tail
                near_factors += 1
                if near_factors == FEW:
                    total += math.log(near_product)
                    near_product, near_factors = 1.0, 0
                of_stream = (1.0 if excess > 0.0 else tail) / (1.0 + tail)
            else:
                total += ln_stream
            for q in range(parts):
                chance[near, q] *= of_stream / sum_parts
            rows[near] = r
            near += 1
        total += math.log(near_product) - math.log(product)
        if averaged:
            slope[:], bend[:] = 0.0, 0.0
            for s in range(near):
                r = rows[s]
                f = first[r]
                size = 0.0
                for m in range(WEIGHTS):
                    size += abs(cubic[r, m])
                for c in range(columns):
                    up, known, squares = 0.0, 0.0, 0.0
                    for q in range(parts):
                        up += chance[s, q] * pull[s, q, c]
                        known += chance[s, q] * stiff[s, q, c]
                        squares += chance[s, q] * pull[s, q, c] * pull[s, q, c]
                    curve = max(known - squares + up * up, least_bend * known)
                    for m in range(WEIGHTS):
                        slope[0, c, f + m] += cubic[r, m] * up
                        bend[0, c, f + m] += abs(cubic[r, m]) * size * curve
            for c in range(columns):  # by how much the errors move the curves toward the stars
                for k in range(knots):
                    low[c, k] = slope[0, c, k] * mean_variance[p, c, k] / (1 + bend[0, c, k] * mean_variance[p, c, k])
            for s in range(near):
                r = rows[s]
                f, k, w0, w1 = first[r], left[r], linear[r, 0], linear[r, 1]
                for c in range(columns):
                    moved = 0.0
                    for m in range(WEIGHTS):
                        moved += cubic[r, m] * low[c, f + m]
                    here = w0 * spread[p, c, k] + w1 * spread[p, c, k + 1]
                    up, known, squares = 0.0, 0.0, 0.0
                    for q in range(parts):
                        rest = pull[s, q, c] - stiff[s, q, c] * moved
                        of_q = here * (rest * rest - stiff[s, q, c])
                        up += chance[s, q] * of_q
                        known += chance[s, q] * 2.0 * here * here * stiff[s, q, c] * rest * rest
                        squares += chance[s, q] * of_q * of_q
                    curve = max(known - squares + up * up, least_bend * known)
                    slope[1, c, k] += w0 * up
                    slope[1, c, k + 1] += w1 * up
                    bend[1, c, k] += w0 * curve
                    bend[1, c, k + 1] += w1 * curve
            for c in range(columns):
                for k in range(knots):
                    for e in range(2):
                        v2 = mean_variance[p, c, k] if e == 0 else spread_variance[p, c, k]
                        stiffer = 1.0 + max(bend[e, c, k], 0.0) * v2
                        total += 0.5 * slope[e, c, k] * slope[e, c, k] * v2 / stiffer - 0.5 * math.log(stiffer)
        found[p] = total


def ln_likelihoods(stars: SingleStars, curves: StreamCurves, far: float, overshoot: float, least_bend: float) -> Array:
    """Return ln L (n,) of stars at n points: the sum of ln[f S + (1 - f) B] over them.

    S is the density of the stream, a sum of Gaussians about a cubic curve through the means at the knots, with widths
    that are linear between them; B is that of the field, and f / (1 - f) are the odds. ln L is averaged over Gaussian
    errors of means and spreads in the approximation of a parabola.

    Parameters
    ----------
    stars, curves
        What was measured, and what the model says.
    far
        A star so many standard deviations off the stream in one column is of the field.
    overshoot
        Of the range of the knots about a star, by which a cubic curve may leave it.
    least_bend
        Least curvature of ln L along a number, of that of known members.
    """
    found = np.empty(len(curves.mean))
    averaged = bool(curves.mean_variance.any() or curves.spread_variance.any())
    _ln_likelihoods(*stars, *curves, averaged, far, overshoot, least_bend, found)
    return found
