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
from streamkit.builtin.samplers.emulator.calls import Calls
from streamkit.builtin.samplers.emulator.density import Joint
from streamkit.builtin.samplers.emulator.populations import Population
from streamkit.builtin.samplers.emulator.start import Known

# Walkers without the limit, sweeps of their walk, and how many of them are used.
WALKERS, SWEEPS, USED = 256, 25, 10
# What the own error adds to ln L beyond the limit where nothing else allows the data.
BEYOND = 1.0
# A call of the tempered posterior finds something where its ln L is higher by this than the emulator has it: more than
# what noise makes.
HIGHER = 3.0
# Share of the posterior without the limit from which calls are made, and how many.
FEW, CALLS = 0.01, 32
# Largest part of the posterior that may be missing.
MISSING = 0.05


@dataclass(frozen=True)
class Recall:
    """What calls find where the emulators put little of the posterior.

    Attributes
    ----------
    share
        Largest part of the posterior without the limit, of a factor, that only its own error allows.
    calls
        How many were made, there and at samples of the tempered posterior.
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
        return f"calls find {100 * self.found:.0f} % of the posterior where the emulators have next to nothing"


def recall(known: Sequence[Known], joint: Joint, begin: Array, tempered: Array, beta: float, seed: list[int]) -> Recall:
    """Call each factor where the emulators put little of the posterior, and keep the calls.

    Parameters
    ----------
    begin
        (n, d) places from which walkers look for what only an emulator's own error allows.
    tempered, beta
        (n, d) samples of the posterior with its likelihood to the power of beta.
    """
    rng = np.random.default_rng(seed)
    free = joint.unlimited()
    population = Population(free, begin, rng).choose(WALKERS, 1.0).settle(SWEEPS)
    places = population.walk(USED, population.moves())[0].reshape(-1, begin.shape[1])
    added = free.ln_likelihoods(places) - joint.ln_likelihoods(places)
    there = (1 - beta) * joint.ln_likelihoods(tempered).sum(axis=1)  # ln weights: samples of the posterior
    weight = np.exp(there - there.max()) / np.mean(np.exp(there - there.max()))
    shares, found, made = [], [0.0], 0
    for k, each in enumerate(known):
        beyond = np.flatnonzero(added[:, k] > BEYOND)
        share = len(beyond) / len(places)
        if share >= FEW:
            rows = rng.choice(beyond, min(CALLS, len(beyond)), replace=False)
            gained = _gained(each, free, k, places[rows])
            found.append(share / max(1 - share, 0.01) * float(np.mean(np.exp(gained))))
            made += len(rows)
        rows = rng.choice(len(tempered), min(CALLS, len(tempered)), replace=False)
        gained = _gained(each, joint, k, tempered[rows])
        found.append(float(np.mean(weight[rows] * np.where(gained > HIGHER, np.exp(gained), 0.0))))
        made += len(rows)
        shares.append(share)
    return Recall(max(shares), made, max(found))


def _gained(each: Known, joint: Joint, k: int, places: Array) -> Array:
    """(n,) Call factor k at places (n, d), and keep the calls; return true minus emulated ln likelihood."""
    z = places[:, each.factor.columns]
    before = joint.emulated[k].ln_likelihood(z)
    called = Calls.at(each.factor.problem, each.calls.space, z)
    each.calls += called
    return np.clip(np.nan_to_num(called.answers.ln_likelihood - before, nan=-700.0), -700.0, 20.0)
