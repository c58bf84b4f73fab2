"""The arguments of an `acceleration` after t, numbers and arrays, packed into one array of doubles.

A number takes one double. An array takes the index of its first element and its shape; the elements of all arrays
follow behind the last argument. Arguments that are all numbers are therefore packed as these numbers alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numba import njit
from numba.np.unsafe.ndarray import to_fixed_tuple

from streamkit.engine.cache import UNCALLED
from streamkit.engine.views import view
from streamkit.stream import Array

ENDLESS = 1 << 40  # length of a view of the packed arguments: each array knows its own


def layout_of(values: Sequence[float | Array]) -> tuple[int, ...]:
    """Return the number of dimensions of each argument, 0 for a number."""
    return tuple(np.ndim(value) for value in values)


def pack(values: Sequence[float | Array]) -> Array:
    """Return the arguments in one array of doubles."""
    end = sum(1 + np.ndim(value) for value in values)
    head: list[float] = []
    for value in values:
        if np.ndim(value) == 0:
            head.append(float(value))
        else:
            head += [end, *np.shape(value)]
            end += np.size(value)
    arrays = [np.asarray(value, dtype=float).ravel() for value in values if np.ndim(value)]
    return np.concatenate([np.array(head, dtype=float), *arrays])


def unpacker(layout: tuple[int, ...]) -> Any:
    """Return a compiled function that turns the result of `pack` into a tuple of numbers and arrays again."""
    if not any(layout):
        count = len(layout)
        return njit(lambda packed: to_fixed_tuple(view(packed, 0, count), count), forceinline=True, **UNCALLED)
    unpack, place = njit(lambda _: (), forceinline=True, **UNCALLED), 0
    for ndim in layout:
        unpack = _with_array(unpack, place, ndim) if ndim else _with_number(unpack, place)
        place += 1 + ndim
    return unpack


def _with_number(before, place):
    return njit(lambda packed: (*before(packed), packed[place]), forceinline=True, **UNCALLED)


def _with_array(before, place, ndim):
    """Add an array of one, two or three dimensions, each by its own function: numba types a shape by its length."""
    if ndim == 1:

        def shape(packed):
            return (int(packed[place + 1]),)

    elif ndim == 2:

        def shape(packed):
            return int(packed[place + 1]), int(packed[place + 2])

    else:

        def shape(packed):
            return int(packed[place + 1]), int(packed[place + 2]), int(packed[place + 3])

    shape_of = njit(shape, forceinline=True, **UNCALLED)

    def unpack(packed):
        first, lengths = int(packed[place]), shape_of(packed)
        count = 1
        for length in lengths:
            count *= length
        return (*before(packed), packed[first : first + count].reshape(lengths))

    return njit(unpack, forceinline=True, **UNCALLED)
