"""Stream to prediction: the observable is asked, and its contract checked, in this one place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from streamkit.components import Observable
from streamkit.errors import ComponentError, blamed
from streamkit.stream import Array, Prediction, Stream


def measure_stream(observable: Observable, stream: Stream) -> Prediction:
    """Return what the observable says of the stream.

    ComponentError if it fails, predicts other shapes than its data have, or for a datum no number without a reason.
    """
    name = f"observable {observable.kind}"
    with blamed(name):
        prediction, (data, _) = observable.predict(stream), observable.data()
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


@dataclass(frozen=True)
class Data:
    """What the observables are compared with: (m,) values, NaN where there is none, and their standard errors."""

    values: Array
    errors: Array
    add_noise: bool = False
