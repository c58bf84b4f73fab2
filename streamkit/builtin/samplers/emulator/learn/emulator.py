"""The emulator: predictions as polynomials of whitened coordinates, with their own error, and the likelihood on top."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.special import log_expit

from streamkit import Array, BoolArray
from streamkit.builtin.samplers.emulator.learn.growth import Growth
from streamkit.builtin.samplers.emulator.learn.kernel import Kernel
from streamkit.builtin.samplers.emulator.learn.polynomial import Leverage, LowRank, Polynomial, Slopes
from streamkit.builtin.samplers.emulator.learn.problem import Problem
from streamkit.builtin.samplers.monomials import monomials

# Noise of a call below this many squared errors of the data is none.
SILENCE = 1e-3


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
        Features, and their coefficients, of (prediction - datum) / error.
    directions
        (m, k) combinations of (prediction - datum) / error that change near the data, in units of their errors and that
        of the fit: what walkers follow.
    growth
        By which factor the lack of fit is larger or smaller at |x|^2 than in the mean.
    leverage, chance
        Variance of the fit over that of the points about it; (features, terms) what makes coefficients by chance of
        independent normal numbers.
    residual_variance, lack_of_fit
        (m,) in squared errors of the data: variance of the points about the fit, and how much of it is not noise: it
        does not average out.
    correlation
        (m, m) of the points about the fit: data of a stream share its particles.
    unstated_variance, stated_variance, pairs
        (m,) in squared errors of the data: noise of a call beyond what the observable states, measured by pairs of
        calls; what it states; and the number of pairs.
    secondary_degree, secondary, positive, secondary_range
        Polynomials of this degree for ln variance and the details, (terms, m + k); which details are logarithms; the
        range in which they stay.
    trusted_r2
        |x|^2 beyond which the fit is not trusted: a penalty brings walks back.
    exists
        (quadratic terms,) log odds that there is a prediction.
    """

    problem: Problem
    centre: Array
    whiten: Array
    basis: Polynomial | Kernel
    growth: Growth
    mean: LowRank
    directions: Array
    leverage: Leverage
    chance: Array
    residual_variance: Array
    correlation: Array
    lack_of_fit: Array
    unstated_variance: Array
    stated_variance: Array
    pairs: int
    secondary_degree: int
    secondary: LowRank
    positive: BoolArray
    secondary_range: tuple[Array, Array]
    trusted_r2: float
    exists: Array

    def __getstate__(self) -> dict[str, Any]:
        """Return what another process is sent: all but the problem, see `of`."""
        return {each.name: getattr(self, each.name) for each in fields(self) if each.name != "problem"}

    def of(self, problem: Problem) -> Emulator:
        """Return the emulator of a problem, if it has come from another process and lacks it."""
        return replace(self, problem=problem)

    @property
    def is_silent(self) -> bool:
        """Whether pairs of calls have shown that there is no noise."""
        return self.pairs > 0 and bool(np.max(self.stated_variance + self.unstated_variance) < SILENCE)

    @property
    def larger_noise(self) -> tuple[int, float] | None:
        """How many data have more noise than is stated, and by which factor at most (of a standard deviation)."""
        more = self.unstated_variance > SILENCE
        if not more.any():
            return None
        return int(more.sum()), float(
            np.sqrt(1 + np.max(self.unstated_variance[more] / np.maximum(self.stated_variance[more], SILENCE)))
        )

    @cached_property
    def _along(self) -> Slopes:
        return self.basis.along(LowRank.of(self.mean.whole @ self.directions))

    def predict(self, y: Array, with_noise: bool = True) -> Predictions:
        """Return the predictions at coordinates y (n, d); NaN where there is no datum, or no noise is asked for."""
        x = (y[:, self.problem.coordinates] - self.centre) @ self.whiten
        r2 = np.sum(x**2, axis=1)
        features, few = self.basis.features(x), monomials(x, self.secondary_degree)
        by_calls, lack = self.leverage.at(features)[:, None], self.growth.at(r2)[:, None]
        fit_variance2 = self.residual_variance * by_calls + self.lack_of_fit * lack
        used = np.isfinite(self.problem.values)
        m, errors = int(used.sum()), self.problem.errors[used]
        secondary = np.clip(self.secondary.at(few), *self.secondary_range)
        details = secondary[:, m:]
        details[:, self.positive] = np.exp(details[:, self.positive])
        mean, fit_variance, noise = (np.full((len(y), len(used)), np.nan) for _ in range(3))
        mean[:, used] = self.problem.values[used] + errors * self.mean.at(features)
        fit_variance[:, used] = errors**2 * fit_variance2
        if with_noise:
            noise[:, used] = errors**2 * (np.exp(secondary[:, :m]) + self.unstated_variance)
        ln_exists = log_expit(few @ self.exists)
        return Predictions(mean, fit_variance, noise, details, ln_exists, np.maximum(r2 / self.trusted_r2, 1.0))

    @cached_property
    def _scatter(self) -> Array:
        """(m, m) S of the covariance S' S of the points about the fit."""
        values, axes = np.linalg.eigh(self.correlation)
        root = np.sqrt(np.maximum(values, 0.0))[:, None] * axes.T
        return np.asarray(root * np.sqrt(np.maximum(self.residual_variance, 0.0)))

    def by_noise(self, rng: np.random.Generator) -> Array:
        """(terms, m) Draw what other noise of the calls would change of the coefficients of the mean."""
        normal = rng.standard_normal((self.chance.shape[1], len(self._scatter)))
        return np.asarray(self.chance @ (normal @ self._scatter))

    def redrawn(self, rng: np.random.Generator) -> Emulator:
        """Return what other calls at the same points could have given: other noise, so other coefficients."""
        return replace(self, mean=LowRank(self.mean.whole + self.by_noise(rng)))

    def ln_likelihood(self, y: Array, theta: Array, noise: bool = False, most_by_error: float = np.inf) -> Array:
        """(n,) ln likelihood at coordinates y (n, d), which are the parameters theta (n, d).

        Parameters
        ----------
        noise
            Whether the variance of one call counts: the likelihood is then that of one realisation, averaged over many.
        most_by_error
            Most that the emulator's own error adds to ln L; 0 is without it.
        """
        return self._compared(self.predict(y, noise), theta, noise, most_by_error)

    def of_other_noise(
        self, y: Array, theta: Array, changes: Sequence[Array], noise: bool, most_by_error: float
    ) -> Array:
        """(k, n) `ln_likelihood` if noise had changed the coefficients of the mean by these (terms, m), see `by_noise`.

        The errors of the fit are the same, and most of the work.
        """
        predicted = self.predict(y, noise)
        features = self.basis.features((y[:, self.problem.coordinates] - self.centre) @ self.whiten)
        used, found = np.isfinite(self.problem.values), np.empty((len(changes), len(y)))
        for i, change in enumerate(changes):
            mean = predicted.mean.copy()
            mean[:, used] += self.problem.errors[used] * (features @ change)
            found[i] = self._compared(predicted._replace(mean=mean), theta, noise, most_by_error)
        return found

    def _compared(self, predicted: Predictions, theta: Array, noise: bool, most_by_error: float) -> Array:
        """(n,) ln likelihood of predictions at parameters theta (n, d)."""
        of_call = predicted.noise if noise else np.zeros_like(predicted.noise)
        outside = len(self.centre) * (predicted.beyond - 1.0)
        lnl, every = np.full(len(theta), np.inf), np.arange(len(theta))
        with_error = every if most_by_error > 0 else every[:0]
        limited = every[~(self._most_added(predicted) < most_by_error)] if np.isfinite(most_by_error) else every[:0]
        # one comparison of both: half of its time is that of a call
        rows = np.concatenate([with_error, limited])
        variance = np.concatenate([(predicted.fit_variance + of_call)[with_error], of_call[limited]])
        found = self.problem.compare(theta[rows], predicted.mean[rows], variance, predicted.details[rows])
        lnl[with_error] = found[: len(with_error)]
        lnl[limited] = np.minimum(lnl[limited], found[len(with_error) :] + most_by_error)
        return np.asarray(lnl + predicted.ln_exists - outside)

    def _most_added(self, predicted: Predictions) -> Array:
        """(n,) Most that the error of the fit can add to ln L, where that is not slow to say.

        With a covariance C of at least the errors D of the data, and V of the fit, it is half of r' C^-1 r minus
        r' (C + V)^-1 r at most, and so half of max(V / D) r' D^-1 r.
        """
        if self.problem.is_ln_likelihood:
            return np.full(len(predicted.mean), np.inf)
        used, errors = np.isfinite(self.problem.values), self.problem.errors
        away = ((predicted.mean - self.problem.values) / errors)[:, used]
        return np.asarray(0.5 * np.sum(away**2, axis=1) * (predicted.fit_variance / errors**2)[:, used].max(axis=1))

    def linear(self, y: Array, noise: bool = False) -> tuple[Array, Array]:
        """(n, k) and (n, d, k) Residuals at y (n, d), along the directions and in their errors, and their slopes.

        They are no part of the likelihood but what walkers follow. Of a ln L that is learned as a whole return ln L and
        its slopes.
        """
        values, along = self._along((y[:, self.problem.coordinates] - self.centre) @ self.whiten)
        slopes = np.zeros((*y.shape, values.shape[1]))
        slopes[:, self.problem.coordinates] = np.matmul(self.whiten, along)
        if self.problem.is_ln_likelihood or not noise:
            return values, slopes
        error = np.sqrt(1.0 + (self.stated_variance + self.unstated_variance) @ self.directions**2)
        return values / error, slopes / error
