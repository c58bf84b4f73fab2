"""The posterior of a run as its sampler sees it: evaluations that are remembered, a start, a chain, a time limit.

A call passes through three objects between a sampler and the physics. `PosteriorTarget` remembers evaluations, so that
no point costs twice. `Workers` spreads the points over processes, counts the calls, and ends those that take too long.
`Posterior` binds the parameters to the run file and compares the streams with the data.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from time import monotonic, time
from typing import Any

import numpy as np

from streamkit.components import Ensemble, Evaluations, TargetFactor
from streamkit.errors import ChainError
from streamkit.report import Progress
from streamkit.runfile import Prior
from streamkit.sample.calls.comparison import Comparison
from streamkit.sample.calls.search import Search
from streamkit.sample.calls.signals import Stopped
from streamkit.sample.calls.workers import Workers
from streamkit.sample.emulating import PART, Emulating
from streamkit.sample.evaluation import Evaluation, details_of
from streamkit.sample.progress import SamplingProgress
from streamkit.sample.store.storage import Storage
from streamkit.stream import Array, Data


@dataclass(frozen=True)
class Deadlines:
    """Values of `time.monotonic` at which the sampling, and the search for a start before it, end."""

    sampling: float = np.inf
    search: float = np.inf


class PosteriorTarget(Emulating):
    """A posterior to be sampled: a `streamkit.Target`."""

    def __init__(
        self,
        priors: Sequence[Prior],
        data: Data,
        seed: int,
        calls: Workers,  # of the posterior "full", and for a search "cheap", whose streams are small
        storage: Storage,
        deadlines: Deadlines = Deadlines(),
        display: SamplingProgress | None = None,
        comparison: Comparison | None = None,  # compares given predictions; None where no sampler emulates them
        which: tuple[str, str] = ("full", "cheap"),  # the names of the posterior for ``calls``; they may be the same
        factors: Sequence[TargetFactor] = (),
    ) -> None:
        self.priors, self.data, self.size, self.seed = tuple(priors), data, len(priors), seed
        self.storage, self.display = storage, display or SamplingProgress()
        self.workers, self.progress = calls.at_a_time, self.display.shown
        self.factors, self.small_is_full = tuple(factors), which[0] == which[1]
        self._calls, self._deadlines, self._comparison, self._which = calls, deadlines, comparison, which
        # The points that were asked for, of all particles and of few; those of a resumed run too.
        self._asked: tuple[set[bytes], set[bytes]] = (set(), set())
        self._before: dict[str, Any] = {"calls": 0, "search_calls": 0, "reasons": {}}  # counts before the sampling

    def from_unit(self, u: Array) -> Array:
        """Return the parameters (..., d) at fractions u (..., d) of their priors."""
        u = np.asarray(u, dtype=float)
        return np.stack([prior.ppf(u[..., i]) for i, prior in enumerate(self.priors)], axis=-1)

    def ln_prior(self, points: Array) -> Array:
        """Return the ln prior density (n,) at points (n, d); -inf outside."""
        columns = np.asarray(points, dtype=float).T
        return np.asarray(sum(prior.lnpdf_of_many(x) for prior, x in zip(self.priors, columns, strict=True)))

    def evaluate(self, points: Array) -> Array:
        """Return ln likelihood (n,) at points (n, d): see `streamkit.Target`."""
        return np.array([each.ln_likelihood for each in self._evaluate(points)])

    def predictions(self, points: Array, small: bool = False) -> Evaluations:
        """Return the posterior at points (n, d), with the prediction of each datum; of small streams if asked for."""
        rows = self._evaluate(points, small)
        m = len(self.data.values)
        return Evaluations(
            np.array([row.lnp for row in rows]),
            np.array([row.ln_likelihood for row in rows]),
            np.array([row.mean for row in rows]).reshape(-1, m),
            np.array([row.variance for row in rows]).reshape(-1, m),
            tuple(row.reason for row in rows),
            details_of(rows),
        )

    def _evaluate(self, points: Array, small: bool = False) -> list[Evaluation]:
        """Evaluate at points (n, d), in order; an interruption keeps the evaluations before it.

        Points in the cache are not evaluated again, except for a chain: there each proposal is a call, and is counted.
        """
        points = np.ascontiguousarray(np.atleast_2d(points), dtype=float)
        small = small and not self.small_is_full
        cache, which = self.storage.small if small else self.storage.evaluations, self._which[small]
        before: dict[bytes, Evaluation] = {} if small or self.storage.is_chain else self.storage.earlier.all()
        missing = list(points) if self.storage.is_chain else cache.missing(points)
        if not self.storage.is_chain:
            self._asked[small].update(key for point in points if (key := point.tobytes()) not in before)
        missing = [point for point in missing if point.tobytes() not in before]
        if not missing and self._calls.stop:
            raise Stopped(self._calls.stop)
        for begin in range(0, len(missing), PART):
            part = missing[begin : begin + PART]
            for point, evaluation in zip(part, self._calls.each(np.array(part), which), strict=True):
                cache.add(point, evaluation)
                cache.write(at_once=False)
                if not self.storage.is_chain:  # of a chain the steps are shown
                    self.show(1, small)
        return [before[key] if (key := point.tobytes()) in before else cache.get(point[None])[0] for point in points]

    @property
    def earlier(self) -> Array:
        """(n, d) Return the points of calls of an earlier run, which cost nothing."""
        points = [np.frombuffer(key) for key in self.storage.earlier.all()]
        return np.array(points).reshape(-1, self.size)

    @property
    def asked(self) -> tuple[int, int]:
        """Points that the sampler has asked for so far, with all particles and with few; those of the factors too.

        A resumed run asks for those of before again.
        """
        every = [self, *(each.target for each in self.factors if isinstance(each.target, PosteriorTarget))]
        full, few = (sum(len(each._asked[small]) for each in every) for small in (False, True))
        return full, few

    # Samplers that walk

    def start(self, count: int, particles: int) -> Ensemble:
        """Return ``count`` starting points, found from the prior; an empty chain is stored first."""
        self.storage.chain.reset(count, self.size)
        deadline = self._deadlines.search
        with Progress("search for a start", 1, shown=self.progress, deadline=deadline) as bar:

            def show(line: str) -> None:
                bar.note(line)
                bar.expect(search.work + search.work_left)
                bar.update(search.work - bar.done)

            rng = np.random.default_rng([self.seed, 1])
            search = Search(self.priors, self._calls.evaluate, count, rng, deadline, show, self.display.full_cost)
            points, evaluations = search.run()
        for point, evaluation in zip(points, evaluations, strict=True):
            self.storage.evaluations.add(point, evaluation)
        # the calls of the search are counted apart; from here on every call is a proposal of the sampler
        self._calls.forget("full")
        self._before = self._before | {"search_calls": search.calls}
        self._note_begin(0)
        return Ensemble(
            points,
            np.array([each.lnp for each in evaluations]),
            np.zeros(count, dtype=bool),
            np.random.RandomState(self.seed).get_state(),
        )

    def restore(self) -> Ensemble | None:
        """Return the last step of a stored chain, or its start; None in a new run."""
        step = self.storage.chain.last
        if step is None:
            return None
        self._note_begin(step.number)
        self._before = self._before | {name: value for name, value in step.counts.items() if name in self._before}
        for point, lnp, blob in zip(step.coords, step.log_prob, step.blobs, strict=True):
            evaluation = Evaluation(float(lnp), float(blob["ln_likelihood"]), blob["mean"], blob["variance"])
            self.storage.evaluations.add(np.ascontiguousarray(point), evaluation)
        accepted = np.asarray(step.accepted, dtype=bool)
        # copies: a sampler may change its arrays, and the stored ones are the chain
        points, lnp = step.coords.copy(), step.log_prob.copy()
        memory = {name: value.copy() for name, value in step.memory.items()}
        return Ensemble(points, lnp, accepted, step.random_state, memory, number=step.number)

    def _note_begin(self, number: int) -> None:
        """Store when the walkers begin, after which step, and when their time is over: `streamkit status` reads it."""
        left, chain = self.time_left(), self.storage.chain
        chain.note(since=time(), first=number, deadline=time() + left if np.isfinite(left) else 0.0)
        with suppress(ChainError):  # a full disk stops the run at its next step, and loses none
            chain.consolidate(goes_on=True)

    def chain(self) -> Array:
        """Return the (steps, walkers, d) samples of all steps so far."""
        return self.storage.chain.samples()

    def chain_evaluations(self) -> Evaluations:
        """Return the posterior and the predictions at all points of `chain`, step by step."""
        whole = self.storage.chain.whole()
        rows, m = whole.blobs.reshape(-1), len(self.data.values)
        mean, variance = (rows[name].reshape(-1, m) for name in ("mean", "variance"))
        return Evaluations(whole.log_prob.reshape(-1), rows["ln_likelihood"], mean, variance, ("",) * len(rows))

    # Time and progress

    def time_left(self) -> float:
        """Return the seconds until the time limit; infinite without one."""
        return self._deadlines.sampling - monotonic()

    def expect(self, calls: float) -> None:
        """Set the expected total number of calls, or of steps of a chain."""
        self.display.expect(calls)

    def remark(self, text: str) -> None:
        """Show a short text beside the progress."""
        self.display.remark(text)

    def counts(self) -> dict[str, Any]:
        """Return the calls, those of the search for a start, and the rejections by reason; before a resumption too."""
        reasons = dict(Counter(self._before["reasons"]) + self._calls.reasons["full"])
        return self._before | {"calls": self._before["calls"] + self._calls.calls["full"], "reasons": reasons}
