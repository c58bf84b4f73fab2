"""The columns of a track: name, unit, label, and the values of particles."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from streamkit import Array, Seen


class Column(NamedTuple):
    """One column: its unit, its label in figures, and a function for the particles' values (n,)."""

    unit: str
    label: str
    of: Callable[[Seen], Array]


# By the names of the fields and of the tables' columns.
COLUMNS: dict[str, Column] = {
    "phi2": Column("deg", r"$\phi_2$", lambda seen: seen.lat),
    "distance": Column("kpc", "distance", lambda seen: seen.distance),
    "distance_modulus": Column("mag", "distance modulus", lambda seen: np.asarray(5 * np.log10(seen.distance) + 10)),
    "pm_phi1_cosphi2": Column("mas/yr", r"$\mu_{\phi_1} \cos \phi_2$", lambda seen: seen.pm_lon_coslat),
    "pm_phi2": Column("mas/yr", r"$\mu_{\phi_2}$", lambda seen: seen.pm_lat),
    "radial_velocity": Column("km/s", r"$v_r$", lambda seen: seen.radial_velocity),
}

DEPTH = "distance_depth"  # the field whose datum is the spread of the distance


def column_of(name: str) -> str:
    """Return the column that a field's data are compared with."""
    return "distance" if name == DEPTH else name


def within(angle: Array, middle: float) -> Array:
    """(n,) Angles in degrees within half a turn of the middle."""
    return np.asarray(angle - 360.0 * np.round((angle - middle) / 360.0))
