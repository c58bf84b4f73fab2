"""Posteriors with exact samples, in five families, for whatever samples a posterior from noisy calls.

All have one form. Leading parameters a have predictions g(a); each of the others, b, has the prediction
(b - f(a)) / s(a). With Gaussian errors and a flat prior that is wide enough in b, the posterior of a is that of g(a)
times the product of all s(a), by quadrature, and b given a is Gaussian about f(a), with an error of s(a) times the
datum's. The parameters are a rotation of (a, b), so that none is aligned with a difficulty.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from emulated import Problem

from streamkit.builtin.samplers.emulator.learn.problem import Answers
from streamkit.runfile import Uniform
from streamkit.stream import Data


def flat(a):
    """No shift of the others."""
    return 0.0 * a[:, :1]


def one(a):
    """No scale of the others."""
    return 1.0 + 0.0 * a[:, :1]


def silent(a):
    """No noise."""
    return 0.0 * a[:, 0]


@dataclass(frozen=True)
class Known:
    """A posterior of this form.

    Attributes
    ----------
    name, family
        What is hard about it.
    leading, others
        Numbers of parameters a and b.
    g, values, errors
        (n, m) predictions of a (n, leading), and the data: their values and errors (m,).
    f, s
        (n, 1) or (n, others) shift and scale of b at a (n, leading).
    error
        Error of the data of b.
    box
        Half width of the prior of a.
    exists
        (n,) whether there is a prediction at a (n, leading).
    noise, stated
        (n,) noise of a call in errors of the data at a (n, leading), and whether the observable states its variance.
    law
        Standardised noise (m,) of a call from a generator.
    modes
        (n,) the number of the mode at a (n, leading): those of one mode are 0.
    """

    name: str
    family: str
    leading: int
    others: int
    g: Callable
    values: tuple[float, ...]
    errors: tuple[float, ...]
    f: Callable = flat
    s: Callable = one
    error: float = 0.5
    box: float = 6.0
    exists: Callable = lambda a: np.ones(len(a), dtype=bool)
    noise: Callable = silent
    stated: bool = True
    law: Callable = lambda rng, m: rng.standard_normal(m)
    modes: Callable = lambda a: np.zeros(len(a), dtype=int)

    @property
    def size(self):
        return self.leading + self.others

    @property
    def rotation(self):
        """(d, d) parameters = (a, b) @ rotation: by 0.6 rad in the planes of neighbours, smooth and fixed."""
        total = np.eye(self.size)
        for i in range(self.size - 1):
            turn = np.eye(self.size)
            turn[i : i + 2, i : i + 2] = [[np.cos(0.6), -np.sin(0.6)], [np.sin(0.6), np.cos(0.6)]]
            total = total @ turn
        return total

    def exact(self, count, seed=1):
        """(count, d) independent samples of the posterior."""
        rng = np.random.default_rng(seed)
        side = {1: 20001, 2: 601, 3: 121}[self.leading]
        axis = np.linspace(-self.box, self.box, side)
        grid = np.stack(np.meshgrid(*[axis] * self.leading, indexing="ij"), axis=-1).reshape(-1, self.leading)
        lnp = -0.5 * np.sum(((self.g(grid) - self.values) / self.errors) ** 2, axis=1)
        lnp = lnp + np.log(np.broadcast_to(self.s(grid), (len(grid), self.others))).sum(axis=1)
        p = np.where(self.exists(grid), np.exp(lnp - lnp.max()), 0.0)
        a = grid[rng.choice(len(grid), count, p=p / p.sum())]
        a = a + (rng.random(a.shape) - 0.5) * (axis[1] - axis[0])
        b = self.f(a) + self.s(a) * self.error * rng.standard_normal((count, self.others))
        return np.concatenate([a, b], axis=1) @ self.rotation

    def apart(self, theta):
        """(n, leading) and (n, others): a and b at parameters (n, d)."""
        both = theta @ self.rotation.T
        return both[:, : self.leading], both[:, self.leading :]

    def mean(self, theta):
        """(n, m) the predictions."""
        a, b = self.apart(theta)
        return np.concatenate([self.g(a), (b - self.f(a)) / self.s(a)], axis=1)

    @property
    def data(self):
        errors = np.concatenate([self.errors, np.full(self.others, self.error)])
        return Data(np.concatenate([self.values, np.zeros(self.others)]), errors)

    @property
    def priors(self):
        """The prior: a box about all of the posterior, twice as wide as that; flat in (a, b) there."""
        found = self.exact(4000)
        middle, half = 0.5 * (found.max(axis=0) + found.min(axis=0)), np.ptp(found, axis=0)
        return tuple(Uniform(float(m - h), float(m + h)) for m, h in zip(middle, half, strict=True))


class OfKnown(Problem):
    """A known posterior as the emulator sees it."""

    def __init__(self, known, seed=1):
        super().__init__(known.priors, seed)
        self.known, self.data = known, known.data
        self.values, self.errors = self.data.values, self.data.errors
        self.coordinates = np.ones(self.size, dtype=bool)
        self.add_noise = self.is_ln_likelihood = False

    def evaluate(self, points):
        self.calls += len(points)
        a, _ = self.known.apart(points)
        m, noise = len(self.values), self.known.noise(a)
        chance = np.zeros((len(points), m))
        for i in np.flatnonzero(noise):
            rng = np.random.default_rng([self.seed, *np.ascontiguousarray(points[i]).view(np.uint32).tolist()])
            chance[i] = self.known.law(rng, m)
        mean = self.known.mean(points) + noise[:, None] * self.errors * chance
        inside = np.isfinite(self.ln_prior(points)) & self.known.exists(a)
        mean[~inside] = np.nan
        variance = (noise[:, None] * self.errors) ** 2 * self.known.stated * np.ones(m)
        lnl = np.full(len(points), -np.inf)
        lnl[inside] = self.compare(points[inside], mean[inside], 0.0 * mean[inside], None)
        return Answers(mean, variance, np.empty((len(points), 0)), lnl)

    def compare(self, points, mean, variance, details):
        return self.data.gaussian_of_many(mean, variance)


def first(a):
    return a


def bent(k, curvature=2.0, offset=3.0):
    """The first of k others follows a parabola."""
    return lambda a: np.concatenate([curvature * a[:, :1] ** 2 - offset, np.zeros((len(a), k - 1))], axis=1)


def both_bent(k, curvature=2.0):
    """The first two of k others follow parabolas of the two leading parameters."""
    return lambda a: np.concatenate([curvature * a[:, :2] ** 2 - 3, np.zeros((len(a), k - 2))], axis=1)


def side(a):
    """Which side of zero."""
    return (a[:, 0] > 0).astype(int)


def double(x, left=-2.0, right=2.0):
    """A quadratic with roots at left and right."""
    return (x - left) * (x - right)


def weighed(a):
    """Two modes, and a datum that is 3.2 errors off in the lower one."""
    return np.concatenate([double(a), 3.2 / (1 + np.exp(3 * a))], axis=1)


def correlated(rng, m):
    """One error of a call for all data."""
    return np.full(m, rng.standard_normal())


def heavy(rng, m):
    """Student's t with four degrees of freedom, of unit variance."""
    return rng.standard_t(4, m) / np.sqrt(2)


def skewed(rng, m):
    """An exponential distribution, of unit variance about zero."""
    return rng.exponential(size=m) - 1


def curvature():
    yield Known("straight in 2", "curvature", 1, 1, first, (0.3,), (1.0,))
    yield Known("straight in 20", "curvature", 1, 19, first, (0.3,), (1.0,))
    yield Known("mild banana in 6", "curvature", 2, 4, first, (0.0, 0.0), (1.0, 1.0), both_bent(4, 0.5), error=0.3)
    yield Known("strong banana in 6", "curvature", 2, 4, first, (0.0, 0.0), (1.0, 1.0), both_bent(4, 2.0), error=0.3)
    yield Known("thin banana in 3", "curvature", 1, 2, first, (0.0,), (1.0,), bent(2, 1.0), error=0.1)
    yield Known("banana in 12", "curvature", 1, 11, first, (0.5,), (1.0,), bent(11, 1.0), error=0.3)
    yield Known("cubic in 4", "curvature", 1, 3, first, (0.0,), (1.0,), lambda a: np.tile(0.4 * a**3, 3), error=0.4)
    yield Known("wave in 3", "curvature", 1, 2, first, (0.0,), (1.5,), lambda a: np.tile(np.sin(1.5 * a), 2), error=0.3)
    yield Known("funnel in 4", "curvature", 1, 3, first, (0.0,), (1.2,), flat, lambda a: np.exp(0.5 * a), error=1.0)
    yield Known(
        "ring in 3", "curvature", 2, 1, lambda a: np.sum(a**2, axis=1, keepdims=True), (4.0,), (0.8,), box=4.0
    )  # fmt: skip


def modes():
    def two(name, f=flat, s=one, others=3, left=-2.0, right=2.0, error=0.5, spread=1.5, **fields):
        def g(a):
            return double(a, left, right)

        return Known(name, "modes", 1, others, g, (0.0,), (spread,), f, s, error, modes=side, **fields)

    yield two("two equal modes in 4")
    yield two("two equal modes in 8", others=7)
    yield two("70 to 30", s=lambda a: np.where(a > 0, 1.0, (3 / 7) ** (1 / 3)))
    yield Known("the lighter four times wider", "modes", 1, 3, weighed, (0.0, 0.0), (1.5, 1.0),
                lambda a: np.where(a > 0, 0.0, 2.0 + 0 * a), lambda a: np.where(a > 0, 1.0, 4.0), error=0.3,
                modes=side)  # fmt: skip
    yield two("smoothly wider", s=lambda a: np.exp(0.25 * a))
    yield two("bent modes", f=lambda a: np.tile(0.5 * a**2, 3), error=0.3)
    yield two("near modes", left=-1.0, right=1.0, spread=0.5)
    yield Known("three modes in 3", "modes", 1, 2, lambda a: a**3 - 3 * a, (0.0,), (0.8,),
                modes=lambda a: (a[:, 0] > -0.87).astype(int) + (a[:, 0] > 0.87), box=4.0)  # fmt: skip
    yield Known("four modes in 4", "modes", 2, 2, lambda a: a**2, (3.0, 3.0), (1.0, 1.0),
                modes=lambda a: (a[:, 0] > 0) + 2 * (a[:, 1] > 0), box=4.0)  # fmt: skip


def noise():
    straight = {"leading": 1, "others": 3, "g": first, "values": (0.0,), "errors": (1.0,)}
    loud = {"noise": lambda a: 1.0 + 0.0 * a[:, 0]}
    for stated in (True, False):
        yield Known(f"one error, stated {stated}", "noise", **straight, **loud, stated=stated)
    yield Known("half an error in a banana", "noise", 1, 3, first, (0.0,), (1.0,), bent(3, 0.5),
                noise=lambda a: 0.5 + 0.0 * a[:, 0])  # fmt: skip
    yield Known("one error, the same for all data", "noise", **straight, **loud, law=correlated)
    yield Known("heavy tails", "noise", **straight, **loud, law=heavy)
    yield Known("skewed, not stated", "noise", **straight, **loud, law=skewed, stated=False)
    yield Known("louder on one side", "noise", **straight, noise=lambda a: 0.8 / (1 + np.exp(-2 * a[:, 0])))
    yield Known("louder on one side, not stated", "noise", **straight, stated=False,
                noise=lambda a: 0.8 / (1 + np.exp(-2 * a[:, 0])))  # fmt: skip
    yield Known("one error in 10", "noise", 1, 9, first, (0.0,), (1.0,), **loud)
    yield Known("two errors", "noise", **straight, noise=lambda a: 2.0 + 0.0 * a[:, 0])


def edges():
    cut = {"leading": 2, "others": 1, "g": first, "values": (0.0, 0.0), "errors": (1.0, 1.0)}
    yield Known("an edge through the middle", "edges", **cut, exists=lambda a: a[:, 0] > 0)
    yield Known("a corner", "edges", **cut, exists=lambda a: (a[:, 0] > -0.5) & (a[:, 1] > 0.3 * a[:, 0]))
    yield Known("a curved edge", "edges", **cut, exists=lambda a: a[:, 1] > 0.7 * a[:, 0] ** 2 - 0.7)
    yield Known("a hole", "edges", **cut, exists=lambda a: np.sum(a**2, axis=1) > 0.8)
    yield Known("an edge in a banana", "edges", 1, 3, first, (0.0,), (1.0,), bent(3, 0.5),
                exists=lambda a: a[:, 0] > -0.4)  # fmt: skip
    yield Known("an edge far out", "edges", **cut, exists=lambda a: a[:, 0] > -2.0)


def kinks():
    def kinked(name, f, **fields):
        return Known(name, "kinks", 1, 3, first, (0.0,), (1.0,), f, **fields)

    yield kinked("a kink", lambda a: np.tile(np.abs(a), 3))
    yield kinked("a sharp kink", lambda a: np.tile(3 * np.abs(a), 3), error=0.3)
    yield kinked("a step of one error", lambda a: np.tile(0.5 * (a > 0.3), 3))
    yield kinked("a step of four errors", lambda a: np.tile(2.0 * (a > 0.3), 3))
    yield kinked("a smooth step", lambda a: np.tile(np.tanh(3 * a), 3), error=0.4)
    yield kinked("a kink with noise", lambda a: np.tile(np.abs(a), 3), noise=lambda a: 0.5 + 0.0 * a[:, 0])


def off(known, samples):
    """How far samples (n, d) are off: largest errors of a mean, a width, in standard deviations, and of a mode."""
    exact = known.exact(50_000)
    mean, sd = exact.mean(axis=0), exact.std(axis=0)
    _, axes = np.linalg.eigh(np.cov((exact / sd).T))
    found, right = (np.concatenate([x, (x - mean) / sd @ axes], axis=1) for x in (samples, exact))
    numbers = [known.modes(known.apart(x)[0]) for x in (samples, exact)]
    count = 1 + max(each.max() for each in numbers)
    shares = [np.bincount(each, minlength=count) / len(each) for each in numbers]
    return (
        np.abs((found.mean(axis=0) - right.mean(axis=0)) / right.std(axis=0)).max(),
        np.abs(found.std(axis=0) / right.std(axis=0) - 1).max(),
        np.abs(shares[0] - shares[1]).max(),
    )


KNOWN = tuple(each for family in (curvature, modes, noise, edges, kinks) for each in family())
