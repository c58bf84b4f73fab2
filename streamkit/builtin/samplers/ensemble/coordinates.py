"""The coordinates of the walks: logarithms of the parameters that are positive by their prior."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from streamkit import Array, LogUniform, Normal, PriorDensity, TruncatedNormal, Uniform


class Space:
    """The coordinates y of the walks: the parameters, or the logarithms of those that are positive by their prior.

    Masses, lengths and speeds enter the model as products of powers, which polynomials of the logarithms follow better.
    """

    def __init__(self, priors: Sequence[PriorDensity]) -> None:
        uniform = np.array([type(prior) is Uniform and prior.low > 0 for prior in priors])  # LogUniform is one too
        self._log = np.array([isinstance(prior, LogUniform) for prior in priors]) | uniform
        self._slope = uniform.astype(float)
        self._low, self._high = np.array([prior.support for prior in priors]).T
        normal = [(p.mean, p.sd) if isinstance(p, Normal | TruncatedNormal) else (0.0, np.inf) for p in priors]
        self._mean, self._sd = np.array(normal).T

    def to(self, theta: Array) -> Array:
        """(n, d) Coordinates of parameters (n, d)."""
        with np.errstate(invalid="ignore", divide="ignore"):  # not positive: outside the prior
            return np.where(self._log, np.log(np.where(self._log, theta, 1.0)), theta)

    def back(self, y: Array) -> Array:
        """(n, d) Parameters at coordinates (n, d)."""
        return np.where(self._log, np.exp(np.where(self._log, y, 0.0)), y)

    def ln_prior(self, y: Array) -> Array:
        """(n,) ln density of the prior in the coordinates, up to a constant; -inf outside."""
        theta = self.back(y)
        inside = ((theta >= self._low) & (theta <= self._high)).all(axis=1)
        density = np.sum(self._slope * y - 0.5 * ((y - self._mean) / self._sd) ** 2, axis=1)
        return np.where(inside, density, -np.inf)

    def ln_jacobian(self, y: Array) -> Array:
        """(n,) ln |d theta / d y|."""
        return np.asarray(np.sum(y[:, self._log], axis=1))
