"""Prediction and data to ln likelihood: the observable's own, or a Gaussian."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from streamkit.components import Measurement
from streamkit.errors import ComponentError, StreamkitError, blamed
from streamkit.observe.measure import parts_of
from streamkit.stream import Array, Data, Prediction


def compare_with_data(observable: Measurement, prediction: Prediction, data: Data) -> float:
    """Return the ln likelihood of the data, by the observable's method if it defines one, else by `Data.gaussian`.

    Raises ComponentError if the method fails, or its result is not finite.
    """
    name = f"{observable.role} {observable.kind}"
    with blamed(name):
        given = observable.ln_likelihood(prediction, data.add_noise)
        value = data.gaussian(prediction.mean, prediction.variance) if given is None else float(given)
    if not np.isfinite(value):
        raise ComponentError(f"{name}: the likelihood is no finite number; {_farthest(prediction, data)}")
    return value


def residuals_of(observable: Measurement, prediction: Prediction, data: Data) -> Array | None:
    """Return the residual (m,) of each datum, by the observable's method if it defines one, else by `Data.residuals`.

    None for an observable that defines a likelihood and no residuals. Raises ComponentError if the method fails, or
    returns another shape.
    """
    name = f"{observable.role} {observable.kind}"
    with blamed(name):
        given = observable.residuals(prediction, data.add_noise)
        own = given is not None or observable.ln_likelihood(prediction, data.add_noise) is not None
    if not own:
        return data.residuals(prediction.mean, prediction.variance)
    if given is not None and np.shape(given) != np.shape(data.values):
        raise ComponentError(f"{name}: {np.shape(given)} residuals for {np.shape(data.values)} data")
    return None if given is None else np.asarray(given, dtype=float)


def scatter_of(measured: Sequence[Measurement], prediction: Prediction) -> Array:
    """Return the standard deviations (m,) of the data of all ``measured`` about their joint prediction.

    Raises ComponentError if a method `scatter` fails, or returns another shape.
    """
    parts = []
    for each, part in zip(measured, parts_of(prediction).values(), strict=True):
        name = f"{each.role} {each.kind}"
        with blamed(name):
            scatter = np.asarray(each.scatter(part), dtype=float)
        if scatter.shape != part.mean.shape:
            raise ComponentError(f"{name}: a scatter of shape {scatter.shape} for {part.mean.shape} data")
        parts.append(scatter)
    return np.concatenate(parts)


def ln_likelihood_of_each(observable: Measurement, prediction: Prediction, data: Data) -> Array | None:
    """Return the ln likelihood (m,) of each datum: the observable's terms, or those of `Data.gaussian_of_each`.

    None for an observable that defines a likelihood and no terms of it.
    """
    with blamed(f"{observable.role} {observable.kind}"):
        given = observable.ln_likelihoods(prediction, data.add_noise)
        own = given is not None or observable.ln_likelihood(prediction, data.add_noise) is not None
    return given if own else data.gaussian_of_each(prediction.mean, prediction.variance)


def new_data(observable: Measurement, prediction: Prediction, data: Data, rng: np.random.Generator) -> Array | None:
    """Draw values (m,) of new data about a prediction: by the observable's `mock`, or Gaussian ones.

    None for an observable that defines a likelihood and no mock data.
    """
    with blamed(f"{observable.role} {observable.kind}"):
        if observable.ln_likelihood(prediction, data.add_noise) is None:
            return data.drawn(prediction.mean, prediction.variance, rng)
        try:
            drawn = observable.mock(prediction, rng)
        except StreamkitError:
            return None
        fields = {name: getattr(observable, name) for name in type(observable).model_fields}
        return np.asarray(type(observable)(**(fields | drawn)).data()[0], dtype=float)


def _farthest(prediction: Prediction, data: Data) -> str:
    """Return a sentence with the datum that is farthest from its prediction, in units of its error."""
    with np.errstate(all="ignore"):
        away = np.abs((prediction.mean - data.values) / data.errors)
    worst = int(np.argmax(np.where(np.isfinite(data.values), np.nan_to_num(away, nan=np.inf), -1.0)))
    return (
        f"{prediction.names[worst]}: predicted {prediction.mean[worst]:g} for the datum {data.values[worst]:g} +- "
        f"{data.errors[worst]:g}"
    )
