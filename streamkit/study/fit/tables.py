"""The tables of a fit, made of plain arrays. Their columns print with four digits; files hold all of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from streamkit.stream import Array

if TYPE_CHECKING:
    from astropy.table import QTable

# Percentiles in tables and pictures: the median with its central 68 % and 95 % intervals.
LEVELS = {"": 50.0, "lo68": 16.0, "hi68": 84.0, "lo95": 2.5, "hi95": 97.5}
DIGITS = ".4g"


def summary_table(names: Sequence[str], units: Sequence[str], samples: Array, judged: Mapping[str, Array]) -> QTable:
    """Return one row per parameter, from its samples (n, d) and more columns (d,).

    Parameters have different units, so the columns are plain numbers, with a column ``unit``. A narrow terminal leaves
    out columns in the middle: their order is one in which it still shows medians and intervals.
    """
    from astropy.table import QTable

    lo95, lo68, median, hi68, hi95 = np.percentile(samples, [2.5, 16, 50, 84, 97.5], axis=0)
    table = QTable({"parameter": list(names), "median": median, "lo68": lo68, "hi68": hi68})
    table["unit"] = [unit.replace(" ", "") or "1" for unit in units]
    for name, column in {**judged, "lo95": lo95, "hi95": hi95}.items():
        table[name] = column
    return printable(table)


def profile_table(radii: Array, mass: Array, v_c: Array) -> QTable:
    """Return median and intervals of M (n, nr) in Msun and v_c (n, nr) in km/s at radii (nr,) in kpc."""
    from astropy import units as u
    from astropy.table import QTable

    table = QTable({"r": radii * u.kpc})
    for name, values, unit in (("M", mass, u.Msun), ("v_c", v_c, u.km / u.s)):
        for level, percentiles in zip(LEVELS, np.percentile(values, list(LEVELS.values()), axis=0), strict=True):
            table[f"{name}_{level}".rstrip("_")] = percentiles * unit
    return printable(table)


def diagnostics_table(calls: int, reasons: Mapping[str, int], stuck: int, walkers: int) -> QTable:
    """Return the sampler's calls, the rejected ones by reason, and how many walkers are stuck."""
    from astropy.table import QTable

    rejected = sorted(reasons.items(), key=lambda item: -item[1])
    rows = [("evaluated proposals", calls, calls)]
    rows += [(f"rejected: {reason}", n, calls) for reason, n in rejected]
    rows += [("stuck walkers", stuck, walkers)] if walkers else []
    table = QTable(
        rows=[(what, n, n / whole if whole else np.nan) for what, n, whole in rows], names=("what", "count", "fraction")
    )
    return printable(table)


def printable(table: QTable, digits: str | None = DIGITS) -> QTable:
    """Give the columns of floats a short format; or, with None, that of files."""
    for column in table.itercols():
        if column.dtype.kind == "f":
            column.info.format = digits
    return table
