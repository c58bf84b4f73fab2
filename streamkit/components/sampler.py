"""Samplers: their input (`Target`), their output (`Samples` or an `Ensemble`), and their base classes."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, Protocol

import numpy as np
from pydantic import Field

from streamkit.components.bases import Component
from streamkit.components.verdict import Verdict
from streamkit.convergence import CHECK, Convergence
from streamkit.stream import Array, BoolArray, Data


@dataclass(frozen=True, eq=False)
class Evaluations:
    """The posterior at n points, and the predictions that it is made of.

    Attributes
    ----------
    ln_probability, ln_likelihood
        (n,) ln prior + ln likelihood, and the second term alone; -inf where there is no stream or outside the prior.
    mean, variance
        (n, m) the prediction of each datum, and the variance of that estimate; NaN where there is none.
    reasons
        n texts: why a point has no likelihood; empty where it has one.
    details
        (n, k) what else of the predictions the likelihoods read, for a sampler that emulates predictions.
    """

    ln_probability: Array
    ln_likelihood: Array
    mean: Array
    variance: Array
    reasons: tuple[str, ...]
    details: Array = field(default_factory=lambda: np.empty((0, 0)))


@dataclass(frozen=True, eq=False)
class Samples:
    """Weighted samples of the posterior, at one stage of the sampling.

    Attributes
    ----------
    points
        (n, d) parameters, each of them evaluated with `Target.evaluate` unless ``evaluations`` says what is known of
        them.
    ln_weights
        (n,) natural logs of their weights in the posterior, up to a constant.
    ln_evidence, ln_evidence_error
        The natural log of the integral of prior times likelihood, and its standard error; NaN if unknown.
    missing
        What the sampler's own rule of stopping still lacks, as the end of a sentence; empty when the rule is met.
    verdicts
        The sampler's own checks, shown on the page of the run beside those of streamkit.
    facts
        Short texts by name, shown on the page and in the terminal.
    evaluations
        The posterior and the predictions at the n points, for samples of an emulator; None where each point was
        evaluated.
    """

    points: Array
    ln_weights: Array
    ln_evidence: float = np.nan
    ln_evidence_error: float = np.nan
    missing: str = ""
    verdicts: tuple[Verdict, ...] = ()
    facts: Mapping[str, str] = field(default_factory=dict)
    evaluations: Evaluations | None = None


@dataclass(frozen=True, eq=False)
class Ensemble:
    """The walkers of a chain after a step: one sample of each, and all that the next step depends on.

    Attributes
    ----------
    points, ln_probability
        (walkers, d) parameters, each evaluated with `Target.evaluate`, and (walkers,) ln prior + ln likelihood there.
    accepted
        (walkers,) whether the step moved each walker.
    random_state
        The generator after the step: `numpy.random.RandomState.get_state`, or the ``bit_generator.state`` of a
        `numpy.random.Generator`.
    memory
        Arrays by name that the next step depends on, beside the points. The last step's are stored.
    history
        Arrays by name, of the same shape in each step, that later steps depend on. Those of every step are stored.
    number
        Steps taken, this one included.
    facts
        Short texts by name, shown on the page and in the terminal. The last step's are stored.
    """

    points: Array
    ln_probability: Array
    accepted: BoolArray
    random_state: Any
    memory: Mapping[str, Array] = field(default_factory=dict)
    history: Mapping[str, Array] = field(default_factory=dict)
    number: int = 0
    facts: Mapping[str, str] = field(default_factory=dict)


class PriorDensity(Protocol):
    """The prior of one parameter, in the unit of its field: `streamkit.Uniform` and the like."""

    def lnpdf(self, x: float) -> float:
        """Return the ln density at x; -inf outside the support."""

    def ppf(self, u: Array) -> Array:
        """Return the quantiles of u in [0, 1], of the same shape."""

    @property
    def support(self) -> tuple[float, float]:
        """The range outside which the density is zero; it may be infinite."""


class Target(Protocol):
    """The posterior as a sampler sees it.

    Attributes
    ----------
    size
        Number of free parameters d.
    seed
        The seed of all that the sampler draws.
    workers
        Points that are evaluated at a time: evaluate many more in one call where you can.
    progress
        Whether progress is shown. streamkit shows that of the calls.
    """

    size: int
    seed: int
    workers: int
    progress: bool

    @property
    def priors(self) -> Sequence[PriorDensity]:
        """The prior densities of the d parameters."""

    @property
    def data(self) -> Data:
        """The m data that predictions are compared with."""

    def from_unit(self, u: Array) -> Array:
        """Return the parameters (..., d) at fractions u (..., d) of their priors: the transform of nested sampling."""

    def ln_prior(self, points: Array) -> Array:
        """Return the ln prior density (n,) at points (n, d); -inf outside."""

    def evaluate(self, points: Array) -> Array:
        """Return ln likelihood (n,) at points (n, d); -inf where there is no stream or outside the prior.

        Weighted samples: every evaluation is stored, on the disk where the run has a directory. A resumed run begins
        its sampler anew with the same seed, and each point that was evaluated before costs nothing. A sampler that
        draws the same points again continues where it was, and needs no checkpoint of its own.

        Chains: `restore` returns the last step that was yielded, and evaluations since then are made again.

        Raises an exception of streamkit's after a signal or a fault: let it pass.
        """

    def predictions(self, points: Array, small: bool = False) -> Evaluations:
        """Return the posterior at points (n, d) as `evaluate` does, with the prediction of each datum.

        With ``small``, of streams with the particles of `Sampler.search_size`, their noise added to that of the data.
        """

    @property
    def coordinates(self) -> BoolArray:
        """(d,) Whether the predictions depend on a parameter; the others enter the likelihood alone."""

    @property
    def undeclared(self) -> Sequence[str]:
        """The measurements that `compare` cannot compare: role and kind. See `Measurement.likelihood_details`."""

    def compare(self, points: Array, mean: Array, variance: Array, details: Array) -> Array:
        """Return ln likelihood (n,) at points (n, d) for given predictions (n, m) and their details (n, k).

        Their variances (n, m) are added to those of the data. At least one point was evaluated before, with a result.
        """

    def start(self, count: int, particles: int) -> Ensemble:
        """Return ``count`` starting points near the maximum of the posterior, found from the prior.

        The search tries small streams, of ``particles`` particles, and evaluates the best of them in full.
        """

    def restore(self) -> Ensemble | None:
        """Return the last step of the chain that is resumed; None in a new run."""

    def chain(self) -> Array:
        """Return the (steps, walkers, d) samples of all steps that were yielded so far, before a resumption too."""

    def history(self, name: str) -> Array | None:
        """Return the arrays of this name in `Ensemble.history` of all steps (steps, ...); None if there are none."""

    def time_left(self) -> float:
        """Return the seconds until the run's time limit; infinite without one. End the sampling when it is over."""

    def expect(self, calls: float) -> None:
        """Set how many calls (steps, of a chain) there may have been at the end, for the progress that is shown."""

    def remark(self, text: str) -> None:
        """Show a short text beside the progress, such as the number of effective samples."""


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
