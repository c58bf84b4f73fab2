"""Trajectories along a posterior that is a thin bent sheet: Hamiltonian steps in the space of parameters and residuals.

Data with small errors leave a sheet of parameters, bent as the predictions are. The residuals r(z), in their errors,
make it flat: in the space of (z, r) the prior and a Gaussian likelihood are one normal distribution, and the places
(z, r(z)) a surface of its own dimension, as wide across the sheet as along it. A walker gets a velocity, and follows
geodesics of this surface, drawn towards the centre (Graham, Thiery & Beskos 2022, J. R. Statist. Soc. B 84, 1229; the
integrator is RATTLE, of Leimkuhler & Skeel 1994, reversible where a step back arrives: Zappa, Holmes-Cerfon & Goodman
2018, Comm. Pure Appl. Math. 71, 2609). The metric is that of Gauss and Newton, 1 + J J', J the slopes of the residuals.
Whatever the density is, its ratio accepts or rejects the end of a trajectory.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from streamkit import Array, BoolArray, IntArray
from streamkit.builtin.samplers.emulator.walk.arrow import Arrow, solved, times
from streamkit.builtin.samplers.emulator.walk.density import Layout, Tangent

# Lengths of a step, in standard deviations, between which each walker draws one by its logarithm; steps at most.
SHORTEST, LONGEST, MOST_STEPS = 0.1, 1.2, 3
# Newton steps to the surface at most, and the largest last one. A walker that does not come back to where it was, to
# this distance in the metric, stays there.
NEWTON, ARRIVED, BACK = 8, 1e-6, 1e-2
# Beyond this a place, or a slope, says nothing.
FARTHEST, STEEPEST = 30.0, 1e6

# From places (n, d): what the data say there.
Tangents = Callable[[Array], Sequence[Tangent]]


@dataclass(frozen=True, eq=False)
class Surface:
    """The surface of a posterior at an inverse temperature.

    Attributes
    ----------
    tangents
        Of its factors.
    layout
        Which coordinates belong to which factor.
    beta
        The inverse temperature.
    precision
        (d, d) of the posterior: the metric where no factor has residuals.
    """

    tangents: Tangents
    layout: Layout
    beta: float
    precision: Array

    def at(self, z: Array) -> Place:
        """Return what is known at places z (n, d)."""
        root = np.sqrt(self.beta)
        return Place(z, [Tangent(each.columns, self.beta * _held(each.force), root * _held(each.residuals),
                                 root * _held(each.along)) for each in self.tangents(z)])  # fmt: skip

    def metric(self, here: Place, there: Place) -> Array:
        """(n, d, d) Return the metric between places: J of one times J of the other, transposed."""
        total = np.tile(self._flat(here), (len(here.z), 1, 1))
        for one, other in zip(here.factors, there.factors, strict=True):
            rows, columns = np.ix_(one.columns, one.columns)
            total[:, rows, columns] += np.matmul(one.along, other.along.transpose(0, 2, 1))
        return total

    def _flat(self, here: Place) -> Array:
        """(d, d) Return the metric without residuals: 1 beside some."""
        return np.eye(len(self.precision)) if any(each.along.shape[2] for each in here.factors) else self.precision

    def _normal(self, here: Place, z: Array, residuals: Sequence[Array]) -> Array:
        """(n, d) Return displacements z (n, d) and of the residuals, along the surface here, times the metric."""
        total = z @ self._flat(here)
        for each, away in zip(here.factors, residuals, strict=True):
            total[:, each.columns] += times(each.along, away)
        return total

    def step(self, here: Place, velocity: Array, length: Array) -> tuple[Place, BoolArray]:
        """Go from places along geodesics; return where to, and whether one arrived (n,)."""
        ahead = here.z + length * velocity
        wanted = [each.residuals + length * times(each.along.transpose(0, 2, 1), velocity[:, each.columns])
                  for each in here.factors]  # fmt: skip
        return self._nearest(here, ahead, wanted)

    def velocity(self, here: Place, there: Place, factors: Arrow, length: Array) -> Array:
        """(n, d) Return the velocity after a step, by the factors of the metric there."""
        moved = self._normal(there, there.z - here.z, [new.residuals - old.residuals for new, old in
                                                       zip(there.factors, here.factors, strict=True)])  # fmt: skip
        return np.asarray(factors.solve(moved) / length)

    def _nearest(self, here: Place, ahead: Array, wanted: Sequence[Array]) -> tuple[Place, BoolArray]:
        """Return the places of the surface that differ from (ahead, wanted) by what is normal to the surface here."""
        there, left = self.at(ahead.copy()), np.arange(len(ahead), dtype=np.int64)
        for _ in range(NEWTON):
            some, begin = there.take(left), here.take(left)
            off = self._normal(begin, some.z - ahead[left], [each.residuals - goal[left] for each, goal in
                                                            zip(some.factors, wanted, strict=True)])  # fmt: skip
            step = solved(self.metric(begin, some), off, self.layout)
            far = ~(np.abs(step).max(axis=1) < ARRIVED)
            left = left[far]
            if not len(left):
                break
            there.put(left, self.at(_held((some.z - step)[far], FARTHEST)))
        arrived = np.ones(len(ahead), dtype=bool)
        arrived[left] = False
        return there, arrived


@dataclass(frozen=True, eq=False)
class Place:
    """Places z (n, d), and what the data of each factor say there."""

    z: Array
    factors: list[Tangent]

    def take(self, rows: IntArray) -> Place:
        """Return some of the places."""
        return Place(self.z[rows], [each.take(rows) for each in self.factors])

    def put(self, rows: IntArray, other: Place) -> None:
        """Put others in place of some."""
        self.z[rows] = other.z
        for mine, new in zip(self.factors, other.factors, strict=True):
            for old, values in zip(mine[1:], new[1:], strict=True):
                old[rows] = values

    def force(self) -> Array:
        """(n, d) Return the slopes of ln density."""
        total = -self.z
        for each in self.factors:
            total[:, each.columns] += each.force
        return total


def trajectory(surface: Surface, z: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Follow trajectories from z (n, d); return where they end, and what is added to ln of the acceptance (n,).

    That is -inf where a trajectory cannot be followed back.
    """
    length = np.exp(rng.uniform(np.log(SHORTEST), np.log(LONGEST), len(z)))[:, None]
    here = surface.at(z)
    metric = surface.metric(here, here)
    factors = Arrow.of(metric, surface.layout)
    velocity = factors.unwhiten(rng.standard_normal(z.shape))
    added = 0.5 * _squared(velocity, metric) + factors.ln_volume()
    followed = np.ones(len(z), dtype=bool)
    for _ in range(rng.integers(1, MOST_STEPS + 1)):
        velocity = velocity + 0.5 * length * factors.solve(here.force())
        there, arrived = surface.step(here, velocity, length)
        metric_there = surface.metric(there, there)
        factors = Arrow.of(metric_there, surface.layout)
        velocity = surface.velocity(here, there, factors, length)
        again, returned = surface.step(there, -velocity, length)
        followed &= arrived & returned & (_squared(again.z - here.z, metric) < BACK**2)
        here, metric = there, metric_there
        velocity = velocity + 0.5 * length * factors.solve(here.force())
    added -= 0.5 * _squared(velocity, metric) + factors.ln_volume()
    return here.z, np.where(followed, added, -np.inf)


def _squared(x: Array, metric: Array) -> Array:
    """(n,) Return squared lengths of vectors x (n, d)."""
    return np.asarray(np.einsum("ni,nij,nj->n", x, metric, x, optimize=True))


def _held(values: Array, most: float = STEEPEST) -> Array:
    """Return values that are not beyond a size; NaN becomes zero."""
    held = np.clip(values, -most, most)
    held[np.isnan(held)] = 0.0
    return held
