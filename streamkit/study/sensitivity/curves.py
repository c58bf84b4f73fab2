"""The observables against one parameter: the grid, the curve, and its slope."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import ndtr

from streamkit.runfile import LogUniform, Prior
from streamkit.sample import Evaluation
from streamkit.stream import Array, IntArray

# Probability of the prior in the range over which a parameter is varied; the rest is equal on both sides.
CENTRAL = 0.95
SAME = 1e-9  # distance in units of the grid's range below which a point of the grid is the fixed point


@dataclass(frozen=True)
class Slope:
    """The slope of a curve at the fixed point, of a parabola through the points within one sd of the prior.

    The sd is half the prior's central 68 %, of ln x for a log-uniform prior. For each observable (m,): the parabola at
    the fixed point; the change over one sd at the slope there, and its standard error from the scatter about the
    parabola; the derivative per unit of the parameter. NaN with fewer than three points that have a value; with three
    it is a straight line.
    """

    sd: float
    at: Array
    per_sd: Array
    error: Array
    per_unit: Array


@dataclass(frozen=True)
class Curve:
    """The observables against one parameter, which is at ``fixed`` while others are varied.

    x (n,) are the values of the parameter in order, with the fixed one. Further arrays (n, m) are the mean over the
    seeds that have a value, NaN without any; the standard deviation, NaN below two seeds; and the noise of the
    observable. ``streams`` (n,) counts the seeds that have a value; ``reasons`` are the reasons of the others.
    """

    name: str
    unit: str
    prior: Prior
    fixed: float
    x: Array
    mean: Array
    scatter: Array
    noise: Array
    streams: IntArray
    reasons: tuple[Counter[str], ...]

    @cached_property
    def missing(self) -> int:
        """The number of points without a value."""
        return int((self.streams == 0).sum())

    @cached_property
    def slope(self) -> Slope:
        """The slope at the fixed point."""
        logarithmic = isinstance(self.prior, LogUniform)
        x, fixed = (np.log(self.x), np.log(self.fixed)) if logarithmic else (self.x, self.fixed)
        low, high = self.prior.ppf(ndtr(np.array([-1.0, 1.0])))
        sd = float(0.5 * (np.log(high / low) if logarithmic else high - low))
        inside = (np.abs(x - fixed) <= (1 + SAME) * sd) & (self.streams > 0)
        z, degree = (x[inside] - fixed) / sd, min(int(inside.sum()) - 2, 2)
        if degree < 1:
            nothing = np.full(self.mean.shape[1], np.nan)
            return Slope(sd, nothing, nothing, nothing, nothing)
        powers = np.stack([z**k for k in range(degree + 1)], axis=1)
        solve = np.linalg.inv(powers.T @ powers)
        parabola = solve @ powers.T @ self.mean[inside]
        scatter = ((self.mean[inside] - powers @ parabola) ** 2).sum(axis=0) / (len(z) - degree - 1)
        per_unit = parabola[1] / sd / (self.fixed if logarithmic else 1.0)
        return Slope(sd, parabola[0], parabola[1], np.sqrt(solve[1, 1] * scatter), per_unit)


def prior_grid(prior: Prior, points: int) -> Array:
    """(points,) Even steps over the central 95 % of the prior; in ln x if it is log-uniform."""
    low, high = prior.ppf(0.5 + 0.5 * CENTRAL * np.array([-1.0, 1.0]))
    return np.geomspace(low, high, points) if isinstance(prior, LogUniform) else np.linspace(low, high, points)


def with_fixed(x: Array, fixed: float) -> Array:
    """Return the points of a grid in order, the fixed one among them, in place of its like if there is one."""
    return np.sort(np.append(x[np.abs(x - fixed) > SAME * (x[-1] - x[0])], fixed))


def curve_of(
    name: str, unit: str, prior: Prior, fixed: float, x: Array, evaluations: Sequence[list[Evaluation]]
) -> Curve:
    """Return the curve of the evaluations at x (n,), of all seeds at each point."""
    good = [[one for one in some if not one.reason] for some in evaluations]
    nothing = np.full(len(evaluations[0][0].mean), np.nan)
    return Curve(
        name, unit, prior, fixed, x,
        np.array([np.mean([e.mean for e in some], axis=0) if some else nothing for some in good]),
        np.array([np.std([e.mean for e in some], axis=0, ddof=1) if len(some) > 1 else nothing for some in good]),
        np.array([np.sqrt(np.mean([e.variance for e in some], axis=0)) if some else nothing for some in good]),
        np.array([len(some) for some in good]),
        tuple(Counter(one.reason for one in some if one.reason) for some in evaluations),
    )  # fmt: skip
