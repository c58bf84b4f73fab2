"""Recall: calls where only the emulator's own error allows the data, and the share of the posterior that they find.

Samples of the emulated posterior say whether the emulator is right where it puts probability. They do not say what it
misses: places far from all calls, of which it knows nothing. Without the limit of what its own error adds to ln L such
places are part of the emulated posterior, by their volume. Calls there say how much of it is real.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from streamkit import Array
from streamkit.builtin.samplers.emulator.known import Known
from streamkit.builtin.samplers.emulator.learn.calls import Calls
from streamkit.builtin.samplers.emulator.walk.density import Joint
from streamkit.builtin.samplers.emulator.walk.population import Population

# Walkers without the limit, sweeps of their walk, and how many of them are used.
WALKERS, SWEEPS, USED = 256, 20, 6
# What the own error adds to ln L beyond the limit where nothing else allows the data.
BEYOND = 1.0
# Share of the posterior without the limit from which calls are made, and how many.
FEW, CALLS = 0.01, 32
# Largest part of the posterior that may be missing.
MISSING = 0.05


@dataclass(frozen=True)
class Recall:
    """What calls find where only an emulator's own error allows the data.

    Attributes
    ----------
    share
        Largest part of the posterior without the limit, of a factor, that only its own error allows.
    calls
        How many were made there.
    found
        What they say is missing of the posterior, as a fraction of it.
    """

    share: float
    calls: int
    found: float

    @property
    def fault(self) -> str:
        """Say that the posterior lacks too much; empty if it does not."""
        if self.found <= MISSING:
            return ""
        return (
            f"calls find {100 * self.found:.0f} % of the posterior where only the emulator's own error allows the data"
        )


def recall(known: Sequence[Known], joint: Joint, begin: Array, seed: list[int]) -> Recall:
    """Walk without the limit from places (n, d), call each factor beyond it, and keep the calls."""
    rng = np.random.default_rng(seed)
    free = joint.unlimited()
    places = Population.of(free, begin, rng).come(free, WALKERS, SWEEPS, USED)
    added = free.ln_likelihoods(places) - joint.ln_likelihoods(places)
    shares, found, made = [], [0.0], 0
    for k, each in enumerate(known):
        beyond = np.flatnonzero(added[:, k] > BEYOND)
        shares.append(len(beyond) / len(places))
        if shares[k] < FEW:
            continue
        z = places[np.ix_(rng.choice(beyond, min(CALLS, len(beyond)), replace=False), each.factor.columns)]
        called = Calls.at(each.factor.problem, each.calls.space, z)
        gained = called.answers.ln_likelihood - free.emulated[k].ln_likelihood(z)
        gained = np.clip(np.nan_to_num(gained, nan=-700.0), -700.0, 20.0)
        found.append(shares[k] / max(1 - shares[k], 0.01) * float(np.mean(np.exp(gained))))
        each.calls += called
        made += len(z)
    return Recall(max(shares), made, max(found))
