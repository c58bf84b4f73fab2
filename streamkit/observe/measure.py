"""Stream to prediction: the observable is asked, and its contract checked, in this one place."""

from __future__ import annotations

import numpy as np

from streamkit.components import Observable
from streamkit.errors import ComponentError, blamed
from streamkit.observe.data import Data
from streamkit.stream import Prediction, Stream


def measure_stream(observable: Observable, stream: Stream, known: Data | None = None) -> Prediction:
    """Return what the observable says of the stream; its data are asked for unless they are ``known``.

    ComponentError if it fails, predicts other shapes than its data have, or for a datum no number without a reason.
    """
    name = f"observable {observable.kind}"
    with blamed(name):
        prediction = observable.predict(stream)
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
