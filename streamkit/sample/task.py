"""What a sampler is given: the posterior, whose calls are remembered, a seed, a time limit."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from time import monotonic
from typing import Any

import numpy as np

from streamkit.components import Sampler, Samples
from streamkit.errors import ChainError, ComponentError
from streamkit.report import Progress
from streamkit.runfile import Prior
from streamkit.sample.evaluation_cache import EvaluationCache
from streamkit.sample.weighted import Weighted
from streamkit.stream import Array


class Task:
    """A posterior to be sampled: a `streamkit.Target`.

    Parameters
    ----------
    priors, seed
        Of the d free parameters; and the seed of all that the sampler draws.
    calls
        Evaluates the posterior and remembers it.
    dtype
        The record stored with each sample.
    workers
        Points that are evaluated at a time.
    deadline
        When the sampling is to end, by `time.monotonic`.
    progress
        Whether to show how many calls are made, and when the sampler expects its end.
    ensemble
        Runs emcee's ensemble; without one there is none.
    """

    def __init__(
        self,
        priors: Sequence[Prior],
        seed: int,
        calls: EvaluationCache,
        dtype: np.dtype[Any],
        *,
        workers: int = 1,
        deadline: float = np.inf,
        progress: bool = False,
        ensemble: Callable[[Sampler], None] | None = None,
    ) -> None:
        self.size, self.seed, self.workers, self.progress = len(priors), seed, workers, progress
        self._priors, self._calls, self._dtype, self._deadline = tuple(priors), calls, dtype, deadline
        self._ensemble = ensemble
        self._bar: Progress | None = None

    def from_unit(self, u: Array) -> Array:
        """Return the parameters (..., d) at fractions u (..., d) of their priors."""
        u = np.asarray(u, dtype=float)
        return np.stack([prior.ppf(u[..., i]) for i, prior in enumerate(self._priors)], axis=-1)

    def ln_prior(self, points: Array) -> Array:
        """Return the ln prior density (n,) at points (n, d); -inf outside."""
        return np.array([sum(p.lnpdf(float(x)) for p, x in zip(self._priors, row, strict=True)) for row in points])

    def evaluate(self, points: Array) -> Array:
        """Return ln likelihood (n,) at points (n, d): see `streamkit.Target`."""
        points = np.atleast_2d(points)
        found = np.array([each.ln_likelihood for each in self._calls.evaluate(points)])
        if self._bar is None:  # the first call of a sampler that is no ensemble
            self._bar = Progress("sampling", np.inf, "call", shown=self.progress, keep=True, deadline=self._deadline)
        self._bar.update(len(points))
        return found

    def expect(self, calls: float) -> None:
        """Tell the progress how many calls there may have been at the end."""
        if self._bar is not None:
            self._bar.expect(calls)

    def time_left(self) -> float:
        """Return the seconds until the time limit; infinite without one."""
        return self._deadline - monotonic()

    def ensemble(self, sampler: Sampler) -> None:
        """Run emcee's ensemble."""
        if self._ensemble is None:
            raise ChainError("there is no place for a chain here")
        self._ensemble(sampler)

    def run(self, sampler: Sampler) -> Iterator[Weighted]:
        """Run a sampler; yield what it finds with what is known of each sample.

        Raises ComponentError if its samples are none: of another shape, without weight, not evaluated.
        """
        try:
            for found in sampler.sample(self):
                yield self._checked(sampler, found)
        finally:
            if self._bar is not None:
                self._bar.close()
            self._calls.write()

    def _checked(self, sampler: Sampler, found: Samples) -> Weighted:
        points, ln_weights = np.asarray(found.points, dtype=float), np.asarray(found.ln_weights, dtype=float)
        if points.ndim != 2 or points.shape != (len(ln_weights), self.size) or not np.isfinite(points).all():
            raise ComponentError(f"sampler {sampler.kind}: gives points of shape {points.shape} and weights of shape "
                                 f"{ln_weights.shape}, expected (n, {self.size}) and (n,), finite")  # fmt: skip
        with np.errstate(invalid="ignore"):
            used = ln_weights > -np.inf
        if not used.any() or np.isnan(ln_weights).any() or np.isposinf(ln_weights).any():
            raise ComponentError(
                f"sampler {sampler.kind}: gives no sample with a weight, or weights that are no numbers"
            )
        points, before = points[used], len(self._calls)
        rows = [each.row() for each in self._calls.evaluate(points)]
        if len(self._calls) != before:
            raise ComponentError(f"sampler {sampler.kind}: gives samples that it never evaluated")
        counts = {"calls": before, "search_calls": 0, "reasons": self._calls.reasons}
        return Weighted(
            points,
            ln_weights[used],
            np.array([row[0] for row in rows]),
            np.array([row[1:] for row in rows], dtype=self._dtype),
            float(found.ln_evidence),
            float(found.ln_evidence_error),
            found.missing,
            {"counts": counts},
        )
