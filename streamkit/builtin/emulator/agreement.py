"""Whether independent starts agree: walks from the places of each must come to all of the posterior."""

from __future__ import annotations

import numpy as np

from streamkit import Array
from streamkit.builtin.emulator.changes import with_axes
from streamkit.builtin.emulator.emulated import Emulated

# Steps of a walk from the places of a start, of which the last are compared with the samples.
STEPS, LAST = 240, 80
# Parts of equal probability along each parameter and principal axis. One is empty with less than this fraction of its
# share.
PARTS, EMPTY = 20, 0.1


def missed_by(places: Array, emulated: Emulated, samples: Array, walkers: int, seed: list[int]) -> float:
    """Return the fraction of the posterior that walks from the places of a start do not come to.

    The walks are on the density that all calls have given: an error that the start's own emulator had does not count,
    but a mode that it has not seen does, as no walker begins in it. It is the largest fraction along any parameter, or
    any principal axis, of samples (n, d) of the posterior.
    """
    chain = emulated.sample(places, walkers, STEPS, seed)
    both = with_axes(np.concatenate([samples, chain[-LAST:].reshape(-1, samples.shape[1])]))
    of_all, of_start = both[: len(samples)], both[len(samples) :]
    missed = []
    for posterior, reached in zip(of_all.T, of_start.T, strict=True):
        edges = np.quantile(posterior, np.linspace(0, 1, PARTS + 1)[1:-1])
        shares = np.bincount(np.searchsorted(edges, reached), minlength=PARTS) / len(reached)
        missed.append(np.mean(shares < EMPTY / PARTS))
    return float(max(missed))
