"""Joint posteriors of several factors with answers in closed form."""

from itertools import pairwise

import numpy as np
from scipy import stats

from streamkit.builtin.samplers.emulator.learn.problem import Answers
from streamkit.builtin.samplers.emulator.walk.density import Factor, Layout, Tangent, Terms


class LinearFactors:
    """Data that are linear in the parameters, with unit errors: ln L_k = -|A_k h + C_k s_k - d_k|^2 / 2.

    The priors are standard normals, so that the joint posterior is a Gaussian in closed form.
    """

    def __init__(self, factors, shared=4, own=5, data=16, seed=1, own_of=None, strength=3.0, reads=None):
        rng = np.random.default_rng(seed)
        sizes = [own] * factors if own_of is None else own_of
        ends = shared + np.cumsum([0, *sizes])
        self.layout = Layout(np.arange(shared), [np.arange(a, b) for a, b in pairwise(ends)])
        self.host = [strength * rng.standard_normal((data, shared)) / np.sqrt(data) for _ in sizes]
        for k, columns in enumerate(reads or []):
            self.host[k][:, [i for i in range(shared) if i not in columns]] = 0.0
        self.mine = [2 * strength * rng.standard_normal((data, n)) / np.sqrt(data) for n in sizes]
        truth = rng.standard_normal(shared)
        self.data = [
            a @ truth + c @ rng.standard_normal(c.shape[1]) + rng.standard_normal(data)
            for a, c in zip(self.host, self.mine, strict=True)
        ]
        self.evaluations = 0

    def terms(self, y):
        h = y[:, self.layout.shared]
        prior, lnl = [-0.5 * np.sum(h**2, axis=1)], []
        for k, own in enumerate(self.layout.own):
            prior.append(-0.5 * np.sum(y[:, own] ** 2, axis=1))
            lnl.append(self.ln_likelihood(k, h, y[:, own]))
            self.evaluations += len(y)
        return Terms(np.stack(prior, axis=1), np.stack(lnl, axis=1))

    def ln_likelihood(self, k, h, s):
        return -0.5 * np.sum((h @ self.host[k].T + s @ self.mine[k].T - self.data[k]) ** 2, axis=1)

    def tangents(self, y):
        h, found = y[:, self.layout.shared], []
        for k, own in enumerate(self.layout.own):
            away = h @ self.host[k].T + y[:, own] @ self.mine[k].T - self.data[k]
            slopes = np.concatenate([self.host[k], self.mine[k]], axis=1).T
            columns = np.concatenate([self.layout.shared, own])
            found.append(Tangent.of(away, np.tile(slopes, (len(y), 1, 1)), columns))
        return found

    def answer(self):
        """Mean (d,) and covariance (d, d) of the joint posterior."""
        d = self.layout.size
        precision, pull = np.eye(d), np.zeros(d)
        for k, own in enumerate(self.layout.own):
            design = np.zeros((len(self.data[k]), d))
            design[:, self.layout.shared], design[:, own] = self.host[k], self.mine[k]
            precision += design.T @ design
            pull += design.T @ self.data[k]
        covariance = np.linalg.inv(precision)
        return covariance @ pull, covariance

    def begin(self, seed, n=640):
        """Two sets of places (n, d): the host from its prior, each stream where it fits another host."""
        rng = np.random.default_rng(seed)
        return tuple(rng.standard_normal((n, self.layout.size)) for _ in range(2))


class Mixture(LinearFactors):
    """The same with two sets of data of the last factor, of which nobody knows which is right: a mode for each.

    The posterior is a mixture of two Gaussians. The second set has such odds that its mode has this weight.
    """

    def __init__(self, *args, apart=4.0, weight=0.4, **kwargs):
        super().__init__(*args, **kwargs)
        rng = np.random.default_rng(99)
        shift = rng.standard_normal(self.mine[-1].shape[1])
        self.other = self.data[-1] + self.mine[-1] @ (apart * shift / np.linalg.norm(shift))
        self.odds = 1.0
        first, second = self.modes()[0]
        self.odds = weight / (1 - weight) * first / second

    def ln_likelihood(self, k, h, s):
        first = super().ln_likelihood(k, h, s)
        if k < len(self.data) - 1:
            return first
        away = h @ self.host[k].T + s @ self.mine[k].T - self.other
        return np.logaddexp(first, np.log(self.odds) - 0.5 * np.sum(away**2, axis=1))

    def modes(self):
        """Weights (2,), means and covariances of the modes."""
        found, data = [], self.data[-1]
        for each in (data, self.other):
            self.data[-1] = each
            mean, covariance = self.answer()
            # ln evidence of a linear model, up to what both modes share
            found.append((self._quadratic(mean), mean, covariance))
        self.data[-1] = data
        ln = np.array([found[0][0], found[1][0] + np.log(self.odds)])
        weight = np.exp(ln - ln.max())
        return weight / weight.sum(), [each[1] for each in found], [each[2] for each in found]

    def _quadratic(self, mean):
        y, total = mean[None], -0.5 * mean @ mean
        h = y[:, self.layout.shared]
        return total + sum(
            LinearFactors.ln_likelihood(self, k, h, y[:, own])[0] for k, own in enumerate(self.layout.own)
        )


class HalfEmpty(LinearFactors):
    """The same, where the first factor has no prediction for a negative first shared coordinate."""

    def ln_likelihood(self, k, h, s):
        lnl = super().ln_likelihood(k, h, s)
        return np.where(h[:, 0] < 0, -np.inf, lnl) if k == 0 else lnl


class OfFactor:
    """The problem of one factor of `LinearFactors`: its data are called with noise of so many errors."""

    def __init__(self, target, k, noise=0.3, seed=1):
        self.target, self.k, self.noise, self.seed = target, k, noise, seed
        self.columns = target.layout.of(k)
        self.size, self.calls = len(self.columns), 0
        self.coordinates = np.ones(self.size, dtype=bool)
        self.values, self.errors = target.data[k], np.ones(len(target.data[k]))
        self.add_noise = self.is_ln_likelihood = False
        self.is_shared = np.isin(self.columns, target.layout.shared)

    def from_unit(self, u):
        return stats.norm.ppf(np.clip(u, 1e-12, 1 - 1e-12))

    def ln_prior(self, points):
        return -0.5 * np.sum(points**2, axis=1)

    def mean_at(self, points):
        h, s = points[:, self.is_shared], points[:, ~self.is_shared]
        return h @ self.target.host[self.k].T + s @ self.target.mine[self.k].T

    def evaluate(self, points):
        self.calls += len(points)
        mean = self.mean_at(points)
        for i, point in enumerate(points):
            rng = np.random.default_rng([self.seed, *point.view(np.uint32).tolist()])
            mean[i] += self.noise * rng.standard_normal(mean.shape[1])
        variance = np.full(mean.shape, self.noise**2)
        return Answers(mean, variance, np.empty((len(points), 0)), self.compare(points, mean, 0 * variance, None))

    def compare(self, points, mean, variance, details):
        total = 1 + variance
        return -0.5 * np.sum((mean - self.values) ** 2 / total + np.log(total), axis=1)

    def time_left(self):
        return np.inf


def factors_of(target, **kwargs):
    """The factors of a target, and all its coordinates."""
    problems = [OfFactor(target, k, **kwargs) for k in range(len(target.data))]
    shared = target.layout.shared
    return [
        Factor(f"stream {k}", problem, problem, shared, own)
        for k, (problem, own) in enumerate(zip(problems, target.layout.own, strict=True))
    ]
