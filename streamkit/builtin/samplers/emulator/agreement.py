"""Whether independent starts agree: walks from the places of each must come to all of the posterior."""

from __future__ import annotations

import numpy as np

from streamkit import Array
from streamkit.builtin.samplers.emulator.changes import with_axes
from streamkit.builtin.samplers.emulator.emulated import Emulated
from streamkit.builtin.samplers.emulator.walk import walk

# Steps of a walk from the places of a start until its last half is compared with the samples, and how often it may go
# on where it has not come to all of them.
STEPS, MOST_PARTS = 200, 3
# Fraction of the posterior that a walk may not come to.
MISSED = 0.05
# Parts of equal probability along each parameter and principal axis. One is empty with less than this fraction of its
# share.
PARTS, EMPTY = 20, 0.1


def missed_by(places: Array, emulated: Emulated, samples: Array, walkers: int, seed: list[int]) -> float:
    """Return the fraction of the posterior that walks from the places of a start do not come to.

    The walks are on the density that all calls have given: an error that the start's own emulator had does not count,
    but a mode that it has not seen does, as no walker begins in it. It is the largest fraction along any parameter, or
    any principal axis, of samples (n, d) of the posterior. A walk ends where that is below `MISSED`.
    """
    chain = emulated.sample(places, walkers, STEPS, seed)
    missed = _not_reached(samples, chain)
    for part in range(1, MOST_PARTS):
        if missed <= MISSED:
            break
        chain, _ = walk(emulated.ln_density, chain[-1], STEPS, [*seed, part])
        missed = _not_reached(samples, chain)
    return missed


def _not_reached(samples: Array, chain: Array) -> float:
    """Return the fraction of samples (n, d) that the last half of a chain (steps, w, d) does not come to."""
    both = with_axes(np.concatenate([samples, chain[len(chain) // 2 :].reshape(-1, samples.shape[1])]))
    of_all, of_start = both[: len(samples)], both[len(samples) :]
    missed = []
    for posterior, reached in zip(of_all.T, of_start.T, strict=True):
        edges = np.quantile(posterior, np.linspace(0, 1, PARTS + 1)[1:-1])
        shares = np.bincount(np.searchsorted(edges, reached), minlength=PARTS) / len(reached)
        missed.append(np.mean(shares < EMPTY / PARTS))
    return float(max(missed))
