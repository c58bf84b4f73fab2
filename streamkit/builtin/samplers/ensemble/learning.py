"""The steps at which the moves of the ensemble learn their surrogate."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from streamkit import Array

# Steps after which the surrogate is learned from all steps so far, up to the end of learning.
LEARNING = (25, 50, 100, 200, 400, 600, 900, 1350)
LEAST_STEPS = 400  # steps of learning at least
# Accepted fraction of the proposals between two of these steps that shows a good surrogate. With less, the ensemble has
# not yet reached the posterior, or training points are few, and learning continues. Two thirds of the replicas are
# tempered until then: afterwards up to twice as many proposals are accepted.
ACCEPTED = 1 / 6


def learning_steps(moves: str, chain: Array) -> int:
    """Return the number of steps in which the moves of this name change, from a chain (steps, walkers, d).

    Learning ends at the first of `LEARNING`, `LEAST_STEPS` or later, at which enough was accepted, or at the last.
    """
    if moves != "surrogate":
        return 0
    for before, end in pairwise(LEARNING):
        if end >= LEAST_STEPS:
            moved = np.diff(chain[before:end], axis=0).any(axis=2)
            if len(chain) < end or moved.mean() >= ACCEPTED:
                return end
    return LEARNING[-1]
