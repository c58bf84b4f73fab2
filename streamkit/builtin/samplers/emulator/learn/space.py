"""The coordinates of the parameters: those that walkers move in, and those that predictions are learned in."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from streamkit import Array
from streamkit.builtin.samplers.emulator.learn.problem import Problem

# Ends of the table of a prior, in standard deviations of the normal that it is mapped to, and its places.
END, PLACES = 8.2, 4101
STEP = 2 * END / (PLACES - 1)


class Space:
    """Coordinates z in which the prior is a standard normal, for walkers; and coordinates y for what is learned.

    Walkers in z meet no edges, and all parameters have one scale. y are the parameters, or the logarithms of those that
    are positive by their prior: masses, lengths and speeds enter the model as products of powers, which polynomials of
    the logarithms follow better. z and y are functions of each other by a table for each parameter, linear between its
    places: 0.004 standard deviations apart.
    """

    def __init__(self, problem: Problem) -> None:
        self._log = problem.from_unit(np.zeros(problem.size)) > 0
        self._z = np.linspace(-END, END, PLACES)
        theta = problem.from_unit(np.repeat(ndtr(self._z)[:, None], problem.size, axis=1))
        self._y = np.ascontiguousarray(self.learned_of(theta).T)

    @property
    def size(self) -> int:
        """Number of parameters d."""
        return len(self._y)

    def learned_of(self, theta: Array) -> Array:
        """(n, d) Return y of parameters (n, d)."""
        return np.where(self._log, np.log(np.where(self._log, theta, 1.0)), theta)

    def learned(self, z: Array) -> Array:
        """(n, d) Return y at z (n, d)."""
        return self.learned_with_rates(z)[0]

    def learned_with_rates(self, z: Array) -> tuple[Array, Array]:
        """(n, d) and (n, d) Return y at z (n, d), and dy / dz."""
        at = np.clip((z + END) / STEP, 0.0, PLACES - 1.0)
        places = np.minimum(at.astype(np.int64), PLACES - 2)
        part, places = at - places, places + PLACES * np.arange(z.shape[1])
        before, after = self._y.take(places), self._y.take(places + 1)
        return before + part * (after - before), (after - before) / STEP

    def parameters(self, y: Array) -> Array:
        """(n, d) Return the parameters at y (n, d)."""
        return np.where(self._log, np.exp(np.where(self._log, y, 0.0)), y)

    def points(self, z: Array) -> Array:
        """(n, d) Return the parameters at z (n, d)."""
        return self.parameters(self.learned(z))

    def normal(self, theta: Array) -> Array:
        """(n, d) Return z of parameters (n, d); those outside the prior are at its ends."""
        y = self.learned_of(theta)
        return np.stack([np.interp(y[:, i], each, self._z) for i, each in enumerate(self._y)], axis=1)
