"""The sum over all pairs of particles in single precision: compiled to vector code, on several cores."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np
from numba import njit
from numpy.typing import NDArray

from streamkit import Array

CHUNK = 128  # particles whose sums are made together: their loop has no branches, and becomes vector instructions
SINGLE, DOUBLE = np.float32, np.float64
# contract: fused multiply-add; arcp: one reciprocal. The sums are not reordered, so any machine gives the same bits
# but for these two.
FAST = {"contract", "arcp"}


@njit(nogil=True, error_model="numpy", fastmath=FAST)
def _accelerations(q, support, begin, end, out):  # type: ignore[no-untyped-def]
    """Fill out (3, n) from begin to end: the acceleration by all particles of unit mass at q (3, n), with G = 1.

    The force of the cubic spline at u = r / support (Springel 2001, New Astronomy 6, 79, appendix A).
    """
    one, half, tiny = SINGLE(1), SINGLE(0.5), SINGLE(1e-12)
    inner = SINGLE(32 / 3), SINGLE(-192 / 5), SINGLE(32)
    outer = SINGLE(64 / 3), SINGLE(-48), SINGLE(192 / 5), SINGLE(-32 / 3), SINGLE(-1 / 15)
    unit, n = one / (support * support), q.shape[1]
    x, y, z = q[0], q[1], q[2]
    sums = np.empty((3, CHUNK), dtype=SINGLE)
    ax, ay, az = sums[0], sums[1], sums[2]
    for first in range(begin, end, CHUNK):
        m = min(CHUNK, end - first)
        xi, yi, zi = x[first : first + m], y[first : first + m], z[first : first + m]
        sums[:] = SINGLE(0)
        for j in range(n):
            xj, yj, zj = x[j], y[j], z[j]
            for i in range(m):
                dx, dy, dz = xj - xi[i], yj - yi[i], zj - zi[i]
                u2 = max((dx * dx + dy * dy + dz * dz) * unit, tiny)
                inverse = one / math.sqrt(u2)
                u, newton = u2 * inverse, inverse * inverse * inverse
                near = inner[0] + u2 * (inner[1] + u * inner[2])
                middle = outer[0] + u * (outer[1] + u * (outer[2] + u * outer[3])) + outer[4] * newton
                soft = near if u < half else middle
                force = newton if u2 >= one else soft
                ax[i] += force * dx
                ay[i] += force * dy
                az[i] += force * dz
        for i in range(m):
            out[0, first + i], out[1, first + i], out[2, first + i] = ax[i], ay[i], az[i]


@njit(nogil=True, error_model="numpy", fastmath=FAST)
def _potentials(q, support, begin, end, out):  # type: ignore[no-untyped-def]
    """Fill out (1, n) from begin to end: the potential of all other particles, as `_accelerations`."""
    zero, one, half, tiny = SINGLE(0), SINGLE(1), SINGLE(0.5), SINGLE(1e-12)
    inner = SINGLE(-14 / 5), SINGLE(16 / 3), SINGLE(-48 / 5), SINGLE(32 / 5)
    outer = SINGLE(-16 / 5), SINGLE(32 / 3), SINGLE(-16), SINGLE(48 / 5), SINGLE(-32 / 15), SINGLE(1 / 15)
    unit, n = one / (support * support), q.shape[1]
    x, y, z = q[0], q[1], q[2]
    sums = np.empty(CHUNK, dtype=SINGLE)
    for first in range(begin, end, CHUNK):
        m = min(CHUNK, end - first)
        xi, yi, zi = x[first : first + m], y[first : first + m], z[first : first + m]
        sums[:] = SINGLE(0)
        for j in range(n):
            xj, yj, zj = x[j], y[j], z[j]
            for i in range(m):
                dx, dy, dz = xj - xi[i], yj - yi[i], zj - zi[i]
                r2 = dx * dx + dy * dy + dz * dz
                u2 = max(r2 * unit, tiny)
                inverse = one / math.sqrt(u2)
                u = u2 * inverse
                near = inner[0] + u2 * (inner[1] + u2 * (inner[2] + u * inner[3]))
                middle = outer[0] + u2 * (outer[1] + u * (outer[2] + u * (outer[3] + u * outer[4])))
                soft = near if u < half else middle + outer[5] * inverse
                value = -inverse if u2 >= one else soft
                sums[i] += value if r2 > zero else zero  # without the particle itself
        for i in range(m):
            out[0, first + i] = sums[i]


def sum_accelerations(q: Array, support: float, workers: int = 1) -> Array:
    """(3, n) Accelerations of particles of unit mass at q (3, n) with G = 1; see `_summed`."""
    # The compiled loop leaves out 1 / support^3.
    return _summed(_accelerations, 3, q, support, workers) / support**3


def sum_potentials(q: Array, support: float, workers: int = 1) -> Array:
    """(n,) Potentials at particles of unit mass at q (3, n) with G = 1, by the other particles; see `_summed`."""
    return _summed(_potentials, 1, q, support, workers)[0] / support


def _summed(loop: object, rows: int, q: Array, support: float, workers: int) -> Array:
    """(rows, n) The result of a compiled loop over all pairs, in units of the support of the spline.

    Positions are counted from their mean: single precision then resolves 1e-7 of their spread.
    """
    n = q.shape[1]
    single: NDArray[np.float32] = np.ascontiguousarray(q - q.mean(axis=1, keepdims=True), dtype=SINGLE)
    out: NDArray[np.float32] = np.empty((rows, n), dtype=SINGLE)
    chunks = -(-n // CHUNK)
    # Only whole chunks: particles in an incomplete one, which fill no register, would be rounded differently.
    edges = [min(CHUNK * (chunks * k // workers), n) for k in range(workers + 1)]
    parts = pairwise(edges)

    def fill(part: tuple[int, int]) -> None:
        """Fill a part of the result: the sum of each particle does not depend on the parts."""
        loop(single, SINGLE(support), *part, out)  # type: ignore[operator]

    if workers == 1:
        fill((0, n))
    else:
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(fill, parts))
    return out.astype(DOUBLE)
