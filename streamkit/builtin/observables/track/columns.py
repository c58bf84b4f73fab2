"""The columns of a track: name, unit, label, and the values of particles."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import Field

import streamkit as sk
from streamkit import Array, Seen, place_on_sky


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

Outliers = Annotated[sk.Number, Field(ge=0, lt=1, description="Fraction of its data that are no members.")]
Name = Literal["phi2", "distance", "distance_modulus", "pm_phi1_cosphi2", "pm_phi2", "radial_velocity"]
# Functions that move drawn data into the allowed range.
LIMITS: dict[str, Callable[[Array], Array]] = {"phi2": lambda angle: np.clip(angle, -90, 90), "distance": np.abs}

DEPTH = "distance_depth"  # the field whose datum is the spread of the distance


def one_column(**value: str) -> sk.Columns:
    """Declare a table of longitudes, one value and its errors in the value's unit."""
    (unit,) = value.values()
    return sk.Columns(phi1="deg", **value, error=unit).positive("error")


def column_of(name: str) -> str:
    """Return the column that a field's data are compared with."""
    return "distance" if name == DEPTH else name


def names_of(given: Mapping[str, tuple[Array, Array, Array]]) -> tuple[str, ...]:
    """Return a name for every datum: the column and the longitude, and a count where several have the same."""
    seen: dict[str, int] = {}
    names = []
    for column, (phi1, _, _) in given.items():
        for angle in phi1.tolist():
            name = f"{column} at {angle:g}"
            seen[name] = seen.get(name, 0) + 1
            names.append(name if seen[name] == 1 else f"{name} ({seen[name]})")
    return tuple(names)


def within(angle: Array, middle: float) -> Array:
    """(n,) Angles in degrees within half a turn of the middle."""
    return np.asarray(angle - 360.0 * np.round((angle - middle) / 360.0))


def radii_of(given: Mapping[str, tuple[Array, Array, Array]], matrix: Array) -> dict[str, float]:
    """Return the smallest and the largest Galactocentric radius of the distances, seen from 8 kpc at phi2 = 0.

    ``given`` are the data by field: longitudes, values and errors; the matrix (3, 3) leads from ICRS to their frame.
    """
    parts = [(phi1, value) for name, (phi1, value, _) in given.items() if name == "distance"]
    parts += [
        (phi1, 10 ** ((value - 10) / 5)) for name, (phi1, value, _) in given.items() if name == "distance_modulus"
    ]
    if not parts:
        return {}
    phi1, distance = (np.concatenate(part) for part in zip(*parts, strict=True))
    q = place_on_sky(phi1, np.zeros(len(phi1)), distance, matrix)
    r = np.sqrt((q**2).sum(axis=0))
    return {"innermost distance": float(r.min()), "outermost distance": float(r.max())}
