"""The sampling itself: start an ensemble, advance it until a limit, keep the counts beside the chain."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from time import monotonic
from typing import Any

import emcee
import numpy as np
from emcee.backends import Backend

from streamkit.errors import ChainError
from streamkit.observe import Data
from streamkit.report import Progress
from streamkit.runfile import Prior
from streamkit.sample.chain_file import ChainFile
from streamkit.sample.convergence import CHECK, Convergence, Limits
from streamkit.sample.coordinates import Space
from streamkit.sample.moves import LEARNING, SurrogateMove, learning_steps, proposals
from streamkit.sample.proposal_log import ProposalLog
from streamkit.sample.start import Search
from streamkit.sample.surrogate import learn
from streamkit.sample.workers import Workers
from streamkit.stream import Array

NOTES = 5.0  # seconds between two looks at the mass


@dataclass
class Sampling:
    """An ensemble and where it is stored.

    Parameters
    ----------
    priors
        d priors, for the start.
    walkers, seed, moves
        The ensemble: its size, the seed of all its proposals, and "surrogate", "de" or "stretch".
    pool
        Evaluates the posteriors "full" and "cheap".
    backend
        Where emcee stores the chain.
    dtype
        The record stored with each sample.
    progress
        Whether to show progress.
    mass
        The mass inside 100 kpc at a point, for the progress bar.
    data
        What the blobs' "mean" is compared with: the surrogate needs it.
    full_cost
        Cost of a "full" call in units of a "cheap" one, about: for the end of the search.
    """

    priors: Sequence[Prior]
    walkers: int
    seed: int
    moves: str
    pool: Workers
    backend: Backend
    dtype: np.dtype[Any]
    progress: bool = True
    mass: Callable[[Array], float] | None = None
    data: Data | None = None
    full_cost: float = 1.0
    _counts: dict[str, Any] = field(
        default_factory=lambda: {"calls": 0, "search_calls": 0, "reasons": {}, "surrogate": ""}
    )
    _before: dict[str, Any] = field(default_factory=dict)
    _state: emcee.State | None = None
    _proposal_log: ProposalLog = field(init=False)
    _learning: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        self._proposal_log = ProposalLog(self.pool, self.walkers, len(self.priors), self.dtype["mean"].shape[0])

    def begin(self, deadline: float = np.inf) -> None:
        """Find starting points and empty the backend. The first step is not taken yet."""
        self.backend.reset(self.walkers, len(self.priors))
        with Progress("search for a start", 1, shown=self.progress, deadline=deadline) as bar:

            def tell(line: str) -> None:
                bar.note(line)
                bar.expect(search.work + search.work_left)
                bar.update(search.work - bar.done)

            rng = np.random.default_rng([self.seed, 1])
            search = Search(self.priors, self.pool.evaluate, self.walkers, rng, deadline, tell, self.full_cost)
            points, results = search.run()
        self._before = self._counts = self._counts | {"search_calls": search.calls}
        rows = [result.row() for result in results]
        self._state = emcee.State(
            points,
            log_prob=np.array([row[0] for row in rows]),
            blobs=np.array([row[1:] for row in rows], dtype=self.dtype),
            random_state=np.random.RandomState(self.seed).get_state(),  # what emcee uses
        )
        # the search is reported by itself; from here on every call is a proposal of the sampler
        self.pool.calls["full"] = 0
        self.pool.reasons["full"].clear()
        if isinstance(self.backend, ChainFile):
            self.backend.begin(self._state, self._counts)

    def resume(self) -> None:
        """Go on from the last step of a chain file, with all that is stored there: as if never stopped.

        Raises ChainError if it cannot be read, or was changed.
        """
        assert isinstance(self.backend, ChainFile)  # noqa: S101  chains in memory end with the process
        self.backend.load()
        start = self.backend.start
        self._state = self.backend.get_last_sample() if start is None else start.state
        counts = self.backend.counts
        self._before = self._counts = {key: counts.get(key, value) for key, value in self._counts.items()}
        if self.backend.tried is not None:
            self._proposal_log.load(self.backend.tried)

    def advance(self, limits: Limits) -> str:
        """Take steps until a limit is reached; return which: "converged", "steps" or "time".

        Raises `Stopped` after a signal; the unfinished step is dropped.
        """
        done = int(self.backend.iteration)
        moves = proposals(self.moves, self.priors)
        self._learn(moves, done)
        sampler = emcee.EnsembleSampler(
            self.walkers,
            len(self.priors),
            _not_called,
            pool=self._proposal_log,
            moves=moves,
            backend=self.backend,
            blobs_dtype=self.dtype,
        )
        if done and self._judge(limits):
            return "converged"
        tau, clock = np.nan, _Clock(self.pool)
        try:
            with Progress(
                "sampling", limits.steps, "step",
                done=done, shown=self.progress, keep=True, deadline=limits.deadline,
            ) as bar:  # fmt: skip
                while done < limits.steps:
                    ends = [CHECK * (done // CHECK + 1), limits.steps, *LEARNING]
                    todo = min(end for end in ends if end > done) - done
                    for state in sampler.sample(self._state, iterations=todo):
                        self._keep(moves, done)
                        self._state, done = state, done + 1
                        if clock.is_due():
                            bar.note(clock.line(sampler, done, tau, self._masses(state)))
                        bar.update()
                        if monotonic() > limits.deadline:
                            return "time"
                    if done in LEARNING and done <= self._learning:
                        self._learn(moves, done)
                    if done % CHECK == 0 or done == limits.steps:
                        judged = self._judge(limits)
                        if judged:
                            return "converged"
                        tau = float(np.max(judged.tau))
            return "steps"
        finally:
            if isinstance(self.backend, ChainFile):
                with suppress(ChainError):  # its journal holds all; whoever closes the run tries again, and tells
                    self.backend.consolidate()

    def totals(self) -> dict[str, Any]:
        """Return the counts of all calls for the finished steps, those before a resumption included."""
        return self._counts

    def _judge(self, limits: Limits) -> Convergence:
        return Convergence(np.asarray(self.backend.get_chain()), self._learning, limits.tau_factor, limits.r_hat)

    def _learn(self, moves: Sequence[tuple[emcee.moves.Move, float]], done: int) -> None:
        """Give the surrogate moves what the chain knew at the last step of `LEARNING` before they have learned all."""
        chain = np.asarray(self.backend.get_chain()) if done else np.empty((0, self.walkers, len(self.priors)))
        self._learning = learning_steps(self.moves, chain)
        steps = max((step for step in LEARNING if step <= min(done, self._learning)), default=0)
        walks = [move for move, _ in moves if isinstance(move, SurrogateMove)]
        if not (steps and walks and self.data is not None):
            return
        points, mean, variance, lnl = self._proposal_log.until(steps)
        space = Space(self.priors)
        y = space.to(points)
        inside = np.isfinite(space.ln_prior(y))
        surrogate = learn(y[inside], mean[inside], variance[inside], self.data, lnl[inside])
        subject = {"surrogate": "none" if surrogate is None else surrogate.subject}
        self._before, self._counts = self._before | subject, self._counts | subject
        for move in walks:
            move.learn(surrogate, self.walkers, self.seed, steps == self._learning)
            if done > steps and isinstance(self.backend, ChainFile):  # resumed
                kept = self.backend.replicas
                if kept is not None and kept.shape == move.replicas.shape:
                    move.replicas = kept

    def _keep(self, moves: Sequence[tuple[emcee.moves.Move, float]], step: int) -> None:
        """Store the step together with what the moves know: a resumed run goes on as an unbroken one would."""
        before = self._before
        reasons = dict(Counter(before["reasons"]) + self.pool.reasons["full"])
        self._counts = before | {"calls": before["calls"] + self.pool.calls["full"], "reasons": reasons}
        tried = self._proposal_log.keep(step, step < self._learning)
        if isinstance(self.backend, ChainFile):
            replicas = [move.replicas for move, _ in moves if isinstance(move, SurrogateMove) and len(move.replicas)]
            self.backend.commit(self._counts, tried, replicas[0] if replicas else None)

    def _masses(self, state: emcee.State) -> Array | None:
        """(walkers,) Masses inside 100 kpc of the ensemble."""
        return None if self.mass is None else np.array([self.mass(point) for point in state.coords])


class _Clock:
    """Speed, and when it is time to say something."""

    def __init__(self, pool: Workers) -> None:
        self._begin = self._last = monotonic()
        self._pool, self._calls = pool, pool.calls["full"]

    def is_due(self) -> bool:
        now = monotonic()
        if now - self._last < NOTES:
            return False
        self._last = now
        return True

    def line(self, sampler: emcee.EnsembleSampler, done: int, tau: float, masses: Array | None) -> str:
        """Return acceptance, speed, autocorrelation time and running mass in one line."""
        rate = (self._pool.calls["full"] - self._calls) / (monotonic() - self._begin)
        accepted = float(np.mean(sampler.backend.accepted)) / done
        parts = [f"accepted {100 * accepted:.0f} %", f"{rate:.1f} calls/s"]
        if np.isfinite(tau):
            parts.append(f"tau {tau:.0f}")
        if masses is not None:
            low, middle, high = np.percentile(masses / 1e11, [16, 50, 84])
            parts.append(f"M(100 kpc) {middle:.2f} +{high - middle:.2f} -{middle - low:.2f}e11 Msun")
        return ", ".join(parts)


def _not_called(_theta: Array) -> float:
    raise AssertionError("the workers hold the posterior themselves")
