"""Goodness of fit: chi^2 of every measured quantity at the best sample, its predictive p-value, and the worst datum."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.special import ndtr
from scipy.stats import chi2

from streamkit.components import HostData, Measurement
from streamkit.errors import OutOfDomain
from streamkit.fit.judge.chain import at_least_one
from streamkit.observe import UNNAMED, parts_of, read_data, residuals_of
from streamkit.runfile import DATA, ONLY, Spec
from streamkit.stream import Array, Data, IntArray, Prediction

SAMPLES = 200  # samples that p-values are averaged over
ALL = "all data"


@dataclass(frozen=True)
class Fitted:
    """The fit to the data of one quantity, or to all data."""

    name: str  # the quantity with its measurement
    data: tuple[str, ...]  # the names of its n data
    residuals: Array  # (n,) data minus the best sample's predictions, in standard deviations of the likelihood
    best: float  # chi^2 at the best sample, correlations included
    samples: Array  # (k,) chi^2 at samples of the posterior; empty where predictions were not stored

    @property
    def p_value(self) -> float:
        """Posterior predictive p-value of chi^2 (Gelman, Meng & Stern 1996, eq. 8); without samples at the best one.

        The distribution of chi^2 of new data is known at each sample: chi^2 with n degrees of freedom.
        """
        values = self.samples if len(self.samples) else np.array([self.best])
        return float(chi2.sf(values, len(self.data)).mean())

    @property
    def p_of_best(self) -> float:
        """The probability of a chi^2 at least as large as the best sample's."""
        return float(chi2.sf(self.best, len(self.data)))

    @property
    def worst(self) -> int:
        """The datum that is farthest from its prediction."""
        return int(np.argmax(np.abs(self.residuals)))

    @property
    def worst_chance(self) -> float:
        """The probability that the farthest of n independent data is at least so far from its prediction."""
        return at_least_one(2 * float(ndtr(-abs(self.residuals[self.worst]))), len(self.data))


@dataclass(frozen=True)
class Goodness:
    """The fit to each quantity, and to all data together."""

    quantities: tuple[Fitted, ...]  # one for each quantity that has data and residuals
    whole: Fitted  # all of their data
    unjudged: tuple[str, ...] = ()  # measurements that define a likelihood and no residuals
    # one for each of several streams, by its name, and one for all data of the host; none where there is one stream
    streams: tuple[Fitted, ...] = ()
    # the share of the samples that are at the edge of what data of the host know of, by the name of the data
    at_edge: Mapping[str, float] = field(default_factory=dict)

    @property
    def least(self) -> tuple[Fitted, float]:
        """The least likely fit, and its p-value; for a quantity the p-value allows for the number of quantities."""
        chances = [at_least_one(each.p_value, len(self.quantities)) for each in self.quantities]
        fits = [(self.whole, self.whole.p_value), *zip(self.quantities, chances, strict=True)]
        return min(fits, key=lambda fit: fit[1])

    @property
    def poorest(self) -> Fitted:
        """The quantity that is least likely by itself."""
        return min(self.quantities, key=lambda fit: fit.p_value)


@dataclass(frozen=True, eq=False)
class Sampled:
    """The samples of a run with their predictions."""

    spec: Spec  # the run
    # the best sample by name, and its predictions. Their details are used for all samples, as runs store only means and
    # variances.
    best: Mapping[str, float]
    predictions: Mapping[str, Prediction]
    # (n, d) samples, and (n,) records of `streamkit.sample.blob_dtype`; None if predictions were not stored.
    samples: Array
    blobs: Any

    @property
    def add_noise(self) -> bool:
        """Whether the likelihood adds the noise of the model."""
        return self.spec.likelihood.noise == "add"

    def measured(self) -> list[Measured]:
        """Return every measurement at the best sample."""
        return [*self._measured(self.best, self.predictions)]

    def at_samples(self, most: int) -> Iterator[list[Measured]]:
        """Return every measurement at samples, as `each`."""
        for _, measured in self.each(most):
            yield measured

    def each(self, most: int) -> Iterator[tuple[int, list[Measured]]]:
        """Return numbers of samples, evenly spaced, with every measurement there; without samples that lack a value.

        Extra dispersions are those of each sample.
        """
        if self.blobs is None:
            return
        for i in np.unique(np.linspace(0, len(self.blobs) - 1, most).astype(int)):
            try:
                one = [*self._measured(self.samples[i], self._predicted(i))]
            except OutOfDomain:
                continue
            if all(np.isfinite(each.prediction.mean[each.rows]).all() for each in one):
                yield int(i), one

    def _predicted(self, i: int) -> dict[str, Prediction]:
        """Return the predictions of a sample."""
        made, first = {}, 0
        for name, prediction in self.predictions.items():
            mean, variance = (self.blobs[i][each][first:] for each in ("mean", "variance"))
            made[name] = _replaced(prediction, mean, variance)
            first += len(prediction.names)
        return made

    def _measured(self, at: Any, predictions: Mapping[str, Prediction]) -> Iterator[Measured]:
        """Return every measurement of the streams and of the host at parameters, in the order of the data."""
        streams, of_host = self.spec.measurements(at)
        for stream, observables in streams.items():
            if stream in predictions:
                parts = parts_of(predictions[stream])
                for name, observable in observables.items():
                    path = ".".join([stream] * (stream != ONLY) + [name] * (name != UNNAMED))
                    yield Measured(path, observable, read_data(observable, self.add_noise), parts[name], stream)
        for name, datum in of_host.items():
            yield Measured(f"data.{name}", datum, read_data(datum, self.add_noise), predictions[f"data.{name}"])


def goodness(sampled: Sampled) -> Goodness | None:
    """Return the goodness of fit of a run; None if no measurement can be judged."""
    here, stored = sampled.measured(), [*sampled.at_samples(SAMPLES)]
    judged = [k for k, one in enumerate(here) if one.is_judged]
    unjudged = tuple(one.name or one.measurement.kind for one in here if not one.is_judged)
    if not any(len(here[k].rows) for k in judged):
        return None

    def fitted(name: str, parts: Mapping[int, IntArray]) -> Fitted:
        """Return the fit to some rows of some measurements."""
        return Fitted(
            name,
            tuple(label for k, rows in parts.items() for label in here[k].labels(rows)),
            np.concatenate([here[k].of(rows) for k, rows in parts.items()]),
            sum(here[k].square(rows) for k, rows in parts.items()),
            np.array([sum(each[k].square(rows) for k, rows in parts.items()) for each in stored]),
        )

    quantities = tuple(fitted(name, {k: rows}) for k in judged for name, rows in here[k].quantities())
    owners = {k: here[k].stream for k in judged if len(here[k].rows)}
    streams = tuple(
        fitted(owner, {k: here[k].rows for k, other in owners.items() if other == owner})
        for owner in (dict.fromkeys(owners.values()) if len(sampled.spec.streams) > 1 else ())
    )
    at_edge = {
        one.name: float(np.mean([one.measurement.at_edge(each[k].prediction) for each in stored or [here]]))
        for k, one in enumerate(here)
        if isinstance(one.measurement, HostData)
    }
    return Goodness(quantities, fitted(ALL, {k: here[k].rows for k in judged}), unjudged, streams, at_edge)


@dataclass(frozen=True)
class Measured:
    """One measurement with a prediction: its name, its data and its residuals."""

    name: str
    measurement: Measurement
    data: Data
    prediction: Prediction
    stream: str = DATA  # the name of its stream; `DATA` for data of the host

    @cached_property
    def residuals(self) -> Array | None:
        """(m,) The residuals; None for a measurement without any."""
        return residuals_of(self.measurement, self.prediction, self.data)

    @property
    def is_judged(self) -> bool:
        """Whether there are residuals."""
        return self.residuals is not None

    @property
    def rows(self) -> IntArray:
        """The rows that have data."""
        return np.flatnonzero(np.isfinite(self.data.values))

    def quantities(self) -> Iterator[tuple[str, IntArray]]:
        """Return the name and the rows with data of each quantity that has some."""
        parts = self.measurement.quantities()
        for name, rows in parts.items():
            used = np.intersect1d(rows, self.rows)
            if len(used):
                path = f"{self.name}.{name}".removeprefix(".")
                yield (self.name or name) if len(parts) == 1 else path, used

    def labels(self, rows: IntArray) -> tuple[str, ...]:
        """Return the names of some data."""
        return tuple(f"{self.name}.{self.prediction.names[row]}".removeprefix(".") for row in rows)

    def of(self, rows: IntArray) -> Array:
        """Return the residuals of some rows; NaN for a measurement without any."""
        return np.full(len(rows), np.nan) if self.residuals is None else self.residuals[rows]

    def square(self, rows: IntArray) -> float:
        """Return chi^2 of some rows."""
        if self.data.covariance is None or not len(rows):
            return float((self.of(rows) ** 2).sum())
        away = (self.data.values - self.prediction.mean)[rows]
        noise = self.prediction.variance[rows] if self.data.add_noise else np.zeros(len(rows))
        whole = self.data.covariance[np.ix_(rows, rows)] + np.diag(noise)
        return float(away @ np.linalg.solve(whole, away))


def _replaced(prediction: Prediction, mean: Array, variance: Array) -> Prediction:
    """Return a prediction with the first of other means and variances, in its parts too."""
    m, first, parts = len(prediction.names), 0, {}
    for name, part in prediction.parts.items():
        parts[name] = _replaced(part, mean[first:], variance[first:])
        first += len(part.names)
    return replace(prediction, mean=mean[:m], variance=variance[:m], parts=parts)
