"""The posterior of a run as its sampler sees it: evaluations that are remembered, a start, a chain, a time limit.

A call passes through three objects between a sampler and the physics. `PosteriorTarget` remembers and counts
evaluations, so that no point costs twice. `Workers` spreads the points over processes, and ends calls that take too
long. `Posterior` binds the parameters to the run file and compares the streams with the data.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from time import monotonic, time
from typing import Any

import numpy as np

from streamkit.components import Ensemble, Evaluations, Sampler, Samples
from streamkit.errors import ChainError, ComponentError
from streamkit.report import Progress
from streamkit.runfile import Prior
from streamkit.sample.calls.comparison import Comparison
from streamkit.sample.calls.posterior import Posterior
from streamkit.sample.calls.search import Search
from streamkit.sample.calls.workers import Stopped, Workers
from streamkit.sample.evaluation import Evaluation, blob_dtype, details_of
from streamkit.sample.store.chain_file import ChainMemory
from streamkit.sample.store.evaluation_cache import EvaluationCache
from streamkit.sample.store.step import Step
from streamkit.sample.store.weighted import Weighted
from streamkit.stream import Array, BoolArray, Data

NOTES = 5.0  # seconds between two notes beside the progress
PART = 256  # points sent to the workers at a time: a stop loses at most their evaluations


class PosteriorTarget:
    """A posterior to be sampled: a `streamkit.Target`."""

    def __init__(
        self,
        priors: Sequence[Prior],
        data: Data,
        seed: int,
        pool: Workers,  # evaluates the posterior "full", and for a search "cheap", whose streams are small
        cache: EvaluationCache | None = None,
        chain: ChainMemory | None = None,
        *,
        resumes: bool = False,  # whether these files hold a chain to continue
        workers: int = 1,  # points that are evaluated at a time
        # Values of `time.monotonic` at which the sampling, and the search for a start before it, end.
        deadline: float = np.inf,
        search_deadline: float = np.inf,
        progress: bool = False,
        # A radius in kpc, and the mass inside it in Msun at a point, for the progress of a chain.
        mass: tuple[float, Callable[[Array], float]] | None = None,
        full_cost: float = 1.0,  # of a "full" call in units of a "cheap" one, about: for the expected end of the search
        small_cache: EvaluationCache | None = None,  # of small streams
        posterior: Posterior | None = None,  # compares given predictions; None where no sampler emulates them
    ) -> None:
        self.priors, self.data, self.size, self.seed = tuple(priors), data, len(priors), seed
        self.workers, self.progress = workers, progress
        self._pool, self._cache = pool, EvaluationCache() if cache is None else cache
        self._chain = ChainMemory() if chain is None else chain
        self._resumes, self._deadline, self._search_deadline = resumes, deadline, search_deadline
        self._mass, self._full_cost = mass, full_cost
        self._small_cache = EvaluationCache() if small_cache is None else small_cache
        self._posterior, self._has_shapes = posterior, False
        self._dtype = blob_dtype(len(data.values))
        self._before: dict[str, Any] = {"calls": 0, "search_calls": 0, "reasons": {}}  # counts before a resumption
        self._bar: Progress | None = None
        self._expected, self._remark = np.inf, ""
        self._noted = monotonic()

    # The sampler's side: streamkit.Target

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

    @property
    def coordinates(self) -> BoolArray:
        """(d,) Whether the predictions depend on a parameter; the others enter the likelihood alone."""
        return self._comparison.coordinates

    @property
    def undeclared(self) -> Sequence[str]:
        """The measurements that `compare` cannot compare: role and kind."""
        return self._comparison.undeclared

    def compare(self, points: Array, mean: Array, variance: Array, details: Array) -> Array:
        """Return ln likelihood (n,) at points (n, d) for given predictions."""
        comparison = self._comparison
        if not self._has_shapes:
            place = self._cache.any_good()
            place = self._small_cache.any_good() if place is None else place
            assert place is not None and self._posterior is not None  # noqa: S101, PT018  the sampler has evaluated
            comparison.details(self._posterior.observe(place))
            self._has_shapes = True
        return comparison.ln_likelihood(points, mean, variance, details)

    @property
    def _comparison(self) -> Comparison:
        assert self._posterior is not None  # noqa: S101  the runner gives it to a sampler that emulates
        return self._posterior.comparison

    def start(self, count: int, particles: int) -> Ensemble:
        """Return ``count`` starting points, found from the prior; an empty chain is stored first."""
        self._chain.reset(count, self.size)
        with Progress("search for a start", 1, shown=self.progress, deadline=self._search_deadline) as bar:

            def show(line: str) -> None:
                bar.note(line)
                bar.expect(search.work + search.work_left)
                bar.update(search.work - bar.done)

            rng = np.random.default_rng([self.seed, 1])
            search = Search(self.priors, self._pool.evaluate, count, rng, self._search_deadline, show, self._full_cost)
            points, evaluations = search.run()
        self._before = self._before | {"search_calls": search.calls}
        for point, evaluation in zip(points, evaluations, strict=True):
            self._cache.add(point, evaluation)
        # the calls of the search are counted apart; from here on every call is a proposal of the sampler
        self._pool.calls["full"] = 0
        self._pool.reasons["full"].clear()
        self._note_begin(0)
        return Ensemble(
            points,
            np.array([each.lnp for each in evaluations]),
            np.zeros(count, dtype=bool),
            np.random.RandomState(self.seed).get_state(),
        )

    def restore(self) -> Ensemble | None:
        """Return the last step of a stored chain, or its start; None in a new run."""
        step = self._chain.last if self._resumes else None
        if step is None:
            return None
        self._note_begin(step.number)
        self._before = self._before | {name: value for name, value in step.counts.items() if name in self._before}
        for point, lnp, blob in zip(step.coords, step.log_prob, step.blobs, strict=True):
            evaluation = Evaluation(float(lnp), float(blob["ln_likelihood"]), blob["mean"], blob["variance"])
            self._cache.add(np.ascontiguousarray(point), evaluation)
        accepted = np.asarray(step.accepted, dtype=bool)
        return Ensemble(step.coords, step.log_prob, accepted, step.random_state, step.memory, number=step.number)

    def _note_begin(self, number: int) -> None:
        """Store when the walkers begin, after which step, and when their time is over: `streamkit status` reads it."""
        left = self.time_left()
        self._chain.note(since=time(), first=number, deadline=time() + left if np.isfinite(left) else 0.0)
        with suppress(ChainError):  # a full disk stops the run at its next step, and loses none
            self._chain.consolidate()

    def chain(self) -> Array:
        """Return the (steps, walkers, d) samples of all steps so far."""
        return self._chain.samples()

    def history(self, name: str) -> Array | None:
        """Return the arrays of this name in `Ensemble.history` of all steps (steps, ...); None if there are none."""
        return self._chain.history(name)

    def time_left(self) -> float:
        """Return the seconds until the time limit; infinite without one."""
        return self._deadline - monotonic()

    def expect(self, calls: float) -> None:
        """Set how many calls, or steps, there may have been at the end."""
        self._expected = calls
        if self._bar is not None:
            self._bar.expect(calls)

    def remark(self, text: str) -> None:
        """Show a short text beside the progress."""
        self._remark = text

    # The runner's side

    def run(self, sampler: Sampler) -> Iterator[Weighted]:
        """Run a sampler. Steps of a chain are stored; weighted samples are yielded with their evaluations.

        Raises ComponentError for samples of another shape, without a weight, or never evaluated.
        """
        try:
            for state in sampler.sample(self):
                if isinstance(state, Ensemble):
                    self._store(sampler, state)
                else:
                    yield self._weighted(sampler, state)
        finally:
            if self._bar is not None:
                self._bar.close()
            self._small_cache.write()
            self._cache.write()
            if self._chain.last is not None:
                with suppress(ChainError):  # the journal holds all steps; the runner tries again, and raises
                    self._chain.consolidate()

    def _evaluate(self, points: Array, small: bool = False) -> list[Evaluation]:
        """Evaluate at points (n, d), in order; an interruption keeps the evaluations before it.

        Points in the cache are not evaluated again, except for a chain: there each proposal is a call, and is counted.
        """
        points = np.ascontiguousarray(np.atleast_2d(points), dtype=float)
        cache, which = (self._small_cache, "cheap") if small else (self._cache, "full")
        missing = cache.missing(points) if self._chain.last is None else list(points)
        if not missing and self._pool.stop:
            raise Stopped(self._pool.stop)
        for begin in range(0, len(missing), PART):
            part = missing[begin : begin + PART]
            for point, evaluation in zip(part, self._pool.evaluate(np.array(part), which), strict=True):
                cache.add(point, evaluation)
            cache.write(at_once=False)
        if self._chain.last is None:  # of a chain the steps are shown
            self._show("call", len(missing))
        return cache.get(points)

    def _store(self, sampler: Sampler, ensemble: Ensemble) -> None:
        """Store a step of a chain with its evaluations; ComponentError if it has another shape or type."""
        points = np.ascontiguousarray(ensemble.points, dtype=float)
        last = self._chain.last
        if points.ndim != 2 or points.shape[1] != self.size or (last and points.shape != last.coords.shape):
            shape = ("walkers", self.size) if last is None else last.coords.shape
            raise ComponentError(f"sampler {sampler.kind}: yields points of shape {points.shape}, expected {shape}")
        if self._cache.missing(points):
            raise ComponentError(f"sampler {sampler.kind}: yields walkers at points that it never evaluated")
        reasons = dict(Counter(self._before["reasons"]) + self._pool.reasons["full"])
        counts = self._before | {"calls": self._before["calls"] + self._pool.calls["full"], "reasons": reasons}
        rows = [each.row()[1:] for each in self._cache.get(points)]
        step = Step(
            self._chain.iteration + (last is not None),
            points,
            ensemble.ln_probability,
            np.array(rows, dtype=blob_dtype(len(self.data.values))),
            ensemble.accepted,
            ensemble.random_state,
            counts | ({"facts": ensemble.facts} if ensemble.facts else {}),
            ensemble.memory,
            ensemble.history,
        )
        with _blamed(sampler):
            self._chain.append(step)
        self._cache.keep_only(points)
        if last is not None:
            self._show("step", 1)

    def _show(self, unit: str, more: int) -> None:
        """Count calls or steps for the progress, with a note every `NOTES` seconds."""
        if self._bar is None:
            done = self._chain.iteration - more if unit == "step" else 0
            self._begun = monotonic(), self._pool.calls["full"]
            self._bar = Progress("sampling", self._expected, unit, done=done, shown=self.progress, keep=True,
                                 deadline=self._deadline)  # fmt: skip
        now = monotonic()
        if now - self._noted > NOTES:
            self._noted = now
            self._bar.note(", ".join([*self._notes(now), *([self._remark] if self._remark else [])]))
        self._bar.update(more)

    def _notes(self, now: float) -> Iterator[str]:
        """Yield acceptance, speed and running mass."""
        begin, calls = self._begun
        step = self._chain.last
        if step is not None and step.number:
            yield f"accepted {100 * self._chain.acceptance:.0f} %"
        yield f"{(self._pool.calls['full'] - calls) / max(now - begin, 1e-9):.1f} calls/s"
        if step is not None and self._mass is not None:
            radius, mass = self._mass
            low, middle, high = np.percentile([mass(point) / 1e11 for point in step.coords], [16, 50, 84])
            yield f"M({radius:g} kpc) {middle:.3g} +{high - middle:.2g} -{middle - low:.2g}e11 Msun"

    def _weighted(self, sampler: Sampler, samples: Samples) -> Weighted:
        """Return weighted samples with their evaluations; ComponentError for wrong shapes, weights or points."""
        points, ln_weights = np.asarray(samples.points, dtype=float), np.asarray(samples.ln_weights, dtype=float)
        if points.ndim != 2 or points.shape != (len(ln_weights), self.size) or not np.isfinite(points).all():
            raise ComponentError(f"sampler {sampler.kind}: gives points of shape {points.shape} and weights of shape "
                                 f"{ln_weights.shape}, expected (n, {self.size}) and (n,), finite")  # fmt: skip
        with np.errstate(invalid="ignore"):
            used = ln_weights > -np.inf
        if not used.any() or np.isnan(ln_weights).any() or np.isposinf(ln_weights).any():
            raise ComponentError(
                f"sampler {sampler.kind}: gives no sample with a weight, or weights that are no numbers"
            )
        points, dtype = np.ascontiguousarray(points[used]), blob_dtype(len(self.data.values))
        if samples.evaluations is None:
            if self._cache.missing(points):
                raise ComponentError(f"sampler {sampler.kind}: gives samples that it never evaluated")
            rows = [each.row() for each in self._cache.get(points)]
            log_prob, blobs = np.array([row[0] for row in rows]), np.array([row[1:] for row in rows], dtype=dtype)
        else:
            given = samples.evaluations
            log_prob, blobs = given.ln_probability[used], np.empty(used.sum(), dtype=dtype)
            for name in dtype.names or ():
                blobs[name] = getattr(given, name)[used]
        counts = {"calls": len(self._cache), "search_calls": len(self._small_cache), "reasons": self._cache.reasons}
        weighted = Weighted(
            points,
            ln_weights[used],
            log_prob,
            blobs,
            samples.ln_evidence,
            samples.ln_evidence_error,
            samples.missing,
            {"counts": counts | ({"facts": samples.facts} if samples.facts else {})},
            samples.verdicts,
        )
        with _blamed(sampler):
            return weighted.checked()


@contextmanager
def _blamed(sampler: Sampler) -> Iterator[None]:
    """Name the sampler in the error of a store for what cannot be stored."""
    try:
        yield
    except ComponentError as error:
        raise ComponentError(f"sampler {sampler.kind}: {error}") from None
