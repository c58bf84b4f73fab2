"""The common parts of both fits of an apocentre: grid of angles, soft window, Gaussian, result."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from streamkit import Array

CELL = 1.0  # grid of angles, degrees
KERNEL = 4.0  # standard deviation of the smoothing kernel of the track, degrees
WINDOW, EDGE = 40.0, 5.0  # half width of the fitted window (Gibbons+ 2014) and the scale of its soft edges, degrees
REACH = 45.0  # limit of the search for the first guess, from the progenitor's own apocentre, degrees
# Particles farther than this from the progenitor's apocentre have no influence, degrees.
FARTHEST = 2 * REACH + WINDOW + 3 * EDGE
FEWEST = 30  # fewest particles in the window (sum of weights)
# Smallest fraction of the particles in the window on either side of the maximum. Without this limit a Gaussian through
# debris that only rises, or only falls, would measure the end of the debris.
COVERAGE = 0.05

NO_GAUSSIAN = "no Gaussian fits the track near the progenitor's own apocentre"
NOT_YET = "the track does not come down beyond its maximum"
NO_RISE = "the track does not rise to its maximum"
TOO_FEW = "too few particles near the apocentre"


@dataclass(frozen=True)
class ArmFit:
    """The fitted apocentre: angle (degrees, progenitor at 0, leading positive) and radius (kpc).

    variance holds those of radius and angle from the finite number of particles; track and curve are (angle, r)
    for plots.
    """

    angle: float
    radius: float
    variance: tuple[float, float]
    track: tuple[Array, Array]
    curve: tuple[Array, Array]


def arm_fit(q: Array, variance: tuple[float, float], grid: Array, track: Array, count: Array) -> ArmFit:
    """Return the fit q = (A, m, ln s), and for plots the track where there are particles, and the curve."""
    shown = count > 0.2
    curve = q[1] + np.linspace(-WINDOW, WINDOW, 81)
    return ArmFit(
        angle=float(q[1]),
        radius=float(q[0]),
        variance=variance,
        track=(grid[shown], track[shown]),
        curve=(curve, gaussian(curve, q)[0]),
    )


def cells(angle: Array, grid: Array, *values: Array) -> list[Array]:
    """Sums of values (n,) on the grid, each particle shared linearly between its two neighbours."""
    place = (angle - grid[0]) / CELL
    i = place.astype(np.int64)
    f = place - i

    return [
        np.asarray(np.bincount(i, (1 - f) * w, len(grid)) + np.bincount(i + 1, f * w, len(grid)), dtype=float)
        for w in values
    ]


def convolve(cell: Array) -> Array:
    """Smooth what is on the grid with a Gaussian kernel of the width `KERNEL`."""
    half = np.arange(-int(4 * KERNEL / CELL), int(4 * KERNEL / CELL) + 1) * CELL
    kernel = np.exp(-0.5 * (half / KERNEL) ** 2)
    return np.convolve(cell, kernel / kernel.sum(), mode="same")


def window(x: Array) -> Array:
    """1 within the fitted window about 0, 0 outside, with soft edges."""
    return between(x, -WINDOW, WINDOW)


def between(x: Array, low: float, high: float) -> Array:
    """1 between low and high, 0 outside, with soft edges."""
    return np.asarray(0.5 * (np.tanh((x - low) / EDGE) - np.tanh((x - high) / EDGE)))


def gaussian(x: Array, q: Array) -> tuple[Array, Array]:
    """A exp(-(x - m)^2 / 2 s^2) at x (n,) and its derivatives (3, n) by A, m and ln s; q = (A, m, ln s)."""
    u = (x - q[1]) * np.exp(-q[2])
    g = np.exp(-0.5 * u * u)
    model = q[0] * g
    return model, np.array([g, model * u * np.exp(-q[2]), model * u * u])


def one_sided(angle: Array, share: Array, centre: float, coverage: float) -> str:
    """Return a reason if too little of the weights (n,) at angles (n,) is beyond the maximum, or before it."""
    beyond = share[np.abs(angle) > abs(centre)].sum() / share.sum()
    return NOT_YET if beyond < coverage else NO_RISE if beyond > 1 - coverage else ""


def is_sensible(q: Array) -> bool:
    """Whether height and width of the Gaussian q = (A, m, ln s) are those of any apocentre."""
    return bool(0 < q[0] < 1e4 and np.log(5.0) < q[2] < np.log(1e3))
