"""The table of a `multipole` potential: Phi_lm at radii and times, with radii as close as its splines need."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from streamkit import Array, Multipoles, StreamkitError

MOST_ROWS = 2_000_000
FEWEST_RADII, MOST_RADII = 25, 800
PRECISION = 3e-5  # of the radial force between two radii, in that of the mean potential
LEAST = 0.1  # of the largest r dPhi/dr: where it is less than that, such as at the centre, errors are in this


def check_rows(rows: int, what: str, remedy: str) -> None:
    """Refuse a table that would be too large; ``what`` says what makes it so."""
    if rows > MOST_ROWS:
        raise StreamkitError(f"the table would have {rows} rows ({what}); expected at most {MOST_ROWS}: {remedy}")


def table_of(times: Array, radii: Array, harmonics: Sequence[tuple[int, int]], phi: Array) -> Any:
    """Return the table of Phi_lm (T, h, k) in (km/s)^2 at times (T,) in Gyr and radii (k,) in kpc.

    Without a column t for a single time.
    """
    from astropy.table import Table  # slow to import

    n, m = np.array(harmonics).T
    columns = {
        "l": np.tile(np.repeat(n, len(radii)), len(times)),
        "m": np.tile(np.repeat(m, len(radii)), len(times)),
        "r": np.tile(radii, len(n) * len(times)),
        "phi": phi.ravel(),
    }
    units = {"r": "kpc", "phi": "km2 / s2"}
    if len(times) > 1:
        columns, units = {"t": np.repeat(times, phi[0].size), **columns}, {"t": "Gyr", **units}
    return Table(columns, units=units)


def force_of(phi: Array, radii: Array, harmonics: Sequence[tuple[int, int]], place: Array) -> Array:
    """(3, n) The force in (km/s)^2/kpc of Phi_lm (h, k) at places (3, n) in kpc."""
    n, m = np.array(harmonics).T
    sphere = Multipoles(np.repeat(n, len(radii)), np.repeat(m, len(radii)), np.tile(radii, len(n)), phi.ravel())
    return np.stack(sphere.acceleration(*place))


def close_radii(
    phi_at: Callable[[Array], Array], first: float, last: float, precision: float = PRECISION
) -> tuple[Array, Array]:
    """Return radii (k,) from ``first`` to ``last``, and Phi_lm (T, h, k) there, of a function of radii (k,).

    They are twice as many until cubic splines in ln r through every second one have the force to ``precision``, at most
    `MOST_RADII`. The mean potential is the first of the h.
    """
    radii = np.geomspace(first, last, FEWEST_RADII)
    phi = phi_at(radii)
    while len(radii) <= MOST_RADII // 2:
        finer = np.geomspace(first, last, 2 * len(radii) - 1)
        exact = phi_at(finer)
        s = np.log(finer)
        slope = CubicSpline(s, exact, axis=2)(s, 1)
        missed = CubicSpline(s[::2], exact[:, :, ::2], axis=2)(s, 1) - slope
        mean = np.abs(slope[:, 0])
        error = np.sqrt((missed**2).sum(axis=1)) / np.maximum(mean, LEAST * mean.max(axis=1, keepdims=True))
        radii, phi = finer, exact
        if error.max() < precision:
            return radii[::2], phi[:, :, ::2]
    return radii, phi
