"""The predictions of the posterior beside the data, and the width of the posterior in units of the prior's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from streamkit.runfile import Prior
from streamkit.stream import Array

EDGE = 0.02  # the outermost fraction of a prior, at either end, that counts as its edge


def prior_fractions(prior: Prior, values: Array) -> Array:
    """(n,) Fraction of the prior below each value: uniform on [0, 1] if the posterior is the prior."""
    u = np.linspace(1e-6, 1 - 1e-6, 20001)
    return np.asarray(np.interp(values, prior.ppf(u), u))


def contraction(fractions: Array) -> float:
    """Return the posterior's spread over the prior's, both in fractions of the prior: 1 if the data say nothing."""
    return float(np.sqrt(12) * fractions.std())


@dataclass(frozen=True)
class Predictive:
    """The data and the predictions of the posterior for them."""

    # (m,) of the data without missing ones.
    names: tuple[str, ...]
    data: Array
    errors: Array
    # (n, m) predictions of the samples, and the variance of each estimate.
    mean: Array
    variance: Array
    add_noise: bool = False  # whether the likelihood adds that variance to the errors
    gaussian: bool = True  # whether the likelihood is the Gaussian of these data: no observable defines another one
    # (m,) standard deviations of the data about the best sample's predictions; None for their errors.
    scatter: Array | None = None

    def farthest(self, most: int) -> Predictive:
        """Return at most so many of the data, in their order: those that are farthest from the predictions."""
        rows = np.sort(np.argsort(-np.abs(np.nan_to_num(self.deviations)), kind="stable")[:most])
        return Predictive(
            tuple(self.names[row] for row in rows.tolist()), self.data[rows], self.errors[rows], self.mean[:, rows],
            self.variance[:, rows], self.add_noise, self.gaussian, None if self.scatter is None else self.scatter[rows],
        )  # fmt: skip

    @property
    def sigma(self) -> Array:
        """(m,) The unit of deviations."""
        return self.errors if self.scatter is None else self.scatter

    @property
    def total(self) -> Array:
        """(n, m) Variances that the likelihood compares with, correlations left aside."""
        return self.errors**2 + (self.variance if self.add_noise else np.zeros_like(self.variance))

    @property
    def deviations(self) -> Array:
        """(m,) Datum minus median prediction, in `sigma`."""
        return np.asarray((self.data - np.median(self.mean, axis=0)) / self.sigma)

    @property
    def noise(self) -> Array:
        """(m,) The model's own noise over `sigma`, median over the samples."""
        return np.asarray(np.sqrt(np.median(self.variance, axis=0)) / self.sigma)
