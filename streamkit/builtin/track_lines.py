"""Kernel-weighted local lines: columns of the debris at given longitudes, smooth in every particle.

At each longitude a line y = b + a (phi - phi_i) is fitted by weighted least squares in closed form. The kernel is a
Gaussian with faint exponential wings, so that there is always an answer: where debris is missing, the nearest debris
gives it, the number of particles under the kernel falls as exp(-distance / kernel), and the variance grows.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from streamkit import Array

WING = 1e-3
"""Height of the exponential wings: the Gaussian is all that counts within three kernels of debris."""
REACH = 4.0
"""Kernels beyond the nearest particle after which the wings are cut, where both are 4e-4 of the peak among debris."""
ENOUGH = 5.0
"""Particles under a kernel that give a line: far below it the slope and the spread are those of the whole stream."""

TURN = 360.0
"""Degrees."""


class Debris(NamedTuple):
    """Particles in the order of their longitudes.

    Attributes
    ----------
    longitude
        (n,) degrees, increasing.
    columns
        (c, n) what was measured of them, less its mean over all.
    weight
        (n,) how many particles each one stands for.
    centre, slope
        (c,) that mean, and the ratio of the standard deviations of the column and the longitude: how steep a line
        may be.
    """

    longitude: Array
    columns: Array
    weight: Array
    centre: Array
    slope: Array


class Lines(NamedTuple):
    """The lines at m longitudes, of c columns.

    Attributes
    ----------
    value
        (c, m) b, the column at the longitude.
    variance
        (c, m) variance of b from the finite number of particles, and from a line that debris on one side or far away
        does not fix.
    spread
        (c, m) standard deviation of the particles about the line.
    depth_variance
        (m,) variance of the spread of one column.
    ln_count
        (m,) ln of the number of particles under the kernel.
    """

    value: Array
    variance: Array
    spread: Array
    depth_variance: Array
    ln_count: Array


def gather(longitude: Array, columns: Array, weight: Array, margin: float = 0.0) -> Debris:
    """Sort particles by longitude (n,), for columns (c, n) and weights (n,).

    With a margin, those so many degrees from either end of the turn are repeated beyond the other one, so that a kernel
    may reach over the seam.
    """
    order = np.argsort(longitude)
    longitude, columns, weight = longitude[order], columns[:, order], weight[order]
    share = weight / weight.sum()
    centre = columns @ share
    columns = columns - centre[:, None]
    about = longitude - longitude @ share
    slope = np.sqrt(columns**2 @ share / max(float(about**2 @ share), 1e-12))
    if margin:
        low, high = np.searchsorted(longitude, (longitude[0] + margin, longitude[-1] - margin)).tolist()
        longitude = np.concatenate([longitude[high:] - TURN, longitude, longitude[:low] + TURN])
        columns = np.concatenate([columns[:, high:], columns, columns[:, :low]], axis=1)
        weight = np.concatenate([weight[high:], weight, weight[:low]])
    return Debris(longitude, columns, weight, centre, slope)


def local_lines(debris: Debris, at: Array, kernel: float, enough: float = ENOUGH, depth: int = -1) -> Lines:
    """Fit a line at every longitude.

    Parameters
    ----------
    debris
        At least one particle.
    at
        (m,) longitudes in degrees.
    kernel
        Standard deviation of the Gaussian, degrees.
    enough
        Particles under a kernel below which the slope shrinks towards zero, by a ridge of kernel^2 enough / count. The
        spread shrinks towards its mean over all longitudes. 0 for plain weighted least squares.
    depth
        The column whose spread is wanted with its variance; -1 for none.
    """
    both = np.concatenate([debris.columns, debris.columns**2])
    found = [_line(debris, both, phi, kernel, enough, depth) for phi in at.tolist()]
    value, noise, square = (np.array(part).T for part in zip(*(f[:3] for f in found), strict=True))
    leverage, drift, fourth, count = np.array([f[3:] for f in found]).T
    number = np.exp(np.minimum(count, 300.0))
    few = enough / (number + enough)
    sure = number + 1e-9
    pool = square @ sure / sure.sum()
    spread2 = square + few * (pool[:, None] - square)
    variance = noise + few * (pool[:, None] * leverage - noise) + (debris.slope[:, None] * drift) ** 2
    of_square = fourth + few * (2 * pool[depth] ** 2 * leverage - fourth)
    of_depth = of_square / np.maximum(4 * spread2[depth], 1e-300)
    return Lines(value + debris.centre[:, None], variance, np.sqrt(spread2), of_depth, count)


def _line(
    debris: Debris, both: Array, phi: float, kernel: float, enough: float, depth: int
) -> tuple[Array, Array, Array, float, float, float, float]:
    """Fit one line.

    Returns b (c,), its variance (c,), and the mean square about it (c,); for all columns the sum of the squared weights
    of the particles in b, how far a slope that is not fixed moves b, the variance of the depth's mean square, and ln of
    the count.
    """
    longitude = debris.longitude
    i = int(np.searchsorted(longitude, phi))
    nearest = min(abs(float(longitude[j]) - phi) for j in (max(i - 1, 0), min(i, len(longitude) - 1)))
    ends = (phi - nearest - REACH * kernel, phi + nearest + REACH * kernel)
    low, high = np.searchsorted(longitude, ends).tolist()
    x = (longitude[low:high] - phi) / kernel
    x2 = x * x
    far = float(np.sqrt(1.0 + (nearest / kernel) ** 2)) - 1.0  # taken out, so that nothing underflows
    k = np.exp(far - 0.5 * x2)
    k += WING * np.exp(far + 1.0 - np.sqrt(1.0 + x2))
    k *= debris.weight[low:high]
    total = float(k.sum())
    count = float(np.log(total)) - far
    k /= total
    middle = float(k @ x)
    x -= middle
    width = float(k @ (x * x))
    ridge = enough / (float(np.exp(min(count, 300.0))) + enough)
    stiff = max(width + ridge, 1e-12)
    own2 = (k * (1.0 - middle / stiff * x)) ** 2  # b is the sum of the columns times the root of this
    part = np.empty((len(k), 4))
    part[:, 0], part[:, 1], part[:, 2], part[:, 3] = k, k * x, own2, own2 * x
    sums = both[:, low:high] @ part
    c = len(debris.columns)
    first, second = sums[:c], sums[c:]
    mean, slope = first[:, 0], first[:, 1] / stiff
    square = np.maximum(second[:, 0] - mean**2 - slope * (2 * first[:, 1] - slope * width), 0.0)
    leverage, skew, spin = float(own2.sum()), float(part[:, 3].sum()), float(part[:, 3] @ x)
    noise = (
        second[:, 2] - 2 * (mean * first[:, 2] + slope * first[:, 3])
        + mean**2 * leverage + 2 * mean * slope * skew + slope**2 * spin
    )  # fmt: skip
    fourth = 0.0
    if depth >= 0:
        residual = debris.columns[depth, low:high] - mean[depth] - slope[depth] * x
        fourth = float((residual * residual - square[depth]) ** 2 @ (k * k))
    drift = middle * kernel * ridge / stiff
    return mean - slope * middle, np.maximum(noise, 0.0), square, leverage, drift, fourth, count
