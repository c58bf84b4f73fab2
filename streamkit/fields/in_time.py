"""A number that changes in time: knots, ``{ times = ["-3 Gyr", 0], values = [100, 120] }`` in the run file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from streamkit import engine
from streamkit.errors import nearest
from streamkit.stream import Array
from streamkit.units import UNITS

KNOTS = ("times", "values")
MOST_KNOTS = 1000


@dataclass(frozen=True)
class InTime:
    """A monotone cubic through knots (Fritsch & Carlson 1980), constant before the first and after the last.

    Between two knots it does not leave their values, so what holds for the values of the knots holds at all times.
    """

    times: tuple[float, ...]  # in Gyr, increasing; 0 is today
    values: tuple[float, ...]  # in the unit of the field

    def at(self, t: float) -> float:
        """Return the value at a time in Gyr."""
        return float(engine.values_at(np.array([t]), self._pieces)[0])

    @cached_property
    def _pieces(self) -> Array:
        return self.pieces(1.0, 1.0)

    def pieces(self, time: float, value: float) -> Array:
        """Return the pieces for the engine, whose units are smaller by these factors: see `engine.Changes`."""
        from scipy.interpolate import PchipInterpolator  # slow to import, and only such numbers need it

        t, y = np.array(self.times) * time, np.array(self.values) * value
        out = engine.linear(t, y)
        out[1:-1, 1:5] = PchipInterpolator(t, y).c[::-1].T
        return out

    def integral(self, time: float, value: float) -> Array:
        """Return the pieces of the integral from today to a time of the difference from the value today."""
        rate = self.pieces(time, value)
        now = float(engine.values_at(np.zeros(1), rate)[0])
        out = np.zeros_like(rate)
        out[:, 0] = rate[:, 0]
        rate[:, 1] -= now
        out[:, 2:] = rate[:, 1:-1] / np.arange(1, out.shape[1] - 1)
        for k in range(1, len(out) - 1):
            s = out[k + 1, 0] - out[k, 0]
            out[k + 1, 1] = out[k, 1:] @ s ** np.arange(out.shape[1] - 1)
        out[:, 1] -= float(engine.values_at(np.zeros(1), out)[0])
        return out


def times_of(table: Mapping[str, Any]) -> tuple[float, ...]:
    """Return the times in Gyr of a table of knots; ValueError with a sentence if it is none.

    Its values, as many, are for the caller to read.
    """
    for key in table:
        if key not in KNOTS:
            raise ValueError(f"knots in time have no {key!r}.{nearest(str(key), KNOTS)} Allowed: times, values")
    if lacking := [key for key in KNOTS if key not in table]:
        raise ValueError(f"knots in time need times and values; found no {lacking[0]}")
    lists = [table[key] for key in KNOTS]
    for key, given in zip(KNOTS, lists, strict=True):
        if isinstance(given, str | Mapping) or not isinstance(given, Sequence):
            raise ValueError(f"found {key} = {given!r}, expected a list")
    if len(lists[0]) != len(lists[1]) or not 2 <= len(lists[0]) <= MOST_KNOTS:
        raise ValueError(
            f"found {len(lists[0])} times and {len(lists[1])} values, expected as many of both, 2 to {MOST_KNOTS}"
        )
    times = [float(UNITS["Duration"].parse(time)) for time in lists[0]]
    for before, after in pairwise(times):
        if not before < after:
            raise ValueError(f"the times must increase, found {after:g} Gyr after {before:g} Gyr; 0 is today")
    return tuple(times)
