"""The result of one call of the posterior, which `calls` make, `store` keeps and the sampler's target hands on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from streamkit.stream import Array


@dataclass(frozen=True)
class Evaluation:
    """The result of one call of the posterior."""

    lnp: float  # ln prior + ln likelihood; -inf where there is no stream or no observable
    ln_likelihood: float  # the second term alone; -inf likewise
    # (m,) the prediction of the observable, and the variance of the prediction; NaN if there is none.
    mean: Array
    variance: Array
    reason: str = ""  # the reason why lnp is -inf, else empty
    # (k,) the details of the prediction that the likelihoods read, for a sampler that emulates predictions; else empty.
    details: Array = field(default_factory=lambda: np.empty(0))

    def row(self) -> tuple[float, float, Array, Array]:
        """Return lnp and the fields of `blob_dtype`: the form of a log-probability function of emcee with blobs."""
        return self.lnp, self.ln_likelihood, self.mean, self.variance


def blob_dtype(m: int) -> np.dtype[Any]:
    """Return the record stored with each sample for m data: ln likelihood, predicted mean and variance."""
    return np.dtype([("ln_likelihood", float), ("mean", float, (m,)), ("variance", float, (m,))])


def details_of(evaluations: Sequence[Evaluation]) -> Array:
    """(n, k) Return the details of evaluations; NaN where there is no prediction."""
    k = max((len(each.details) for each in evaluations), default=0)
    nothing = np.full(k, np.nan)
    rows = [each.details if len(each.details) else nothing for each in evaluations]
    return np.array(rows, dtype=float).reshape(len(rows), k)
