"""Arguments of a force that change in time: piecewise polynomials, evaluated once for all particles of one time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from numba import njit

from streamkit.engine.cache import INLINE, OPTIONS, UNCALLED
from streamkit.stream import Array

# For each argument after t that changes, its number and its pieces in time; the number FACTOR is the whole force's.
# A row of the pieces (k, 6) is the time from which it holds, and the coefficients of powers of the time since then. The
# first row holds at all times before the second one too.
Changes: TypeAlias = tuple[tuple[int, Array], ...]
FACTOR = -1
DEGREE = 4  # of the polynomials


def numbers_of(changes: Changes) -> tuple[int, ...]:
    """Return which arguments change: this and the layout decide the machine code."""
    return tuple(number for number, _ in changes)


def tables_of(changes: Changes) -> tuple[Array, ...]:
    """Return the pieces, which follow the arguments in compiled code."""
    return tuple(pieces for _, pieces in changes)


def linear(times: Array, values: Array) -> Array:
    """Return the pieces of a line through values (n,) at increasing times (n,), constant beyond them."""
    pieces = np.zeros((len(times) + 1, DEGREE + 2))
    pieces[:, 0] = times[np.maximum(np.arange(len(times) + 1) - 1, 0)]
    pieces[:, 1] = values[np.maximum(np.arange(len(times) + 1) - 1, 0)]
    pieces[1:-1, 2] = np.diff(values) / np.diff(times)
    return pieces


def _row_at(t: Any, table: Any) -> Any:
    """Return the row of a table that holds at one time; the rows may be many, so that they are halved."""
    k, last = 0, table.shape[0] - 1
    while k < last:
        middle = (k + last + 1) // 2
        if table[middle, 0] <= t:
            k = middle
        else:
            last = middle - 1
    return k


row_at = njit(**INLINE)(_row_at)


def value_at(t: Any, pieces: Any) -> Any:
    """Return the value at one time."""
    k = row_at(t, pieces)
    s = t - pieces[k, 0]
    return pieces[k, 1] + s * (pieces[k, 2] + s * (pieces[k, 3] + s * (pieces[k, 4] + s * pieces[k, 5])))


def values_at(t: Array, pieces: Array) -> Array:
    """(n,) Return the values at times (n,), through NumPy."""
    rows = pieces[np.searchsorted(pieces[1:, 0], t, side="right")].T
    s = t - rows[0]
    return np.asarray(rows[1] + s * (rows[2] + s * (rows[3] + s * (rows[4] + s * rows[5]))))


def arguments_at(t: Array, arguments: Sequence[Any], changes: Changes) -> tuple[tuple[Any, ...], Array | float]:
    """Return the arguments at times (n,), numbers or arrays (n,), and the factor on the force, through NumPy."""
    now: list[Any] = list(arguments)
    factor: Array | float = 1.0
    for number, pieces in changes:
        if number == FACTOR:
            factor = values_at(t, pieces)
        else:
            now[number] = values_at(t, pieces)
    return tuple(now), factor


def compiled_arguments(count: int, numbers: tuple[int, ...]) -> tuple[Any, Any]:
    """Return two compiled functions of a time and of `count` arguments with the tables behind them.

    The first returns the arguments at that time, the second the factor on the force.
    """
    inlined = njit(forceinline=True, **UNCALLED, **OPTIONS)
    value = inlined(value_at)
    arguments = inlined(lambda t, packed: ())
    for place in range(count):
        table = count + numbers.index(place) if place in numbers else -1
        arguments = _with_changing(arguments, value, table) if table > 0 else _with_constant(arguments, place)
    if FACTOR not in numbers:
        return arguments, inlined(lambda t, packed: 1.0)
    last = count + numbers.index(FACTOR)
    return arguments, inlined(lambda t, packed: value(t, packed[last]))


def _with_constant(before: Any, place: int) -> Any:
    return njit(lambda t, packed: (*before(t, packed), packed[place]), forceinline=True, **UNCALLED)


def _with_changing(before: Any, value: Any, table: int) -> Any:
    return njit(lambda t, packed: (*before(t, packed), value(t, packed[table])), forceinline=True, **UNCALLED)
