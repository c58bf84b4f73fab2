"""The tables of a fit, made of plain arrays. Their columns print with four digits; files hold all of them."""

from __future__ import annotations

import numpy as np
from astropy.table import QTable

from streamkit.stream import Array

# Percentiles in tables and pictures: the median with its central 68 % and 95 % intervals.
LEVELS = {"": 50.0, "lo68": 16.0, "hi68": 84.0, "lo95": 2.5, "hi95": 97.5}
DIGITS = ".4g"


def intervals(values: Array) -> dict[str, Array]:
    """Return median and ends of intervals of values (n, ...) over the first axis, by the names of `LEVELS`."""
    return dict(zip(LEVELS, np.percentile(values, list(LEVELS.values()), axis=0), strict=True))


def printable(table: QTable, digits: str | None = DIGITS) -> QTable:
    """Give the columns of floats a short format; or, with None, that of files."""
    for column in table.itercols():
        if column.dtype.kind == "f":
            column.info.format = digits
    return table
