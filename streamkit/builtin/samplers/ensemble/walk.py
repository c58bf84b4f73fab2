"""The steps of the ensemble, by emcee's moves and by moves that learn a surrogate."""

from __future__ import annotations

from collections.abc import Iterator

import emcee
import numpy as np
from emcee.model import Model

from streamkit import Array, Ensemble, Target
from streamkit.builtin.samplers.ensemble.coordinates import Space
from streamkit.builtin.samplers.ensemble.learning import LEARNING, learning_steps
from streamkit.builtin.samplers.ensemble.moves import SurrogateMove, proposals
from streamkit.builtin.samplers.ensemble.surrogate import learn

TRIALS = "trials"  # history: every proposal of a step of learning, and the prediction there
REPLICAS = "replicas"  # memory: coordinates of the replicas that move on the surrogate


def walk(moves: str, target: Target, ensemble: Ensemble) -> Iterator[Ensemble]:
    """Yield the ensemble after each step that follows ``ensemble``, without end; see `streamkit.ChainSampler.walk`.

    emcee's moves are called directly, without its `EnsembleSampler`: streamkit stores the chain, and calls of the
    posterior pass through ``target`` alone.
    """
    random = np.random.RandomState()
    random.set_state(ensemble.random_state)
    choices, shares = zip(*proposals(moves, target.priors), strict=True)
    share = np.array(shares) / np.sum(shares)
    learner = Learner(moves, target, choices)
    learner.learn(ensemble.number, ensemble.memory.get(REPLICAS))
    state = emcee.State(ensemble.points, log_prob=ensemble.ln_probability, copy=True)
    model = Model(None, learner.ln_probability, map, random)
    number = ensemble.number
    while True:
        move = random.choice(np.array(choices, dtype=object), p=share)
        state, accepted = move.propose(model, state)
        trials = learner.trials(number)
        number += 1
        yield Ensemble(
            state.coords.copy(),
            state.log_prob.copy(),
            np.array(accepted),
            random.get_state(),
            learner.memory(),
            {} if trials is None else {TRIALS: trials},
            number,
            learner.facts,
        )
        if number in LEARNING and number <= learner.steps:
            learner.learn(number)


class Learner:
    """Evaluates the proposals, stores those of the steps of learning, and gives the moves their surrogate.

    A rejected proposal is as good a training point as an accepted one, and most are rejected. The proposals are stored
    with each step, so that a resumed run learns the same surrogate as an unbroken one.
    """

    def __init__(self, name: str, target: Target, moves: tuple[emcee.moves.Move, ...]) -> None:
        self._name, self._target, self._space = name, target, Space(target.priors)
        self._moves = [move for move in moves if isinstance(move, SurrogateMove)]
        self._rows: list[Array] = []
        self.steps = 0  # of learning, estimated from the chain so far
        self.facts: dict[str, str] = {}  # the subject of the surrogate, once one was learned

    def ln_probability(self, points: Array) -> tuple[Array, None]:
        """Return ln posterior (n,) at points (n, d), in the form of emcee's ``compute_log_prob``: without blobs."""
        result = self._target.predictions(points)
        self._rows.append(np.column_stack([points, result.mean, result.variance, result.ln_likelihood]))
        return result.ln_probability, None

    def trials(self, step: int) -> Array | None:
        """(walkers, d + 2 m + 1) The proposals since the last call; None for a step after those of learning."""
        rows, self._rows = self._rows, []
        return np.concatenate(rows) if step < self.steps else None

    def memory(self) -> dict[str, Array]:
        """Return the replicas, if there are any."""
        replicas = [move.replicas.copy() for move in self._moves if len(move.replicas)]
        return {REPLICAS: replicas[0]} if replicas else {}

    def learn(self, done: int, replicas: Array | None = None) -> None:
        """Learn the surrogate of the last of the steps of `LEARNING` that are done, from all proposals before it.

        ``replicas`` are those of a resumed run.
        """
        self.steps = learning_steps(self._name, self._target.chain())
        last = max((step for step in LEARNING if step <= min(done, self.steps)), default=0)
        trials = self._target.history(TRIALS)
        if not (last and self._moves and trials is not None):
            return
        walkers, d, m = trials.shape[1], self._target.size, len(self._target.data.values)
        rows = trials[:last].reshape(-1, trials.shape[2])
        rows = rows[np.isfinite(rows[:, :d]).all(axis=1)]
        y = self._space.to(rows[:, :d])
        inside = np.isfinite(self._space.ln_prior(y))
        mean, variance, lnl = rows[inside, d : d + m], rows[inside, d + m : -1], rows[inside, -1]
        surrogate = learn(y[inside], mean, variance, self._target.data, lnl)
        self.facts = {"surrogate": "none: too few points to learn from" if surrogate is None else surrogate.subject}
        for move in self._moves:
            move.learn(surrogate, walkers, self._target.seed, last == self.steps)
            if done > last and replicas is not None and replicas.shape == move.replicas.shape:
                move.replicas = replicas.copy()
