"""The results of a run that nobody made."""

from typing import Any

import numpy as np

import streamkit as sk
from streamkit.fit.samples.results import Results, draws_of
from streamkit.sample import Chain


def synthetic(document: Any, steps: int = 12, walkers: int = 32, seed: int = 1, quick: bool = False) -> Results:
    """Return the results of a run that nobody made: correlated walkers around the prior's centre."""
    spec, rng = sk.load(document), np.random.default_rng(seed)
    d = len(spec.names)
    mix = np.linalg.cholesky(0.5 * np.eye(d) + 0.5)
    z = np.empty((steps, walkers, d))
    z[0] = 3 * rng.normal(size=(walkers, d))
    for k in range(1, steps):
        z[k] = 0.8 * z[k - 1] + 0.6 * rng.normal(size=(walkers, d)) @ mix.T
    chain = spec.centre() * (1 + 0.03 * z)
    ln_p = -0.5 * (np.linalg.solve(mix, z[..., None])[..., 0] ** 2).sum(axis=2)
    stored = Chain(chain, ln_p, None, np.full(walkers, steps // 3), {"status": "steps"})
    return Results(spec, draws_of(stored, spec, quick))
