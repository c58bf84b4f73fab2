"""Two populations of a posterior that start apart: walked until they agree, and long enough.

Each begins from its own places, at a small inverse temperature, and comes to the posterior in stages (sequential Monte
Carlo: Del Moral, Doucet & Jasra 2006). Weights move walkers from one mode to another there, as no walk would. Some of
both then walk on until thin ends are filled, and again with moves that are made from this walk. Rank-normalised R-hat
over both, and over both halves of their walks, says whether they are samples of one distribution (Vehtari et al. 2021):
of all coordinates and of the principal axes of those that a factor depends on, means and widths.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from streamkit import Array, IntArray, StreamkitError
from streamkit.builtin.samplers.emulator.agreement import judge
from streamkit.builtin.samplers.emulator.changes import every_so_often
from streamkit.builtin.samplers.emulator.density import Density, Terms
from streamkit.builtin.samplers.emulator.moves import Moves

# Walkers of a population of one posterior; of K factors it has that divided by K, and so many at least.
WALKERS, LEAST_WALKERS = 1000, 400
# Fraction of the walkers that the weights of a stage leave, and the sweeps of a stage: of one posterior, and of several
# factors, whose walkers start at places of each and move in blocks.
EFFECTIVE, STAGE, STAGE_OF_SEVERAL = 0.5, 10, 4
# Stages after which inverse temperatures rise by equal factors, and the factor of the first in them.
MOST_STAGES = 24
# New moves are made every so many sweeps until they are fixed. Walkers follow the surface once in so many, and at last:
# that is most of the work, and what weighs modes are the others. In long walks they do in one of FOLLOWED: for as many
# independent samples of Sagittarius's posterior, all of them take 1.3 times the work, and one in eight 2.3 times.
RENEWED, FOLLOWED = 5, 2
# Draws of all coordinates of several streams, and trajectories of them, are made no more where a smaller fraction is
# accepted: those of many streams together never are.
RARE, TOO_RARE_TO_FOLLOW = 1e-3, 0.02
# Walkers of a population that walk on, sweeps of their first walk, and their most sweeps. Thin ends of a posterior fill
# slowly, and a walk of fewer sweeps does not show that they are missing.
WALKING, FIRST, MOST_SWEEPS = 64, 100, 3000
# Of several factors: draws of each by which walkers at the posterior move what is shared, and the sweeps of their first
# walk. A sweep is five times the work of one with one draw, and walkers forget where they were in a few.
OF_EACH, FIRST_OF_SEVERAL = 8, 32
# Places of the first walk that the moves of the second one are made from.
MANY = 8000
# Largest R-hat over both populations. It is a difference of means of 0.15 standard deviations: their common mean is off
# by half of it.
R_HAT = 1.004
# Sweeps that widths are waited for at most, in units of the first walk. Those of heavy tails are uncertain for long,
# and no reason to refuse.
FOR_WIDTHS = 8
# Samples of a population that the next walk may begin from.
LAST = 512
# In a round, from where the last one ended: walkers, sweeps until moves are fixed and after, sweeps of a tempered copy.
# Sweeps take seconds, and a needless round, as few independent samples measured what moves, takes minutes.
ROUND_WALKERS, ROUND_SETTLING, ROUND_SWEEPS, TEMPERED = 128, 10, 60, 10
ROUND_SWEEPS_OF_SEVERAL = 16


class Asked(NamedTuple):
    """How long a walk is asked to be.

    Attributes
    ----------
    times, independent
        Its autocorrelation times and its independent samples, at least.
    width_error
        The largest standard error of a width, as a fraction, see `Populations`.
    least
        Its sweeps, in units of the first walk, if there is one factor; of K factors they are K times fewer, but a unit
        at least. Where no walker happens to be in a thin end, the numbers above do not know of it.
    """

    times: float
    independent: float
    width_error: float
    least: float


# Of the answer that is given, and of one that fresh calls only test.
GIVEN, TESTED = Asked(16.0, 2000, 0.04, 3.0), Asked(6.0, 800, 0.08, 1.0)


@dataclass(frozen=True, eq=False)
class Populations:
    """What two populations have given.

    Attributes
    ----------
    samples
        (n, d) places of both, of all sweeps; neighbours in a walk are not independent.
    terms
        Of the samples.
    last
        (2, n, d) some samples of both, at equal distances in their walks.
    r_hat, time, independent
        The largest R-hat over both, the longest autocorrelation time in sweeps, and the number of independent samples.
    width_error
        The largest standard error of a standard deviation, as a fraction of it: sqrt((kurtosis - 1) / 4 / independent).
    sweeps
        Of both walks, at inverse temperature 1 with fixed moves.
    accepted
        (4,) fractions of accepted steps, as in `Moves`.
    agree
        Whether both are samples of one distribution, and there are enough of them.
    """

    samples: Array
    terms: Terms
    last: Array
    r_hat: float
    time: float
    independent: float
    width_error: float
    sweeps: int
    accepted: Array
    agree: bool


class Population:
    """One population: places (w, d) with their terms, at an inverse temperature.

    Raises StreamkitError where no place to begin from has a probability.
    """

    def __init__(self, density: Density, begin: Array, rng: np.random.Generator) -> None:
        self._density, self._rng = density, rng
        self.layout = density.layout
        terms = density.terms(begin)
        there = np.isfinite(terms.total(1.0))
        if there.sum() < 2:
            raise StreamkitError(f"of {len(begin)} places to begin from only {there.sum()} have a probability")
        self.z, self.terms, self.beta = begin[there], terms.take(there), 0.0
        self._draws = self._follows = True

    def choose(self, walkers: int, beta: float) -> Population:
        """Take some of the places by their density at an inverse temperature (Gumbel's way), and begin there."""
        keys = self.terms.total(beta) + self._rng.gumbel(size=len(self.z))
        self._take(np.argsort(-keys)[:walkers])
        self.beta = beta
        return self

    def at(self, walkers: int, beta: float) -> Population:
        """Take some of the places, which are samples at an inverse temperature."""
        self._take(self._rng.permutation(len(self.z))[:walkers])
        self.beta = beta
        return self

    def come(self, walkers: int, sweeps: int, used: int) -> Array:
        """(n, d) Walk to the density from the likeliest places in so many sweeps, and return the places of the next."""
        self.choose(walkers, 1.0).settle(sweeps)
        return self.walk(used, self.moves())[0].reshape(-1, self.z.shape[1])

    def anneal(self, walkers: int, sweeps: int) -> Population:
        """Come to inverse temperature 1 in stages of so many sweeps."""
        slowest = 0.0
        for stage in range(10 * MOST_STAGES):
            wanted = self._next_beta(walkers)
            if stage == 0:
                slowest = wanted ** (-1 / MOST_STAGES)
            weights = np.exp(self._ln_weights(wanted))
            self._take(_systematic(weights, walkers, self._rng))
            # a stage at least as long as equal factors make it: the walk does what the weights cannot
            self.beta = min(max(wanted, self.beta * slowest if stage >= MOST_STAGES // 2 else 0.0), 1.0)
            self.settle(sweeps, follow=self.beta >= 1 or not self.layout.several)
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

    def joined(self, other: Population, walkers: int) -> Population:
        """Return some walkers of this one and as many of another one at the same inverse temperature, as one."""
        count = min(walkers, len(self.z), len(other.z))
        both, mine, its = copy(self), self.z[:count], other.z[:count]
        both.z, rows = np.concatenate([mine, its]), np.arange(count)
        pairs = zip(self.terms.take(rows), other.terms.take(rows), strict=True)
        both.terms = Terms(*(np.concatenate(pair) for pair in pairs))
        both._draws, both._follows = self._draws or other._draws, self._follows or other._follows
        return both

    def _take(self, rows: IntArray) -> None:
        self.z, self.terms = self.z[rows], self.terms.take(rows)

    def moves(self, places: Array | None = None, beside: Array | None = None, of_each: int = 1) -> Moves:
        """Return moves made from these places (n, d), or from those of the population; see `Moves` for the others."""
        places = self.z if places is None else places
        return Moves(self.layout, places, self._rng, self._draws, self._follows, beside, of_each)

    def settle(self, sweeps: int, follow: bool = True) -> Population:
        """Walk, with new moves every `RENEWED` sweeps; in the last of them, walkers may ``follow`` the surface."""
        for done in range(sweeps):
            if done % RENEWED == 0:
                moves = self.moves()
            last = done == sweeps - 1
            self._sweep(moves, follow=follow and (last or (done % RENEWED == RENEWED - 1 and not self.layout.several)))
        if self.layout.several:
            self._draws = self._draws and moves.rates[1] >= RARE
            self._follows = self._follows and (not follow or moves.rates[3] >= TOO_RARE_TO_FOLLOW)
        return self

    def _sweep(self, moves: Moves, follow: bool) -> None:
        self.z, self.terms = moves.sweep(self._density, self.z, self.terms, max(self.beta, 1e-9), self._rng, follow)

    def walk(self, sweeps: int, moves: Moves, followed: int = 1) -> tuple[Array, list[Terms]]:
        """Return the places (sweeps, w, d) and terms of a walk with moves that do not change.

        Walkers follow the surface in one of ``followed`` sweeps.
        """
        places, terms = np.empty((sweeps, *self.z.shape)), []
        for i in range(sweeps):
            self._sweep(moves, follow=i % followed == followed - 1)
            places[i] = self.z
            terms.append(self.terms)
        return places, terms


def sample(
    density: Density,
    begin: Sequence[Array],
    seed: list[int],
    beta: float = 0.0,
    walkers: int | None = None,
    asked: Asked = GIVEN,
    most_sweeps: int = 0,
) -> Populations:
    """Sample a posterior by two populations.

    Parameters
    ----------
    density
        The posterior.
    begin
        (n, d) places from which each population begins.
    seed
        Of all random numbers.
    beta
        Inverse temperature that the places are samples at; 0 for any places.
    walkers
        Of each population until it comes to the posterior.
    asked
        How long the walks are asked to be.
    most_sweeps
        Sweeps of a walk at most; 0 for `MOST_SWEEPS`.

    Raises StreamkitError where no place has a probability.
    """
    several, most_sweeps = density.layout.several, most_sweeps or MOST_SWEEPS
    first, of_each = (FIRST_OF_SEVERAL, OF_EACH) if several else (FIRST, 1)
    walkers = walkers or max(WALKERS // max(len(density.layout.own), 1), LEAST_WALKERS)
    populations = [Population(density, places, np.random.default_rng([*seed, i])) for i, places in enumerate(begin)]
    for each in populations:
        if beta > 0:
            each.at(walkers, beta)
        each.anneal(walkers, STAGE_OF_SEVERAL if several else STAGE)
    # Both learn the moves from both: what one has lost, the other may have kept. A narrow mode of one stream holds few
    # walkers at middle temperatures, and both may have lost it: it is among the places of the begin.
    both = populations[0].joined(populations[1], WALKING)
    places, beside = np.concatenate([each.z for each in populations]), np.concatenate(begin) if several else None
    moves = both.moves(places, beside, of_each)
    if most_sweeps <= first:
        return _judged(both, moves, [both.walk(most_sweeps, moves)], asked)
    # Stages leave thin ends empty, and the first walk fills them: it is no part of the answer. Its places are many more
    # than the walkers. A mixture of them follows these ends, where a walk by the first moves stays for long.
    for length in (first, 2 * first) if several else (first,):
        places = both.walk(length, moves, FOLLOWED)[0].reshape(-1, both.z.shape[1])
        moves = both.moves(every_so_often(places, MANY), of_each=of_each)
    parts: list[tuple[Array, list[Terms]]] = []
    sweeps, more = 0, int(first * max(asked.least / len(density.layout.own), 1.0))
    while True:
        parts.append(both.walk(more, moves, FOLLOWED))
        sweeps += more
        result = _judged(both, moves, parts, asked)
        lacking = (result.width_error / asked.width_error) ** 2 if sweeps < FOR_WIDTHS * first else 0.0
        if (result.agree and lacking <= 1) or sweeps >= most_sweeps:
            return result
        lacking = max(min(lacking, FOR_WIDTHS * first / sweeps), asked.independent / max(result.independent, 1.0))
        wanted = max(asked.times * result.time, sweeps * lacking)
        more = min(max(int(1.1 * min(wanted, most_sweeps)) - sweeps, sweeps // 4), sweeps, most_sweeps - sweeps)


def go_on(density: Density, begin: Array, seed: list[int]) -> Populations:
    """Walk shortly from where two populations (2, w, d) ended, with another density that is nearly the same."""
    one, other = (Population(density, places, np.random.default_rng([*seed, i])) for i, places in enumerate(begin))
    both = one.at(ROUND_WALKERS, 1.0).joined(other.at(ROUND_WALKERS, 1.0), ROUND_WALKERS).settle(ROUND_SETTLING)
    several = density.layout.several
    moves = both.moves(of_each=OF_EACH if several else 1)
    return _judged(both, moves, [both.walk(ROUND_SWEEPS_OF_SEVERAL if several else ROUND_SWEEPS, moves)], GIVEN)


def tempered(density: Density, begin: Array, beta: float, seed: list[int]) -> Array:
    """(2, n, d) Walk shortly from places (2, w, d) at an inverse temperature; return the last half of the walks."""
    one, other = (Population(density, places, np.random.default_rng([*seed, i])) for i, places in enumerate(begin))
    both = one.at(ROUND_WALKERS, beta).joined(other.at(ROUND_WALKERS, beta), ROUND_WALKERS).settle(TEMPERED)
    places, _ = both.walk(TEMPERED // 2, both.moves())
    return np.stack([each.reshape(-1, places.shape[2]) for each in np.split(places, 2, axis=1)])


def _judged(both: Population, moves: Moves, parts: Sequence[tuple[Array, list[Terms]]], asked: Asked) -> Populations:
    """Say how well two populations agree that have walked as one, in parts; each is a half of the walkers."""
    walked = np.concatenate([places for places, _ in parts])
    kept, walkers, d = walked.shape
    r_hat, time, spread = judge(both.layout, walked)
    samples = np.concatenate([each.reshape(-1, d) for each in np.split(walked, 2, axis=1)])
    halves = np.split(np.arange(walkers), 2)
    terms = [each.take(half) for half in halves for _, part in parts for each in part]
    last = samples.reshape(2, -1, d)[:, np.linspace(0, kept * walkers // 2 - 1, LAST).astype(int)]
    count, width_error = len(samples) / time, float(np.sqrt(spread / (4 * len(samples))))
    return Populations(
        samples, Terms(*(np.concatenate(each) for each in zip(*terms, strict=True))),
        last, r_hat, time, count, width_error, kept, moves.rates,
        bool(r_hat < R_HAT and kept > asked.times * time and count > asked.independent),
    )  # fmt: skip


def _systematic(weights: Array, n: int, rng: np.random.Generator) -> IntArray:
    """(n,) Indices drawn in proportion to weights, by one random number: the least noise."""
    steps = np.cumsum(weights) / weights.sum()
    return np.minimum(np.searchsorted(steps, (rng.random() + np.arange(n)) / n), len(weights) - 1)
