"""Samplers: how draws from the posterior are made, what they are given, and what they give."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Literal, Protocol

from pydantic import Field

from streamkit.components.bases import Component
from streamkit.stream import Array


@dataclass(frozen=True, eq=False)
class Samples:
    """Weighted samples of the posterior, as far as a sampler has come.

    Attributes
    ----------
    points
        (n, d) parameters, every one of them evaluated with `Target.evaluate`.
    ln_weights
        (n,) natural logs of their weights in the posterior, up to a constant.
    ln_evidence, ln_evidence_error
        The natural log of the integral of prior times likelihood, and its standard error; NaN if unknown.
    missing
        What the sampler's own rule of stopping still asks for, as the end of a sentence; empty when it is met.
    """

    points: Array
    ln_weights: Array
    ln_evidence: float
    ln_evidence_error: float
    missing: str = ""


class Target(Protocol):
    """The posterior as a sampler sees it.

    Attributes
    ----------
    size
        Number of free parameters d.
    seed
        The seed of all that the sampler draws.
    workers
        Points that are evaluated at a time: ask for many more at once where you can.
    progress
        Whether progress is shown: that of the calls is, by streamkit.
    """

    size: int
    seed: int
    workers: int
    progress: bool

    def from_unit(self, u: Array) -> Array:
        """Return the parameters (..., d) at fractions u (..., d) of their priors: the transform of nested sampling."""

    def ln_prior(self, points: Array) -> Array:
        """Return the ln prior density (n,) at points (n, d); -inf outside."""

    def evaluate(self, points: Array) -> Array:
        """Return ln likelihood (n,) at points (n, d); -inf where there is no stream or outside the prior.

        All that was evaluated is kept, on the disk where the run has a directory. A resumed run begins its sampler
        anew, with the same seed, and each point that was evaluated before costs nothing: a sampler that draws the same
        points again goes on where it was, after whatever end, and needs no checkpoint of its own. Raises an exception
        of streamkit's after a signal or a fault: let it pass.
        """

    def time_left(self) -> float:
        """Return the seconds until the run's time limit; infinite without one. End the sampling when it is over."""

    def expect(self, calls: float) -> None:
        """Say how many calls there may have been at the end, as far as is known by now: for the progress."""

    def ensemble(self, sampler: Sampler) -> None:
        """Run emcee's ensemble with streamkit's moves, stored as a chain; ``sampler`` has the fields of ``emcee``."""


class Sampler(Component):
    """How the posterior of a run is sampled. The fields below belong to every sampler."""

    role: ClassVar[str] = "sampler"
    stopping: ClassVar[tuple[str, ...]] = ()
    """Fields that only say when to stop: a resumed run may change them."""

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
    def loose(cls) -> tuple[str, ...]:
        """Return the fields that a resumed run may change."""
        return (*cls.stopping, "call_limit", "over_limit")

    @abstractmethod
    def sample(self, target: Target) -> Iterator[Samples]:
        """Yield the samples so far now and then, for reports of a run in progress; the last are the result.

        All chance comes from ``target.seed``, and the clock is looked at for `Target.time_left` alone: the same target
        gives the same samples.
        """

    def unfit(self, d: int) -> str:
        """Say why d free parameters cannot be sampled: a field, what was found, what is allowed. Empty if they can."""
        return ""

    def quick(self, d: int) -> dict[str, int | float]:
        """Return the fields that a coarse look within 3 minutes changes, with their values."""
        return {}

    def start(self) -> tuple[int, int]:
        """Return how many starting points the search has to find, and the particles of the small streams it tries.

        `Target.ensemble` makes this search; other samplers have none.
        """
        return 0, 1000

    def calls(self, d: int) -> tuple[int, str]:
        """Return how many calls of the posterior a fit of d parameters may take, and how that comes about; 0: unknown.

        `streamkit check` tells it.
        """
        return 0, "unknown"

    def advice(self, d: int) -> tuple[str, ...]:
        """Return a sentence for every setting that is allowed for d parameters, and bad. `streamkit check` warns."""
        return ()

    def cites(self) -> dict[str, str]:
        """Return keys of streamkit's own bibliography to cite for these settings, and what for."""
        return {}
