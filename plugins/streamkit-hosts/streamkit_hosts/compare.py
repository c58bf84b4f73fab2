"""Compare forces in a host: where, and by how much they differ."""

from __future__ import annotations

import numpy as np

from streamkit import Array

POINTS = 400  # places at which forces are compared
LIMIT = 0.01  # largest change of the force of which nothing is said


def places(low: float, high: float, seed: int) -> Array:
    """(3, `POINTS`) Places in random directions, at radii from ``low`` to ``high``."""
    direction = np.random.default_rng(seed).standard_normal((3, POINTS))
    return np.asarray(direction / np.sqrt((direction**2).sum(axis=0)) * np.geomspace(low, high, POINTS))


def median_change(one: Array, other: Array, whole: Array) -> float:
    """Return the median over places of the difference of two forces (3, n), over the size of the whole force."""
    return float(np.median(np.sqrt(((one - other) ** 2).sum(axis=0)) / np.sqrt((whole**2).sum(axis=0))))
