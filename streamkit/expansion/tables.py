"""From the force at the nodes of a grid to the table of an expansion."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from streamkit.expansion.forms import HEAD
from streamkit.expansion.grid import INNER, OUTER, Grid
from streamkit.stream import Array


def table_of(grid: Grid, force: Array) -> Array:
    """Return the table of the form ``grid.form`` from the acceleration (3, nodes) at ``grid.positions()``."""
    return _sphere(grid, force) if grid.heights == 1 else _patches(grid, force)


def _sphere(grid: Grid, force: Array) -> Array:
    pull = (force * grid.positions()).sum(axis=0)
    spline = CubicSpline(grid.s, pull)
    cell = grid.s[1] - grid.s[0]
    coefficients = spline.c[::-1].T * cell ** np.arange(4)
    return np.concatenate([_head(grid, *_ends(pull, spline(grid.s[[0, -1]], 1))), coefficients.ravel()])


def _ends(pull: Array, slope: Array) -> tuple[float, float]:
    """Powers of r of the force inside the first and outside the last node, from r a_r and its slope there."""
    inner, outer = (float(slope[k] / pull[k]) - 1.0 if pull[k] != 0 else 0.0 for k in (0, -1))
    return inner, outer


def _powers(n: float) -> tuple[float, float, float, float]:
    """Coefficients of q, 1, 1/q and 1/q^2: a sum that is 1 and has the slope n at q = 1, from -2 to 1."""
    n = min(max(n, -2.0), 1.0)
    if n >= 0:
        return n, 1 - n, 0.0, 0.0
    return (0.0, 1 + n, -n, 0.0) if n > -1 else (0.0, 0.0, 2 + n, -1 - n)


def _head(grid: Grid, inner: float, outer: float) -> Array:
    head = np.zeros(HEAD)
    cells, heights = grid.radii - 1, grid.heights - 1
    head[:5] = grid.s[0], cells / (grid.s[-1] - grid.s[0]), cells, INNER, OUTER
    head[9:13] = _powers(outer)
    head[5:9] = np.array(_powers(inner)) - head[9:13]
    if heights:
        w = grid.w
        head[13:17] = grid.thickness**2, w[0], heights / (w[-1] - w[0]), heights
    head[17] = -1.0 if grid.mirror else 1.0
    head[18:20] = 1.0 / OUTER, 1.0 / INNER
    return head


def _derivatives(grid: Grid, force: Array) -> tuple[Array, Array, Array]:
    """(radii, heights, angles) Derivatives of the potential with respect to s, w and phi at the nodes."""
    shape = grid.radii, grid.heights, grid.angles
    x, y, z = grid.positions().reshape(3, *shape)
    ax, ay, az = np.asarray(force).reshape(3, *shape)
    mu = grid.mu()
    wmu, ws = (slope[..., None] for slope in grid.slopes(mu))
    r = np.exp(grid.s)[:, None, None]
    outward = (x * ax + y * ay) / (x * x + y * y)  # of the component across the axis, over the distance from it
    dw = -r * (az - mu[..., None] * r * outward) / wmu
    ds = -(x * ax + y * ay + z * az) - dw * ws
    return ds, dw, y * ax - x * ay


def _patches(grid: Grid, force: Array) -> Array:
    """Return the table of bicubic splines of every harmonic of the potential.

    That of the mean over azimuth is integrated outwards along the axis, and from there towards the plane; those of
    the others follow from the torque about the axis.
    """
    ds, dw, dphi = _derivatives(grid, force)
    mean = ds.mean(axis=(1, 2))
    head = _head(grid, *_ends(-mean, -np.gradient(mean, grid.s)[[0, -1]]))
    sine = np.sqrt(1 - grid.mu() ** 2)
    even, uneven = _harmonics(grid, ds, 1.0), _harmonics(grid, dw, 1.0)
    torque = _harmonics(grid, dphi, -1.0)
    parts = []
    for m, value, along, across in zip(_orders(grid), torque, even, uneven, strict=True):
        if m == 0:
            axis = CubicSpline(grid.s, along[:, -1]).antiderivative()(grid.s)
            down = CubicSpline(grid.w, across, axis=1).antiderivative()(grid.w)
            parts.append(_bicubic(grid, axis[:, None] + down - down[:, -1:], along[[0, -1]], across, m))
            continue
        power = sine**m
        potential, ends = value / power, (along / power)[[0, -1]]
        for poles in (slice(None),) if grid.mirror else (slice(None), slice(None, None, -1)):
            _fill_pole(potential[:, poles], sine[:, poles])
            _fill_pole(ends[:, poles], sine[[0, -1]][:, poles])
        parts.append(_bicubic(grid, potential, ends, across / power, m))
    cells = np.stack(parts, axis=3)  # (radii - 1, heights - 1, 4 powers of s, tables, 4 powers of w)
    return np.concatenate([head, cells.ravel()])


def _orders(grid: Grid) -> list[int]:
    """Order of the harmonic of each table."""
    return [m for m in grid.orders for _ in range(2 if m and grid.sines else 1)]


def _harmonics(grid: Grid, values: Array, parity: float) -> list[Array]:
    """Amplitudes (radii, heights) of the harmonics, for each table, from values at the azimuths.

    Of the potential itself, given its derivative with respect to phi, if ``parity`` is -1.
    """
    if grid.angles == 1:
        return [values[..., 0]]
    if not grid.sines:
        values = np.concatenate([values, parity * values[..., -2:0:-1]], axis=-1)
    spectrum = np.fft.rfft(values, axis=-1) / values.shape[-1]
    parts = [spectrum[..., 0].real]
    for k, m in enumerate(grid.orders):
        if k:
            amplitude = 2.0 * (spectrum[..., k] if parity > 0 else spectrum[..., k] / (1j * m))
            parts += [amplitude.real, -amplitude.imag] if grid.sines else [amplitude.real]
    return parts


def _fill_pole(values: Array, sine: Array) -> None:
    """Put what a parabola in sin^2(theta) through the last nodes says at the pole, in place."""
    x = sine[:, -4:-1] ** 2
    total = np.zeros(len(values))
    for k in range(3):
        others = [i for i in range(3) if i != k]
        weight = np.prod([-x[:, i] / (x[:, k] - x[:, i]) for i in others], axis=0)
        total += weight * values[:, k - 4]
    values[:, -1] = total


def _bicubic(grid: Grid, values: Array, ends: Array, dw: Array, m: int) -> Array:
    """(radii - 1, heights - 1, 4, 4) Coefficients of the C2 spline with the derivatives given at its ends."""
    s, w = grid.s, grid.w
    low: object = (1, dw[:, 0]) if grid.mirror or not m else "not-a-knot"
    high: object = "not-a-knot" if m else (1, dw[:, -1])
    along = CubicSpline(w, values, axis=1, bc_type=(low, high)).c[::-1]  # (4, heights - 1, radii)
    edge = CubicSpline(w, ends, axis=1).c[::-1]  # (4, heights - 1, 2)
    up = CubicSpline(s, along, axis=2, bc_type=((1, edge[..., 0]), (1, edge[..., 1]))).c[::-1]
    scale = np.outer((s[1] - s[0]) ** np.arange(4), (w[1] - w[0]) ** np.arange(4))
    # (4 powers of s, radii - 1, 4 powers of w, heights - 1) -> (radii - 1, heights - 1, 4, 4)
    return np.asarray((up * scale[:, None, :, None]).transpose(1, 3, 0, 2))
