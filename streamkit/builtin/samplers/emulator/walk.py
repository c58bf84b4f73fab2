"""Walks on the emulated posterior: emcee with differential evolution, many walkers at a time."""

from __future__ import annotations

from collections.abc import Callable

import emcee
import numpy as np

from streamkit import Array, IntArray


def walk(ln_density: Callable[[Array], Array], start: Array, steps: int, seed: list[int]) -> tuple[Array, Array]:
    """Walk from start (w, d); return all places (steps, w, d) and their ln densities (steps, w).

    Differential evolution: mostly the length that is best for a Gaussian, a third of it where the posterior is curved,
    sometimes 1, which leads from one mode to another (ter Braak 2006).
    """
    walkers, d = start.shape
    best = 2.38 / np.sqrt(2 * d)
    moves = [(emcee.moves.DEMove(gamma0=gamma), part) for gamma, part in ((best, 0.6), (best / 3, 0.3), (1.0, 0.1))]
    sampler = emcee.EnsembleSampler(walkers, d, ln_density, moves=moves, vectorize=True)
    random = np.random.RandomState(np.random.SeedSequence(seed).generate_state(4)).get_state()
    sampler.run_mcmc(emcee.State(start, random_state=random), steps, skip_initial_state_check=True)
    return np.asarray(sampler.get_chain()), np.asarray(sampler.get_log_prob())


def choose(ln_weight: Array, n: int, rng: np.random.Generator) -> IntArray:
    """(n,) Indices drawn without replacement with probabilities proportional to the weights (Gumbel's way)."""
    keys = ln_weight + rng.gumbel(size=len(ln_weight))
    return np.argsort(-keys)[:n]
