"""The coordinates of the walks: logarithms of the parameters that are positive by their prior."""

from __future__ import annotations

import numpy as np

from streamkit import Array, Target


class Space:
    """The coordinates y of the walks: the parameters, or the logarithms of those that are positive by their prior.

    A ridge of constant products is straight in the logarithms.
    """

    def __init__(self, target: Target) -> None:
        self.size, self._ln_prior = target.size, target.ln_prior
        self._log = target.from_unit(np.zeros(target.size)) > 0

    def to(self, theta: Array) -> Array:
        """(n, d) Coordinates of parameters (n, d)."""
        return np.where(self._log, np.log(np.where(self._log, theta, 1.0)), theta)

    def back(self, y: Array) -> Array:
        """(n, d) Parameters at coordinates (n, d)."""
        with np.errstate(over="ignore"):  # infinite: outside the prior
            return np.where(self._log, np.exp(np.where(self._log, y, 0.0)), y)

    def ln_prior(self, y: Array) -> Array:
        """(n,) ln density of the prior in the coordinates; -inf outside."""
        return self._ln_prior(self.back(y)) + self.ln_jacobian(y)

    def ln_jacobian(self, y: Array) -> Array:
        """(n,) ln |d theta / d y|."""
        return np.asarray(np.sum(y[:, self._log], axis=1))
