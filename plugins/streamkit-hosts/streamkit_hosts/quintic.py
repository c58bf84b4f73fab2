"""Splines of the fifth degree through values and slopes, as AGAMA makes them (Vasiliev 2019, MNRAS 482, 1525)."""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_banded

from streamkit import Array


class Quintic:
    """Piecewise polynomials through values (k, n) with slopes (k, n) at nodes (k,), with three continuous derivatives.

    The fourth derivative vanishes at both ends.
    """

    def __init__(self, nodes: Array, value: Array, slope: Array) -> None:
        self.nodes, self.value, self.slope = nodes, value, slope
        inverse = 1 / np.diff(nodes)
        h = inverse[:, None]
        band = np.zeros((3, len(nodes)))
        band[1, 1:] += 3 * inverse
        band[1, :-1] += 3 * inverse
        band[0, 1:], band[2, :-1] = -inverse, -inverse
        band[0, 1], band[2, -2] = -2 * inverse[0], -2 * inverse[-1]
        rise = np.diff(value, axis=0) * h
        right = np.zeros(value.shape)
        right[1:] -= (20 * rise - 12 * slope[1:] - 8 * slope[:-1]) * h**2
        right[:-1] += (20 * rise - 12 * slope[:-1] - 8 * slope[1:]) * h**2
        right[0] = (30 * rise[0] - 14 * slope[1] - 16 * slope[0]) * h[0] ** 2
        right[-1] = (-30 * rise[-1] + 14 * slope[-2] + 16 * slope[-1]) * h[-1] ** 2
        right[[0, -1]] /= h[[0, -1]]
        band[1, [0, -1]] = 3.0
        band[0, 1], band[2, -2] = -2.0, -2.0
        self.bend = solve_banded((1, 1), band, right)

    def __call__(self, x: Array) -> tuple[Array, Array]:
        """(m, n) The splines at places (m,) between the first and the last node, and their slopes."""
        return self._at(x[:, None], self._piece(x)[:, None], np.arange(self.value.shape[1])[None])

    def each(self, x: Array) -> tuple[Array, Array]:
        """(n,) Each spline at a place of its own (n,), and its slope."""
        return self._at(x, self._piece(x), np.arange(self.value.shape[1]))

    def _piece(self, x: Array) -> Array:
        return np.clip(np.searchsorted(self.nodes, x, side="right") - 1, 0, len(self.nodes) - 2)

    def _at(self, x: Array, low: Array, column: Array) -> tuple[Array, Array]:
        h = self.nodes[low + 1] - self.nodes[low]
        u = (x - self.nodes[low]) / h
        f, g = self.value[low, column], self.value[low + 1, column]
        df, dg = self.slope[low, column] * h, self.slope[low + 1, column] * h
        bf, bg = self.bend[low, column] * h**2, self.bend[low + 1, column] * h**2
        rise = g - f
        a = 10 * rise - 6 * df - 4 * dg - 1.5 * bf + 0.5 * bg
        b = -15 * rise + 8 * df + 7 * dg + 1.5 * bf - bg
        c = 6 * rise - 3 * (df + dg) + 0.5 * (bg - bf)
        value = f + u * (df + u * (0.5 * bf + u * (a + u * (b + u * c))))
        return value, (df + u * (bf + u * (3 * a + u * (4 * b + u * 5 * c)))) / h
