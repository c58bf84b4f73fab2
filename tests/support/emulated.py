"""What the emulator samples: a toy in this process."""

from __future__ import annotations

import numpy as np

from streamkit.builtin.samplers.emulator.learn.calls import Calls
from streamkit.builtin.samplers.emulator.learn.problem import Answers
from streamkit.builtin.samplers.emulator.learn.space import Space


def ln_densities(priors, points):
    """(n,) ln density of independent priors at points (n, d)."""
    return sum(prior.lnpdf_of_many(x) for prior, x in zip(priors, points.T, strict=True))


class Problem:
    """Common to all."""

    def __init__(self, priors, seed):
        self.priors, self.seed, self.size = priors, seed, len(priors)
        self.calls = 0

    def from_unit(self, u):
        return np.stack([prior.ppf(u[..., i]) for i, prior in enumerate(self.priors)], axis=-1)

    def ln_prior(self, points):
        return ln_densities(self.priors, points)

    def time_left(self):
        return np.inf


class OfToy(Problem):
    """That of a toy, with noise added to its predictions: so much in ln L."""

    def __init__(self, toy, seed=1, noise=0.0, stated=True):
        super().__init__(toy.priors, seed)
        self.toy, self.data = toy, toy.data
        self.values, self.errors = toy.data.values, toy.data.errors
        self.coordinates = np.ones(self.size, dtype=bool)
        self.add_noise = self.is_ln_likelihood = False
        self.noise, self.stated = noise, stated

    def evaluate(self, points):
        self.calls += len(points)
        m = len(self.values)
        mean, lnl = np.full((len(points), m), np.nan), np.full(len(points), -np.inf)
        for i, theta in enumerate(points):
            found = self.toy.evaluate(theta)
            if np.isfinite(found.lnp):
                rng = np.random.default_rng([self.seed, *theta.view(np.uint32).tolist()])
                mean[i] = found.mean + self.noise * self.errors * rng.standard_normal(m)
        good = np.isfinite(mean).all(axis=1)
        variance = np.broadcast_to((self.noise * self.errors) ** 2 * self.stated, mean.shape)
        lnl[good] = self.compare(points[good], mean[good], 0 * mean[good], None)
        return Answers(mean, variance.copy(), np.empty((len(points), 0)), lnl)

    def compare(self, points, mean, variance, details):
        return self.data.gaussian_of_many(mean, variance)


def called(problem, count, seed=1):
    """Calls at draws of the prior."""
    u = np.random.default_rng(seed).random((count, problem.size))
    return Calls.of(problem, Space(problem), problem.from_unit(u))
