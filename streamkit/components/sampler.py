"""The base classes of samplers. A sampler receives a `Target`, and yields `Samples` or the `Ensemble` of each step."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from streamkit.components.bases import Component
from streamkit.components.samples import Ensemble, Samples
from streamkit.components.target import Target
from streamkit.convergence import CHECK, Convergence
from streamkit.stream import Array


class Sampler(Component):
    """How the posterior of a run is sampled. The fields below belong to every sampler."""

    role: ClassVar[str] = "sampler"
    stopping: ClassVar[tuple[str, ...]] = ()
    """Fields that only say when to stop: a resumed run may change them."""
    emulates: ClassVar[bool] = False
    """Whether it emulates predictions: points then have random numbers of their own, and `Evaluations` details."""

    call_limit: float = Field(
        default=3600.0,
        gt=0,
        description="Longest time of one call in seconds. A worker process is ended then; without workers the call is, "
        "but for compiled code in it, which comes to its end first.",
    )
    over_limit: Literal["stop", "reject"] = Field(
        default="stop",
        description="What becomes of a longer call: the run stops, or it is a rejection, with this reason. Which calls "
        "are rejected then depends on the machine.",
    )

    @classmethod
    def resumable_fields(cls) -> tuple[str, ...]:
        """Return the fields that a resumed run may change."""
        return (*cls.stopping, "call_limit", "over_limit")

    @abstractmethod
    def sample(self, target: Target) -> Iterator[Samples | Ensemble]:
        """Yield weighted `Samples` now and then, the last of which are the result, or an `Ensemble` after each step.

        streamkit stores each result before the next one is computed. All random numbers come from ``target.seed``, and
        the clock is used for `Target.time_left` alone: the same target gives the same samples.
        """

    def reject_dimension(self, d: int) -> str:
        """Return why d free parameters cannot be sampled: a field, its value, what is allowed. Empty if they can."""
        return ""

    def quick_settings(self, d: int) -> dict[str, int | float]:
        """Return the fields that a coarse look within 3 minutes changes, with their values."""
        return {}

    def search_size(self) -> tuple[int, int]:
        """Return the two arguments of `Target.start` that the sampler uses; 0 points for one without such a search.

        `streamkit check` estimates the cost of the search from them.
        """
        return 0, 1000

    def calls(self, d: int) -> tuple[int, str]:
        """Return how many calls of the posterior a fit of d parameters may take, and how that comes about; 0: unknown.

        `streamkit check` shows it.
        """
        return 0, "unknown"

    def advice(self, d: int) -> tuple[str, ...]:
        """Return a sentence for every setting that is allowed for d parameters, and bad. `streamkit check` warns."""
        return ()

    def cites(self) -> dict[str, str]:
        """Return keys of streamkit's own bibliography to cite for these settings, and what for."""
        return {}


class ChainSampler(Sampler):
    """A sampler whose walkers take steps. A class of this kind says how: `walk`.

    streamkit finds the start, stores each step, resumes the chain, and ends it by one rule: `Convergence`.
    """

    stopping: ClassVar[tuple[str, ...]] = ("steps", "tau_factor", "r_hat")

    walkers: int = Field(default=32, ge=2, description="Number of walkers, at least twice the free parameters.")
    steps: int = Field(default=5000, ge=1, description="Longest chain, in steps per walker.")
    tau_factor: float = Field(
        default=50.0, gt=0, description="Stop when the chain is longer than so many autocorrelation times."
    )
    r_hat: float = Field(
        default=1.02,
        gt=1,
        description="Stop only when the rank-normalised R-hat of every parameter is below this.",
    )
    start_particles: int = Field(
        default=1000,
        ge=2,
        description="Particles of the streams that the search for a start tries, the run's own number at most. Where "
        "an observable is made of little of the debris, such small streams have none of it: take more.",
    )

    @abstractmethod
    def walk(self, target: Target, ensemble: Ensemble) -> Iterator[Ensemble]:
        """Yield the ensemble after each of the steps that follow ``ensemble``, without end.

        ``ensemble`` is the start (``number`` 0; its ``random_state`` is that of a `numpy.random.RandomState` with the
        run's seed), or the last step of a run that is resumed: the steps must be those of an unbroken run.
        """

    def learning_steps(self, chain: Array) -> int:
        """Return how many steps at the beginning of a chain (steps, walkers, d) depend on the steps before them.

        They are left out of the samples: the sampler changes while it learns.
        """
        return 0

    def convergence(self, chain: Array) -> Convergence:
        """Return the rule of convergence, applied to a chain (steps, walkers, d)."""
        return Convergence(chain, self.learning_steps(chain), self.tau_factor, self.r_hat)

    def expected_steps(self, chain: Array, judged: Convergence | None = None) -> float:
        """Return how long a chain (steps, walkers, d) will be at its end, by the last look at its convergence.

        ``judged`` is that look, if it is known. Without an estimate the chain takes all ``steps``.
        """
        looked = len(chain) - len(chain) % CHECK
        if judged is None and looked:
            judged = self.convergence(chain[:looked])
        expected = np.nan if judged is None else judged.expected_steps
        return float(max(min(self.steps, expected), len(chain))) if np.isfinite(expected) else float(self.steps)

    def sample(self, target: Target) -> Iterator[Ensemble]:
        """Walk until the chain has converged, ``steps`` are taken, or the time is over."""
        ensemble = target.restore()
        if ensemble is None:
            ensemble = target.start(*self.search_size())
            yield ensemble
        done = ensemble.number
        if done >= self.steps or (done and self.convergence(target.chain())):
            return
        target.expect(self.expected_steps(target.chain()))
        for after in self.walk(target, ensemble):
            yield after
            done += 1
            if target.time_left() < 0:
                return
            if done % CHECK == 0 or done == self.steps:
                judged = self.convergence(target.chain())
                if judged:
                    return
                target.expect(self.expected_steps(target.chain(), judged))
                if np.isfinite(judged.span):
                    target.remark(f"tau {np.max(judged.tau):.0f}")
            if done == self.steps:
                return

    def search_size(self) -> tuple[int, int]:
        """Return one point for each walker."""
        return self.walkers, self.start_particles

    def calls(self, d: int) -> tuple[int, str]:
        """Return those of the longest chain."""
        total = self.walkers * self.steps
        return total, f"{self.walkers} walkers x at most {self.steps} steps = {total} calls"
