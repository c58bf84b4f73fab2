"""Array types, and the signs of the two Lagrange points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""An array of floats: positions and velocities are (3, n), what belongs to a particle (n,)."""
IntArray = NDArray[np.int64]
"""An array of integers."""
BoolArray = NDArray[np.bool_]
"""An array of booleans."""

ARMS = {"leading": 1, "trailing": -1}
"""The arms by the sign of the angle along the stream."""

LEADING, TRAILING = -1, 1
"""Sign of the radial offset at release, as in Gibbons+ 2014: leading inwards, trailing outwards."""
