"""Speeds of particles in spheres whose isotropic distribution function has a closed form, over the escape speed."""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.special import betaincinv

from streamkit import Array

CELLS = 1024  # cells of a table of speeds: the error of linear interpolation is far below the particles' noise
# Cells are evenly spaced in 1 - (1 - fraction^(1/3))^(1/4). The fraction of slow particles grows as the cube of the
# speed. Near the escape speed it depends on a high power of the remaining energy.
RADII = np.linspace(np.log(1e-4), np.log(1e4), 321)  # ln(r / a) of the table for Hernquist's sphere


def plummer_speeds(chance: Array) -> Array:
    """(n,) Speeds over the escape speed with fractions ``chance`` (n,) of slower particles, the same at all radii.

    f(E) ~ E^(7/2), so that s^2 (1 - s^2)^(7/2) is the density of s (Aarseth, Henon & Wielen 1974, A&A 37, 183).
    """
    return np.interp(np.cbrt(chance), *_plummer_table())


@cache
def _plummer_table() -> tuple[Array, Array]:
    """Cube roots of the fractions at the edges of the cells, and the speeds."""
    roots = _edges()
    return roots, np.sqrt(betaincinv(1.5, 4.5, roots**3))


def hernquist_speeds(radius: Array, chance: Array) -> Array:
    """(n,) The same at radii (n,) in units of a, by the distribution function of Hernquist 1990, eq. 17."""
    table = _hernquist_table()
    place = np.clip((np.log(radius) - RADII[0]) / (RADII[1] - RADII[0]), 0, len(RADII) - 1)
    i = np.minimum(place.astype(int), len(RADII) - 2)
    cell = (1 - np.sqrt(np.sqrt(1 - np.cbrt(chance)))) * CELLS
    k = np.minimum(cell.astype(int), CELLS - 1)
    s, w = place - i, cell - k
    below = (1 - w) * table[i, k] + w * table[i, k + 1]
    above = (1 - w) * table[i + 1, k] + w * table[i + 1, k + 1]
    return np.asarray((1 - s) * below + s * above)


@cache
def _hernquist_table() -> Array:
    """(radii, CELLS + 1) Speeds at each radius and at the edges of the cells."""
    roots = _edges()
    s = np.linspace(0.0, 1.0, 4 * CELLS + 1) ** 2  # finer at low speeds, for the slow particles in a cusp
    table = np.empty((len(RADII), CELLS + 1))
    for row, depth in zip(table, 1 / (1 + np.exp(RADII)), strict=True):
        q = np.sqrt(depth * (1 - s * s))
        left = 1 - q * q
        f = (3 * np.arcsin(q) + q * np.sqrt(left) * (1 - 2 * q * q) * (8 * q**4 - 8 * q * q - 3)) / left**2.5
        density = s * s * f
        shares = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(s))])
        row[:] = np.interp(roots, np.cbrt(shares / shares[-1]), s)
    return table


def _edges() -> Array:
    """(CELLS + 1,) Cube roots of the fractions at the edges of the cells."""
    return np.asarray(1 - (1 - np.linspace(0.0, 1.0, CELLS + 1)) ** 4)
