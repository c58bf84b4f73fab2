"""Member stars in ICRS as columns of a track: their angles, proper motions and errors in the frame of the stream."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

import streamkit as sk

POSITION_ERROR = 1e-3  # error of phi2 in degrees, far below the width of any stream
PLAIN = ("distance", "distance_modulus", "radial_velocity")  # columns with the same numbers in every frame
MOTIONS = ("pm_phi1_cosphi2", "pm_phi2")
IN_ICRS = ("pm_ra_cosdec", "pm_dec")

VALUES = {"distance": "kpc", "distance_modulus": "mag", "pm_ra_cosdec": "mas/yr", "pm_dec": "mas/yr",
          "radial_velocity": "km/s"}  # fmt: skip
ERRORS = {f"{name}_error": unit for name, unit in VALUES.items()}
MEMBERS = (
    sk.Columns(ra="deg", dec="deg")
    .optional(**VALUES, **ERRORS, pm_correlation="")
    .between("ra", -360, 360)
    .between("dec", -90, 90)
    .positive("distance", *ERRORS)
    .with_gaps(*VALUES, *ERRORS, "pm_correlation")
)


@dataclass(frozen=True, eq=False)
class Members:
    """The stars of a table, in the frame of the stream."""

    table: sk.Table
    frame: sk.SkyFrame
    phi1: sk.Array  # (n,) degrees
    # (n,) by the names of the track's columns; NaN where a star has none.
    values: Mapping[str, sk.Array]
    errors: Mapping[str, sk.Array]
    covariance: sk.Array  # (n,) of the two proper motions, (mas/yr)^2; NaN where a star has none

    def rows(self, name: str) -> sk.IntArray:
        """(k,) The stars that have a value of a column."""
        return np.flatnonzero(np.isfinite(self.values[name]))

    def column(self, name: str) -> tuple[sk.Array, sk.Array, sk.Array]:
        """Return longitudes, values and errors (k,) of the stars that have a value."""
        rows = self.rows(name)
        return self.phi1[rows], self.values[name][rows], self.errors[name][rows]

    def redrawn(self, drawn: Mapping[str, sk.Array]) -> dict[str, list[float]]:
        """Return the table in ICRS with other values (k,) of some columns; the errors in the frame do not change."""
        values = {name: np.array(column) for name, column in self.values.items()}
        for name, column in drawn.items():
            values[name][self.rows(name)] = column
        table: dict[str, Any] = {name: np.array(self.table[name]) for name in self.table.names}
        table |= {name: values[name] for name in PLAIN if name in values}
        motions = [values.get(name, np.full(len(self.phi1), np.nan)) for name in MOTIONS]
        table["ra"], table["dec"], *pm = self.frame.to_icrs(self.phi1, values["phi2"], *motions)
        if MOTIONS[0] in values:
            table |= dict(zip(IN_ICRS, pm, strict=True))
            here = _matrix(self.errors[MOTIONS[0]], self.errors[MOTIONS[1]], self.covariance)
            turn = self.frame.turn(table["ra"], table["dec"])
            there = turn.swapaxes(1, 2) @ here @ turn
            errors = np.sqrt(there[:, 0, 0]), np.sqrt(there[:, 1, 1])
            table |= {f"{name}_error": error for name, error in zip(IN_ICRS, errors, strict=True)}
            table["pm_correlation"] = there[:, 0, 1] / (errors[0] * errors[1])
        return {name: column.tolist() for name, column in table.items()}


def members_of(table: sk.Table, frame: sk.Frame) -> Members:
    """Return the stars of a table in a frame; ValueError for a value without an error, or half a proper motion.

    The covariance of the proper motions, from Gaia's errors in ra and dec and `pm_correlation`, is rotated with them.
    """
    for name in VALUES:
        if name in table and f"{name}_error" not in table:
            raise ValueError(f"the column '{name}_error' is missing: each value needs its error")
        if name in table and (without := np.isfinite(table[name]) & ~np.isfinite(table[f"{name}_error"])).any():
            raise ValueError(f"{name}: row {int(np.argmax(without)) + 1} has a value and no error")
    if (IN_ICRS[0] in table) != (IN_ICRS[1] in table):
        raise ValueError(f"a proper motion has two components: the table needs {' and '.join(IN_ICRS)}")
    circle, none = sk.sky_frame(sk.sky_matrix(frame)), np.full(len(table), np.nan)
    ra, dec = table["ra"], table["dec"]
    motions = (none, none) if IN_ICRS[0] not in table else tuple(table[name] for name in IN_ICRS)
    phi1, phi2, *pm = circle.from_icrs(ra, dec, *motions)
    values = {"phi2": phi2} | {name: table[name] for name in PLAIN if name in table}
    errors = {"phi2": np.full(len(table), POSITION_ERROR)}
    errors |= {name: table[f"{name}_error"] for name in PLAIN if name in table}
    covariance = none
    if IN_ICRS[0] in table:
        correlation = np.nan_to_num(table["pm_correlation"]) if "pm_correlation" in table else np.zeros(len(table))
        if not (np.abs(correlation) < 1).all():
            raise ValueError(f"pm_correlation: row {int(np.argmax(np.abs(correlation))) + 1} is not within -1 and 1")
        e_ra, e_dec = (table[f"{name}_error"] for name in IN_ICRS)
        turn = circle.turn(ra, dec)
        there = turn @ _matrix(e_ra, e_dec, correlation * e_ra * e_dec) @ turn.swapaxes(1, 2)
        values |= dict(zip(MOTIONS, pm, strict=True))
        errors |= {name: np.sqrt(there[:, i, i]) for i, name in enumerate(MOTIONS)}
        covariance = there[:, 0, 1]
    return Members(table, circle, phi1, values, errors, covariance)


def _matrix(one: sk.Array, other: sk.Array, covariance: sk.Array) -> sk.Array:
    """(n, 2, 2) Covariances from standard errors and covariances (n,)."""
    return np.asarray(np.moveaxis(np.array([[one**2, covariance], [covariance, other**2]]), 2, 0))


def which_columns(members: Members, compared: Sequence[str] | None) -> tuple[str, ...]:
    """Return the columns that are compared; ValueError for a column that the table lacks."""
    have = tuple(name for name in members.values if len(members.rows(name)))
    if compared is None:
        return have
    if missing := [name for name in compared if name not in have]:
        raise ValueError(f"members have no {missing[0]}; they have {', '.join(have)}")
    return tuple(name for name in have if name in compared)
