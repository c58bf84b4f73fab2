"""Posteriors known in closed form for the sampling code."""

from __future__ import annotations

import time

import numpy as np

from streamkit.observe import Data
from streamkit.runfile import Uniform
from streamkit.sample import Evaluation, Sampling, Workers, blob_dtype

MEAN = np.array([1.0, -2.0, 0.5])
COVARIANCE = np.array([[1.0, 0.6, 0.0], [0.6, 2.0, -0.3], [0.0, -0.3, 0.5]])
PRIORS = (Uniform(-20, 20), Uniform(-20, 20), Uniform(-20, 20))


class Gaussian:
    """A correlated Gaussian; half of the space has no stream if ``cut``."""

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


def sampling(pool: Workers, backend, seed: int = 5, walkers: int = 24, moves: str = "de") -> Sampling:
    return Sampling(PRIORS, walkers, seed, moves, pool, backend, blob_dtype(2), progress=False)


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


def banana_run(backend, limits, moves: str, resume: bool = False, toy: Banana | None = None):
    toy = Banana() if toy is None else toy
    m = len(toy.data.values)
    with Workers({"full": toy, "cheap": toy}) as pool:
        run = Sampling(toy.priors, 16, 5, moves, pool, backend, blob_dtype(m), progress=False, data=toy.data)
        if resume:
            run.resume()
        else:
            run.begin()
        return run, run.advance(limits)
