"""Elementary functions and tables for potentials: NumPy on arrays, vectorising arithmetic in the compiled loop.

`log`, `exp` and `power` of NumPy become calls to the scalar C library when numba compiles them, and the loop
around them stays scalar. These names are replaced by straight arithmetic (see ``engine/vector.py``), so that an
`acceleration` that uses them runs on all lanes of the processor.
"""

from __future__ import annotations

from typing import Any

import numpy as np


def log(x: Any) -> Any:
    """Natural logarithm of a positive number."""
    return np.log(x)


def exp(x: Any) -> Any:
    """Exponential function."""
    return np.exp(x)


def power(x: Any, y: Any) -> Any:
    """Return ``x ** y`` for positive x."""
    return np.exp(y * np.log(x))


def sqrt(x: Any) -> Any:
    """Square root."""
    return np.sqrt(x)


def interp(x: Any, xp: Any, fp: Any) -> Any:
    """Interpolate linearly between fp (n,) at xp (n,), which increase; beyond them the first or last value holds.

    ``xp`` may be two numbers ``(first, last)``, the ends of an even grid: that needs no search. The search of an uneven
    one costs about a nanosecond for every doubling of n in the compiled loop, and keeps it from running on all lanes.
    """
    if not isinstance(xp, tuple):
        return np.interp(x, xp, fp)
    k, s = _cell(x, xp, len(fp) - 1)
    return fp[k] + s * (fp[k + 1] - fp[k])


def cubic(x: Any, ends: Any, pieces: Any) -> Any:
    """Evaluate a piecewise cubic on an even grid, without a search; beyond its ends the value there holds.

    Parameters
    ----------
    x
        Where.
    ends
        First and last node, two numbers.
    pieces
        (n, 4) coefficients of 1, s, s^2 and s^3 in each of n cells, s from 0 to 1. `cubic_pieces` makes them.
    """
    k, s = _cell(x, ends, len(pieces))
    return pieces[k, 0] + s * (pieces[k, 1] + s * (pieces[k, 2] + s * pieces[k, 3]))


def cubic_pieces(values: Any, steps: Any) -> Any:
    """(n, 4) coefficients of the cubics through n + 1 values with given derivatives: for `cubic`.

    Parameters
    ----------
    values
        (n + 1,) at the nodes of an even grid.
    steps
        (n + 1,) derivatives there, times the distance of two nodes.
    """
    y, d = np.asarray(values, dtype=float), np.asarray(steps, dtype=float)
    rise = y[1:] - y[:-1]
    return np.stack([y[:-1], d[:-1], 3 * rise - 2 * d[:-1] - d[1:], d[:-1] + d[1:] - 2 * rise], axis=1)


def _cell(x: Any, ends: Any, count: int) -> tuple[Any, Any]:
    """Cell of an even grid, and the place in it from 0 to 1; NaN stays NaN."""
    u = np.clip((x - ends[0]) * (count / (ends[1] - ends[0])), 0.0, count)
    k = np.minimum(np.nan_to_num(u), count - 1).astype(int)
    return k, u - k
