"""Posteriors that samplers find hard, with their exact means and standard deviations: each has one difficulty.

All are functions of what an observable would predict, as in a fit, with uniform priors: the surrogate of the default
sampler learns from that. A toy has the attributes ``priors``, ``data`` and ``evaluate`` of a posterior.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from streamkit.runfile import Uniform
from streamkit.sample import Evaluation
from streamkit.stream import Data


class Toy:
    """Independent Gaussian data about ``mean(theta)``; a box for a prior."""

    box: tuple[tuple[float, float], ...]
    values: tuple[float, ...]
    errors: tuple[float, ...]

    def __init__(self):
        self.priors = tuple(Uniform(*ends) for ends in self.box)
        self.data = Data(np.array(self.values), np.array(self.errors))
        self._low, self._high = np.array(self.box).T
        self._ln_volume = float(np.log(self._high - self._low).sum())

    @property
    def name(self):
        return " ".join(self.__doc__.split(":")[0].split()).lower()

    def mean(self, theta):
        """(m, ...) predictions at parameters (d, ...)."""
        raise NotImplementedError

    def smooth(self, theta):
        """(...) ln likelihood that the exact moments are those of."""
        shape = (-1,) + (1,) * (np.ndim(theta) - 1)
        away = (self.mean(theta) - np.reshape(self.values, shape)) / np.reshape(self.errors, shape)
        return -0.5 * (away**2).sum(axis=0)

    def roughness(self, theta):
        """What is added to it at each call."""
        return 0.0

    def allowed(self, theta):
        """Whether there is a stream."""
        return np.ones(np.shape(theta)[1:], dtype=bool)

    def evaluate(self, theta):
        outside = (theta < self._low).any() or (theta > self._high).any()
        if outside or not self.allowed(theta):
            nothing = np.full(len(self.values), np.nan)
            reason = "outside the prior" if outside else "no stream on this side"
            return Evaluation(-np.inf, -np.inf, nothing, nothing, reason)
        lnl = float(self.smooth(theta) + self.roughness(theta))
        return Evaluation(lnl - self._ln_volume, lnl, np.asarray(self.mean(theta)), np.zeros(len(self.values)))

    @cached_property
    def moments(self):
        """(d,) means and (d,) standard deviations, by an integral over a grid of the first parameters.

        `integrated` says how many; the others are independent of these and Gaussian, as `rest` has them.
        """
        axes = [
            low + (high - low) * (np.arange(n) + 0.5) / n for (low, high), n in zip(self.box, self.grid, strict=False)
        ]
        total, first, second = 0.0, 0.0, 0.0
        across = [place.ravel() for place in np.meshgrid(*axes[1:], indexing="ij")]
        size = len(across[0]) if across else 1
        others = [np.zeros(size)] * (len(self.box) - len(self.grid))
        for x in axes[0]:  # by slices: the whole grid would not fit
            points = np.array([np.full(size, x), *across, *others])
            weight = np.where(self.allowed(points), np.exp(self.smooth(points)), 0.0)
            total = total + weight.sum()
            first, second = first + points @ weight, second + points**2 @ weight
        mean = first / total
        sd = np.sqrt(second / total - mean**2)
        rest = self.rest
        if rest:
            mean[-len(rest) :], sd[-len(rest) :] = np.array(rest).T
        return mean, sd

    grid: tuple[int, ...]
    rest: tuple[tuple[float, float], ...] = ()


class Curved(Toy):
    """Banana: two data, three parameters, a curved sheet that the prior ends."""

    box = ((-3.0, 3.0),) * 3
    values, errors, grid = (0.5, 1.0), (0.3, 0.5), (120, 120, 120)

    def mean(self, theta):
        x, y, z = theta
        return np.array([x + 0.5 * y**2, z - x + 0.3 * x * y])


class Wavy(Curved):
    """Waves: what no polynomial of low degree follows."""

    def mean(self, theta):
        x, y, z = theta
        return np.array([x + 0.5 * np.sin(3 * y), z - x])


class TwoModes(Toy):
    """Two modes: eighteen standard deviations apart."""

    box = ((-5.0, 5.0),) * 4
    values, errors, grid, rest = (4.0, 0.3, 0.0, 0.5), (0.9, 0.5, 0.5, 0.4), (4000, 100), ((0.0, 0.5), (0.5, 0.4))

    def mean(self, theta):
        x, y, z, w = theta
        return np.array([x**2 + 0.3 * x, y - 0.1 * x, z, w])


class Edges(Toy):
    """Hard edges: beyond two oblique ones, where the likelihood is largest, there is no stream."""

    box = ((-4.0, 4.0),) * 3
    values, errors, grid = (-0.5, 0.5, 0.0), (0.8, 0.8, 0.8), (160, 160, 160)

    def mean(self, theta):
        return np.array(theta)

    def allowed(self, theta):
        x, y, z = theta
        return (x > 0.3 * y) & (y < 0.2 + 0.5 * z)


class Thin(Toy):
    """Thin tail: a ridge of constant x y that narrows by a factor ten."""

    box = ((0.2, 10.0), (0.1, 8.0), (-4.0, 4.0))
    values, errors, grid, rest = (1.5, 0.0), (0.1, 0.5), (4000, 4000), ((0.0, 0.5),)

    def mean(self, theta):
        x, y, z = theta
        return np.array([x * y, z])


class Rough(Toy):
    """Rough ln p: a Gaussian with waves of rms 1.5 in ln p, far shorter than it is wide."""

    box = ((-5.0, 5.0),) * 4
    values, errors, grid = (0.0, 0.3, 0.0, 0.5), (0.5, 0.5, 0.5, 0.4), (2,)
    rest = ((0.0, 0.5), (0.3, 0.5), (0.0, 0.5), (0.5, 0.4))
    waves = np.random.default_rng(7).standard_normal((12, 4)) * 40.0
    phases = np.random.default_rng(8).uniform(0, 2 * np.pi, 12)

    def mean(self, theta):
        return np.array(theta)

    def roughness(self, theta):
        return 1.5 * np.sqrt(2 / 12) * np.cos(self.waves @ theta + self.phases).sum()


class Funnel(Toy):
    """Funnel: three parameters whose widths are the exponential of half a fourth one (Neal 2003)."""

    box = ((-8.0, 8.0), (-80.0, 80.0), (-80.0, 80.0), (-80.0, 80.0))
    values, errors, grid = (0.0, 0.0, 0.0, 0.0), (1.5, 1.0, 1.0, 1.0), (2,)
    rest = ((0.0, 1.5), *((0.0, float(np.exp(1.5**2 / 4))),) * 3)

    def mean(self, theta):
        v = theta[0]
        return np.array([v, *(x * np.exp(-0.5 * v) for x in theta[1:])])

    def smooth(self, theta):
        return super().smooth(theta) - 1.5 * theta[0]


TOYS = (Curved, TwoModes, Edges, Thin, Rough, Funnel)
