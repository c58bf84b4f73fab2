"""The learner of a chain: it evaluates the proposals, and gives the moves their surrogate."""

from __future__ import annotations

import emcee
import numpy as np

from streamkit import Array, Ensemble, Target
from streamkit.builtin.samplers.ensemble.called import learn
from streamkit.builtin.samplers.ensemble.learning import LEARNING, learning_steps
from streamkit.builtin.samplers.ensemble.moves import SurrogateMove

REPLICAS = "replicas"  # memory: coordinates of the replicas that move on the surrogate
FEWEST = 256  # least number of them
REFUSED = "refused"  # memory: number of the step, and parameters (1 + d), of proposals without a prediction
# Such proposals that are kept of each step of learning: they show the surrogate its edges, and more show no more.
KEPT = 2


class Learner:
    """Evaluates the proposals, and gives the moves their surrogate, which it learns from the chain.

    A resumed run learns the same surrogate as an unbroken one, from the steps that are stored.
    """

    def __init__(self, name: str, target: Target, moves: tuple[emcee.moves.Move, ...], begin: Ensemble) -> None:
        self._name, self._target = name, target
        self._move = next((move for move in moves if isinstance(move, SurrogateMove)), None)
        self._new: list[Array] = []  # refused proposals of this step
        self._refused = begin.memory.get(REFUSED, np.empty((0, 1 + target.size)))
        self.steps = 0  # of learning, estimated from the chain so far
        self.facts: dict[str, str] = {}  # the subject of the surrogate, once one was learned
        self.learn(begin.number, begin.memory.get(REPLICAS))

    def ln_probability(self, points: Array) -> tuple[Array, None]:
        """Return ln posterior (n,) at points (n, d), in the form of emcee's ``compute_log_prob``: without blobs."""
        result = self._target.predictions(points)
        lost = ~np.isfinite(result.ln_likelihood) & np.isfinite(self._target.ln_prior(points))
        self._new += list(points[lost])
        return result.ln_probability, None

    def memory(self, number: int) -> dict[str, Array]:
        """Return the replicas and the refused proposals after the step of this number."""
        if number <= self.steps and self._new:
            new = np.array(self._new[:KEPT])
            self._refused = np.concatenate([self._refused, np.column_stack([np.full(len(new), number), new])])
        self._new = []
        replicas = np.empty(0) if self._move is None else self._move.replicas.copy()
        arrays = {REFUSED: self._refused, REPLICAS: replicas}
        return {name: values for name, values in arrays.items() if len(values)}

    def learn_after(self, number: int) -> None:
        """Learn the surrogate anew if the step of this number is one of `LEARNING`."""
        if number in LEARNING and number <= self.steps:
            self.learn(number)

    def learn(self, done: int, replicas: Array | None = None) -> None:
        """Learn the surrogate of the last of the steps of `LEARNING` that are done, from all steps before it.

        ``replicas`` are those of a resumed run.
        """
        self.steps = learning_steps(self._name, self._target.chain())
        last = max((step for step in LEARNING if step <= min(done, self.steps)), default=0)
        if not last or self._move is None:
            return
        learned = learn(self._target, last, self._refused[self._refused[:, 0] <= last, 1:])
        if learned is None:
            self.facts = {"surrogate": "none: too few points to learn from"}
            return
        surrogate, places, subject = learned
        self.facts = {"surrogate": subject}
        number = max(FEWEST, 2 * self._target.chain().shape[1])
        self._move.use(surrogate, places, number, self._target.seed, last == self.steps)
        if done > last and replicas is not None and replicas.shape == self._move.replicas.shape:
            self._move.replicas = replicas.copy()
