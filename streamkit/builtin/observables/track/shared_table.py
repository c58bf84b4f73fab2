"""One table for all columns of a track: longitudes, and each column with its errors, where values may be missing."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

import streamkit as sk
from streamkit.builtin.observables.track.columns import COLUMNS, DEPTH

VALUES = {name: column.unit for name, column in COLUMNS.items()} | {DEPTH: "kpc"}
ERRORS = {f"{name}_error": unit for name, unit in VALUES.items()}
TABLE = (
    sk.Columns(phi1="deg")
    .optional(**VALUES, **ERRORS)
    .between("phi2", -90, 90)
    .positive("distance", *ERRORS)
    .with_gaps(*VALUES, *ERRORS)
)


def data_of(table: sk.Table) -> dict[str, tuple[sk.Array, sk.Array, sk.Array]]:
    """Return longitudes, values and errors (k,) of each column that has values; ValueError for one without an error."""
    parts = {}
    for name in VALUES:
        if name not in table:
            continue
        rows = rows_of(table, name)
        if not len(rows):
            continue
        if f"{name}_error" not in table:
            raise ValueError(f"the column '{name}_error' is missing: each value needs its error")
        error = table[f"{name}_error"][rows]
        if np.isnan(error).any():
            raise ValueError(f"{name}: row {int(rows[np.argmax(np.isnan(error))]) + 1} has a value and no error")
        parts[name] = table["phi1"][rows], table[name][rows], error
    return parts


def rows_of(table: sk.Table, name: str) -> sk.IntArray:
    """(k,) The rows that have a value of a column."""
    return np.flatnonzero(np.isfinite(table[name]))


def redrawn(table: sk.Table, drawn: Mapping[str, sk.Array]) -> dict[str, list[float]]:
    """Return the table with other values (k,) of some columns."""
    columns = {name: np.array(table[name]) for name in table.names}
    for name, values in drawn.items():
        columns[name][rows_of(table, name)] = values
    return {name: column.tolist() for name, column in columns.items()}


def check_sources(
    own: Collection[str],
    table: sk.Table | None,
    of_table: Collection[str],
    members: sk.Table | None,
    of_members: Collection[str],
    compared: Collection[str] | None,
) -> None:
    """Refuse columns from several places: fields of their ``own``, a shared table, members; ValueError says which.

    ``compared`` names columns of table and members, which both have been read without the others.
    """
    if compared is not None and table is None and members is None:
        raise ValueError("compared names columns of table or members, and there are no members and no table")
    for source, names in (("table", of_table), ("members", of_members)):
        if twice := [name for name in names if name in own]:
            raise ValueError(f"{twice[0]} is a table and also in {source}: leave it out of `compared`")
    if twice := [name for name in of_members if name in of_table]:
        raise ValueError(f"{twice[0]} is in table and also in members: name in `compared` what is compared of both")
    missing = [name for name in compared or () if name not in (*of_table, *of_members)]
    if missing and table is not None:
        raise ValueError(f"table has no {missing[0]}; it has {', '.join(data_of(table)) or 'no values'}")
