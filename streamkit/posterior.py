"""The posterior: ln prior, then the stream, then a Gaussian comparison of its observables with the data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from streamkit.errors import ComponentError, OutOfDomain, SpecError
from streamkit.model import Model, simulate
from streamkit.phase import Array, Prediction, Stream
from streamkit.spec import Setup, Spec

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


def gaussian(mean: Array, variance: Array, data: Array, sigma: Array, add_noise: bool) -> float:
    """Return the ln likelihood of independent Gaussians; a NaN datum is not used.

    Parameters
    ----------
    mean, variance
        (m,) prediction, and the variance of that estimate.
    data, sigma
        (m,) data and their standard errors.
    add_noise
        Whether to add ``variance`` to ``sigma**2``.
    """
    used = np.isfinite(data)
    total = sigma[used] ** 2 + (variance[used] if add_noise else 0.0)
    chi2 = (data[used] - mean[used]) ** 2 / total
    return float(-0.5 * np.sum(chi2 + np.log(2 * np.pi * total)))


class Posterior:
    """The log-probability of the free parameters of a run file. It pickles as its spec.

    Raises
    ------
    SpecError
        If the spec has no free parameter, no observable or no datum: nothing can be fitted.
    """

    def __init__(self, spec: Spec) -> None:
        self.spec = spec
        self.model = Model(spec)
        self.add_noise = spec.document["likelihood"]["noise"] == "add"
        if not spec.names:
            raise SpecError("no field has a prior: a fit needs at least one free parameter")
        observable = spec.bind(spec.centre()).observable
        if observable is None:
            raise SpecError("observable: there is none, and a fit needs one with data")
        data, _ = observable.data()
        if not np.isfinite(data).any():
            raise SpecError("observable: there is no datum to compare with")
        self.size = len(data)

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

        Raises
        ------
        ComponentError
            If a component fails, or predicts no number without a reason. Names it and the parameters.
        """
        theta = np.asarray(theta, dtype=float)
        ln_prior = self.ln_prior(theta)
        if ln_prior == -np.inf:
            return self._rejected(OUTSIDE)
        try:
            setup = self.spec.bind(theta)
            prediction = self._predict(setup)
            if prediction.why_not:
                return self._rejected(prediction.why_not)
            ln_likelihood = self._compare(setup, prediction)
        except OutOfDomain as error:
            return self._rejected(error.reason)
        except ComponentError as error:
            raise ComponentError(f"{error}. {self._at(theta)}") from error
        except Exception as error:  # any failure stops the run, with name and parameters
            what = f"{type(error).__name__} in {_culprit(error)}: {error}"
            raise ComponentError(f"{what}. {self._at(theta)}") from error
        return Evaluation(ln_prior + ln_likelihood, ln_likelihood, prediction.mean, prediction.variance)

    def predict(self, theta: Array) -> tuple[Stream, Prediction]:
        """Return the stream at theta and what the observable says of it.

        Raises
        ------
        OutOfDomain
            If there is no stream there.
        """
        setup = self.spec.bind(theta)
        assert setup.observable is not None  # noqa: S101  checked in __init__
        stream = simulate(setup, self.model.normals)
        return stream, setup.observable.predict(stream)

    def _predict(self, setup: Setup) -> Prediction:
        assert setup.observable is not None  # noqa: S101  checked in __init__
        return setup.observable.predict(simulate(setup, self.model.normals))

    def _compare(self, setup: Setup, prediction: Prediction) -> float:
        assert setup.observable is not None  # noqa: S101  checked in __init__
        data, sigma = setup.observable.data()
        kind = setup.observable.kind
        if prediction.mean.shape != data.shape or prediction.variance.shape != data.shape:
            raise ComponentError(
                f"observable {kind}: predicted {prediction.mean.shape} values with "
                f"{prediction.variance.shape} variances for {data.shape} data"
            )
        value = gaussian(prediction.mean, prediction.variance, data, sigma, self.add_noise)
        if not np.isfinite(value):
            raise ComponentError(
                f"observable {kind}: predicted {prediction.mean.tolist()} with variances "
                f"{prediction.variance.tolist()}, not all of them usable numbers, and gave no reason"
            )
        return value

    def _rejected(self, reason: str) -> Evaluation:
        nothing = np.full(self.size, np.nan)
        return Evaluation(-np.inf, -np.inf, nothing, nothing, reason)

    def _at(self, theta: Array) -> str:
        values = zip(self.spec.names, theta, self.spec.units, strict=True)
        return "Parameters: " + ", ".join(f"{n} = {float(x)!r} {u}".strip() for n, x, u in values)


def _culprit(error: BaseException) -> str:
    """Name the function in which an exception was raised: the innermost one outside installed libraries."""
    place = "a component"
    trace = error.__traceback__
    while trace is not None:
        code, module = trace.tb_frame.f_code, trace.tb_frame.f_globals.get("__name__", "")
        if module.split(".")[0] not in ("numpy", "scipy", "numba", "astropy", "pydantic"):
            place = f"{module}.{code.co_qualname}"
        trace = trace.tb_next
    return place
