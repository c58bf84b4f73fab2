"""The emulated posterior: one likelihood for each stream, by its own emulator, and the prior.

ln p(h, s_1 .. s_K) = ln p(h) + sum over k of [ln p(s_k) + ln L_k(h, s_k)], with the shared parameters h (the host) and
the own parameters s_k of each stream. A posterior of one stream is the case K = 1 without shared parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Protocol

import numpy as np

from streamkit import Array, BoolArray, IntArray
from streamkit.builtin.samplers.emulator.learn.emulator import Emulator
from streamkit.builtin.samplers.emulator.learn.problem import Problem
from streamkit.builtin.samplers.emulator.learn.space import Space

# Most that the emulator's own error adds to ln L. Without a limit, places far from all calls have the likelihood of a
# flat density, and their volume may hold more of the posterior than the places that fit.
MOST_BY_ERROR = 1.0
# Most places that are computed at a time: more need memory, and are no faster.
PART = 2048


@dataclass(frozen=True, eq=False)
class Layout:
    """Which of d coordinates are shared by all factors, and which belong to one.

    Attributes
    ----------
    shared
        Indices of the coordinates h.
    own
        Indices of the coordinates s_k of each factor; empty for a factor that depends on h alone.
    """

    shared: IntArray
    own: Sequence[IntArray]

    @classmethod
    def of_one(cls, d: int) -> Layout:
        """Return that of a single posterior of d parameters."""
        return cls(np.empty(0, dtype=np.int64), (np.arange(d),))

    @property
    def size(self) -> int:
        """Number of coordinates d."""
        return len(self.shared) + sum(map(len, self.own))

    @property
    def several(self) -> bool:
        """Whether there are several factors."""
        return len(self.own) > 1

    def of(self, factor: int) -> IntArray:
        """Indices of all coordinates that a factor depends on, in rising order."""
        return np.sort(np.concatenate([self.shared, self.own[factor]]))


class Terms(NamedTuple):
    """The terms of ln density at n places.

    Attributes
    ----------
    prior
        (n, 1 + K) ln prior of h, and of each s_k.
    ln_likelihood
        (n, K) of each factor; -inf where there is no prediction.
    """

    prior: Array
    ln_likelihood: Array

    def total(self, beta: float) -> Array:
        """(n,) ln density at an inverse temperature: the likelihoods to the power of beta."""
        return np.asarray(self.prior.sum(axis=1) + beta * self.ln_likelihood.sum(axis=1))

    def take(self, rows: IntArray | BoolArray) -> Terms:
        """Return those of some of the places."""
        return Terms(self.prior[rows], self.ln_likelihood[rows])

    def and_of(self, other: Terms) -> Terms:
        """Return these terms, and others after them."""
        return Terms(*(np.concatenate(pair) for pair in zip(self, other, strict=True)))

    def replaced(self, other: Terms, accepted: BoolArray) -> Terms:
        """Return these terms, with those of ``other`` at the accepted places (n,)."""
        rows = accepted[:, None]
        return Terms(*(np.where(rows, new, old) for old, new in zip(self, other, strict=True)))


def gain(after: Array, before: Array) -> Array:
    """Return differences of ln densities; those of walkers that are nowhere yet are infinite."""
    with np.errstate(invalid="ignore"):
        return np.where(np.isneginf(before), np.where(np.isneginf(after), -np.inf, np.inf), after - before)


class Tangent(NamedTuple):
    """What the data of one factor say at n places, and how it changes there.

    Attributes
    ----------
    columns
        (c,) the coordinates that it depends on.
    force
        (n, c) slopes of ln L.
    residuals
        (n, m) of predictions from the data, in units of their errors: ln L is about minus half the sum of squares. None
        are known of an ln L that is learned as a whole, m = 0.
    along
        (n, c, m) slopes of the residuals.
    """

    columns: IntArray
    force: Array
    residuals: Array
    along: Array

    @classmethod
    def of(cls, residuals: Array, along: Array, columns: IntArray) -> Tangent:
        """Return that of residuals (n, m) with these slopes (n, c, m)."""
        return cls(columns, -np.matmul(along, residuals[:, :, None])[:, :, 0], residuals, along)

    def take(self, rows: IntArray) -> Tangent:
        """Return that at some of the places."""
        return Tangent(self.columns, self.force[rows], self.residuals[rows], self.along[rows])


class Density(Protocol):
    """A density of this form, of coordinates in which the prior is a standard normal."""

    @property
    def layout(self) -> Layout:
        """Which coordinates belong to which factor."""

    def terms(self, z: Array) -> Terms:
        """Return the terms at coordinates z (n, d)."""

    def tangents(self, z: Array) -> Sequence[Tangent]:
        """Return about what the data of each factor say at z (n, d).

        Walkers follow it, so that more of their steps are accepted; the density of the samples does not depend on it.
        """


@dataclass(frozen=True, eq=False)
class Emulated:
    """The likelihood of one factor, by its emulator, at coordinates z.

    Attributes
    ----------
    noise
        Whether the variance of one call is part of the likelihood.
    most_by_error
        Most that the emulator's own error adds to ln L.
    """

    space: Space
    emulator: Emulator
    noise: bool
    most_by_error: float = MOST_BY_ERROR

    def ln_likelihood(self, z: Array, fit_error: bool = True) -> Array:
        """(n,) ln likelihood at z (n, d), with or without the emulator's own error."""
        found = np.empty(len(z))
        most = self.most_by_error if fit_error else 0.0
        for i in range(0, len(z), PART):
            y = self.space.learned(z[i : i + PART])
            found[i : i + PART] = self.emulator.ln_likelihood(y, self.space.parameters(y), self.noise, most)
        return np.where(np.isnan(found), -np.inf, found)

    def of_other_noise(self, z: Array, rng: np.random.Generator, count: int) -> Array:
        """(count, n) ln likelihood at z (n, d) of emulators that other noise in the calls could have given."""
        changes = [self.emulator.by_noise(rng) for _ in range(count)]
        found = np.empty((count, len(z)))
        for i in range(0, len(z), PART):
            y = self.space.learned(z[i : i + PART])
            theta, rows = self.space.parameters(y), slice(i, i + PART)
            found[:, rows] = self.emulator.of_other_noise(y, theta, changes, self.noise, self.most_by_error)
        return np.where(np.isnan(found), -np.inf, found)

    def unlimited(self) -> Emulated:
        """Return the likelihood in which the emulator's own error may add any amount to ln L."""
        return replace(self, most_by_error=np.inf)

    def at_best(self, z: Array, sigmas: float) -> Array:
        """(n,) ln likelihood at z (n, d) if all predictions are nearer to the data by so many of their own errors."""
        y = self.space.learned(z)
        predicted, problem = self.emulator.predict(y, with_noise=False), self.emulator.problem
        own = sigmas * np.sqrt(predicted.fit_variance)
        away = predicted.mean - problem.values
        mean = problem.values + np.sign(away) * np.maximum(np.abs(away) - own, 0.0)
        if problem.is_ln_likelihood:
            mean = predicted.mean + own
        theta = self.space.parameters(y)
        return problem.compare(theta, mean, 0.0 * own, predicted.details) + predicted.ln_exists

    def change_by_error(self, z: Array) -> Array:
        """(n,) What the emulator's own error changes of ln likelihood at z (n, d)."""
        return self.ln_likelihood(z) - self.ln_likelihood(z, fit_error=False)

    def tangent(self, z: Array, columns: IntArray) -> Tangent:
        """Return what its data say at z (n, c), which are these coordinates of a posterior."""
        y, rates = self.space.learned_with_rates(z)
        values, along = self.emulator.linear(y, self.noise)
        along = along * rates[:, :, None]
        if self.emulator.problem.is_ln_likelihood:
            return Tangent(columns, along[:, :, 0], values[:, :0], along[:, :, :0])
        return Tangent.of(values, along, columns)

    def redrawn(self, rng: np.random.Generator) -> Emulated:
        """Return what other noise in the calls could have given."""
        return replace(self, emulator=self.emulator.redrawn(rng))


@dataclass(frozen=True, eq=False)
class Factor:
    """One factor: what can be called. A posterior of one stream is one factor.

    Attributes
    ----------
    name
        Of its stream; `[data]` for the data of the host.
    problem, small
        Its posterior alone, with all particles and with few of them.
    shared, own
        Indices of its coordinates among all d: those that all factors share, and its own; their order is that of the
        run file, here as there.
    earlier
        (n, p) parameters at which an earlier run has called it.
    """

    name: str
    problem: Problem
    small: Problem
    shared: IntArray
    own: IntArray
    earlier: Array = field(default_factory=lambda: np.empty((0, 0)))

    @property
    def columns(self) -> IntArray:
        """Indices of its coordinates among all, in rising order."""
        return np.sort(np.concatenate([self.shared, self.own]))

    @property
    def alone(self) -> Factor:
        """The factor as a posterior of its own."""
        none, all_of_it = np.empty(0, dtype=np.int64), np.arange(len(self.columns))
        return replace(self, shared=none, own=all_of_it)


def one_factor(problem: Problem, small: Problem) -> Factor:
    """Return the only factor of a posterior."""
    return Factor("the stream", problem, small, np.empty(0, dtype=np.int64), np.arange(problem.size))


@dataclass(frozen=True, eq=False)
class Joint:
    """The posterior of all factors, by the emulator of each: a `Density`.

    Attributes
    ----------
    factors
        The factors.
    emulated
        The emulated likelihood of each.
    """

    factors: Sequence[Factor]
    emulated: Sequence[Emulated]

    @property
    def layout(self) -> Layout:
        """Which coordinates belong to which factor."""
        return Layout(self.factors[0].shared, [each.own for each in self.factors])

    def terms(self, z: Array) -> Terms:
        """Return the terms of ln density at coordinates z (n, d)."""
        layout = self.layout
        blocks = [layout.shared, *layout.own]
        prior = np.stack([-0.5 * np.sum(z[:, block] ** 2, axis=1) for block in blocks], axis=1)
        return Terms(prior, self.ln_likelihoods(z))

    def ln_likelihoods(self, z: Array) -> Array:
        """(n, K) ln likelihood of each factor at coordinates z (n, d)."""
        pairs = zip(self.factors, self.emulated, strict=True)
        return np.stack([each.ln_likelihood(z[:, factor.columns]) for factor, each in pairs], axis=1)

    def tangents(self, z: Array) -> list[Tangent]:
        """Return what the data of each factor say at z (n, d)."""
        pairs = zip(self.factors, self.emulated, strict=True)
        return [each.tangent(z[:, factor.columns], factor.columns) for factor, each in pairs]

    def unlimited(self) -> Joint:
        """Return the posterior in which an emulator's own error may add any amount to ln L."""
        return Joint(self.factors, [each.unlimited() for each in self.emulated])
