"""A population of walkers, and two of them that walk by the same moves: each in a process of its own.

Moves do not change while populations walk by them, so that neither needs to know of the other one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np

from streamkit import Array, IntArray, StreamkitError
from streamkit.builtin.samplers.emulator.at_once import AtOnce
from streamkit.builtin.samplers.emulator.walk.density import Density, Layout, Terms
from streamkit.builtin.samplers.emulator.walk.moves import Moves

# Fraction of the walkers that the weights of a stage leave.
EFFECTIVE = 0.5
# Stages after which inverse temperatures rise by equal factors, and the factor of the first in them.
MOST_STAGES = 24
# New moves are made every so many sweeps until they are fixed. Walkers follow the surface in the last of these sweeps
# at most: that is most of the work, and what weighs modes are the others.
RENEWED = 5
# Draws of all coordinates of several streams, and trajectories of them, are made no more where a smaller fraction is
# accepted: those of many streams together never are.
RARE, TOO_RARE_TO_FOLLOW = 1e-3, 0.02


class _Walkers(Protocol):
    """What `_settle` asks of a population, or of two."""

    draws: bool
    follows: bool

    @property
    def layout(self) -> Layout:
        """Of the coordinates."""

    def moves(self) -> Moves:
        """Return moves made from the places of now."""

    def walk(self, density: Density, sweeps: int, moves: Moves, followed: int = 1) -> tuple[Array, Sequence[Terms]]:
        """Walk."""


def _settle(walkers: _Walkers, density: Density, sweeps: int, follow: bool) -> None:
    """Walk, with new moves every `RENEWED` sweeps; in the last of them, walkers may ``follow`` the surface."""
    several = walkers.layout.several
    for done in range(0, sweeps, RENEWED):
        moves, count = walkers.moves(), min(RENEWED, sweeps - done)
        now = follow and (done + count == sweeps or not several)
        walkers.walk(density, count, moves, followed=count if now else 0)
    if several:
        walkers.draws = walkers.draws and moves.rates[1] >= RARE
        walkers.follows = walkers.follows and (not follow or moves.rates[3] >= TOO_RARE_TO_FOLLOW)


@dataclass(eq=False)
class Population:
    """Places z (w, d) with their terms, at an inverse temperature.

    Attributes
    ----------
    layout
        Of the coordinates.
    rng
        Of all that it draws.
    draws, follows
        Whether moves are tried that many streams together hardly accept, see `Moves`.
    """

    layout: Layout
    z: Array
    terms: Terms
    rng: np.random.Generator
    beta: float = 0.0
    draws: bool = True
    follows: bool = True

    @classmethod
    def of(cls, density: Density, begin: Array, rng: np.random.Generator) -> Population:
        """Return that of places to begin from (n, d). Raises StreamkitError where no place has a probability."""
        terms = density.terms(begin)
        there = np.isfinite(terms.total(1.0))
        if there.sum() < 2:
            raise StreamkitError(f"of {len(begin)} places to begin from only {there.sum()} have a probability")
        return cls(density.layout, begin[there], terms.take(there), rng)

    def choose(self, walkers: int, beta: float) -> Population:
        """Take some of the places by their density at an inverse temperature (Gumbel's way), and begin there."""
        keys = self.terms.total(beta) + self.rng.gumbel(size=len(self.z))
        self.beta = beta
        return self.take(np.argsort(-keys)[:walkers])

    def at(self, walkers: int, beta: float) -> Population:
        """Take some of the places, which are samples at an inverse temperature."""
        self.beta = beta
        return self.take(self.rng.permutation(len(self.z))[:walkers])

    def come(self, density: Density, walkers: int, sweeps: int, used: int) -> Array:
        """(n, d) Walk to the density from the likeliest places in so many sweeps, and return the places of the next."""
        self.choose(walkers, 1.0).settle(density, sweeps)
        return self.walk(density, used, self.moves())[0].reshape(-1, self.z.shape[1])

    def anneal(self, density: Density, walkers: int, sweeps: int) -> Population:
        """Come to inverse temperature 1 in stages of so many sweeps."""
        slowest = 0.0
        for stage in range(10 * MOST_STAGES):
            wanted = self._next_beta(walkers)
            if stage == 0:
                slowest = wanted ** (-1 / MOST_STAGES)
            weights = np.exp(self._ln_weights(wanted))
            self.take(_systematic(weights, walkers, self.rng))
            # a stage at least as long as equal factors make it: the walk does what the weights cannot
            self.beta = min(max(wanted, self.beta * slowest if stage >= MOST_STAGES // 2 else 0.0), 1.0)
            self.settle(density, sweeps, follow=self.beta >= 1 or not self.layout.several)
            if self.beta >= 1:
                break
        return self

    def _ln_weights(self, beta: float) -> Array:
        lnw = (beta - self.beta) * self.terms.ln_likelihood.sum(axis=1)
        return np.asarray(lnw - lnw.max())

    def _next_beta(self, walkers: int) -> float:
        """Return the inverse temperature whose weights leave the fraction `EFFECTIVE` of the walkers, by bisection."""
        low, high = self.beta, 1.0
        wanted = EFFECTIVE * min(walkers, len(self.z))

        def left(beta: float) -> float:
            weights = np.exp(self._ln_weights(beta))
            return float(weights.sum() ** 2 / np.sum(weights**2))

        if left(high) >= wanted:
            return high
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if left(middle) >= wanted else (low, middle)
        return max(low, 1e-9)

    def take(self, rows: IntArray) -> Population:
        """Take some of the places."""
        self.z, self.terms = self.z[rows], self.terms.take(rows)
        return self

    def moves(self) -> Moves:
        """Return moves made from its places."""
        return Moves(self.layout, self.z, self.rng, self.draws, self.follows)

    def settle(self, density: Density, sweeps: int, follow: bool = True) -> Population:
        """Walk, with new moves every `RENEWED` sweeps; in the last of them, walkers may ``follow`` the surface."""
        _settle(self, density, sweeps, follow)
        return self

    def walk(self, density: Density, sweeps: int, moves: Moves, followed: int = 1) -> tuple[Array, list[Terms]]:
        """Return the places (sweeps, w, d) and terms of a walk with moves that do not change.

        Walkers follow the surface in one of ``followed`` sweeps; in none if that is 0.
        """
        places, terms, beta = np.empty((sweeps, *self.z.shape)), [], max(self.beta, 1e-9)
        for i in range(sweeps):
            follow = followed > 0 and i % followed == followed - 1
            self.z, self.terms = moves.sweep(density, self.z, self.terms, beta, self.rng, follow)
            places[i] = self.z
            terms.append(self.terms)
        return places, terms


class Pair:
    """Two populations at one inverse temperature, of as many walkers, that walk by the same moves."""

    def __init__(self, two: Sequence[Population], walkers: int, at_once: AtOnce) -> None:
        count = np.arange(min(walkers, *(len(each.z) for each in two)))
        self.two, self._at_once = [each.take(count) for each in two], at_once
        self.draws, self.follows = any(each.draws for each in two), any(each.follows for each in two)

    @property
    def layout(self) -> Layout:
        """Of the coordinates."""
        return self.two[0].layout

    def moves(self, places: Array | None = None, beside: Array | None = None, of_each: int = 1) -> Moves:
        """Return moves made from these places (n, d), or from those of both; see `Moves` for the others."""
        places = np.concatenate([each.z for each in self.two]) if places is None else places
        return Moves(self.layout, places, self.two[0].rng, self.draws, self.follows, beside, of_each)

    def settle(self, density: Density, sweeps: int) -> Pair:
        """Walk, with new moves every `RENEWED` sweeps."""
        _settle(self, density, sweeps, follow=True)
        return self

    def walk(self, density: Density, sweeps: int, moves: Moves, followed: int = 1) -> tuple[Array, list[Terms]]:
        """Return the places (sweeps, 2 w, d) and terms of a walk of both; see `Population.walk`."""
        found = self._at_once([partial(_walked, each, density, sweeps, moves, followed) for each in self.two])
        self.two = [each for each, *_ in found]
        for _, mine, _, _ in found:
            moves.count(mine)
        places = np.concatenate([each for _, _, each, _ in found], axis=1)
        return places, [one.and_of(other) for one, other in zip(found[0][3], found[1][3], strict=True)]


def _walked(
    population: Population, density: Density, sweeps: int, moves: Moves, followed: int
) -> tuple[Population, Array, Array, list[Terms]]:
    """Walk; return the population as it is then, the counts of its steps, its places and their terms."""
    mine = moves.uncounted()
    places, terms = population.walk(density, sweeps, mine, followed)
    return population, mine.counts, places, terms


def _systematic(weights: Array, n: int, rng: np.random.Generator) -> IntArray:
    """(n,) Indices drawn in proportion to weights, by one random number: the least noise."""
    steps = np.cumsum(weights) / weights.sum()
    return np.minimum(np.searchsorted(steps, (rng.random() + np.arange(n)) / n), len(weights) - 1)
