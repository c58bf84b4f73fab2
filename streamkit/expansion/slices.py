"""Tables of an expansion that changes in time: splines of every coefficient, as weights of the slices of four times.

A spline in time through n tables is a sum of n slices, of which four count at a time (B-splines). It is cubic, with two
continuous derivatives, through four tables or more, a parabola through three and a line through two. The table of the
expansion then has these parts, one behind the other: its head, the head of the times, a list that leads from evenly
spaced times to intervals, the ends of these, the polynomials of the weights, and the slices. A slice holds the points
of cubic B-splines in ln r (radii + 2, heights - 1, tables, 4 powers of w).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from scipy.interpolate import BSpline, PPoly, make_interp_spline

from streamkit.engine import SLICES, Patches
from streamkit.expansion.forms import HEAD, OPTIONS
from streamkit.expansion.grid import Grid
from streamkit.stream import Array

POWERS = 4  # of a weight as a polynomial of the time since the beginning of its interval
# Numbers of the head of the times: first and last time, entries of the list per unit of time, the number of its last
# entry (0-3), where the list, the ends of intervals, the polynomials and the slices begin (4-7), the lengths of a slice
# and of the points of one radius in it (8, 9).
TIME_HEAD = 10
FIRST, LAST, PER_TIME, LAST_ENTRY, LIST, EDGES, WEIGHTS, BODY, LENGTH, ROW = range(HEAD, HEAD + TIME_HEAD)


@njit(**OPTIONS)
def at_time(t, p):
    """Where the slices of a time are, and their weights: see `streamkit.engine.Patches`.

    Before the first time and after the last they are those of that time.
    """
    now = min(max(t, p[FIRST]), p[LAST])
    n = np.int64(p[np.int64(p[LIST]) + np.int64(min((now - p[FIRST]) * p[PER_TIME], p[LAST_ENTRY]))])
    edges = np.int64(p[EDGES])
    n += 1 if now >= p[edges + n + 1] else 0
    s, b = now - p[edges + n], np.int64(p[WEIGHTS]) + SLICES * POWERS * n
    w0 = p[b] + s * (p[b + 1] + s * (p[b + 2] + s * p[b + 3]))
    w1 = p[b + 4] + s * (p[b + 5] + s * (p[b + 6] + s * p[b + 7]))
    w2 = p[b + 8] + s * (p[b + 9] + s * (p[b + 10] + s * p[b + 11]))
    w3 = p[b + 12] + s * (p[b + 13] + s * (p[b + 14] + s * p[b + 15]))
    return p[BODY] + n * p[LENGTH], p[LENGTH], p[ROW], w0, w1, w2, w3


def in_time(static: Patches) -> Patches:
    """Return the patches of a form whose table changes."""
    located = static.locate

    @njit(**OPTIONS)
    def locate(x, y, z, p):
        first, f, g, inverse, k, wmu, ws = located(x, y, z, p)
        return 0.25 * (first - HEAD), f, g, inverse, k, wmu, ws

    return Patches(static.number, locate, static.finish, at_time)


def table_in_time(grid: Grid, times: Array, tables: Array) -> Array:
    """Return the table of an expansion that changes, from its tables (n, k) at increasing times (n,).

    The powers of r beyond the innermost and the outermost radius are those of the last table.
    """
    points = np.array([_points(grid, table[HEAD:]) for table in tables])
    edges, weights, body = weights_and_slices(times, points.reshape(len(times), -1))
    span, shortest = times[-1] - times[0], np.diff(edges).min()
    entries = int(np.ceil(span / shortest))
    even = times[0] + span / entries * np.arange(entries)
    listed = np.minimum(np.searchsorted(edges, even, side="right") - 1, len(edges) - 2)
    head = np.zeros(TIME_HEAD)
    parts = [tables[-1, :HEAD], head, listed, np.append(edges[:-1], np.inf), weights, body]
    begin = np.cumsum([0, *(part.size for part in parts)])
    head[:] = times[0], times[-1], entries / span, entries - 1, *begin[2:6], body.shape[1], points[0, 0].size
    return np.concatenate([np.ravel(part) for part in parts])


def _points(grid: Grid, body: Array) -> Array:
    """(radii + 2, k) Points of the splines in ln r of a table, from the polynomials in its cells."""
    cells = body.reshape(grid.radii - 1, max(grid.heights - 1, 1), 4, -1)
    if grid.heights == 1:  # a patch of a sphere is constant in w
        cells = np.concatenate([cells, np.zeros((*cells.shape[:3], 3))], axis=3)
    a0, a1, a2, a3 = cells.transpose(2, 0, 1, 3).reshape(4, grid.radii - 1, -1)
    p1 = a0 - a2 / 3
    p0, p2 = p1 + a2 - a1, p1 + a2 + a1
    p3 = 6 * a3 + 3 * (p2 - p1) + p0
    return np.concatenate([p0, p1[-1:], p2[-1:], p3[-1:]])


def weights_and_slices(times: Array, values: Array) -> tuple[Array, Array, Array]:
    """Return the spline through values (n, k) at times (n,).

    Its edges (intervals + 1,), the coefficients (intervals, `SLICES`, `POWERS`) of its weights, and its slices.
    """
    degree = min(len(times) - 1, POWERS - 1)
    spline = make_interp_spline(times, values, k=degree)
    count = len(spline.c)
    weights = np.zeros((count - degree, SLICES, POWERS))
    for k, one in enumerate(np.eye(count)):
        powers = PPoly.from_spline(BSpline(spline.t, one, degree)).c[::-1, degree:count]  # powers, intervals
        for i in range(max(k - degree, 0), min(k, len(weights) - 1) + 1):
            weights[i, k - i, : degree + 1] = powers[:, i]
    slices = np.concatenate([spline.c, np.zeros((max(SLICES - count, 0), values.shape[1]))])
    return spline.t[degree : count + 1], weights, slices
