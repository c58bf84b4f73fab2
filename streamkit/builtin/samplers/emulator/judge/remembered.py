"""What the starts have found and the emulator has given up though it is not sure there.

In a wide region with few calls, the emulator's own error is many errors of the data. Its likelihood there is a mean
over that error, and hundreds of times lower than the true one may be. A wide mode is no part of the posterior then, nor
of its tempered copies, and calls never come there. But places of the starts are there.
"""

from __future__ import annotations

import numpy as np

from streamkit.builtin.samplers.emulator.judge.recall import CALLS, MISSING
from streamkit.builtin.samplers.emulator.known import Known
from streamkit.builtin.samplers.emulator.learn.calls import Calls

# Standard deviations of the own error by which the predictions may be nearer to the data, and nats that this must add.
SIGMAS, UNSURE = 2.0, 3.0
# So often as many calls at most, until it is clear whether they find too much.
BATCHES = 4
# Largest logarithm of a weight: its square is a number still, and a larger one would say the same.
LARGEST = 300.0
# Nats below the best call, beyond which a place is of no account.
FAR = 20.0


def given_up(known: Known, rng: np.random.Generator) -> str:
    """Call a factor where its starts allow the data and its emulator is unsure; keep the calls; say what they find.

    Weights of a likelihood over the start's say what part of the posterior a place is. Half of the calls are made by
    the emulated weights, half by the largest that the emulator's own error allows. Told is by how much the true
    weights exceed the emulated ones: an emulator that is unsure and right has given up nothing. The text is empty if
    that is little.
    """
    z = np.concatenate([start.places for start in known.starts])
    by_start = np.concatenate([start.emulated.ln_likelihood(start.places) for start in known.starts])
    emulated, best = known.emulated.ln_likelihood(z), known.emulated.at_best(z, SIGMAS)
    top = float(np.max(known.calls.answers.ln_likelihood))
    is_unsure = (best > emulated + UNSURE) & (best > top - FAR)
    if not is_unsure.any():
        return ""
    zero = float(np.max(np.where(is_unsure, best, emulated) - by_start))  # of the logarithms of weights
    said, most = np.exp(emulated - by_start - zero), np.exp(best - by_start - zero)[is_unsure]
    elsewhere, said = float(said[~is_unsure].sum()), said[is_unsure]
    z, by_start = z[is_unsure], by_start[is_unsure]
    if not most.any():  # far below the others
        return ""
    chance = most / most.sum()
    if said.any():
        chance = 0.5 * (chance + said / said.sum())
    more, weights = np.empty(0), np.empty(0)
    for _ in range(BATCHES):
        different, drawn = np.unique(rng.choice(len(chance), CALLS, p=chance), return_inverse=True)
        called = Calls.at(known.factor.problem, known.calls.space, z[different])
        known.calls += called
        true = np.exp(np.minimum(called.answers.ln_likelihood - by_start[different] - zero, LARGEST))
        more = np.append(more, ((true - said[different]) / chance[different])[drawn])
        weights = np.append(weights, (true / chance[different])[drawn])
        whole = max(elsewhere + float(weights.mean()), np.finfo(float).tiny)
        found, error = float(more.mean()) / whole, float(more.std()) / np.sqrt(len(more)) / whole
        if abs(found - MISSING) > error:
            break
    if not found > MISSING:
        return ""
    return f"calls at places of the starts find {100 * found:.0f} % of the posterior where the emulator is not sure"
