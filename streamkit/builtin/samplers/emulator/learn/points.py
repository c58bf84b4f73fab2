"""The calls that gave a prediction, as points of a regression: what each counts, and where errors are measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from streamkit import Array, BoolArray, IntArray
from streamkit.builtin.samplers.emulator.learn.emulator import SILENCE
from streamkit.builtin.samplers.emulator.learn.pairs import pairs_of
from streamkit.builtin.samplers.emulator.learn.problem import Answers, Problem
from streamkit.builtin.samplers.monomials import count

# Points lower in ln likelihood than the best by so much, plus half the number of parameters, count a quarter.
NEAR = 10.0
# The best points by ln likelihood, which is noisy: the best one is this one from the top, a fraction.
BEST = 0.01
# Effective points that the weights leave at least, for each term of a quadratic.
ENOUGH = 2.0
# Points at least, and for each parameter, on which errors are measured if fewer are close.
LEAST_CLOSE, CLOSE = 40, 3
# A call counts less if its stated noise is larger than that of most calls, this fraction of them, by this factor: one
# such call could decide the lengths of a process alone.
MOST, NOISY = 0.9, 10.0


@dataclass(frozen=True, eq=False)
class Points:
    """The calls that gave a prediction, as points of a regression.

    Attributes
    ----------
    centre, whiten
        Of the coordinates x, see `Emulator`.
    x
        (n, c) whitened coordinates.
    target, noise
        (n, m) differences from the data and stated variances, in errors of the data and in squared ones.
    weight, close
        (n,) how much a point counts, and whether errors are measured on it.
    pairs
        (p, 2) indices of calls at one place.
    """

    centre: Array
    whiten: Array
    x: Array
    target: Array
    noise: Array
    weight: Array
    close: BoolArray
    pairs: IntArray

    @classmethod
    def of(cls, problem: Problem, y: Array, answers: Answers, lnl: Array) -> Points:
        """Weigh and whiten calls with predictions at coordinates y (n, d), by ln likelihood (n,)."""
        used, z = np.isfinite(problem.values), y[:, problem.coordinates]
        weight = weights(lnl, y.shape[1], ENOUGH * count(z.shape[1], 2))
        errors = problem.errors[used]
        noise = answers.variance[:, used] / errors**2
        typical = np.maximum(NOISY * np.quantile(noise, MOST, axis=0), SILENCE)
        weight /= np.max(np.maximum(noise / typical, 1.0), axis=1)
        centre, whiten = whitening(z, weight)
        x = (z - centre) @ whiten
        target = (answers.mean[:, used] - problem.values[used]) / errors
        return cls(centre, whiten, x, target, noise, weight, nearest(lnl, y.shape[1]), pairs_of(x))

    @property
    def typical_noise(self) -> Array:
        """(m,) The mean of the stated variances near the data."""
        return np.asarray(np.average(self.noise[self.close], axis=0, weights=self.weight[self.close]))


def weights(lnl: Array, d: int, wanted: float) -> Array:
    """(n,) Weights of points with ln likelihood (n,): one near the best, falling so that enough points count."""
    away = np.maximum(best_of(lnl) - lnl, 0.0)
    scale, wanted = NEAR + 0.5 * d, min(wanted, 0.6 * len(lnl))
    for _ in range(80):
        weight = 1 / (1 + away / scale) ** 2
        if weight.sum() ** 2 / np.sum(weight**2) >= wanted:
            break
        scale *= 1.25
    return np.asarray(weight)


def nearest(lnl: Array, d: int) -> BoolArray:
    """(n,) Whether points with ln likelihood (n,) are near the data: errors are measured there, as others err more."""
    away = best_of(lnl) - lnl
    least = np.sort(away)[min(LEAST_CLOSE + CLOSE * d, len(lnl)) - 1]
    return np.asarray(away <= max(NEAR + 0.5 * d, least), dtype=bool)


def whitening(y: Array, weight: Array) -> tuple[Array, Array]:
    """(d,) and (d, d) Centre and matrix of x = (y - centre) @ matrix: half a standard deviation is 1.

    The powers of x then stay of order one.
    """
    covariance = np.atleast_2d(np.cov(y.T, aweights=weight))
    covariance[np.diag_indices_from(covariance)] *= 1 + 1e-9
    centre = np.asarray(np.average(y, axis=0, weights=weight), dtype=float)
    return centre, np.asarray(0.5 * np.linalg.inv(np.linalg.cholesky(covariance)).T, dtype=float)


def best_of(lnl: Array) -> float:
    """Return the best of noisy ln likelihoods (n,)."""
    return float(np.sort(lnl)[-max(int(BEST * len(lnl)), 1)])
