"""The steps of the ensemble, by emcee's moves and by moves that learn a surrogate."""

from __future__ import annotations

from collections.abc import Iterator

import emcee
import numpy as np
from emcee.model import Model

from streamkit import Ensemble, Target
from streamkit.builtin.samplers.ensemble.coordinates import Space
from streamkit.builtin.samplers.ensemble.learner import Learner
from streamkit.builtin.samplers.ensemble.moves import proposals


def walk(moves: str, target: Target, ensemble: Ensemble) -> Iterator[Ensemble]:
    """Yield the ensemble after each step that follows ``ensemble``, without end; see `streamkit.ChainSampler.walk`.

    emcee's moves are called directly, without its `EnsembleSampler`: streamkit stores the chain, and calls of the
    posterior pass through ``target`` alone.
    """
    random = np.random.RandomState()
    random.set_state(ensemble.random_state)
    choices, shares = zip(*proposals(moves, Space(target)), strict=True)
    share = np.array(shares) / np.sum(shares)
    learner = Learner(moves, target, choices, ensemble)
    state = emcee.State(ensemble.points, log_prob=ensemble.ln_probability, copy=True)
    model = Model(None, learner.ln_probability, map, random)
    number = ensemble.number
    while True:
        move = random.choice(np.array(choices, dtype=object), p=share)
        state, accepted = move.propose(model, state)
        number += 1
        yield Ensemble(
            state.coords.copy(),
            state.log_prob.copy(),
            np.array(accepted),
            random.get_state(),
            learner.memory(number),
            number,
            learner.facts,
        )
        learner.learn_after(number)
