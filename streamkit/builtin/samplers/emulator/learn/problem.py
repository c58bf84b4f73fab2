"""The posterior as the emulator sees it: predictions at points, and the comparison of any predictions with the data."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from streamkit import Array, BoolArray


class Answers(NamedTuple):
    """What calls of the model gave at n points.

    Attributes
    ----------
    mean, variance
        (n, m) the predictions, and the variances that the observables state for them; NaN where there is none.
    details
        (n, k) what else of a prediction the likelihoods read.
    ln_likelihood
        (n,) as the run file has it; -inf where there is no prediction.
    """

    mean: Array
    variance: Array
    details: Array
    ln_likelihood: Array

    def take(self, rows: BoolArray) -> Answers:
        """Return those of some of the points."""
        return Answers(*(each[rows] for each in self))

    def joined(self, other: Answers) -> Answers:
        """Return the answers of both; calls without any prediction may have no column of details."""
        k = max(self.details.shape[1], other.details.shape[1])
        pairs = zip(self._padded(k), other._padded(k), strict=True)
        return Answers(*(np.concatenate(pair) for pair in pairs))

    def _padded(self, k: int) -> Answers:
        if self.details.shape[1] == k:
            return self
        return self._replace(details=np.full((len(self.mean), k), np.nan))


class Problem(Protocol):
    """A posterior whose predictions can be emulated.

    Attributes
    ----------
    size, seed
        Number of free parameters d; the seed of all that the sampler draws.
    coordinates
        (d,) whether the predictions depend on a parameter; the others enter the likelihood alone.
    values, errors
        (m,) the data and their standard errors, the units of the fit; NaN for no datum.
    add_noise
        Whether the run file adds the model's own variance to that of the data.
    is_ln_likelihood
        Whether the only prediction is ln likelihood itself.
    """

    size: int
    seed: int
    coordinates: BoolArray
    values: Array
    errors: Array
    add_noise: bool
    is_ln_likelihood: bool

    def from_unit(self, u: Array) -> Array:
        """Return the parameters (..., d) at fractions u (..., d) of their priors."""

    def ln_prior(self, points: Array) -> Array:
        """Return the ln prior density (n,) at points (n, d); -inf outside."""

    def evaluate(self, points: Array) -> Answers:
        """Call the model at points (n, d), with new random numbers at every point."""

    def compare(self, points: Array, mean: Array, variance: Array, details: Array) -> Array:
        """Return ln likelihood (n,) for given predictions, whose variances are added to those of the data."""

    def time_left(self) -> float:
        """Return the seconds until the run's time limit; infinite without one."""
