"""The posterior of a run as the emulator sees it: its predictions, or ln likelihood itself."""

from __future__ import annotations

import numpy as np

from streamkit import Array, BoolArray, Target
from streamkit.builtin.samplers.emulator.learn.problem import Answers, Problem

# Largest variance of an emulated ln likelihood that counts: more would drown all else where there are no calls.
MOST_VARIANCE = 40.0


class OfTarget:
    """The predictions of a run, with all particles or with few: a `Problem` of `problem`."""

    def __init__(self, target: Target, small: bool = False) -> None:
        self._target, self._small = target, small
        self.size, self.seed = target.size, target.seed
        self.coordinates: BoolArray = target.coordinates
        self.values, self.errors = target.data.values, target.data.errors
        self.add_noise, self.is_ln_likelihood = target.data.add_noise or small, False

    def from_unit(self, u: Array) -> Array:
        """Return the parameters (..., d) at fractions u (..., d) of their priors."""
        return self._target.from_unit(u)

    def ln_prior(self, points: Array) -> Array:
        """Return the ln prior density (n,) at points (n, d); -inf outside."""
        return self._target.ln_prior(points)

    def evaluate(self, points: Array) -> Answers:
        """Call the model at points (n, d)."""
        evaluations = self._target.predictions(points, small=self._small)
        return Answers(evaluations.mean, evaluations.variance, evaluations.details, evaluations.ln_likelihood)

    def compare(self, points: Array, mean: Array, variance: Array, details: Array) -> Array:
        """Return ln likelihood (n,) for given predictions."""
        return self._target.compare(points, mean, variance, details)

    def time_left(self) -> float:
        """Return the seconds until the run's time limit."""
        return self._target.time_left()


class LikelihoodOnly:
    """A problem whose one prediction is ln likelihood: for likelihoods that nobody can call for given predictions."""

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self.size, self.seed = problem.size, problem.seed
        self.coordinates: BoolArray = np.ones(problem.size, dtype=bool)
        self.values, self.errors, self.add_noise = np.zeros(1), np.ones(1), False
        self.is_ln_likelihood = True
        self.from_unit, self.ln_prior = problem.from_unit, problem.ln_prior
        self.time_left = problem.time_left

    def evaluate(self, points: Array) -> Answers:
        """Call the model at points (n, d)."""
        lnl = self._problem.evaluate(points).ln_likelihood
        mean = np.where(np.isfinite(lnl), lnl, np.nan)[:, None]
        return Answers(mean, 0.0 * mean, np.empty((len(points), 0)), lnl)

    def compare(self, points: Array, mean: Array, variance: Array, details: Array) -> Array:
        """Return ln of the likelihood (n,), averaged over Gaussian errors of ln likelihood: a log-normal mean."""
        return np.asarray(mean[:, 0] + 0.5 * np.minimum(variance[:, 0], MOST_VARIANCE))
