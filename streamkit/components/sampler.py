"""The base classes of samplers. A sampler receives a `Target`, and yields `Samples` or the `Ensemble` of each step."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from streamkit.components.bases import Component
from streamkit.components.samples import Ensemble, Samples
from streamkit.components.target import EmulatedLikelihood, Target
from streamkit.convergence import CHECK, Convergence
from streamkit.errors import ComponentError
from streamkit.stream import Array


class Sampler(Component):
    """The sampler of a run's posterior. Every sampler has the fields below.

    streamkit calls `sample` once in a run, and once more when a run is resumed. The sampler evaluates points (n, d), in
    the units of the run file's fields, by `Target.evaluate`. It yields weighted `Samples` or, if it derives from
    `ChainSampler`, an `Ensemble` after each step. streamkit checks and stores what it yields. Exceptions of
    `Target.evaluate` must pass. Any other exception ends the run as a `ComponentError`; the stored samples stay.
    """

    role: ClassVar[str] = "sampler"
    stopping: ClassVar[tuple[str, ...]] = ()
    """Fields that only decide when to stop: a resumed run may change them."""
    emulates: ClassVar[bool] = False
    """Whether it emulates predictions: random numbers then differ between points, `Evaluations` have details."""

    call_limit: float = Field(
        default=3600.0,
        gt=0,
        description="Longest time of one call in seconds. After this time the worker process is killed. Without "
        "workers the call is interrupted, once its compiled code has ended.",
    )
    over_limit: Literal["stop", "reject"] = Field(
        default="stop",
        description="The result of a longer call: the run stops, or the call counts as rejected. In the second "
        "case the rejected calls depend on the machine.",
    )

    @classmethod
    def resumable_fields(cls) -> tuple[str, ...]:
        """Return the fields that a resumed run may change."""
        return (*cls.stopping, "call_limit", "over_limit")

    @abstractmethod
    def sample(self, target: Target) -> Iterator[Samples | Ensemble]:
        """Yield weighted `Samples` now and then, the last of which are the result, or an `Ensemble` after each step.

        streamkit stores each result before the next one is computed. All random numbers must come from ``target.seed``,
        and the only clock is `Target.time_left`: the same target then gives the same samples.
        """

    def emulated(self, target: Target) -> EmulatedLikelihood | None:
        """Return the likelihood that it learns from the calls at `Target.earlier`, without a new call. Optional.

        None for a sampler that learns none. `streamkit export --host-likelihood` asks for it, of each stream alone.
        """
        return None

    def reject_dimension(self, d: int) -> str:
        """Return why d free parameters cannot be sampled: field, value, allowed values; empty if they can."""
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
        """Return the expected number of calls in a fit of d parameters, and its derivation in words; 0 if unknown.

        `streamkit check` shows it.
        """
        return 0, "unknown"

    def advice(self, d: int) -> tuple[str, ...]:
        """Return a warning for every setting that is allowed but bad for d parameters; `streamkit check` prints it."""
        return ()

    def cites(self) -> dict[str, str]:
        """Return the keys of streamkit's bibliography to cite for these settings, each with its subject."""
        return {}


class ChainSampler(Sampler):
    """A sampler whose walkers take steps. A derived class defines the steps: `walk`.

    streamkit finds the start, calls `walk` once with it, or with the last stored step of a resumed run, and takes steps
    from `walk` until the chain has converged (`Convergence`), has ``steps`` steps, or its time is over. It stores each
    step before the next one is taken.
    """

    stopping: ClassVar[tuple[str, ...]] = ("steps", "tau_factor", "r_hat")

    walkers: int = Field(default=32, ge=2, le=10**5, description="Walkers, at least twice the free parameters.")
    steps: int = Field(default=5000, ge=1, le=10**8, description="Largest length of the chain, in steps per walker.")
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
        le=10**7,
        description="Particles of the streams in the search for a start, at most the run's number. Where an observable "
        "depends on a small part of the debris, small streams cannot show it: take more.",
    )

    @abstractmethod
    def walk(self, target: Target, ensemble: Ensemble) -> Iterator[Ensemble]:
        """Yield the ensemble after each of the steps that follow ``ensemble``, without end.

        ``ensemble`` is the start (``number`` 0; its ``random_state`` is that of a `numpy.random.RandomState` with the
        run's seed), or the last step of a resumed run: the steps must then be those of an uninterrupted run.
        """

    def learning_steps(self, chain: Array) -> int:
        """Return the number of steps at the beginning of a chain (steps, walkers, d) in which the moves still learn.

        They are left out of the samples.
        """
        return 0

    def convergence(self, chain: Array) -> Convergence:
        """Return the rule of convergence, applied to a chain (steps, walkers, d)."""
        return Convergence(chain, self.learning_steps(chain), self.tau_factor, self.r_hat)

    def expected_steps(self, chain: Array, judged: Convergence | None = None) -> float:
        """Return the expected final length of a chain (steps, walkers, d), by the last test of its convergence.

        ``judged`` is the result of this test, if it is known. Without an estimate the chain takes all ``steps``.
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
        raise ComponentError(f"sampler {self.kind}: walk ended after {done} steps, expected steps without end")

    def search_size(self) -> tuple[int, int]:
        """Return one point for each walker."""
        return self.walkers, self.start_particles

    def calls(self, d: int) -> tuple[int, str]:
        """Return those of the longest chain."""
        total = self.walkers * self.steps
        return total, f"{self.walkers} walkers x at most {self.steps} steps = {total} calls"
