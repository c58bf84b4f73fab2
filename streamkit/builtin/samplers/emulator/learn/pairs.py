"""Pairs of calls at one place, which differ by the noise of the particles alone: they measure it.

What an emulator leaves over beyond that noise is its lack of fit ("pure error": Draper & Smith 1998, section 2.1).
Without pairs it would be all beyond the noise that the observable *states*, which may be too small.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from streamkit import Array, IntArray

# Distance of the calls of a pair, and the distance that two calls may have to be one, in standard deviations: another
# place has other random numbers.
APART, TOGETHER = 1e-8, 1e-5
# Pairs from which noise is measured at least.
ENOUGH = 10


def paired(places: Array, pairs: int) -> Array:
    """Return places (n, d), the last ones replaced by others a hair's breadth from the first: so many pairs."""
    hair = APART * places.std(axis=0)
    places = places.copy()
    places[len(places) - pairs :] = places[:pairs] + hair
    return places


def pairs_of(x: Array) -> IntArray:
    """(k, 2) Indices of points x (n, c), in units of about their standard deviation, that are pairs."""
    pairs = cKDTree(x).query_pairs(TOGETHER, output_type="ndarray")
    return np.asarray(pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))])
