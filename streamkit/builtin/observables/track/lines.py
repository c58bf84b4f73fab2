"""Kernel-weighted local lines: columns of the debris at given longitudes, smooth in every particle.

At each longitude a line y = b + a (phi - phi_i) is fitted by weighted least squares in closed form. The kernel is a
Gaussian with faint exponential wings, so that there is always an answer: where debris is missing, the nearest debris
gives it, the number of particles under the kernel falls as exp(-distance / kernel), and the variance grows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from streamkit import Array, BoolArray, Prediction, Stream

WING = 1e-3  # height of the kernel's exponential wings: within three kernels of debris they are negligible
LN_WING = math.log(WING)
# Distance in kernels from the nearest particle at which the wings end.
REACH = 4.0
# Particles under a kernel that determine a line. With far fewer, slope and spread are those of the whole stream.
ENOUGH = 5.0
FEWEST = 10  # fewest particles outside the progenitor: with fewer there is no stream
ARMS = {"leading": 1, "trailing": -1}

TURN = 360.0  # degrees
SEAM = 90.0  # degrees from the nearest debris: beyond, debris on the other side of the sky has no influence
LN_MOST = 170.0  # largest ln of a number of particles: the fourth power of its exponential is finite
LN_TINY = -20.0  # ln n below which 1 - exp(-n) is n
FINE, MANY = 0.125, 200  # kernels between the nodes of splines, and number of longitudes below which none are used
TILE, BLOCK = 12, 512  # lines that are fitted together, and particles that are summed together


def beyond_seam(away: Array, kernel: float) -> float:
    """Return the degrees of debris that lines at longitudes so far from their middle need from beyond half a turn."""
    farthest = np.abs(away).max() + REACH * kernel
    return float(np.clip(farthest - SEAM, 0.0, TURN))


class Debris(NamedTuple):
    """Particles in the order of their longitudes."""

    longitude: Array  # (n,) degrees, increasing
    columns: Array  # (c, n) measured values, minus their mean over all particles
    weight: Array  # (n,) statistical weight of each
    # (c,) that mean, and the ratio of the standard deviations of column and longitude: the scale of a line's slope.
    centre: Array
    slope: Array


class Lines(NamedTuple):
    """The lines at m longitudes, of c columns."""

    value: Array  # (c, m) b, the column at the longitude
    # (c, m) variance of b from the finite number of particles, and from the uncertain slope of a line where the debris
    # is far away, or on one side only.
    variance: Array
    spread: Array  # (c, m) standard deviation of the particles about the line
    depth_variance: Array  # (m,) variance of the spread of one column
    ln_count: Array  # (m,) ln of the number of particles under the kernel


def debris_of(stream: Stream, arm: str) -> BoolArray:
    """(n,) Return which particles have left the progenitor, in one arm or in "both"."""
    return ~stream.bound if arm == "both" else stream.arm == ARMS[arm]


def is_enough(stream: Stream, chosen: BoolArray) -> bool:
    """Return whether the chosen particles are enough for lines, or for a density."""
    return bool(chosen.sum() >= FEWEST and stream.weight[chosen].sum() > 0)


def too_few(names: Sequence[str]) -> Prediction:
    """Return the prediction of these numbers where the debris is not enough."""
    none = np.full(len(names), np.nan)
    return Prediction(tuple(names), none, none, why_not="too few particles have left the progenitor")


def kernels(x: Array) -> Array:
    """Return the kernel, 1 at its middle, at distances x from there in its standard deviations."""
    x2 = x**2
    return np.asarray(np.exp(-0.5 * x2) + np.exp(LN_WING + 1 - np.sqrt(1 + x2)))


def ln_coverage(ln_count: Array) -> Array:
    """(m,) Return ln c = ln(1 - exp(-n)): the chance that any particle is under a kernel where n are expected.

    It is practically zero where the stream has debris, however much. A factor that keeps rising with n would favour
    models that spread their debris to the positions of the data.
    """
    few = ln_count < LN_TINY
    return np.where(few, ln_count, np.log(-np.expm1(-np.exp(np.clip(ln_count, LN_TINY, LN_MOST)))))


def is_gap(ln_c: Array) -> BoolArray:
    """(m,) Return where fewer than `ENOUGH` particles are under the kernel, by the `ln_coverage` there."""
    return np.asarray(ln_c < ln_coverage(np.log(ENOUGH)), dtype=bool)


def share_near(at: Array, ln_count: Array, kernel: float, debris: float) -> float:
    """Return about which share of so much debris is between the first and the last of longitudes (m,) of lines."""
    order = np.argsort(at)
    density = np.exp(np.minimum(ln_count[order], LN_MOST)) / (math.sqrt(2 * math.pi) * kernel)
    return float(np.trapezoid(density, at[order]) / debris)


def warning_of_gaps(subject: str, empty: Array, kernel: float) -> str:
    """Return the warning that data, the subject, lie at longitudes (k,) without debris under the kernel."""
    where = ", ".join(f"{angle:g}" for angle in empty[:8]) + (", ..." if len(empty) > 8 else "")
    return (
        f"{subject} lie where the stream has no debris, fewer than {ENOUGH:g} particles within a kernel of "
        f"{kernel:g} deg (phi1 = {where}). Raise progenitor.lookback or stripping.particles, or place the progenitor "
        "nearer."
    )


def gather(longitude: Array, columns: Sequence[Array], weight: Array, margin: float = 0.0) -> Debris:
    """Sort particles by longitude (n,), for c columns (n,) and weights (n,).

    Particles within a margin (degrees) of either end of the turn are repeated beyond the other end, because a kernel
    may extend beyond the end.
    """
    order = np.argsort(longitude)
    longitude, weight = longitude[order], weight[order]
    sorted_ = np.stack([column[order] for column in columns])
    share = weight / weight.sum()
    centre = np.einsum("cn,n->c", sorted_, share)  # BLAS would wake threads for this, which costs far more
    sorted_ -= centre[:, None]
    about = longitude - (longitude * share).sum()
    breadth2 = max(float((about * about * share).sum()), 1e-12)
    slope = np.sqrt(np.einsum("cn,cn,n->c", sorted_, sorted_, share) / breadth2)
    if margin:
        low, high = np.searchsorted(longitude, (longitude[0] + margin, longitude[-1] - margin)).tolist()
        longitude = np.concatenate([longitude[high:] - TURN, longitude, longitude[:low] + TURN])
        sorted_ = np.concatenate([sorted_[:, high:], sorted_, sorted_[:, :low]], axis=1)
        weight = np.concatenate([weight[high:], weight, weight[:low]])
    return Debris(longitude, sorted_, weight, centre, slope)


def local_lines(debris: Debris, at: Array, kernel: float, enough: float = ENOUGH, depth: int = -1) -> Lines:
    """Fit a line to debris, at least one particle, at every longitude (m,) with a kernel, all in degrees.

    With fewer than ``enough`` particles under a kernel the slope shrinks towards zero, by a ridge of
    kernel^2 enough / count, and the spread towards its mean over all longitudes; 0 gives plain weighted least squares.
    The mean may be many times the spread: its share falls as 1 / count^4, far below the noise of the spread.
    ``depth`` is the column for whose spread the variance is computed; -1 for none.
    """
    order = np.argsort(at)
    powers = _powers(debris, kernel)
    tiles = [order[i : i + TILE] for i in range(0, len(at), TILE)]
    fits = [_tile(debris, powers, at[tile], kernel, enough, depth) for tile in tiles]
    parts = [np.empty((len(debris.columns), len(at))) for _ in range(3)] + [np.empty(len(at)) for _ in range(4)]
    for tile, fit in zip(tiles, fits, strict=True):
        for part, piece in zip(parts, fit, strict=True):
            part[..., tile] = piece
    value, noise, square, leverage, drift, fourth, count = parts
    number = np.exp(np.minimum(count, LN_MOST))
    few, pooled = enough / (number + enough), enough**4 / (number**4 + enough**4)
    sure = number + 1e-9
    pool = square @ sure / sure.sum()
    spread2 = square + pooled * (pool[:, None] - square)
    variance = noise + few * (pool[:, None] * leverage - noise) + (debris.slope[:, None] * drift) ** 2
    of_square = fourth + pooled * (2 * pool[depth] ** 2 * leverage - fourth)
    of_depth = of_square / np.maximum(4 * spread2[depth], 1e-300)
    return Lines(value + debris.centre[:, None], variance, np.sqrt(spread2), of_depth, count)


def lines_at(debris: Debris, at: Array, kernel: float, depth: int = -1) -> Lines:
    """Fit lines at longitudes (m,) as `local_lines`.

    If there are many more longitudes than `FINE` of a kernel can distinguish, the lines are fitted on an even grid of
    that spacing and splined: they are smooth over a kernel.
    """
    low, high = float(at.min()), float(at.max())
    nodes = int(np.ceil((high - low) / (FINE * kernel))) + 1
    if len(at) < max(2 * nodes, MANY):
        return local_lines(debris, at, kernel, depth=depth)
    grid = np.linspace(low, max(high, low + kernel), max(nodes, 5))
    fit = local_lines(debris, grid, kernel, depth=depth)
    splined = Lines(*(CubicSpline(grid, part, axis=-1)(at) for part in fit))
    floors = {name: np.maximum(getattr(splined, name), 0.0) for name in ("variance", "spread", "depth_variance")}
    return splined._replace(**floors)


def _powers(debris: Debris, kernel: float) -> Array:
    """(n + BLOCK, 3 + 3c) For each particle 1, x and x^2, and of every column y, y^2 and x y; then rows of zeros.

    x is the longitude less its mean in units of the kernel.
    """
    c, n = debris.columns.shape
    x = (debris.longitude - debris.longitude.mean()) / kernel
    rows = np.zeros((3 + 3 * c, n + BLOCK))
    rows[0, :n], rows[1, :n] = 1.0, x
    rows[3 : 3 + c, :n] = debris.columns
    np.multiply(x, x, out=rows[2, :n])
    np.multiply(debris.columns, debris.columns, out=rows[3 + c : 3 + 2 * c, :n])
    np.multiply(debris.columns, x, out=rows[3 + 2 * c :, :n])
    return np.ascontiguousarray(rows.T)


def _sums(weights: Array, powers: Array) -> Array:
    """(t, 3 + 3c) Sums of the powers (b BLOCK, 3 + 3c) with weights (t, b BLOCK).

    Block after block, each small enough for BLAS to take one thread: more cost more than they give.
    """
    t, n = weights.shape
    blocks = weights.reshape(t, n // BLOCK, BLOCK).transpose(1, 0, 2)
    return np.asarray((blocks @ powers.reshape(n // BLOCK, BLOCK, -1)).sum(axis=0))


def _tile(
    debris: Debris, powers: Array, at: Array, kernel: float, enough: float, depth: int
) -> tuple[Array, Array, Array, Array, Array, Array, Array]:
    """Fit the lines at a few neighbouring longitudes (t,).

    Returns b (c, t), its variance (c, t), and the mean square about it (c, t); for all columns the sum of the squared
    weights of the particles in b, how far a slope that is not fixed moves b, the variance of the depth's mean square,
    and ln of the count, (t,) each.
    """
    longitude, c = debris.longitude, len(debris.columns)
    i = np.searchsorted(longitude, at)
    last = len(longitude) - 1
    nearest = np.minimum(np.abs(longitude[np.maximum(i - 1, 0)] - at), np.abs(longitude[np.minimum(i, last)] - at))
    reach = nearest + REACH * kernel
    low, high = (np.searchsorted(longitude, end) for end in (at - reach, at + reach))
    begin = int(low.min())
    k = np.zeros((len(at), -(-(int(high.max()) - begin) // BLOCK) * BLOCK))
    far = np.where(nearest > kernel, nearest / kernel, 0.0)  # taken out, so that nothing underflows
    powers = powers[begin : begin + k.shape[1]]
    here = np.ascontiguousarray(powers[:, 1])
    centre = (at - longitude.mean()) / kernel
    for row, phi, lift, a, b in zip(k, centre.tolist(), far.tolist(), low.tolist(), high.tolist(), strict=True):
        _fill(row[a - begin : b - begin], here[a - begin : b - begin], debris.weight[a:b], phi, lift)
    total, x, x2, *of = _sums(k, powers).T
    count = np.log(total) - far
    x, x2 = x / total, x2 / total
    mean, mean2, xy = (np.array(of[j * c : (j + 1) * c]) / total for j in range(3))
    width = np.maximum(x2 - x * x, 0.0)
    ridge = enough / (np.exp(np.minimum(count, LN_MOST)) + enough)
    stiff = np.maximum(width + ridge, 1e-12)
    middle = x - centre
    tilt = middle / stiff
    root = np.multiply.outer(-tilt / total, here)
    root += ((1.0 + tilt * x) / total)[:, None]
    root *= k
    root *= root  # b is the sum of the columns times the root; its variance needs the square
    cross = xy - mean * x
    slope = cross / stiff
    square = np.maximum(mean2 - mean**2 - slope * (2 * cross - slope * width), 0.0)
    leverage, o, o2, *of = _sums(root, powers).T
    first, second, mixed = (np.array(of[j * c : (j + 1) * c]) for j in range(3))
    start = mean - slope * x  # the line is start + slope x
    noise = second - 2 * (start * first + slope * mixed) + start**2 * leverage + 2 * start * slope * o + slope**2 * o2
    fourth = np.zeros(len(at))
    if depth >= 0:
        rest = powers[:, 3 + depth] - start[depth][:, None] - np.multiply.outer(slope[depth], here)
        fourth = np.einsum("tn,tn,tn->t", (rest * rest - square[depth][:, None]) ** 2, k, k) / total**2
    drift = middle * kernel * ridge / stiff
    return mean - slope * middle, np.maximum(noise, 0.0), square, leverage, drift, fourth, count


def _fill(k: Array, x: Array, weight: Array, centre: float, lift: float) -> None:
    """Write the kernel about a centre, times e^lift and the weights, of particles at x (w,) into k (w,)."""
    x2 = x - centre
    x2 *= x2
    np.multiply(x2, -0.5, out=k)
    if lift:
        k += lift
    np.exp(k, out=k)
    x2 += 1.0
    np.sqrt(x2, out=x2)
    np.subtract(lift + 1.0 + LN_WING, x2, out=x2)
    k += np.exp(x2, out=x2)
    k *= weight
