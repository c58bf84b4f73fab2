"""When the moves of the ensemble learn their surrogate, and until when."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from streamkit import Array

# Steps after which the surrogate is learned from all steps so far, up to the end of learning.
LEARNING = (25, 50, 100, 200, 400, 600, 900, 1350)
LEAST_STEPS = 400  # steps of learning at least
# Fraction of the proposals between two of these steps that shows a good surrogate. With fewer accepted, the ensemble
# had not yet found the posterior, or its points are still few, and the learning goes on. Two thirds of the replicas
# are tempered until then: afterwards up to twice as many proposals are accepted.
ACCEPTED = 1 / 6


def learning_steps(moves: str, chain: Array) -> int:
    """Return the steps in which the moves of this name change, as far as a chain (steps, walkers, d) can tell.

    That is to the first of `LEARNING` at which enough was accepted, `LEAST_STEPS` or later, or to the last of them.
    """
    if moves != "surrogate":
        return 0
    for before, end in pairwise(LEARNING):
        if end >= LEAST_STEPS:
            moved = np.diff(chain[before:end], axis=0).any(axis=2)
            if len(chain) < end or moved.mean() >= ACCEPTED:
                return end
    return LEARNING[-1]
