"""The emulator: predictions as polynomials of whitened coordinates, with their own error, and the likelihood on top."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.special import log_expit

from streamkit import Array, BoolArray
from streamkit.builtin.samplers.emulator.kernel import Kernel
from streamkit.builtin.samplers.emulator.polynomial import Polynomial
from streamkit.builtin.samplers.emulator.problem import Problem
from streamkit.builtin.samplers.monomials import monomials

# Singular values of coefficients below this fraction of the largest are left out.
NEGLIGIBLE = 1e-6
# Noise of a call below this many squared errors of the data is none.
SILENCE = 1e-3


class Low(NamedTuple):
    """Coefficients (terms, k), as a product of two thinner matrices where that is less work."""

    left: Array
    right: Array | None = None

    @classmethod
    def of(cls, coefficients: Array) -> Low:
        """Take coefficients apart where they have a low rank."""
        if min(coefficients.shape) < 8:
            return cls(coefficients)
        u, s, v = np.linalg.svd(coefficients, full_matrices=False)
        rank = int(np.sum(s > NEGLIGIBLE * s[0])) or 1
        if rank * sum(coefficients.shape) >= coefficients.size:
            return cls(coefficients)
        return cls(np.ascontiguousarray(u[:, :rank] * s[:rank]), np.ascontiguousarray(v[:rank]))

    def at(self, terms: Array) -> Array:
        """(n, k) The polynomials with terms (n, t)."""
        first = terms @ self.left
        return np.asarray(first if self.right is None else first @ self.right)


class Predictions(NamedTuple):
    """Predictions of the emulator at n points.

    Attributes
    ----------
    mean, fit_variance, noise
        (n, m) the prediction of infinitely many particles, the variance of that estimate, and the variance of one call
        about it.
    details
        (n, k).
    ln_exists
        (n,) ln probability that there is a prediction.
    beyond
        (n,) how far outside the points that are known: 1 at their edge and inside.
    """

    mean: Array
    fit_variance: Array
    noise: Array
    details: Array
    ln_exists: Array
    beyond: Array


@dataclass(frozen=True, eq=False)
class Emulator:
    """Predictions as polynomials; they are learned by `learn`.

    Attributes
    ----------
    centre, whiten
        (c,) and (c, c): x = (z - centre) @ whiten of the c coordinates z that predictions depend on.
    basis, mean
        Terms, and their coefficients, of (prediction - datum) / error.
    growth
        Power of |x|^2 by which the lack of fit grows outside the points.
    root
        (terms, terms): the squared length of ``terms @ root`` is the leverage, the variance of the fit over that of the
        points about it.
    spread2, lack2
        (m,) in squared errors of the data: variance of the points about the fit, and how much of it is not noise: it
        does not average out.
    more2, stated2, pairs
        (m,) in squared errors of the data: noise of a call beyond what the observable states, measured by pairs of
        calls; what it states; and the number of pairs.
    low, rest, positive, ends
        Polynomials of this degree for ln variance and the details, (terms, m + k); which details are logarithms; the
        range in which they stay.
    typical_r2, trusted_r2
        |x|^2 beyond which the lack of fit grows, and beyond which the fit is not trusted: a penalty brings walks back.
    exists
        (quadratic terms,) log odds that there is a prediction.
    """

    problem: Problem
    centre: Array
    whiten: Array
    basis: Polynomial | Kernel
    growth: int
    mean: Low
    root: Array
    spread2: Array
    lack2: Array
    more2: Array
    stated2: Array
    pairs: int
    low: int
    rest: Low
    positive: BoolArray
    ends: tuple[Array, Array]
    typical_r2: float
    trusted_r2: float
    exists: Array

    @property
    def is_silent(self) -> bool:
        """Whether pairs of calls have shown that there is no noise."""
        return self.pairs > 0 and bool(np.max(self.stated2 + self.more2) < SILENCE)

    @property
    def larger_noise(self) -> tuple[int, float] | None:
        """How many data have more noise than is stated, and by which factor at most (of a standard deviation)."""
        more = self.more2 > SILENCE
        if not more.any():
            return None
        return int(more.sum()), float(np.sqrt(1 + np.max(self.more2[more] / np.maximum(self.stated2[more], SILENCE))))

    def predict(self, y: Array) -> Predictions:
        """Return the predictions at coordinates y (n, d); NaN where there is no datum."""
        x = (y[:, self.problem.coordinates] - self.centre) @ self.whiten
        r2 = np.sum(x**2, axis=1)
        terms, few = self.basis.terms(x), monomials(x, self.low)
        leverage = np.sum((terms @ self.root) ** 2, axis=1)
        grown = np.maximum(r2 / self.typical_r2, 1.0) ** self.growth
        fit_variance2 = (
            self.spread2 * leverage[:, None] + self.lack2 * grown[:, None] + self.basis.unseen(terms)[:, None]
        )
        used = np.isfinite(self.problem.values)
        m, errors = int(used.sum()), self.problem.errors[used]
        rest = np.clip(self.rest.at(few), *self.ends)
        details = np.where(self.positive, np.exp(np.where(self.positive, rest[:, m:], 0.0)), rest[:, m:])
        mean, fit_variance, noise = (np.full((len(y), len(used)), np.nan) for _ in range(3))
        mean[:, used] = self.problem.values[used] + errors * self.mean.at(terms)
        fit_variance[:, used] = errors**2 * fit_variance2
        noise[:, used] = errors**2 * (np.exp(rest[:, :m]) + self.more2)
        ln_exists = log_expit(few @ self.exists)
        return Predictions(mean, fit_variance, noise, details, ln_exists, np.maximum(r2 / self.trusted_r2, 1.0))

    def redrawn(self, rng: np.random.Generator) -> Emulator:
        """Return what other calls at the same points could have given: other noise, so other coefficients."""
        left, right = self.mean
        coefficients = left if right is None else left @ right
        chance = self.root @ rng.standard_normal(coefficients.shape) * np.sqrt(self.spread2)
        return replace(self, mean=Low(coefficients + chance))

    def ln_likelihood(self, y: Array, theta: Array, noise: bool = False, fit_error: bool = True) -> Array:
        """(n,) ln likelihood at coordinates y (n, d), which are the parameters theta (n, d).

        Parameters
        ----------
        noise
            Whether the variance of one call counts: the likelihood is then that of one realisation, averaged over many.
        fit_error
            Whether the emulator's own error counts.
        """
        predicted = self.predict(y)
        variance = predicted.fit_variance * fit_error + (predicted.noise if noise else 0.0)
        lnl = self.problem.compare(theta, predicted.mean, variance, predicted.details)
        outside = len(self.centre) * (predicted.beyond - 1.0)
        return np.asarray(lnl + predicted.ln_exists - outside)
