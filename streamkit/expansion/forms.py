"""The forces of the three forms of an expansion, elementwise: what numba compiles into the loop.

A table is one array: a head of `HEAD` numbers (see `Head`), then the coefficients of polynomials. They hold the
potential as cubic splines in s = ln r and w, a coordinate that runs from the plane to the pole, with a power of
e^(i phi) sin(theta) for each harmonic of the angle about the z axis. The force is the gradient of that, so an orbit
keeps its energy. Inside the innermost and outside the outermost node it goes on in a power of r.

    mu = z / r,    w^4 = mu^4 (r^2 + h^2) / (mu^2 r^2 + h^2)

Close to the plane w follows z for |z| < h, and at large angles it follows sqrt(mu): a disc of the thickness h is
resolved at all radii. Without a disc h is large, and w is mu.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from streamkit.elementary import log, sqrt

HEAD = 24
"""Numbers in front of the coefficients: first s, intervals of s per unit and their number (0-2), the innermost and
the outermost radius (3, 4), coefficients of r, 1, 1/r and 1/r^2 inside the one and outside the other (5-8, 9-12), h^2
(13), first w, intervals of w per unit and their number (14-16), -1 if the plane is a mirror, else 1 (17), number of
tables (18), step of the harmonics (19), 1 if there are sines (20)."""
TINY = 1e-30
"""kpc^2, added to squared radii: a force at the very centre is finite."""

OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": {"arcp", "contract"}, "forceinline": True}


@njit(**OPTIONS)
def _radial(x, y, z, p):
    """Radius, the radius of the spline, interval and place in it, and the factor beyond its ends."""
    r2 = x * x + y * y + z * z + TINY
    u = min(max((0.5 * log(r2) - p[0]) * p[1], 0.0), p[2])
    i = np.int32(min(u, p[2] - 1.0))
    r = sqrt(r2)
    c = min(max(r, p[3]), p[4])
    q = r / c
    d = 1.0 / q
    inner = q < 1.0
    k1, k0 = p[5] if inner else p[9], p[6] if inner else p[10]
    d1, d2 = p[7] if inner else p[11], p[8] if inner else p[12]
    return r, c, np.int64(i), u - i, k1 * q + k0 + d * (d1 + d * d2)


@njit(**OPTIONS)
def _polar(mu, c, p):
    """Interval of w and place in it, dw/dmu (with its sign) and dw/ds."""
    m = max(mu, p[17] * mu)
    c2, h2 = c * c, p[13]
    low = 1.0 / (m * m * c2 + h2)
    root = sqrt(sqrt((c2 + h2) * low))
    near = m * m * c2 * low
    w = m * root
    v = min(max((w - p[14]) * p[15], 0.0), p[16])
    j = np.int32(min(v, p[16] - 1.0))
    slope = root * (1.0 - 0.5 * near)
    return np.int64(j), v - j, slope if m == mu else -slope, 0.5 * w * (c2 / (c2 + h2) - near)


@njit(**OPTIONS)
def _patch(p, b, f, g):
    """Value of a bicubic and its derivatives with respect to f and g."""
    a0 = p[b] + f * (p[b + 4] + f * (p[b + 8] + f * p[b + 12]))
    a1 = p[b + 1] + f * (p[b + 5] + f * (p[b + 9] + f * p[b + 13]))
    a2 = p[b + 2] + f * (p[b + 6] + f * (p[b + 10] + f * p[b + 14]))
    a3 = p[b + 3] + f * (p[b + 7] + f * (p[b + 11] + f * p[b + 15]))
    d0 = p[b + 4] + f * (2.0 * p[b + 8] + 3.0 * f * p[b + 12])
    d1 = p[b + 5] + f * (2.0 * p[b + 9] + 3.0 * f * p[b + 13])
    d2 = p[b + 6] + f * (2.0 * p[b + 10] + 3.0 * f * p[b + 14])
    d3 = p[b + 7] + f * (2.0 * p[b + 11] + 3.0 * f * p[b + 15])
    value = a0 + g * (a1 + g * (a2 + g * a3))
    return value, d0 + g * (d1 + g * (d2 + g * d3)), a1 + g * (2.0 * a2 + 3.0 * g * a3)


@njit(**OPTIONS)
def _gradient(x, y, z, r, c, k, ds, dw, wmu, ws, radial, gx, gy):
    """Force from the derivatives: with respect to s, w, and of the powers of (x + iy) / r."""
    up = -k * dw * wmu / c
    out = (-k * (ds + dw * ws - radial) / c - up * z / r) / r
    return out * x - k * gx / c, out * y - k * gy / c, out * z + up


@njit(**OPTIONS)
def spherical(x, y, z, p):
    """Force of a sphere: cubics in ln r for r times the radial acceleration."""
    r, c, i, f, k = _radial(x, y, z, p)
    b = HEAD + 4 * i
    pull = p[b] + f * (p[b + 1] + f * (p[b + 2] + f * p[b + 3]))
    g = pull * k / (c * r)
    return g * x, g * y, g * z


@njit(**OPTIONS)
def axisymmetric(x, y, z, p):
    """Force of a potential that is the same at all azimuths."""
    r, c, i, f, k = _radial(x, y, z, p)
    j, g, wmu, ws = _polar(z / r, c, p)
    _, ds, dw = _patch(p, HEAD + 16 * (i * np.int64(p[16]) + j), f, g)
    return _gradient(x, y, z, r, c, k, ds * p[1], dw * p[15], wmu, ws, 0.0, 0.0, 0.0)


@njit(**OPTIONS)
def _no_harmonics(p, b, f, g, tx, ty, cx, cy, bx, by, order, ds, dw, radial, gx, gy):
    """End of the sum over harmonics."""
    return ds, dw, radial, gx, gy


def _harmonics(count: int, sines: bool) -> Any:
    """Compile the sum over ``count`` harmonics, written out one after the other, so that lanes run together."""
    if count == 0:
        return _no_harmonics
    rest, more = _harmonics(count - 1, sines), 32 if sines else 16

    @njit(**OPTIONS)
    def harmonics(p, b, f, g, tx, ty, cx, cy, bx, by, order, ds, dw, radial, gx, gy):
        v, dv_s, dv_w = _patch(p, b, f, g)
        ds, dw, v = ds + cx * dv_s, dw + cx * dv_w, order * v
        radial, gx, gy = radial + v * cx, gx + v * bx, gy - v * by
        if sines:
            v, dv_s, dv_w = _patch(p, b + 16, f, g)
            ds, dw, v = ds + cy * dv_s, dw + cy * dv_w, order * v
            radial, gx, gy = radial + v * cy, gx + v * by, gy + v * bx
        px, py = bx * tx - by * ty, bx * ty + by * tx
        qx, qy = cx * tx - cy * ty, cx * ty + cy * tx
        return rest(p, b + more, f, g, tx, ty, qx, qy, px, py, order + p[19], ds, dw, radial, gx, gy)

    return harmonics


def general(count: int, sines: bool) -> Any:
    """Return the force of any potential: ``count`` harmonics beyond the mean, cosines and perhaps sines."""
    harmonics, size = _harmonics(count, sines), 16 * (1 + count * (2 if sines else 1))

    @njit(**OPTIONS)
    def force(x, y, z, p):
        r, c, i, f, k = _radial(x, y, z, p)
        j, g, wmu, ws = _polar(z / r, c, p)
        b = HEAD + size * (i * np.int64(p[16]) + j)
        ex, ey = x / r, y / r
        half = p[19] > 1.5  # (tx + i ty) = (ex + i ey)^step, and (bx + i by) is one power less
        tx, ty = ex * ex - ey * ey if half else ex, 2.0 * ex * ey if half else ey
        bx, by = ex if half else 1.0, ey if half else 0.0
        _, ds, dw = _patch(p, b, f, g)
        ds, dw, radial, gx, gy = harmonics(p, b + 16, f, g, tx, ty, tx, ty, bx, by, p[19], ds, dw, 0.0, 0.0, 0.0)
        return _gradient(x, y, z, r, c, k, ds * p[1], dw * p[15], wmu, ws, radial, gx, gy)

    return force
