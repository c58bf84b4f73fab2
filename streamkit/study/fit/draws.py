"""The samples of a run: the base of chains and of weighted samples, with their descriptions and verdicts."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from streamkit.components import Verdict
from streamkit.errors import ChainError
from streamkit.sample import Weighted
from streamkit.stream import Array, IntArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Row = tuple[str, str, str]  # of a terminal's table: name, value, remark
# How the sampling ended, by the status of a run that has ended.
ENDED = {
    "converged": "by the rule of convergence",
    "few": "by the rule of the sampler, with few effective samples",
    "steps": "at the given number of steps",
    "time": "at its time limit",
}


class Draws(ABC):
    """The samples of a run: a chain, or weighted samples in the form of one.

    Parameters
    ----------
    chain, log_prob, blobs
        (steps, walkers, d) samples, (steps, walkers) ln posterior, and records of `streamkit.sample.blob_dtype`.
    attributes
        The run's notes: status, counts.
    quick
        Whether the run is a coarse look.

    Attributes
    ----------
    calls, search_calls
        Evaluations of the posterior while sampling, and in the search for a start.
    reasons
        Rejected proposals by reason.
    facts
        The sampler's own short texts by name.
    status
        Why the sampling ended: "converged", "steps", "time", "few" (effective samples), or "unfinished".
    discard
        Steps of learning and of burn-in.
    tau, r_hat, ess
        (d,) Autocorrelation times in steps and R-hat, NaN where there is none, and effective numbers of samples.
    acceptance
        Fraction of the proposals that were accepted, or of the calls that became an effective sample.
    weighted
        The weighted samples; None for a chain.
    """

    weighted: Weighted | None = None
    discard: int
    acceptance: float

    def __init__(self, chain: Array, log_prob: Array, blobs: Any, attributes: Mapping[str, Any], quick: bool) -> None:
        if not len(chain):
            raise ChainError("the run ended before its first step: there are no samples")
        self.chain, self.log_prob, self.blobs, self.quick = chain, log_prob, blobs, quick
        counts = attributes.get("counts", {})
        self.calls, self.search_calls = int(counts.get("calls", 0)), int(counts.get("search_calls", 0))
        self.reasons: dict[str, int] = counts.get("reasons", {})
        self.facts: dict[str, str] = counts.get("facts", {})
        self.status = str(attributes.get("status", "unfinished"))

    @property
    def kept(self) -> Array:
        """(steps, walkers, d) The samples after burn-in."""
        return self.chain[self.discard :]

    @property
    @abstractmethod
    def tau(self) -> Array:
        """(d,) Autocorrelation times in steps; NaN where there is no estimate."""

    @property
    @abstractmethod
    def r_hat(self) -> Array:
        """(d,) Rank-normalised split R-hat after burn-in; NaN where there is none."""

    @property
    @abstractmethod
    def ess(self) -> Array:
        """(d,) Effective number of independent samples after burn-in."""

    @property
    def stuck(self) -> IntArray:
        """(n,) Numbers of the walkers that are stuck far below the others."""
        return np.empty(0, dtype=np.int64)

    @property
    def best(self) -> Array:
        """(d,) The sample of the highest ln posterior."""
        step, walker = np.unravel_index(np.argmax(self.log_prob), self.log_prob.shape)
        return np.asarray(self.chain[step, walker])

    @abstractmethod
    def lacks(self, names: Sequence[str]) -> str:
        """Return what is missing for samples that can be trusted, as the end of a sentence; empty if nothing is."""

    @abstractmethod
    def length(self) -> str:
        """Return the length of the sampling: "1000 steps"."""

    @abstractmethod
    def praise(self) -> str:
        """Return why the samples can be trusted, once nothing is missing, as a sentence."""

    def note(self, names: Sequence[str]) -> str:
        """Return in one sentence how far the percentiles can be trusted, and what is missing."""
        if self.quick:
            return f"QUICK LOOK, {self.length()}: few particles, not converged, not for science."
        missing = self.lacks(names)
        return f"Not converged: {missing}." if missing else self.praise()

    @abstractmethod
    def __repr__(self) -> str:
        """Return the kind and number of the samples."""

    @abstractmethod
    def verdicts(self, names: Sequence[str]) -> list[Verdict]:
        """Return the outcome of every check of the samples of parameters of these names."""

    @abstractmethod
    def headline(self) -> str:
        """Return the number of the samples, as the first line of a report in a terminal."""

    @abstractmethod
    def rows(self) -> list[Row]:
        """Return the rows of a terminal's table about the sampler."""

    @abstractmethod
    def record(self) -> dict[str, Any]:
        """Return the numbers of the samples, for JSON."""

    def provenance(self) -> dict[str, Any]:
        """Return the notes that a table about the samples carries."""
        steps, walkers, _ = self.chain.shape
        return {
            "status": self.status,
            "steps": steps,
            "walkers": walkers,
            "burn-in": self.discard,
            "acceptance": round(self.acceptance, 4),
            "calls": self.calls,
            "calls of the search": self.search_calls,
        }

    @abstractmethod
    def description(self) -> str:
        """Return a description of the samples for the page."""

    @property
    @abstractmethod
    def trace(self) -> tuple[str, str]:
        """Label of the horizontal axis of the traces, and their legend."""

    @abstractmethod
    def draw_trace(self, axes: Axes, parameter: int | None, scale: float) -> None:
        """Draw the trace of a parameter in units of ``scale``, or of ln posterior for None."""

    def pictures(self, labels: Sequence[str]) -> dict[str, Callable[[], Figure]]:
        """Return pictures for the page that only samples of this kind have, by name."""
        return {}

    @property
    def trusted_ess(self) -> Array:
        """(d,) Effective number of samples; NaN where the chains disagree so much that the number has no meaning."""
        return self.ess
