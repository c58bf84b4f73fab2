"""Prediction and data to ln likelihood: the observable's own, or a Gaussian."""

from __future__ import annotations

import numpy as np

from streamkit.components import Measurement
from streamkit.errors import ComponentError, blamed
from streamkit.stream import Data, Prediction


def compare_with_data(observable: Measurement, prediction: Prediction, data: Data) -> float:
    """Return the ln likelihood of the data: what the observable itself says, or that of `Data.gaussian`.

    ComponentError if it fails, or is no finite number.
    """
    name = f"{observable.role} {observable.kind}"
    with blamed(name):
        own = observable.ln_likelihood(prediction, data.add_noise)
        value = data.gaussian(prediction.mean, prediction.variance) if own is None else float(own)
    if not np.isfinite(value):
        raise ComponentError(f"{name}: the likelihood is no finite number; {_farthest(prediction, data)}")
    return value


def _farthest(prediction: Prediction, data: Data) -> str:
    """Say which datum is the farthest from what is predicted, in its errors."""
    with np.errstate(all="ignore"):
        away = np.abs((prediction.mean - data.values) / data.errors)
    worst = int(np.argmax(np.where(np.isfinite(data.values), np.nan_to_num(away, nan=np.inf), -1.0)))
    return (
        f"{prediction.names[worst]}: predicted {prediction.mean[worst]:g} for the datum {data.values[worst]:g} +- "
        f"{data.errors[worst]:g}"
    )
