"""Stream to prediction: observables are called, and their results checked, in this one place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from streamkit.components import HostData, HostView, Observable
from streamkit.errors import ComponentError, blamed
from streamkit.stream import Data, Prediction, Stream, join_predictions

UNNAMED = "observable"  # the name of a stream's only observable where the run file gives none


def measure_stream(
    observables: Mapping[str, Observable], stream: Stream, data: Mapping[str, Data] | None = None
) -> Prediction | None:
    """Return the predictions of all observables of a stream as one; None without observables.

    The name of an observable precedes the names of its numbers, unless it is the only one and called ``observable``.
    Without given data the observables are asked for them. Raises ComponentError if an observable fails, if a prediction
    has another shape than the data, or if a prediction is NaN for a datum without a reason.
    """
    data = data or {}
    predictions = {name: _measure(observable, stream, data.get(name)) for name, observable in observables.items()}
    return predictions.get(UNNAMED) if predictions.keys() <= {UNNAMED} else join_predictions(predictions)


def parts_of(prediction: Prediction) -> dict[str, Prediction]:
    """Return the prediction of each observable by its name, from the result of `measure_stream`."""
    return prediction.parts or {UNNAMED: prediction}


def measure_host(measurement: HostData, host: HostView, data: Data | None = None) -> Prediction:
    """Return the prediction of the host for data without a stream; raises as `measure_stream`."""
    return _measure(measurement, host, data)


def _measure(observable: Any, source: Any, data: Data | None) -> Prediction:
    name = f"{observable.role} {observable.kind}"
    with blamed(name):
        prediction: Prediction = observable.predict(source)
        values = observable.data()[0] if data is None else data.values
        mean, variance = np.shape(prediction.mean), np.shape(prediction.variance)
        if prediction.why_not:
            return prediction
        if not len(prediction.names) == len(values) or not mean == variance == np.shape(values):
            raise ComponentError(
                f"{name}: predicted {mean} values with {variance} variances and {len(prediction.names)} names "
                f"for {np.shape(values)} data"
            )
        if np.iscomplexobj(prediction.mean) or np.iscomplexobj(prediction.variance):
            raise ComponentError(f"{name}: predicted complex numbers: {np.asarray(prediction.mean).tolist()}")
        used = np.isfinite(values)
        usable = (
            np.isfinite(prediction.mean) & np.isfinite(prediction.variance) & (np.asarray(prediction.variance) >= 0)
        )
        if not usable[used].all():
            raise ComponentError(
                f"{name}: predicted {np.asarray(prediction.mean).tolist()} with variances "
                f"{np.asarray(prediction.variance).tolist()}, not all of them usable numbers, and gave no reason"
            )
    if all(np.asarray(each).dtype == np.float64 for each in (prediction.mean, prediction.variance)):
        return prediction
    floats = np.array([prediction.mean, prediction.variance], dtype=float)  # no file of calls holds integers or float32
    return replace(prediction, mean=floats[0], variance=floats[1])
