"""The forces of the three forms of an expansion, elementwise: what numba compiles into the loop.

A table is one array: a head of `HEAD` numbers, then the coefficients of polynomials. They hold the
potential as cubic splines in s = ln r and w, a coordinate that runs from the plane to the pole, with a power of
e^(i phi) sin(theta) for each harmonic of the angle about the z axis. The force is the gradient of that, so an orbit
keeps its energy. Inside the innermost and outside the outermost node it is a power law in r.

    mu = z / r,    w^4 = mu^4 (r^2 + h^2) / (mu^2 r^2 + h^2)

Close to the plane w follows z for |z| < h, and at large angles it follows sqrt(mu): a disc of the thickness h is
resolved at all radii. Without a disc w is mu.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from streamkit.elementary import log, sqrt
from streamkit.engine import Patches
from streamkit.units import CENTRE

# Numbers in front of the coefficients: first s, intervals of s per unit and their number (0-2), the innermost and the
# outermost radius (3, 4), coefficients of r, 1, 1/r and 1/r^2 outside the outermost radius (9-12), the terms to add to
# them inside the innermost radius (5-8), h^2 (13), first w, intervals of w per unit and their number (14-16), -1 if the
# plane is a mirror, else 1 (17), the inverse of the outermost and of the innermost radius (18, 19).
HEAD = 20

OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": {"arcp", "contract"}, "forceinline": True}


@njit(**OPTIONS)
def radial(x, y, z, p):
    """Inverse radius, radius of the spline, interval and place in it, the factor beyond its ends over that radius."""
    r2 = x * x + y * y + z * z + CENTRE
    u = min(max((0.5 * log(r2) - p[0]) * p[1], 0.0), p[2])
    i = np.int32(min(u, p[2] - 1.0))
    r = sqrt(r2)
    inverse = 1.0 / r
    c, d = min(max(r, p[3]), p[4]), min(max(inverse, p[18]), p[19])
    q, t = r * d, c * inverse
    inner = 1.0 if q < 1.0 else 0.0  # as a factor: a choice of numbers of the table would be a gather
    k1, k0 = p[9] + inner * p[5], p[10] + inner * p[6]
    d1, d2 = p[11] + inner * p[7], p[12] + inner * p[8]
    return inverse, c, i, u - i, d * (k1 * q + k0 + t * (d1 + t * d2))


def _polar(bent: bool) -> Any:
    """Compile the interval of w and the place in it, dw/dmu (with its sign) and dw/ds."""

    @njit(**OPTIONS)
    def place(w, p):
        v = min(max((w - p[14]) * p[15], 0.0), p[16])
        j = np.int32(min(v, p[16] - 1.0))
        return j, v - j

    @njit(**OPTIONS)
    def straight(mu, c, p):
        w = max(mu, p[17] * mu)
        j, g = place(w, p)
        return j, g, 1.0 if w == mu else -1.0, 0.0

    @njit(**OPTIONS)
    def polar(mu, c, p):
        m = max(mu, p[17] * mu)
        c2, h2 = c * c, p[13]
        far, close = c2 + h2, m * m * c2 + h2
        both = 1.0 / (far * close)
        nearness = 1.0 - h2 * far * both
        root = sqrt(sqrt(far * far * both))
        w = m * root
        j, g = place(w, p)
        slope = root * (1.0 - 0.5 * nearness)
        return j, g, slope if m == mu else -slope, 0.5 * w * (c2 * close * both - nearness)

    return polar if bent else straight


@njit(**OPTIONS)
def _patch(values, n, g):
    """Value of a bicubic and its derivatives with respect to f and g, of `streamkit.engine.Patches`' values from n."""
    a1, a2, a3 = values[n + 1], values[n + 2], values[n + 3]
    value = values[n] + g * (a1 + g * (a2 + g * a3))
    along = values[n + 4] + g * (values[n + 5] + g * (values[n + 6] + g * values[n + 7]))
    return value, along, a1 + g * (2.0 * a2 + 3.0 * g * a3)


@njit(**OPTIONS)
def spherical(x, y, z, p):
    """Force of a sphere: cubics in ln r for r times the radial acceleration."""
    inverse, _, i, f, k = radial(x, y, z, p)
    b = HEAD + 4 * np.int64(i)
    g = (p[b] + f * (p[b + 1] + f * (p[b + 2] + f * p[b + 3]))) * k * inverse
    return g * x, g * y, g * z


@njit(**OPTIONS)
def _no_harmonics(values, g, ex, ey, tx, ty, bx, by, ds, dw, gx, gy):
    """End of the sum over harmonics."""
    return ds, dw, gx, gy


def _harmonics(orders: tuple[int, ...], sines: bool, n: int = 8) -> Any:
    """Compile the sum over harmonics, written out one after the other, so that lanes run together."""
    if not orders:
        return _no_harmonics
    order, rest = float(orders[0]), _harmonics(orders[1:], sines, n + (16 if sines else 8))

    @njit(**OPTIONS)
    def harmonics(values, g, ex, ey, tx, ty, bx, by, ds, dw, gx, gy):
        v, dv_s, dv_w = _patch(values, n, g)
        c, v = bx * ex - by * ey, order * v
        ds, dw, gx, gy = ds + c * dv_s, dw + c * dv_w, gx + v * bx, gy - v * by
        if sines:
            v, dv_s, dv_w = _patch(values, n + 8, g)
            c, v = bx * ey + by * ex, order * v
            ds, dw, gx, gy = ds + c * dv_s, dw + c * dv_w, gx + v * by, gy + v * bx
        return rest(values, g, ex, ey, tx, ty, bx * tx - by * ty, bx * ty + by * tx, ds, dw, gx, gy)

    return harmonics


def patches_of(orders: tuple[int, ...], sines: bool, bent: bool) -> Patches:
    """Return how the force of a potential with harmonics of these orders m is made.

    That is 0 and perhaps multiples of 1 or 2; with cosines and perhaps ``sines``. Where w is not mu it is ``bent``.
    """
    first, *_ = *orders[1:], 0
    harmonics, tables, polar = _harmonics(orders[1:], sines), 1 + (len(orders) - 1) * (1 + sines), _polar(bent)

    @njit(**OPTIONS)
    def locate(x, y, z, p):
        inverse, c, i, f, k = radial(x, y, z, p)
        j, g, wmu, ws = polar(z * inverse, c, p)
        return HEAD + 16.0 * tables * (i * p[16] + j), f, g, inverse, k, wmu, ws

    @njit(**OPTIONS)
    def finish(x, y, z, located, values, p):
        g, inverse, k, wmu, ws = located[2], located[3], located[4], located[5], located[6]
        ex, ey, mu = x * inverse, y * inverse, z * inverse
        _, ds, dw = _patch(values, 0, g)
        gx, gy = 0.0, 0.0
        if first == 1:  # (tx + i ty) = (ex + i ey)^first, and (bx + i by) is one power less
            ds, dw, gx, gy = harmonics(values, g, ex, ey, ex, ey, 1.0, 0.0, ds, dw, gx, gy)
        elif first == 2:
            ds, dw, gx, gy = harmonics(values, g, ex, ey, ex * ex - ey * ey, 2.0 * ex * ey, ex, ey, ds, dw, gx, gy)
        dw *= p[15]
        up = k * dw * wmu
        out = k * (ds * p[1] + dw * ws - (ex * gx + ey * gy)) - up * mu
        return -out * ex - k * gx, -out * ey - k * gy, -out * mu - up

    return Patches(tables, locate, finish)


@njit(**OPTIONS)
def _locate_sphere(x, y, z, p):
    inverse, _, i, f, k = radial(x, y, z, p)
    return HEAD + 16.0 * i, f, 0.0, inverse, k, 0.0, 0.0


@njit(**OPTIONS)
def _finish_sphere(x, y, z, located, values, p):
    g = values[0] * located[4] * located[3]
    return g * x, g * y, g * z


# A sphere as patches that are constant in w: for one that changes in time.
SPHERE = Patches(1, _locate_sphere, _finish_sphere)
