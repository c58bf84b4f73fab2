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
EXTRA = Field(
    ge=0,
    description="Extra error of its track: of the model, or of a smooth table. Two data at longitudes that differ by d "
    "have the covariance s^2 exp(-d^2 / 2 l^2), with the error s and `extra_error_length` l.",
)
ALIKE = Field(ge=0, description="Length l in phi1 over which the extra errors are alike; they need one above 0.")
Name = Literal["phi2", "distance", "distance_modulus", "pm_phi1_cosphi2", "pm_phi2", "radial_velocity"]
# Functions that move drawn data into the allowed range.
LIMITS: dict[str, Callable[[Array], Array]] = {"phi2": lambda angle: np.clip(angle, -90, 90), "distance": np.abs}

MOST_TURNS = 2  # of a stream whose longitudes are unwrapped by mistake alone: more are those of another unit
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


def check_turn(given: Mapping[str, tuple[Array, Array, Array]], unwrapped: bool) -> None:
    """Refuse longitudes that run over more than a turn without being unwrapped; ValueError says which."""
    for name, (phi1, _, _) in given.items():
        if not unwrapped and np.ptp(phi1) > 360:
            wrong = np.ptp(phi1) > MOST_TURNS * 360 and np.abs(phi1).max() * np.pi / 180 <= 360
            raise ValueError(
                f"{name}: phi1 runs over {np.ptp(phi1):g} deg, more than a turn; expected "
                + ('the unit "deg" for phi1, as numbers in degrees?' if wrong else "unwrapped = true")
            )


def middle_of(phi1: Array) -> float:
    """Return the middle of longitudes on the circle, in degrees."""
    return float(np.degrees(np.angle(np.exp(1j * np.radians(phi1)).sum())))


def extra_error_of(track: sk.Observable, name: str) -> float | Array:
    """Return the extra error of a field's data; the depth has none."""
    return 0.0 if name == DEPTH else getattr(track, f"{name}_extra_error")


def check_extra_errors(track: sk.Observable, pair: tuple[str, ...]) -> None:
    """Refuse extra errors without a length or beside outliers; ValueError says which.

    The columns of a pair have a covariance, so that neither has outliers where one has an extra error.
    """
    for name in COLUMNS:
        if not extra_error_of(track, name):
            continue
        if not track.extra_error_length > 0:  # type: ignore[attr-defined]
            raise ValueError(
                f"{name}_extra_error is alike along the track: expected extra_error_length, the degrees of phi1 over "
                f"which it is, above 0. An error of each datum by itself is {name}_dispersion"
            )
        for other in pair if name in pair else (name,):
            if getattr(track, f"{other}_outliers"):
                raise ValueError(
                    f"{name}_extra_error and {other}_outliers: a column with an extra error has no outliers; leave out "
                    f"either, or take {name}_dispersion in place of the extra error"
                )
