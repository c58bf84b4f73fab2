"""The data that predictions are compared with, read from observables and checked in one place."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from streamkit.components import Measurement
from streamkit.errors import ComponentError, blamed
from streamkit.stream import Array, Data

SAME = 1e-6  # relative difference up to which a covariance is symmetric, and its diagonal the errors squared


def read_data(observable: Measurement, add_noise: bool = False) -> Data:
    """Return the data of an observable. Raises ComponentError if it fails, or if its covariance is not valid."""
    name = f"{observable.role} {observable.kind}"
    with blamed(name):
        values, errors = (np.asarray(each, dtype=float) for each in observable.data())
        given = observable.covariance()
        covariance = None if given is None else np.asarray(given, dtype=float)
    if covariance is not None and (fault := _fault(values, errors, covariance)):
        raise ComponentError(f"{name}: {fault}")
    return Data(values, errors, add_noise, covariance)


def _fault(values: Array, errors: Array, covariance: Array) -> str:
    """Return what is wrong with a covariance; an empty text if it fits the data."""
    m = len(values)
    if covariance.shape != (m, m):
        return f"the covariance has the shape {covariance.shape}, expected ({m}, {m})"
    used = np.isfinite(values)
    some = covariance[np.ix_(used, used)]
    if not np.isfinite(some).all():
        return "the covariance holds numbers that are not finite"
    scale = np.sqrt(np.abs(np.diag(some)))
    if (np.abs(some - some.T) > SAME * np.outer(scale, scale)).any():
        return "the covariance is not symmetric"
    if not np.allclose(np.diag(some), errors[used] ** 2, rtol=SAME, atol=0):
        return "the diagonal of the covariance is not the square of the errors that `data` gives"
    least = float(np.linalg.eigvalsh(some / np.outer(scale, scale)).min(initial=1.0))
    if least <= 0:
        return f"the covariance is not positive definite: the least eigenvalue of its correlations is {least:.2g}"
    return ""


def join_data(parts: Sequence[Data]) -> Data:
    """Return the data of several observables, which are independent of each other, as one."""
    if len(parts) == 1:
        return parts[0]
    values, errors = (np.concatenate([getattr(part, name) for part in parts]) for name in ("values", "errors"))
    covariance = None
    if any(part.covariance is not None for part in parts):
        covariance, first = np.zeros((len(values), len(values))), 0
        for part in parts:
            last = first + len(part.values)
            block = np.diag(part.errors**2) if part.covariance is None else part.covariance
            covariance[first:last, first:last] = block
            first = last
    return Data(values, errors, parts[0].add_noise, covariance)
