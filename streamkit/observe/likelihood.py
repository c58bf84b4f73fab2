"""Prediction and data to ln likelihood: the observable's own, or a Gaussian."""

from __future__ import annotations

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from streamkit.components import Measurement
from streamkit.errors import ComponentError, blamed
from streamkit.observe.data import Data
from streamkit.stream import Array, Prediction


def compare_with_data(observable: Measurement, prediction: Prediction, data: Data) -> float:
    """Return the ln likelihood of the data, by the observable's own method or by `gaussian`.

    Raises ComponentError if the method fails, or its result is not finite.
    """
    name = f"{observable.role} {observable.kind}"
    with blamed(name):
        given = observable.ln_likelihood(prediction, data.add_noise)
        value = gaussian(prediction.mean, prediction.variance, data) if given is None else float(given)
    if not np.isfinite(value):
        raise ComponentError(f"{name}: the likelihood is no finite number; {_farthest(prediction, data)}")
    return value


def _farthest(prediction: Prediction, data: Data) -> str:
    """Return a sentence with the datum that is farthest from its prediction, in units of its error."""
    with np.errstate(all="ignore"):
        away = np.abs((prediction.mean - data.values) / data.errors)
    worst = int(np.argmax(np.where(np.isfinite(data.values), np.nan_to_num(away, nan=np.inf), -1.0)))
    return (
        f"{prediction.names[worst]}: predicted {prediction.mean[worst]:g} for the datum {data.values[worst]:g} +- "
        f"{data.errors[worst]:g}"
    )


def gaussian(mean: Array, variance: Array, data: Data) -> float:
    """Return the ln likelihood of Gaussian errors; a NaN datum is not used.

    Parameters
    ----------
    mean, variance
        (m,) prediction, and the variance of that estimate; the latter is added to that of the data if they say so.
    data
        The m data, independent or with a covariance.
    """
    used = np.isfinite(data.values)
    noise = variance[used] if data.add_noise else 0.0
    if data.covariance is None:
        total = data.errors[used] ** 2 + noise
        chi2 = (data.values[used] - mean[used]) ** 2 / total
        return float(-0.5 * np.sum(chi2 + np.log(2 * np.pi * total)))
    root = cholesky(data.covariance[np.ix_(used, used)] + np.diag(noise * np.ones(used.sum())), lower=True)
    white = solve_triangular(root, data.values[used] - mean[used], lower=True)
    return float(-0.5 * (white @ white + len(white) * np.log(2 * np.pi)) - np.log(np.diag(root)).sum())
