"""The posterior: ln prior, then the stream, then the comparison of its observables with the data."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from streamkit.errors import OutOfDomain, SpecError
from streamkit.model import Model, Observation
from streamkit.observe import join_data
from streamkit.runfile import ModelInputs, Source, as_spec
from streamkit.sample.calls.comparison import Comparison
from streamkit.sample.evaluation import Evaluation
from streamkit.stream import Array, Prediction, Stream

OUTSIDE = "outside the prior"


class Posterior:
    """The log-probability of the free parameters of a run file. Its pickle only contains the spec.

    Parameters
    ----------
    spec
        The run file.
    emulated
        Whether a sampler emulates the predictions: random numbers then differ between calls, and an evaluation has the
        details that the likelihoods read.
    streams
        Whether streams are made: without them, it is the posterior of the data of the host, a factor of several.

    Raises SpecError if the spec has no free parameter, no observable or no datum: nothing can be fitted.
    """

    def __init__(self, spec: Source, emulated: bool = False, streams: bool = True) -> None:
        self.spec = spec = as_spec(spec)
        self.model = Model(spec, fresh=emulated)
        self._emulated, self._streams = emulated, streams
        if streams and not spec.names:
            raise SpecError(f"{spec.source}: no field has a prior: a fit needs at least one free parameter")
        bound = self._bind()
        measured = self.model.measured(bound)
        for name, inputs in bound.streams.items():
            where = f"{spec.source}: {spec.prefix(name)}observable"
            if not inputs.observables:
                each = " for every stream" if len(bound.streams) > 1 else ""
                raise SpecError(f"{where}: there is none, and a fit needs one with data{each}")
            if not any(np.isfinite(one.data.values).any() for one in measured if one.stream == name):
                raise SpecError(f"{where}: there is no datum to compare with")
        self.data = join_data([one.data for one in measured])
        self.size = len(self.data.values)

    @cached_property
    def comparison(self) -> Comparison:
        """The comparison of given predictions with the data."""
        return Comparison(self.model)

    def __repr__(self) -> str:
        return f"<Posterior of {self.spec.source}: {len(self.spec.names)} parameters, {self.size} data>"

    def __reduce__(self) -> tuple[Any, ...]:
        return Posterior, (self.spec, self._emulated, self._streams)

    def __call__(self, theta: Array) -> tuple[float, float, Array, Array]:
        """Return ``(lnp, ln_likelihood, mean, variance)`` at parameters theta (d,), for emcee and other samplers."""
        return self.evaluate(theta).row()

    def ln_prior(self, theta: Array) -> float:
        """Return the ln prior density; -inf outside its support."""
        total = 0.0
        for prior, value in zip(self.spec.priors, theta, strict=True):
            total += float(prior.lnpdf(float(value)))
        return total if np.isfinite(total) else -np.inf

    def evaluate(self, theta: Array) -> Evaluation:
        """Evaluate at theta (d,).

        A component that fails, or predicts no number without a reason, is a ComponentError that names it and theta.
        """
        theta = np.asarray(theta, dtype=float)
        ln_prior = self.ln_prior(theta)
        if ln_prior == -np.inf:
            return self.rejected(OUTSIDE)
        try:
            bound = self._bind(theta)
            observation = self.model.observe_all(bound)
        except OutOfDomain as error:
            return self.rejected(error.reason)
        prediction = observation.prediction
        if prediction.why_not:
            return self.rejected(prediction.why_not)
        ln_likelihood = self.model.ln_likelihood(bound, observation)
        details = self.comparison.details(observation) if self._emulated else np.empty(0)
        lnp, mean, variance = ln_prior + ln_likelihood, prediction.mean, prediction.variance
        return Evaluation(lnp, ln_likelihood, mean, variance, details=details)

    def observe(self, theta: Array) -> Observation:
        """Return the streams at theta (d,) and the predictions of their observables; OutOfDomain if there are none."""
        return self.model.observe_all(self._bind(theta))

    def _bind(self, theta: Array | None = None) -> ModelInputs:
        bound = self.spec.bind_all(theta)
        return bound if self._streams else replace(bound, streams={})

    def predict(self, theta: Array) -> tuple[Stream, Prediction]:
        """Return the only stream at theta (d,) and its prediction; OutOfDomain if there is none."""
        name, observation = self.spec.stream_name(), self.observe(theta)
        return observation.streams[name], observation.predictions[name]

    def rejected(self, reason: str) -> Evaluation:
        """Return the evaluation of parameters without a stream or an observable: ln p = -inf, NaN, and the reason."""
        nothing = np.full(self.size, np.nan)
        return Evaluation(-np.inf, -np.inf, nothing, nothing, reason)
