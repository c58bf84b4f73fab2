"""Whether a start leads to all of a posterior: it has seen it, or walkers come there by steps that cross no gap.

A start has few particles in its streams, so that it may end beside the posterior of all particles, a few standard
deviations away, and its emulator knows nothing of what lies there. If walkers that begin at its places come to all of
the posterior, there is one basin, and the start has found it. They do not come to a mode that the start has missed.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from streamkit import Array
from streamkit.builtin.samplers.emulator.known import Start
from streamkit.builtin.samplers.emulator.walk.density import Density, Joint
from streamkit.builtin.samplers.emulator.walk.population import Population

# Walkers, their sweeps until they have come, and how many of those after it are used.
WALKERS, SWEEPS, USED = 256, 60, 8
# A sample is reached if a walker has been so near, in units of the distance at which nearly all walkers have another.
NEAR, NEARLY_ALL = 1.5, 0.99
# Fraction of the posterior that a start may miss.
MISSED = 0.05


def leading(starts: Sequence[Start], alone: Joint, samples: Array, seed: list[int]) -> int:
    """Return how many starts exclude none of these samples (n, d) of their stream's posterior, or lead to all of it."""
    lnl = alone.ln_likelihoods(samples)[:, 0]
    return sum(
        start.missed(samples, lnl) <= MISSED or unreached(alone, start.places, samples, seed) <= MISSED
        for start in starts
    )


def unreached(density: Density, begin: Array, samples: Array, seed: list[int]) -> float:
    """Return the fraction of samples (n, d) that no walker comes near which begins at one of these places (m, d)."""
    rng = np.random.default_rng(seed)
    walked = Population.of(density, begin, rng).come(density, WALKERS, SWEEPS, USED)
    white = np.linalg.inv(np.linalg.cholesky(np.atleast_2d(np.cov(walked.T)))).T
    one, other = np.array_split(rng.permutation(walked) @ white, 2)
    tree = cKDTree(one)
    apart, away = tree.query(other)[0], tree.query(samples @ white)[0]
    return float(np.mean(away > NEAR * np.quantile(apart, NEARLY_ALL)))
