"""Knots along phi1: curves between them, as sparse matrices from numbers at the knots to numbers at the stars."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from streamkit import Array, IntArray

FEWEST, MOST = 4, 200  # a cubic needs four
ABOUT = 2  # knots on either side of an interval on which a curve depends


class Knots(NamedTuple):
    """An even grid of longitudes, and the curves through numbers at them.

    Attributes
    ----------
    phi1
        (K,) degrees, increasing.
    cubic, linear
        (N, K) weights of the knots at N stars: of a cubic curve, which is exact for parabolas, and of a line.
    left
        (N,) the knot before each star.
    """

    phi1: Array
    cubic: csr_array
    linear: csr_array
    left: IntArray

    def cubic_from(self) -> tuple[IntArray, Array]:
        """(N,) The first of the four knots that a cubic curve at each star depends on, and their weights (N, 4)."""
        first = np.clip(self.left - 1, 0, len(self.phi1) - FEWEST)
        columns = first[:, None] + np.arange(FEWEST)
        return first, np.take_along_axis(self.cubic.toarray(), columns, axis=1)

    def largest_about(self, numbers: Array) -> Array:
        """(N,) The largest of the numbers (K,) at the knots that a curve at each star may depend on."""
        last = len(numbers) - 1
        shifts = range(-ABOUT, ABOUT + 2)
        of_each = np.max([numbers[np.clip(np.arange(last) + shift, 0, last)] for shift in shifts], axis=0)
        return np.asarray(of_each[self.left])


def knots_between(low: float, high: float, count: int, at: Array) -> Knots:
    """Return knots from one end of a window to the other, with the weights at longitudes (N,) between the ends."""
    grid = np.linspace(low, high, count)
    step = grid[1] - grid[0]
    left = np.clip(((at - low) / step).astype(int), 0, count - 2)
    x = np.clip((at - grid[left]) / step, 0.0, 1.0)
    return Knots(grid, _cubic(left, x, count), _matrix(left, [1 - x, x], count), left)


def _cubic(left: Array, x: Array, count: int) -> csr_array:
    """Catmull & Rom 1974: the slope at a knot is that between its neighbours.

    Beyond the ends a parabola through three knots gives the missing neighbour.
    """
    before, here = -0.5 * x + x**2 - 0.5 * x**3, 1 - 2.5 * x**2 + 1.5 * x**3
    after, last = 0.5 * x + 2 * x**2 - 1.5 * x**3, -0.5 * x**2 + 0.5 * x**3
    weights = np.zeros((len(x), count + 2))
    rows = np.arange(len(x))
    for shift, part in enumerate((before, here, after, last)):
        weights[rows, left + shift] += part
    inside = weights[:, 1:-1]
    inside[:, :3] += np.outer(weights[:, 0], [3.0, -3.0, 1.0])
    inside[:, -3:] += np.outer(weights[:, -1], [1.0, -3.0, 3.0])
    return csr_array(inside)


def _matrix(left: Array, parts: list[Array], count: int) -> csr_array:
    rows = np.tile(np.arange(len(left)), len(parts))
    columns = np.concatenate([left + shift for shift in range(len(parts))])
    return csr_array((np.concatenate(parts), (rows, columns)), shape=(len(left), count))
