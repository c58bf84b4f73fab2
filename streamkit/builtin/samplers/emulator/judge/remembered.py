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
# Nats below the best call, beyond which a place is of no account.
FAR = 20.0


def given_up(known: Known, rng: np.random.Generator) -> str:
    """Call a factor where its starts allow the data and its emulator is unsure; keep the calls; say what they find.

    Weights of true over the start's likelihood, of these places and of all others by the emulator, say what part of the
    posterior they are. The text is empty if that is little.
    """
    z = np.concatenate([start.places for start in known.starts])
    by_start = np.concatenate([start.emulated.ln_likelihood(start.places) for start in known.starts])
    emulated, best = known.emulated.ln_likelihood(z), known.emulated.at_best(z, SIGMAS)
    top = float(np.max(known.calls.answers.ln_likelihood))
    unsure = np.flatnonzero((best > emulated + UNSURE) & (best > top - FAR))
    sure = np.delete(np.arange(len(z)), unsure)
    if not len(unsure) or not len(sure):
        return ""
    some = rng.permutation(unsure)[:CALLS]
    known.calls += (called := Calls.at(known.factor.problem, known.calls.space, z[some]))
    there, elsewhere = called.answers.ln_likelihood - by_start[some], emulated[sure] - by_start[sure]
    most = max(float(there.max()), float(elsewhere.max()))
    found = len(unsure) * float(np.mean(np.exp(there - most)))
    found /= found + float(np.sum(np.exp(elsewhere - most)))
    if not found > MISSING:
        return ""
    return f"calls at places of the starts find {100 * found:.0f} % of the posterior where the emulator is not sure"
