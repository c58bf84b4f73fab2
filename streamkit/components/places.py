"""Positions and radii as a caller gives them: one or many, with a unit of length or in kpc."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import wraps
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike

from streamkit.stream import Array

Owner = TypeVar("Owner")
Found = TypeVar("Found", bound=Array | None)


def takes_positions(method: Callable[[Owner, Array], Found]) -> Callable[[Owner, ArrayLike], Found]:
    """Let a method of positions (3, n) take one (3,), units of length, and anything that is an array.

    The method then raises ValueError if positions have another shape or a unit that is no length.
    """

    @wraps(method)
    def of_any(self: Owner, q: ArrayLike) -> Found:
        places = in_kpc(q, "positions")
        if places.ndim not in (1, 2) or len(places) != 3:
            rest = f"; transposed, {places.T.shape}, it is right" if places.shape[1:] == (3,) else ""
            raise ValueError(f"positions have the shape (3,) or (3, n), x, y and z first; found {places.shape}{rest}")
        result = method(self, np.ascontiguousarray(places.reshape(3, -1)))
        return result if result is None else cast(Found, result.reshape((*result.shape[:-1], *places.shape[1:])))

    return of_any


def takes_radii(method: Callable[[Owner, Array], Found]) -> Callable[[Owner, ArrayLike], Found]:
    """Let a method of radii (nr,) take one, units of length, and anything that is an array.

    The method then raises ValueError if radii are negative, have more than one axis, or a unit that is no length.
    """

    @wraps(method)
    def of_any(self: Owner, radii: ArrayLike) -> Found:
        given = in_kpc(radii, "radii")
        if given.ndim > 1 or (given < 0).any():
            wrong = f"the shape {given.shape}" if given.ndim > 1 else f"{given.min():g}"
            raise ValueError(f"radii are one number or an array of one axis, none of them negative; found {wrong}")
        result = method(self, given.reshape(-1))
        return result if result is None else cast(Found, result.reshape(given.shape))

    return of_any


def in_kpc(given: Any, what: str) -> Array:
    """Return numbers in kpc of a length of astropy, or of plain numbers, which are in kpc; else raise ValueError."""
    if hasattr(given, "to_value"):
        try:
            given = given.to_value("kpc")
        except ValueError as error:  # which astropy's UnitConversionError is
            raise ValueError(f"{what} are lengths, such as 8 kpc: {error}") from None
    if given is not None:
        with suppress(TypeError, ValueError):
            return np.asarray(given, dtype=float)
    raise ValueError(f"{what} are numbers in kpc; found {given!r}")
