"""One call of the model: what is predicted of one stream, or of the host, with the variance of each datum."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from streamkit import Array, Model, Observable, OutOfDomain, Prediction, Spec, StreamkitError
from streamkit.components import Measurement
from streamkit.model import Measured, Observation
from streamkit.observe import measure_stream, parts_of, read_data
from streamkit.runfile import DATA, ModelInputs

# The name of single data of which each is one more; a TOML key of a survey has no blank unless it is quoted.
ONE_MORE = "one more"
# Observables that the run file does not have, by the name of their stream and their own name.
Added = dict[str, dict[str, Observable]]
# A pickled run file with what is added to it, the number of its seed, a stream or `DATA`, and the parameters.
Job = tuple[bytes, int, str, tuple[float, ...]]


@dataclass(frozen=True)
class Predicted:
    """The data of one stream, or of the host, at one point: (m,) means and variances; a reason where there are none."""

    mean: Array
    variance: Array
    reason: str = ""


@dataclass(frozen=True)
class Part:
    """The data of one measurement: its name, whether it is added to the run file, the names and errors of its data."""

    name: str
    added: bool
    names: tuple[str, ...]
    measurement: Measurement
    used: Array  # (m,) whether there is a datum
    covariance: Array | None  # (m, m) of the errors, where they correlate
    prediction: Prediction | None = None  # at the place of the forecast; None where there is none

    @property
    def one_more(self) -> bool:
        """Whether these are single data of which each is one more."""
        return self.added and self.name == ONE_MORE


def packed(spec: Spec, added: Added) -> bytes:
    """Return a run file and what is added to it, for the jobs of other processes."""
    return pickle.dumps((spec, added))


@cache
def _unpacked(content: bytes, seed: int) -> tuple[Model, Added]:
    spec, added = pickle.loads(content)  # noqa: S301  our own, from the process that started this one
    return Model(spec.with_values({"seed": spec.seed + seed})), added


def evaluate(job: Job) -> Predicted:
    """Make one stream with the n-th of its seeds, or the host, and measure it; no stream is a reason."""
    content, seed, source, theta = job
    model, added = _unpacked(content, seed)
    try:
        bound = model.spec.bind_all(np.array(theta))
        found = list(_measured(model, bound, source, added))
    except OutOfDomain as error:
        return Predicted(np.empty(0), np.empty(0), error.reason)
    reason = next((prediction.why_not for _, prediction in found if prediction.why_not), "")
    if reason or not found:
        return Predicted(np.empty(0), np.empty(0), reason or "there is nothing to measure")
    noisy = model.spec.likelihood.noise == "add"
    mean = np.concatenate([prediction.mean for _, prediction in found])
    variance = [
        np.asarray(one.scatter(prediction)) ** 2 + (prediction.variance if noisy else 0.0) for one, prediction in found
    ]
    return Predicted(mean, np.concatenate(variance))


def parts(spec: Spec, source: str, added: Added, theta: Array) -> list[Part]:
    """Return the measurements of a stream, or of the host, in the order of the numbers of `evaluate`."""
    model = Model(spec)
    bound = spec.bind_all(theta)
    found = []
    for one in _of(model, bound, source):
        _check(spec, one)
        names = _names(one.measurement, len(one.data.values))
        used = np.isfinite(one.data.values)
        found.append(Part(one.name, False, names, one.measurement, used, one.data.covariance))
    for name, extra in added.get(source, {}).items():
        data = read_data(extra)
        used = np.isfinite(data.values)
        found.append(Part(name, True, _names(extra, len(used)), extra, used, data.covariance))
    try:
        predictions = [prediction for _, prediction in _measured(model, bound, source, added)]
    except OutOfDomain:  # said where the slopes are taken
        return found
    if any(prediction.why_not for prediction in predictions):
        return found
    return [replace(part, prediction=made) for part, made in zip(found, predictions, strict=True)]


def _of(model: Model, bound: ModelInputs, source: str) -> list[Measured]:
    return [one for one in model.measured(bound) if one.stream == ("" if source == DATA else source)]


def _names(measurement: Measurement, size: int) -> tuple[str, ...]:
    return tuple(getattr(measurement, "names", ())) or tuple(f"{measurement.kind} {i + 1}" for i in range(size))


def _check(spec: Spec, one: Measured) -> None:
    """Refuse a likelihood that is not about predictions with a known scatter."""
    cls = type(one.measurement)
    own = cls.ln_likelihood is not Measurement.ln_likelihood
    if own and cls.scatter is Measurement.scatter:
        where = ".".join(filter(None, (f"stream.{one.stream}" if one.stream else "data", one.name)))
        raise StreamkitError(
            f"{spec.source}: {where}: {cls.kind} has a likelihood of its own and does not say how its data scatter "
            "(`scatter`), so what they tell cannot be forecast; leave this section out"
        )


def _measured(model: Model, bound: ModelInputs, source: str, added: Added) -> Iterator[tuple[Measurement, Prediction]]:
    measured = _of(model, bound, source)
    if source == DATA:
        observation = Observation({}, {f"data.{name}": one for name, one in model.observe_host(bound).items()})
        yield from ((one.measurement, observation.prediction_of(one)) for one in measured)
        return
    stream, prediction = model.observe(bound.streams[source])
    if prediction is not None:
        if prediction.why_not:
            raise OutOfDomain(prediction.why_not)
        of = parts_of(prediction)
        yield from ((one.measurement, of[one.name]) for one in measured)
    for name, extra in added.get(source, {}).items():
        one = measure_stream({name: extra}, stream)
        if one is not None:
            yield extra, parts_of(one)[name]
