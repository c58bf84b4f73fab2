"""Posteriors known in closed form for the sampling code."""

from __future__ import annotations

import time
from collections import deque

import numpy as np

from streamkit.builtin.samplers.ensemble.sampler import Emcee
from streamkit.runfile import Uniform
from streamkit.sample import (
    ChainMemory,
    Evaluation,
    PosteriorTarget,
    SamplingProgress,
    Storage,
    Workers,
    run_sampler,
)  # fmt: skip
from streamkit.stream import Data

MEAN = np.array([1.0, -2.0, 0.5])
COVARIANCE = np.array([[1.0, 0.6, 0.0], [0.6, 2.0, -0.3], [0.0, -0.3, 0.5]])
PRIORS = (Uniform(-20, 20), Uniform(-20, 20), Uniform(-20, 20))


class Gaussian:
    """A correlated Gaussian; half of the space has no stream if ``cut``."""

    priors, data = PRIORS, Data(np.zeros(2), np.ones(2))

    def __init__(self, cut: bool = False) -> None:
        self.cut = cut
        self.inverse = np.linalg.inv(COVARIANCE)

    def evaluate(self, theta):
        if self.cut and theta[0] < MEAN[0]:
            return Evaluation(-np.inf, -np.inf, np.full(2, np.nan), np.full(2, np.nan), "no stream on this side")
        x = theta - MEAN
        inside = all(np.isfinite(p.lnpdf(v)) for p, v in zip(PRIORS, theta, strict=True))
        if not inside:
            return Evaluation(-np.inf, -np.inf, np.full(2, np.nan), np.full(2, np.nan), "outside the prior")
        lnl = float(-0.5 * x @ self.inverse @ x)
        return Evaluation(lnl - 3 * np.log(40), lnl, theta[:2], np.zeros(2))


def walk(toy, pool: Workers, chain: ChainMemory, seed=5, progress=False, **fields) -> PosteriorTarget:
    """Sample a toy by the default sampler; the chain has as many steps as the fields say, or as it needs."""
    storage, display = Storage(chain=chain, is_chain=True), SamplingProgress(progress)
    target = PosteriorTarget(toy.priors, toy.data, seed, pool, storage, display=display)
    fields = {"walkers": 24, "moves": "de", "tau_factor": 1e9, "r_hat": 1e9} | fields
    deque(run_sampler(Emcee(**fields), target), maxlen=0)
    chain.consolidate()
    return target


class OfPriors:
    """What the moves need of a target: its priors."""

    def __init__(self, priors) -> None:
        self.priors, self.size = priors, len(priors)

    def from_unit(self, u):
        return np.array([prior.ppf(x) for prior, x in zip(self.priors, u, strict=True)])

    def ln_prior(self, points):
        return sum(prior.lnpdf_of_many(x) for prior, x in zip(self.priors, points.T, strict=True))


class Slow(Gaussian):
    """One that never ends for a tenth of the points."""

    def evaluate(self, theta):
        if int(abs(theta[0]) * 1e6) % 10 == 0:
            time.sleep(self.seconds)
        return super().evaluate(theta)

    def rejected(self, reason):
        return Evaluation(-np.inf, -np.inf, np.full(2, np.nan), np.full(2, np.nan), reason)

    def __init__(self, seconds: float) -> None:
        super().__init__()
        self.seconds = seconds


class Banana:
    """Two curved observables of three parameters, uniform between -3 and 3."""

    priors = (Uniform(-3, 3), Uniform(-3, 3), Uniform(-3, 3))
    data = Data(np.array([0.5, 1.0]), np.array([0.3, 0.5]))

    def mean(self, theta):
        x, y, z = theta
        return np.array([x + 0.5 * y**2, z - x + 0.3 * x * y])

    def ln_likelihood(self, theta):
        return float(-0.5 * np.sum(((self.mean(theta) - self.data.values) / self.data.errors) ** 2))

    def evaluate(self, theta):
        if (np.abs(theta) > 3).any():
            nothing = np.full(len(self.data.values), np.nan)
            return Evaluation(-np.inf, -np.inf, nothing, nothing, "outside the prior")
        lnl = self.ln_likelihood(theta)
        return Evaluation(lnl - 3 * np.log(6), lnl, self.mean(theta), np.zeros(len(self.data.values)))


class Many(Banana):
    """Forty correlated data along the curve of the two."""

    x = np.linspace(-1, 1, 40)
    sigma = np.full(40, 1.5)
    covariance = 1.5**2 * np.exp(-np.abs(x[:, None] - x) / 0.1)
    data = Data(0.5 + x, sigma, covariance=covariance)
    inverse = np.linalg.inv(covariance)

    def mean(self, theta):
        first, second = super().mean(theta)
        return first + second * self.x

    def ln_likelihood(self, theta):
        away = self.mean(theta) - self.data.values
        return float(-0.5 * away @ self.inverse @ away)


class Heavy(Banana):
    """The two data with Student's t of three degrees of freedom in place of Gaussians."""

    def ln_likelihood(self, theta):
        away = (self.mean(theta) - self.data.values) / self.data.errors
        return float(-2 * np.log1p(away**2 / 3).sum())


def banana_run(chain: ChainMemory, steps: int, moves: str, toy: Banana | None = None, **fields):
    toy = Banana() if toy is None else toy
    with Workers({"full": toy, "cheap": toy}) as pool:
        return walk(toy, pool, chain, walkers=16, steps=steps, moves=moves, **fields)
