"""Two populations of a joint posterior that start apart: walked until they agree, and long enough.

Each begins from its own places, at a small inverse temperature, and comes to the posterior in stages (sequential Monte
Carlo: Del Moral, Doucet & Jasra 2006). Weights move walkers from one mode to another there, as no walk would. Both then
walk on, with moves that no longer change. Rank-normalised R-hat over both, and over both halves of their walks, says
whether they are samples of one distribution (Vehtari et al. 2021): of all coordinates and of the principal axes of
those that a factor depends on, means and widths.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from streamkit import Array, IntArray, StreamkitError
from streamkit.builtin.samplers.emulator.block_moves import BlockMoves
from streamkit.builtin.samplers.emulator.joint_density import JointDensity, Layout, Terms

# Walkers of a population.
WALKERS = 320
# Fraction of the walkers that the weights of a stage leave, and the sweeps of a stage.
EFFECTIVE, SWEEPS = 0.5, 5
# Stages after which inverse temperatures rise by equal factors, and the factor of the first in them.
MOST_STAGES = 24
# Sweeps until moves are fixed, for new moves every `SWEEPS`; and of the first walk with fixed moves.
SETTLING, FIRST = 20, 60
# Largest R-hat over both populations, fewest autocorrelation times of a walk, and fewest independent samples.
# R-hat of 1.004 is a difference of means of 0.15 standard deviations: their common mean is off by half of it.
R_HAT, TIMES, INDEPENDENT = 1.004, 10.0, 2000
# A sum of autocorrelations ends at so many times (Sokal 1997).
WINDOW = 5.0
# Places of both walks that the moves of the next ones are made from.
ARCHIVE = 6000
# Walkers of a population that go on where the first walk was too short.
WALKING = 256
# How often a walk may be doubled.
DOUBLED = 5
# In a round, from where the last one ended: walkers, sweeps until moves are fixed and after, sweeps of a tempered copy.
ROUND_WALKERS, ROUND_SETTLING, ROUND_SWEEPS, TEMPERED = 128, 10, 20, 20


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
        (2, w, d) the last places of both.
    r_hat, time, independent
        The largest R-hat over both, the longest autocorrelation time in sweeps, and the number of independent samples.
    sweeps, evaluations
        Of both walks, at inverse temperature 1 with fixed moves; and the evaluations of one factor in all.
    accepted
        Fractions of accepted steps, of the shared coordinates and of the own ones.
    """

    samples: Array
    terms: Terms
    last: Array
    r_hat: float
    time: float
    independent: float
    sweeps: int
    evaluations: int
    accepted: tuple[float, float]

    @property
    def agree(self) -> bool:
        """Whether both are samples of one distribution, and there are enough of them."""
        return self.r_hat < R_HAT and self.sweeps > TIMES * self.time and self.independent > INDEPENDENT


class Moves(Protocol):
    """Moves that do not change, made from a population.

    Attributes
    ----------
    accepted, sweeps
        (2,) sums of the fractions of accepted steps of two kinds, and the sweeps.
    steps
        Evaluations of the density for each walker in a sweep.
    """

    accepted: Array
    sweeps: int
    steps: int

    def sweep(
        self, density: JointDensity, y: Array, terms: Terms, beta: float, rng: np.random.Generator
    ) -> tuple[Array, Terms]:
        """Move walkers (w, d) with these terms; return the new places and their terms."""


MakeMoves = Callable[[Layout, Array], Moves]


class _Population:
    """One population: places (w, d) with their terms, at an inverse temperature."""

    def __init__(
        self, density: JointDensity, begin: Array, rng: np.random.Generator, walkers: int, moves: MakeMoves
    ) -> None:
        self._density, self._rng, self._walkers, self._moves = density, rng, walkers, moves
        terms = density.terms(begin)
        there = np.isfinite(terms.total(1.0))
        if there.sum() < 2:
            raise StreamkitError(f"of {len(begin)} places to begin from only {there.sum()} have a probability")
        self.y, self.terms, self.beta = begin[there], terms.take(there), 0.0
        self.evaluations = len(begin)

    def continue_at(self, beta: float) -> None:
        """Begin at an inverse temperature, with some of the places."""
        self._take(self._rng.permutation(len(self.y))[: self._walkers])
        self.beta = beta

    def anneal(self, sweeps: int) -> None:
        """Come to inverse temperature 1 in stages of so many sweeps."""
        slowest = 0.0
        for stage in range(10 * MOST_STAGES):
            wanted = self._next_beta()
            if stage == 0:
                slowest = wanted ** (-1 / MOST_STAGES)
            weights = np.exp(self._ln_weights(wanted))
            self._take(_systematic(weights, self._walkers, self._rng))
            # a stage at least as long as equal factors make it: the walk does what the weights cannot
            self.beta = min(max(wanted, self.beta * slowest if stage >= MOST_STAGES // 2 else 0.0), 1.0)
            self.settle(sweeps)
            if self.beta >= 1:
                return

    def _ln_weights(self, beta: float) -> Array:
        lnw = (beta - self.beta) * self.terms.ln_likelihood.sum(axis=1)
        return np.asarray(lnw - lnw.max())

    def _next_beta(self) -> float:
        """Return the inverse temperature whose weights leave the fraction `EFFECTIVE` of the walkers, by bisection."""
        low, high = self.beta, 1.0
        wanted = EFFECTIVE * min(self._walkers, len(self.y))

        def left(beta: float) -> float:
            weights = np.exp(self._ln_weights(beta))
            return float(weights.sum() ** 2 / np.sum(weights**2))

        if left(high) >= wanted:
            return high
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if left(middle) >= wanted else (low, middle)
        return max(low, 1e-9)

    def _take(self, rows: IntArray) -> None:
        self.y, self.terms = self.y[rows], self.terms.take(rows)

    def settle(self, sweeps: int) -> None:
        """Walk, with new moves every `SWEEPS` sweeps."""
        for done in range(sweeps):
            if done % SWEEPS == 0:
                moves = self._moves(self._density.layout, self.y)
            self.sweep(moves)

    def thin(self, walkers: int) -> None:
        """Go on with some of the walkers, at random."""
        self._take(self._rng.permutation(len(self.y))[:walkers])

    def sweep(self, moves: Moves) -> None:
        """Walk one sweep."""
        self.y, self.terms = moves.sweep(self._density, self.y, self.terms, max(self.beta, 1e-9), self._rng)
        self.evaluations += moves.steps * len(self.y) * self.terms.ln_likelihood.shape[1]

    def walk(self, sweeps: int, learned_from: Array) -> tuple[Array, list[Terms], Moves]:
        """Return the places (sweeps, w, d) and terms of a walk with fixed moves, made from places (n, d)."""
        moves = self._moves(self._density.layout, learned_from)
        places, terms = np.empty((sweeps, *self.y.shape)), []
        for i in range(sweeps):
            self.sweep(moves)
            places[i] = self.y
            terms.append(self.terms)
        return places, terms, moves


def sample(
    density: JointDensity,
    begin: Sequence[Array],
    seed: list[int],
    walkers: int = WALKERS,
    doubled: int = DOUBLED,
    moves: MakeMoves = BlockMoves,
    stage: int = SWEEPS,
    times: float = TIMES,
) -> Populations:
    """Sample a joint posterior by two populations.

    Parameters
    ----------
    density
        The posterior.
    begin
        (n, d) places from which each population begins.
    seed
        Of all random numbers.
    walkers
        Of each population.
    doubled
        How often a walk may be doubled until the populations agree.
    moves
        Makes the moves of a population from its layout and places (n, d).
    stage
        Sweeps of a stage on the way to the posterior.
    times
        Autocorrelation times after which the walks end; fewer, down to `TIMES`, will do where they are doubled no more.

    Raises StreamkitError where no place has a probability.
    """
    populations = [
        _Population(density, places, np.random.default_rng([*seed, i]), walkers, moves)
        for i, places in enumerate(begin)
    ]
    for each in populations:
        each.anneal(stage)
        each.settle(SETTLING)
    sweeps, rng = FIRST, np.random.default_rng([*seed, 2])
    places = np.concatenate([each.y for each in populations])
    for trial in range(doubled + 1):
        # both learn the moves from both: what one has lost, the other may have kept
        walks = [each.walk(sweeps, places) for each in populations]
        chains = np.stack([places for places, _, _ in walks])
        result = _judged(density.layout, chains, walks, populations)
        if (result.agree and sweeps > times * result.time) or trial == doubled:
            break
        places = rng.choice(chains.reshape(-1, chains.shape[3]), ARCHIVE, replace=False)
        for each in populations:  # few walkers go far at the price of many that do not
            each.thin(WALKING)
        sweeps *= 2
    return result


def go_on(density: JointDensity, begin: Array, seed: list[int], moves: MakeMoves = BlockMoves) -> Populations:
    """Walk shortly from where two populations (2, w, d) ended, with another density that is nearly the same."""
    populations = []
    for i, places in enumerate(begin):
        each = _Population(density, places, np.random.default_rng([*seed, i]), ROUND_WALKERS, moves)
        each.continue_at(1.0)
        each.settle(ROUND_SETTLING)
        populations.append(each)
    walks = [each.walk(ROUND_SWEEPS, each.y) for each in populations]
    return _judged(density.layout, np.stack([places for places, _, _ in walks]), walks, populations)


def tempered(density: JointDensity, begin: Array, beta: float, seed: list[int]) -> Array:
    """(n, d) Walk shortly from places (2, w, d) at an inverse temperature; return the last half of the walk."""
    rng = np.random.default_rng(seed)
    each = _Population(density, begin.reshape(-1, begin.shape[2]), rng, 2 * ROUND_WALKERS, BlockMoves)
    each.continue_at(beta)
    each.settle(TEMPERED)
    places, _, _ = each.walk(TEMPERED // 2, each.y)
    return places.reshape(-1, places.shape[2])


def _judged(
    layout: Layout, chains: Array, walks: list[tuple[Array, list[Terms], Moves]], populations: list[_Population]
) -> Populations:
    """Say how well both agree, from their walks (2, sweeps, w, d)."""
    _, sweeps, walkers, d = chains.shape
    samples = chains.reshape(-1, d)
    watched = with_block_axes(layout, samples).reshape(2, sweeps, walkers, -1)
    both = np.concatenate(list(watched), axis=1)
    time = float(autocorrelation_times(both).max())
    terms = [each for _, steps, _ in walks for each in steps]
    joined = Terms(*(np.concatenate(parts) for parts in zip(*terms, strict=True)))
    accepted = np.mean([moves.accepted / max(moves.sweeps, 1) for _, _, moves in walks], axis=0)
    return Populations(
        samples, joined, chains[:, -1], agreement(watched), time, len(samples) / time, sweeps,
        sum(each.evaluations for each in populations), (float(accepted[0]), float(accepted[1])),
    )  # fmt: skip


def autocorrelation_times(chain: Array) -> Array:
    """(q,) Integrated autocorrelation times in sweeps of walks (sweeps, w, q) of many walkers.

    Deviations are those from the mean of all walkers. A short walk then shows a long time: each walker about its own
    mean would hide what is slower than the walk. It is infinite for a quantity that no walker has changed.
    """
    sweeps, _, q = chain.shape
    away = chain - chain.mean(axis=(0, 1))
    spectrum = np.fft.rfft(away, 2 * sweeps, axis=0)
    together = np.fft.irfft(np.mean(np.abs(spectrum) ** 2, axis=1), axis=0)[:sweeps]
    together /= np.arange(sweeps, 0, -1)[:, None]  # each lag has its own number of pairs
    with np.errstate(invalid="ignore", divide="ignore"):
        sums = 2 * np.cumsum(together / together[0], axis=0) - 1
    inside = np.arange(sweeps)[:, None] < WINDOW * sums  # a sum ends at the first lag outside, or with the walk
    ends = np.where(inside.all(axis=0), sweeps - 1, np.argmin(inside, axis=0))
    times = np.nan_to_num(sums[ends, np.arange(q)], nan=np.inf)
    return np.where(np.ptp(chain, axis=(0, 1)) > 0, np.maximum(times, 1.0), 0.0)


def agreement(watched: Array) -> float:
    """Return the largest rank-normalised R-hat of walks (2, sweeps, w, q) of two populations, each a chain.

    It is split in halves of the walks, and the larger of that of the values and of their distances from the median.
    """
    from arviz_stats.base.array import array_stats  # a second or more to load

    chains = watched.reshape(2, -1, watched.shape[3])  # sweep after sweep: halves are early and late
    moved = np.ptp(chains.reshape(-1, chains.shape[2]), axis=0) > 0
    r_hat = array_stats.rhat(chains[..., moved], chain_axis=0, draw_axis=1, method="rank")  # type: ignore[no-untyped-call]
    return float(np.max(r_hat)) if moved.any() else 1.0


def with_block_axes(layout: Layout, samples: Array) -> Array:
    """(n, q) Append the principal axes of the shared coordinates, and of those of each factor, to samples (n, d)."""
    blocks = [layout.shared, *(layout.of(k) for k, own in enumerate(layout.own) if len(own))]
    scaled = (samples - samples.mean(axis=0)) / np.maximum(samples.std(axis=0), 1e-300)
    axes = [scaled[:, b] @ np.linalg.eigh(np.atleast_2d(np.cov(scaled[:, b].T)))[1] for b in blocks if len(b) > 1]
    return np.concatenate([samples, *axes], axis=1)


def _systematic(weights: Array, n: int, rng: np.random.Generator) -> IntArray:
    """(n,) Indices drawn in proportion to weights, by one random number: the least noise."""
    steps = np.cumsum(weights) / weights.sum()
    return np.minimum(np.searchsorted(steps, (rng.random() + np.arange(n)) / n), len(weights) - 1)
