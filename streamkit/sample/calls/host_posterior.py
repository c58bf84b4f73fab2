"""The posterior of the data of the host alone, without any stream: a factor of a posterior of several streams."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from streamkit.errors import OutOfDomain
from streamkit.model import Model, Observation
from streamkit.observe import join_data
from streamkit.runfile import Spec
from streamkit.sample.calls.comparison import Comparison
from streamkit.sample.calls.posterior import OUTSIDE
from streamkit.sample.evaluation import Evaluation
from streamkit.stream import Array


class HostPosterior:
    """What `Posterior` is for streams, for the data of the host alone. A pickle of it holds the spec alone.

    ``spec`` is that of `Spec.only_data`.
    """

    def __init__(self, spec: Spec) -> None:
        self.spec, self.model = spec, Model(spec)
        self.data = join_data([one.data for one in self.model.measured(spec.bind_all())])

    @cached_property
    def comparison(self) -> Comparison:
        """The comparison of given predictions with the data."""
        return Comparison(self.model)

    def __reduce__(self) -> tuple[Any, ...]:
        return HostPosterior, (self.spec,)

    def evaluate(self, theta: Array) -> Evaluation:
        """Evaluate at theta (d,), with the details that the likelihoods read; raises as `Posterior.evaluate`."""
        theta = np.asarray(theta, dtype=float)
        ln_prior = float(sum(p.lnpdf(float(x)) for p, x in zip(self.spec.priors, theta, strict=True)))
        if not np.isfinite(ln_prior):
            return self.rejected(OUTSIDE)
        try:
            bound = self.spec.bind_all(theta)
            predictions = {f"data.{name}": one for name, one in self.model.observe_host(bound).items()}
        except OutOfDomain as error:
            return self.rejected(error.reason)
        observation = Observation({}, predictions)
        prediction = observation.prediction
        if prediction.why_not:
            return self.rejected(prediction.why_not)
        lnl = self.model.ln_likelihood(bound, observation)
        details = self.comparison.details(observation)
        return Evaluation(ln_prior + lnl, lnl, prediction.mean, prediction.variance, details=details)

    def rejected(self, reason: str) -> Evaluation:
        """Return the evaluation of parameters without a host that can be measured, and the reason."""
        nothing = np.full(len(self.data.values), np.nan)
        return Evaluation(-np.inf, -np.inf, nothing, nothing, reason)
