"""Two populations of a posterior that start apart: walked until they agree, and long enough.

Each begins from its own places, at a small inverse temperature, and comes to the posterior in stages (sequential Monte
Carlo: Del Moral, Doucet & Jasra 2006). Weights move walkers from one mode to another there, as no walk would. Some of
both then walk on until thin ends are filled, and again with moves that are made from this walk. Rank-normalised R-hat
over both, and over both halves of their walks, says whether they are samples of one distribution (Vehtari et al. 2021):
of all coordinates and of the principal axes of those that a factor depends on, means and widths. Each population may
walk in a process of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from streamkit import Array
from streamkit.builtin.samplers.emulator.at_once import AtOnce, in_turn
from streamkit.builtin.samplers.emulator.changes import every_so_often
from streamkit.builtin.samplers.emulator.walk.agreement import judge
from streamkit.builtin.samplers.emulator.walk.density import Density, Layout, Terms
from streamkit.builtin.samplers.emulator.walk.moves import Moves
from streamkit.builtin.samplers.emulator.walk.population import Pair, Population

# Walkers of a population of one posterior; of K factors it has that divided by K, and so many at least.
WALKERS, LEAST_WALKERS = 1000, 400
# Sweeps of a stage: of one posterior, and of several factors, whose walkers start at places of each and move in blocks.
STAGE, STAGE_OF_SEVERAL = 10, 4
# In long walks, walkers follow the surface in one of so many sweeps: for as many independent samples of Sagittarius's
# posterior, all of them take 1.3 times the work, and one in eight 2.3 times.
FOLLOWED = 2
# Walkers of a population that walk on, sweeps of their first walk, and their most sweeps. Thin ends of a posterior fill
# slowly, and a walk of fewer sweeps does not show that they are missing.
WALKING, FIRST, MOST_SWEEPS = 64, 100, 3000
# Of several factors: draws of each by which walkers at the posterior move what is shared, and the sweeps of their first
# walk. A sweep is five times the work of one with one draw, and walkers forget where they were in a few.
OF_EACH, FIRST_OF_SEVERAL = 8, 32
# Places of a walk that the moves of the next one are made from.
MANY = 8000
# A walk of so many first ones, but fewer than so many of its autocorrelation times, starts anew by moves that are made
# from it. Those of a shorter walk may not know a thin end, and a walker that is there stays for hundreds of sweeps.
LONG, FEW_TIMES = 4, 8
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


def sample(
    density: Density,
    begin: Sequence[Array],
    seed: list[int],
    beta: float = 0.0,
    walkers: int | None = None,
    asked: Asked = GIVEN,
    most_sweeps: int = 0,
    at_once: AtOnce = in_turn,
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
    at_once
        Lets both walk at a time.

    Raises StreamkitError where no place has a probability.
    """
    several, most_sweeps = density.layout.several, most_sweeps or MOST_SWEEPS
    first, of_each = (FIRST_OF_SEVERAL, OF_EACH) if several else (FIRST, 1)
    walkers = walkers or max(WALKERS // max(len(density.layout.own), 1), LEAST_WALKERS)
    two = [Population.of(density, places, np.random.default_rng([*seed, i])) for i, places in enumerate(begin)]
    if beta > 0:
        two = [each.at(walkers, beta) for each in two]
    stage = STAGE_OF_SEVERAL if several else STAGE
    two = at_once([partial(each.anneal, density, walkers, stage) for each in two])
    # Both learn the moves from both: what one has lost, the other may have kept. A narrow mode of one stream holds few
    # walkers at middle temperatures, and both may have lost it: it is among the places of the begin.
    places, beside = np.concatenate([each.z for each in two]), np.concatenate(begin) if several else None
    both = Pair(two, WALKING, at_once)
    moves = both.moves(places, beside, of_each)
    if most_sweeps <= first:
        return _judged(both.layout, moves, [both.walk(density, most_sweeps, moves)], asked)

    def made_from(walked: Array) -> Moves:
        return both.moves(every_so_often(walked.reshape(-1, density.layout.size), MANY), of_each=of_each)

    # Stages leave thin ends empty, and the first walk fills them: it is no part of the answer. Its places are many more
    # than the walkers. A mixture of them follows these ends, where a walk by the first moves stays for long.
    for length in (first, 2 * first) if several else (first,):
        moves = made_from(both.walk(density, length, moves, FOLLOWED)[0])
    parts: list[tuple[Array, list[Terms]]] = []
    sweeps, more, long = 0, int(first * max(asked.least / len(density.layout.own), 1.0)), LONG * first
    while True:
        parts.append(both.walk(density, more, moves, FOLLOWED))
        sweeps += more
        result = _judged(both.layout, moves, parts, asked)
        lacking = (result.width_error / asked.width_error) ** 2 if sweeps < FOR_WIDTHS * first else 0.0
        if (result.agree and lacking <= 1) or sweeps >= most_sweeps:
            return result
        if long <= sweeps < min(FEW_TIMES * result.time, most_sweeps / 3):
            moves = made_from(np.concatenate([walked for walked, _ in parts]))
            most_sweeps, long, more, sweeps, parts = most_sweeps - sweeps, 2 * sweeps, sweeps, 0, []
            continue
        lacking = max(min(lacking, FOR_WIDTHS * first / sweeps), asked.independent / max(result.independent, 1.0))
        wanted = max(asked.times * result.time, sweeps * lacking)
        more = min(max(int(1.1 * min(wanted, most_sweeps)) - sweeps, sweeps // 4), sweeps, most_sweeps - sweeps)


def go_on(density: Density, begin: Array, seed: list[int], at_once: AtOnce = in_turn) -> Populations:
    """Walk shortly from where two populations (2, w, d) ended, with another density that is nearly the same."""
    several = density.layout.several
    both = _again(density, begin, 1.0, seed, at_once).settle(density, ROUND_SETTLING)
    moves = both.moves(of_each=OF_EACH if several else 1)
    walked = both.walk(density, ROUND_SWEEPS_OF_SEVERAL if several else ROUND_SWEEPS, moves)
    return _judged(both.layout, moves, [walked], GIVEN)


def tempered(density: Density, begin: Array, beta: float, seed: list[int], at_once: AtOnce = in_turn) -> Array:
    """(2, n, d) Walk shortly from places (2, w, d) at an inverse temperature; return the last half of the walks."""
    both = _again(density, begin, beta, seed, at_once).settle(density, TEMPERED)
    places, _ = both.walk(density, TEMPERED // 2, both.moves())
    return np.stack([each.reshape(-1, places.shape[2]) for each in np.split(places, 2, axis=1)])


def _again(density: Density, begin: Array, beta: float, seed: list[int], at_once: AtOnce) -> Pair:
    """Return two populations that begin at some of these places (2, w, d), samples at an inverse temperature."""
    two = (Population.of(density, places, np.random.default_rng([*seed, i])) for i, places in enumerate(begin))
    return Pair([each.at(ROUND_WALKERS, beta) for each in two], ROUND_WALKERS, at_once)


def _judged(layout: Layout, moves: Moves, parts: Sequence[tuple[Array, list[Terms]]], asked: Asked) -> Populations:
    """Say how well two populations agree that have walked as one, in parts; each is a half of the walkers."""
    walked = np.concatenate([places for places, _ in parts])
    kept, walkers, d = walked.shape
    r_hat, time, spread = judge(layout, walked)
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
