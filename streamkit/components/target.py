"""What a sampler receives: the posterior as a `Target`, with the prior density of each parameter."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from streamkit.components.samples import Ensemble, Evaluations
from streamkit.stream import Array, BoolArray, Data, IntArray

T = TypeVar("T")


class PriorDensity(Protocol):
    """The prior of one parameter, in the unit of its field: `streamkit.Uniform` and the like."""

    def lnpdf(self, x: float) -> float:
        """Return the ln density at x; -inf outside the support."""

    def ppf(self, u: Array) -> Array:
        """Return the quantiles of u in [0, 1], of the same shape."""

    @property
    def support(self) -> tuple[float, float]:
        """The range outside which the density is zero; it may be infinite."""


@dataclass(frozen=True, eq=False)
class TargetFactor:
    """One stream of several, or the data of the host: a factor of the likelihood, and a target of its own.

    Attributes
    ----------
    name
        The name of the stream; ``[data]`` for the data of the host.
    shared, own
        Indices of its parameters among all of the run: those that the other factors have too, and its own. Their order
        is the same in its target.
    target
        The posterior of this factor alone, with its data, which stand among all of the run in the order of the factors.
    """

    name: str
    shared: IntArray
    own: IntArray
    target: Target


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
    def factors(self) -> Sequence[TargetFactor]:
        """The factors of the likelihood of several streams, for a sampler that emulates predictions; else none."""

    def call_factors(self, points: Mapping[str, Array]) -> None:
        """Call several factors by name at points (n, p), from one queue; their `predictions` cost nothing then."""

    def at_once(self, tasks: Sequence[Callable[[], T]], /) -> list[T]:
        """Run tasks in as many processes as the run may use; return their results, in order.

        The tasks may call `compare`. Their results are pickled. What a task changes in its process may be lost: without
        forks, or with one worker, they run here, one after another.
        """

    @property
    def earlier(self) -> Array:
        """(n, d) The points of calls of an earlier run, which cost nothing; empty if there are none."""

    @property
    def small_is_full(self) -> bool:
        """Whether streams with the particles of `Sampler.search_size` are those of the run."""

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

    def chain_evaluations(self) -> Evaluations:
        """Return the posterior and the predictions at all points of `chain`, step by step: (steps * walkers,) of them.

        They have no details. `chain` must have a step.
        """

    def time_left(self) -> float:
        """Return the seconds until the run's time limit; infinite without one. End the sampling when it is over."""

    def expect(self, calls: float) -> None:
        """Set how many calls (steps, of a chain) there may have been at the end, for the progress that is shown."""

    def remark(self, text: str) -> None:
        """Show a short text beside the progress, such as the number of effective samples."""


class EmulatedLikelihood(Protocol):
    """The likelihood that a sampler has learned from calls; it costs next to nothing."""

    def ln_likelihood(self, points: Array) -> Array:
        """Return ln likelihood (n,) at points (n, d) inside the prior."""

    def is_trusted(self, points: Array) -> BoolArray:
        """Return whether points (n, d) are among the calls, (n,)."""

    def redrawn(self, rng: np.random.Generator) -> EmulatedLikelihood:
        """Return the likelihood that other noise in the calls could have given."""
