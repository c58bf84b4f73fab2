"""The coordinates of the emulator and of its walks: logarithms of the parameters that are positive by their prior."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from streamkit import Array
from streamkit.builtin.samplers.emulator.problem import Problem


class Space:
    """The coordinates y: the parameters, or the logarithms of those that are positive by their prior.

    Masses, lengths and speeds enter the model as products of powers, which polynomials of the logarithms follow better.
    The prior is that of the problem, or another density of its parameters.
    """

    def __init__(self, problem: Problem, ln_prior: Callable[[Array], Array] | None = None) -> None:
        self._ln_prior = ln_prior or problem.ln_prior
        self._log = problem.from_unit(np.zeros(problem.size)) > 0

    def to(self, theta: Array) -> Array:
        """(n, d) Coordinates of parameters (n, d)."""
        return np.where(self._log, np.log(np.where(self._log, theta, 1.0)), theta)

    def back(self, y: Array) -> Array:
        """(n, d) Parameters at coordinates (n, d)."""
        with np.errstate(over="ignore"):  # infinite: outside the prior
            return np.where(self._log, np.exp(np.where(self._log, y, 0.0)), y)

    def ln_prior(self, y: Array) -> Array:
        """(n,) ln density of the prior in the coordinates; -inf outside."""
        return np.asarray(self._ln_prior(self.back(y)) + np.sum(y[:, self._log], axis=1))
