"""Array types, and the signs of the two Lagrange points."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]  # an array of floats: positions and velocities are (3, n), numbers for each particle (n,)
IntArray = NDArray[np.int64]  # an array of integers
BoolArray = NDArray[np.bool_]  # an array of booleans

ARMS = {"leading": 1, "trailing": -1}  # the arms by the sign of the angle along the stream

# Sign of the radial offset at release, as in Gibbons+ 2014: leading inwards, trailing outwards.
LEADING, TRAILING = -1, 1


def read_only(array: Any) -> Any:
    """Return a view of an array that refuses to be changed: others look at the same numbers."""
    view = np.asarray(array).view()
    view.flags.writeable = False
    return view


def freeze(noun: object) -> None:
    """Make the arrays of a frozen dataclass read-only; what it was made from stays as it was."""
    for name, value in list(vars(noun).items()):
        if isinstance(value, np.ndarray):
            object.__setattr__(noun, name, read_only(value))
