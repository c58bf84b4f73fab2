"""The sampler: dynesty's static nested sampling."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, ClassVar, Literal

import dynesty
import numpy as np
from pydantic import Field
from threadpoolctl import threadpool_limits

from streamkit import Sampler, Samples, Target
from streamkit_dynesty.together import Together

PART = 2000  # calls after which the samples so far are yielded
NO_LIKELIHOOD = -1e290  # dynesty has -1e300 in place of minus infinity


class Dynesty(Sampler):
    """Nested sampling by dynesty: the evidence, and any number of modes."""

    kind = "dynesty"
    reference = "Speagle 2020, MNRAS 493, 3132"
    bibtex = """
@article{Speagle2020,
  author = {{Speagle}, Joshua S.},
  title = {{DYNESTY: a dynamic nested sampling package for estimating Bayesian posteriors and evidences}},
  journal = {MNRAS},
  year = 2020,
  volume = {493},
  pages = {3132--3158},
  doi = {10.1093/mnras/staa278},
}
@article{Skilling2006,
  author = {{Skilling}, John},
  title = {{Nested sampling for general Bayesian computation}},
  journal = {Bayesian Analysis},
  year = 2006,
  volume = {1},
  pages = {833--859},
  doi = {10.1214/06-BA127},
}
"""
    stopping = ("evidence_left", "max_calls")
    example: ClassVar[dict[str, Any]] = {"live_points": 80}

    live_points: int = Field(default=500, ge=10, description="Live points. More find more modes, and cost more calls.")
    evidence_left: float = Field(
        default=0.01, gt=0, description="Stop when what is left can raise ln evidence by no more than this."
    )
    max_calls: int = Field(
        default=1_000_000, ge=1, description="Stop after so many calls of the posterior in any case."
    )
    bound: Literal["none", "single", "multi", "balls", "cubes"] = Field(
        default="multi", description="What the live points are enclosed in."
    )
    walk: Literal["auto", "unif", "rwalk", "slice", "rslice"] = Field(
        default="auto",
        description="How a new live point is drawn: uniform within the bound below 10 parameters, by random walks up "
        "to 20, else by slices; or one of these.",
    )
    together: int = Field(
        default=16,
        ge=1,
        description="Proposals that are made at a time, a multiple of the workers. Samples depend on it.",
    )

    def sample(self, target: Target) -> Iterator[Samples]:
        """Run dynesty; yield the samples every `PART` calls."""
        with threadpool_limits(1):  # on matrices as small as these, threads only wait for each other
            yield from self._run(target)

    def _run(self, target: Target) -> Iterator[Samples]:
        pool = Together(target.evaluate, self.together)
        with _without_tracebacks():
            sampler = dynesty.NestedSampler(
                pool.ln_likelihood, target.from_unit, target.size, nlive=self.live_points, bound=self.bound,
                sample=self.walk, rstate=np.random.default_rng(target.seed), pool=pool, queue_size=self.together,
                bootstrap=0,
            )  # fmt: skip
        dead = sampler.sample(dlogz=self.evidence_left, maxcall=self.max_calls, add_live=False)
        yielded, missing = 0, ""  # calls at the last yield, and the missing part of the stopping rule
        for step in dead:
            left = f"ln evidence may still rise by {step.delta_logz:.2g}, and {self.evidence_left:g} is wanted"
            # what is left shrinks by a factor e in as many steps as there are live points
            steps = self.live_points * max(math.log(max(step.delta_logz, 1e-300) / self.evidence_left), 0.0)
            target.expect(min(sampler.ncall * (1.0 + steps / max(sampler.it, 1)), self.max_calls))
            if sampler.ncall >= yielded + PART:
                yielded = sampler.ncall
                yield _samples(sampler, self.live_points, left)
            if target.time_left() < 0 or sampler.ncall >= self.max_calls:
                missing = left
                break
        for _ in sampler.add_live_points():
            pass
        yield _samples(sampler, self.live_points, missing)

    def quick_settings(self, d: int) -> dict[str, int | float]:
        """Take few live points."""
        return {"live_points": min(self.live_points, max(100, 4 * d)), "evidence_left": max(self.evidence_left, 0.1)}


@contextmanager
def _without_tracebacks() -> Iterator[None]:
    """Make a sampler without dynesty's wrapper of the likelihood, which prints tracebacks: streamkit reports errors."""

    def plain(function: Any, args: Any, kwargs: Any, **_: Any) -> Any:
        return partial(function, *args, **kwargs) if args or kwargs else function

    before = dynesty.dynesty._function_wrapper
    dynesty.dynesty._function_wrapper = plain
    try:
        yield
    finally:
        dynesty.dynesty._function_wrapper = before


def _samples(sampler: dynesty.sampler.Sampler, live: int, missing: str) -> Samples:
    """Return the dead points with their weights, and the evidence with its error (Skilling 2006, sec. 8)."""
    results = sampler.results
    used = results["logl"] > NO_LIKELIHOOD
    points, ln_weights, ln_evidence = results["samples"][used], results["logwt"][used], float(results["logz"][-1])
    weights = np.exp(ln_weights - ln_evidence)
    information = float(weights @ (results["logl"][used] - ln_evidence)) / float(weights.sum())
    return Samples(points, ln_weights, ln_evidence, math.sqrt(max(information, 0.0) / live), missing)
