"""Data grouped by the column that they measure, for tables and pictures of many data."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from streamkit.stream import Array, IntArray

MANY = 8  # with more data, tables and pictures show columns


def by_column(names: Sequence[str]) -> dict[str, IntArray]:
    """Return the numbers (k,) of the data of each column, by its name: "phi2" of "phi2 at -60"."""
    rows: dict[str, list[int]] = {}
    for i, name in enumerate(names):
        rows.setdefault(name.partition(" at ")[0], []).append(i)
    return {name: np.array(which) for name, which in rows.items()}


def rms(values: Array) -> Array:
    """(...) Root of the mean square over the last axis, of those that are known; NaN without any."""
    finite = np.isfinite(values)
    square = np.where(finite, values, 0.0) ** 2
    count = finite.sum(axis=-1)
    return np.asarray(np.sqrt(np.where(count > 0, square.sum(axis=-1) / np.maximum(count, 1), np.nan)))
