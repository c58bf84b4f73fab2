"""The samples of a run: the base of chains and of weighted samples, with their descriptions and verdicts."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from streamkit.components import Verdict
from streamkit.errors import ChainError
from streamkit.sample import Weighted
from streamkit.stream import Array, IntArray

Row = tuple[str, str, str]  # a row of a terminal's table: name, value, remark
# The way in which the sampling ended, by the status of the run.
ENDED = {
    "converged": "by the rule of convergence",
    "few": "by the rule of the sampler, with few effective samples",
    "steps": "at the given number of steps",
    "time": "at its time limit",
}


class Draws(ABC):
    """The samples of a run: a chain, or weighted samples in the form of one.

    ``chain`` (steps, walkers, d), ``log_prob`` (steps, walkers) and ``blobs``, records of
    `streamkit.sample.blob_dtype`, are all samples; ``attributes`` the run's notes: status, counts. A subclass sets the
    attributes below.
    """

    acceptance: float  # fraction of accepted proposals, or effective samples per call
    tau: Array  # (d,) autocorrelation times in steps; NaN where there is no estimate
    r_hat: Array  # (d,) rank-normalised split R-hat after burn-in; NaN where there is none
    ess: Array  # (d,) effective numbers of independent samples after burn-in
    trusted_ess: Array  # (d,) the same; NaN where the chains disagree too much for a meaningful number
    best: Array  # (d,) the sample with the highest ln posterior
    length: str  # the length of the sampling: "1000 steps"
    headline: str  # kind and number of the samples, on the first line of a report
    lacks: str  # what is missing for reliable samples, as the end of a sentence; empty if nothing is missing
    praise: str  # the reason why the samples are reliable, as a sentence, for samples that lack nothing
    trace: tuple[str, str]  # label of the horizontal axis of the traces, and their legend
    trace_caption: str  # what the page says below them
    last_trace = r"$\ln p$"  # label of their last panel, after the parameters
    discard = 0  # steps of learning and of burn-in
    stuck: IntArray = np.empty(0, dtype=np.int64)  # (n,) numbers of the walkers that are stuck far below the others
    weighted: Weighted | None = None  # the weighted samples; None for a chain

    def __init__(self, chain: Array, log_prob: Array, blobs: Any, attributes: Mapping[str, Any], quick: bool) -> None:
        if not len(chain):
            raise ChainError("the run ended before its first step: there are no samples")
        self.chain, self.log_prob, self.blobs, self.quick = chain, log_prob, blobs, quick
        counts = attributes.get("counts", {})
        self.calls, self.search_calls = int(counts.get("calls", 0)), int(counts.get("search_calls", 0))
        self.reasons: dict[str, int] = counts.get("reasons", {})  # rejected proposals by reason
        self.facts: dict[str, str] = counts.get("facts", {})  # short texts of the sampler by name
        self.status = str(attributes.get("status", "unfinished"))  # a key of `ENDED`, or "unfinished"

    @property
    def kept(self) -> Array:
        """(steps, walkers, d) The samples after burn-in."""
        return self.chain[self.discard :]

    @property
    def predictions(self) -> Any:
        """(steps, walkers) The records of `blobs` after burn-in; None if the run stored no predictions."""
        names = None if self.blobs is None else self.blobs.dtype.names
        return self.blobs[self.discard :] if names and "mean" in names else None

    def note(self) -> str:
        """Return one sentence: whether the percentiles are reliable, and what is missing."""
        if self.quick:
            return f"QUICK LOOK, {self.length}: few particles, not converged, not for science."
        return f"Not converged: {self.lacks}." if self.lacks else self.praise

    @abstractmethod
    def verdicts(self) -> list[Verdict]:
        """Return the outcome of every check of the samples."""

    @abstractmethod
    def rows(self) -> list[Row]:
        """Return the rows of a terminal's table about the sampler."""

    @abstractmethod
    def record(self) -> dict[str, Any]:
        """Return the numbers of the samples, for JSON."""

    def provenance(self) -> dict[str, Any]:
        """Return the notes of a table about the samples."""
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
    def draw_trace(self, axes: Axes, parameter: int | None, scale: float) -> None:
        """Draw the trace of a parameter in units of ``scale``, or the last panel for None."""

    def pictures(self, labels: Sequence[str], shown: IntArray) -> dict[str, Callable[[], Figure]]:
        """Return the additional pictures of samples of this kind for the page, by name, of the parameters ``shown``."""
        return {}
