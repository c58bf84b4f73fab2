"""Whether the posterior goes on where an emulator is not trusted, as no call is near.

Beyond its calls a polynomial may be anything, so that a penalty keeps walkers near them (`Emulator.trusted_r2`). Thin
ends of a bent posterior may lie beyond: few samples, and much of a width. Walkers that are trusted further go there,
and calls say whether the ends are real.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from streamkit import Array
from streamkit.builtin.samplers.emulator.changes import change_of, with_axes
from streamkit.builtin.samplers.emulator.judge.recall import CALLS, SWEEPS, USED, WALKERS
from streamkit.builtin.samplers.emulator.known import Known
from streamkit.builtin.samplers.emulator.learn.calls import Calls
from streamkit.builtin.samplers.emulator.walk.density import Emulated, Joint
from streamkit.builtin.samplers.emulator.walk.population import Population

# Factor of the trusted |x|^2 within which ends are looked for.
FURTHER = 4.0
# Standard deviations that these ends may move a mean, or fraction that they may change a width by.
CHANGED = 0.1
# ln L of the penalty from which a place is beyond.
BEYOND = 0.1


def extrapolated(known: Sequence[Known], joint: Joint, begin: Array, seed: list[int]) -> list[str]:
    """Walk from places (n, d) beyond what is trusted, call factors there, keep the calls, and say what they confirm."""
    rng, faults = np.random.default_rng(seed), list[str]()
    further = Joint(joint.factors, [_further(each) for each in joint.emulated])
    places = Population.of(further, begin, rng).come(further, WALKERS, SWEEPS, USED)
    penalties = further.ln_likelihoods(places) - joint.ln_likelihoods(places)
    for each, emulated, penalty in zip(known, further.emulated, penalties.T, strict=True):
        mine, beyond = places[:, each.factor.columns], np.flatnonzero(penalty > BEYOND)
        if not len(beyond) or (changed := change_of(with_axes(mine), -penalty)) <= CHANGED:
            continue
        called = Calls.at(each.factor.problem, each.calls.space, mine[rng.permutation(beyond)[:CALLS]])
        each.calls += called
        gained = np.nan_to_num(called.answers.ln_likelihood - emulated.ln_likelihood(called.z), nan=-700.0)
        changed *= float(np.mean(np.exp(np.clip(gained, -700.0, 0.0))))
        if changed > CHANGED:
            faults.append(f"{each.factor.name}: the posterior goes on where no calls were, and its ends change a mean "
                          f"or a width by {changed:.2f} standard deviations")  # fmt: skip
    return faults


def _further(each: Emulated) -> Emulated:
    return replace(each, emulator=replace(each.emulator, trusted_r2=FURTHER * each.emulator.trusted_r2))
