"""Stream to prediction: the observable is asked, and its contract checked, in this one place."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from streamkit.components import HostData, HostView, Observable
from streamkit.errors import ComponentError, blamed
from streamkit.stream import Data, Prediction, Stream, join_predictions

UNNAMED = "observable"  # what the only observable of a stream is called, if the run file does not name it


def measure_stream(
    observables: Mapping[str, Observable], stream: Stream, known: Mapping[str, Data] | None = None
) -> Prediction | None:
    """Return what the observables say of the stream, as one prediction; None without observables.

    Parameters
    ----------
    observables
        By name. The names of the predicted numbers begin with it, but for a single observable called ``observable``.
    known
        Their data; else they are asked for.

    ComponentError if one fails, predicts other shapes than its data have, or for a datum no number without a reason.
    """
    found = {name: _measure(observable, stream, (known or {}).get(name)) for name, observable in observables.items()}
    return found.get(UNNAMED) if found.keys() <= {UNNAMED} else join_predictions(found)


def parts_of(prediction: Prediction) -> dict[str, Prediction]:
    """Return what each observable of a stream said, by its name, from what `measure_stream` returned."""
    return prediction.parts or {UNNAMED: prediction}


def measure_host(data: HostData, host: HostView, known: Data | None = None) -> Prediction:
    """Return what the host says of data that are no stream; ComponentError as `measure_stream`."""
    return _measure(data, host, known)


def _measure(observable: Any, source: Any, known: Data | None) -> Prediction:
    name = f"{observable.role} {observable.kind}"
    with blamed(name):
        prediction: Prediction = observable.predict(source)
        data = observable.data()[0] if known is None else known.values
        mean, variance = np.shape(prediction.mean), np.shape(prediction.variance)
        if prediction.why_not:
            return prediction
        if not len(prediction.names) == len(data) or not mean == variance == np.shape(data):
            raise ComponentError(
                f"{name}: predicted {mean} values with {variance} variances and {len(prediction.names)} names "
                f"for {np.shape(data)} data"
            )
        if np.iscomplexobj(prediction.mean) or np.iscomplexobj(prediction.variance):
            raise ComponentError(f"{name}: predicted complex numbers: {np.asarray(prediction.mean).tolist()}")
        used = np.isfinite(data)
        usable = (
            np.isfinite(prediction.mean) & np.isfinite(prediction.variance) & (np.asarray(prediction.variance) >= 0)
        )
        if not usable[used].all():
            raise ComponentError(
                f"{name}: predicted {np.asarray(prediction.mean).tolist()} with variances "
                f"{np.asarray(prediction.variance).tolist()}, not all of them usable numbers, and gave no reason"
            )
    return prediction
