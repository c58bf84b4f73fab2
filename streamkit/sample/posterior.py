"""The posterior: ln prior, then the stream, then the comparison of its observables with the data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from streamkit.errors import OutOfDomain, SpecError
from streamkit.model import Model
from streamkit.observe import compare_with_data
from streamkit.spec import Setup, Source, as_spec
from streamkit.stream import Array, Prediction, Stream

OUTSIDE = "outside the prior"


@dataclass(frozen=True)
class Evaluation:
    """What one call of the posterior found.

    Attributes
    ----------
    lnp
        ln prior + ln likelihood; -inf where there is no stream or no observable.
    ln_likelihood
        The second term alone; -inf likewise.
    mean, variance
        (m,) what the observable predicts, and the variance of that estimate; NaN if none.
    reason
        Why lnp is -inf, else empty.
    """

    lnp: float
    ln_likelihood: float
    mean: Array
    variance: Array
    reason: str = ""

    def row(self) -> tuple[float, float, Array, Array]:
        """Return what emcee wants: lnp, then the blobs of `blob_dtype`."""
        return self.lnp, self.ln_likelihood, self.mean, self.variance


def blob_dtype(m: int) -> np.dtype[Any]:
    """Return the record stored with each sample for m data: ln likelihood, predicted mean and variance."""
    return np.dtype([("ln_likelihood", float), ("mean", float, (m,)), ("variance", float, (m,))])


class Posterior:
    """The log-probability of the free parameters of a run file. It pickles as its spec.

    Raises SpecError if the spec has no free parameter, no observable or no datum: nothing can be fitted.
    """

    def __init__(self, spec: Source) -> None:
        self.spec = spec = as_spec(spec)
        self.model = Model(spec)
        if not spec.names:
            raise SpecError("no field has a prior: a fit needs at least one free parameter")
        observable = spec.bind().observable
        if observable is None:
            raise SpecError("observable: there is none, and a fit needs one with data")
        self.data = self.model.data(observable)
        if not np.isfinite(self.data.values).any():
            raise SpecError("observable: there is no datum to compare with")
        self.size = len(self.data.values)

    def __repr__(self) -> str:
        return f"<Posterior of {self.spec.source}: {len(self.spec.names)} parameters, {self.size} data>"

    def __reduce__(self) -> tuple[Any, ...]:
        return Posterior, (self.spec,)

    def __call__(self, theta: Array) -> tuple[float, float, Array, Array]:
        """Return ``(lnp, ln_likelihood, mean, variance)`` at parameters theta (d,): what emcee wants."""
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
            setup = self.spec.bind(theta)
            prediction = self._observed(setup)[1]
        except OutOfDomain as error:
            return self.rejected(error.reason)
        if prediction.why_not:
            return self.rejected(prediction.why_not)
        with self.model.naming_parameters(setup):
            ln_likelihood = self._compare(setup, prediction)
        return Evaluation(ln_prior + ln_likelihood, ln_likelihood, prediction.mean, prediction.variance)

    def predict(self, theta: Array) -> tuple[Stream, Prediction]:
        """Return the stream at theta (d,) and what the observable says of it; OutOfDomain if there is none."""
        return self._observed(self.spec.bind(theta))

    def _observed(self, setup: Setup) -> tuple[Stream, Prediction]:
        stream, prediction = self.model.observe(setup)
        assert prediction is not None  # noqa: S101  __init__ has made sure of an observable
        return stream, prediction

    def _compare(self, setup: Setup, prediction: Prediction) -> float:
        assert setup.observable is not None  # noqa: S101  checked in __init__
        return compare_with_data(setup.observable, prediction, self.model.data(setup.observable))

    def rejected(self, reason: str) -> Evaluation:
        """Return what stands for parameters without a stream, or an observable: no numbers, and the reason."""
        nothing = np.full(self.size, np.nan)
        return Evaluation(-np.inf, -np.inf, nothing, nothing, reason)
