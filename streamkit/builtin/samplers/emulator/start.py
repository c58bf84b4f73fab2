"""The start of each factor: waves of calls with few particles, from the whole prior to where the data may be.

The emulator's own error is part of its likelihood, so that nothing is given up before it is certain to be wrong: where
little is certain, the emulated posterior is broad, and new points in it make it narrower (history matching, Vernon,
Goldstein & Bower 2010).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial, reduce
from operator import add
from typing import TypeVar

import numpy as np
from scipy.spatial import cKDTree
from scipy.stats import norm, qmc

from streamkit import Array, BoolArray, StreamkitError
from streamkit.builtin.samplers.emulator.at_once import AtOnce, Work, in_turn, side_by_side
from streamkit.builtin.samplers.emulator.changes import every_so_often
from streamkit.builtin.samplers.emulator.known import SOME, Known, Start
from streamkit.builtin.samplers.emulator.learn.calls import Calls
from streamkit.builtin.samplers.emulator.learn.emulator import Emulator
from streamkit.builtin.samplers.emulator.learn.problem import Problem
from streamkit.builtin.samplers.emulator.learn.space import Space
from streamkit.builtin.samplers.emulator.walk.density import Density, Emulated, Factor, Joint, Layout, Tangent, Terms
from streamkit.builtin.samplers.emulator.walk.population import Population

T = TypeVar("T")

# Draws of the prior for each parameter and in any case, made until so many predictions for each parameter are there,
# and so often at most.
DRAWS, FEWEST_DRAWS, NEEDED, MOST_BATCHES = 20, 60, 8, 16
# New points of a wave for each parameter, and in any case.
WAVE, LEAST_WAVE = 6, 48
# Most waves of a start. It ends earlier where the emulator's own error stays above this fraction of its least for so
# many waves: more calls with few particles do not help, as where an orbit is chaotic.
WAVES, LOWER, PATIENCE = 40, 0.9, 12
# Doubt, in ln likelihood, below which the emulator has arrived: what its own error makes of it at a typical sample.
ARRIVED = 1.5
# The same for the data of the host beside several streams: a call there takes no stream, and all streams need it.
HOST_ARRIVED = 0.05
# Walkers of a wave for each parameter and in any case, and sweeps of their walk, of which the last are used.
WALKERS, LEAST_WALKERS, SWEEPS, USED = 10, 128, 15, 4
# Calls with all particles where the starts have arrived, for each parameter and in any case.
FIRST, LEAST_FIRST = 16, 160
# New calls at a time where too few of them have a prediction.
MORE = 80
# Nearest places of a start, one of which a walker gets beside its host; walkers to choose from.
NEAREST, BEGIN = 15, 2000


@dataclass(frozen=True, eq=False)
class Beside:
    """The posterior of a factor alone, with what the data of the host say of its shared coordinates."""

    alone: Joint
    host: Emulated
    shared: BoolArray
    layout: Layout

    def terms(self, z: Array) -> Terms:
        """Return the terms at z (n, d)."""
        prior, lnl = self.alone.terms(z)
        prior[:, 0] += self.host.ln_likelihood(z[:, self.shared])
        return Terms(prior, lnl)

    def tangents(self, z: Array) -> list[Tangent]:
        """Return what the data of the factor and of the host say at z (n, d)."""
        return [*self.alone.tangents(z), self.host.tangent(z[:, self.shared], np.flatnonzero(self.shared))]


class Starter:
    """Makes the starts of all factors.

    Parameters
    ----------
    noise
        Whether the variance of one call is part of the likelihood.
    note
        Called with a line about the progress.
    at_once
        Runs tasks in several processes: what all starts learn from their calls, and their walks.
    """

    def __init__(self, noise: bool, note: Callable[[str], None], at_once: AtOnce = in_turn) -> None:
        self._noise, self._note, self._at_once = noise, note, at_once
        self._host: Emulated | None = None

    def all(self, factors: Sequence[Factor], starts: int, max_calls: int) -> list[Known]:
        """Start each factor alone, so many times; those of the host's data first: they are part of the others' prior.

        Raises StreamkitError where too few calls give a prediction.
        """
        known: dict[str, Known] = {}
        hosts, streams = [each for each in factors if not len(each.own)], [each for each in factors if len(each.own)]
        for some in (*([each] for each in hosts), streams):
            wanted = [(each, i) for each in some for i in range(1 if len(each.earlier) else starts)]
            made = self._made([self.one(*each) for each in wanted])
            begun = [[start for (its, _), start in zip(wanted, made, strict=True) if its is each] for each in some]
            works = [self._known(*each, max_calls) for each in zip(some, begun, strict=True)]
            known |= {each.factor.name: each for each in self._made(works)}
            if some is not streams and self._host is None:
                self._host = known[some[0].name].emulated
        return [known[factor.name] for factor in factors]

    def _made(self, works: Sequence[Work[T]]) -> list[T]:
        return side_by_side(works, self._at_once)

    def one(self, factor: Factor, number: int) -> Work[Start]:
        """Make waves until the emulator is sure of its posterior, from draws of the prior or from calls that were made.

        A stream's place in the run file does not change its calls: its name decides.
        """
        small, seed = factor.small, [factor.problem.seed, 12, *factor.name.encode(), number]
        space, rng, calls = Space(factor.problem), np.random.default_rng([*seed, 1]), None
        if len(factor.earlier):
            small = factor.problem
            calls = Calls.of(small, space, factor.earlier)
        calls = _draws(small, space, seed) if calls is None else calls
        d, places, draws = small.size, None, 0 if len(factor.earlier) else len(calls)
        least, last = np.inf, 0
        for wave in range(WAVES):
            found = yield partial(self._wave, factor, calls, places, [*seed, 2, wave])
            if found is None:
                more = rng.standard_normal((4 * d, d)), _between(calls.z[calls.good], rng)
                calls += Calls.at(small, space, np.concatenate(more))
                continue
            emulator, places, own_error = found
            self._note(f"{factor.name}: {len(calls)} draws, the emulator's own error is {own_error:.1f} in ln L")
            if own_error < LOWER * least:
                least, last = own_error, wave
            if own_error < (ARRIVED if len(factor.own) else HOST_ARRIVED) or wave - last == PATIENCE:
                break
            calls += Calls.at(small, space, rng.choice(places, max(WAVE * d, LEAST_WAVE), replace=False))
        if places is None:
            raise StreamkitError(
                f"found no place to start: of {len(calls)} draws only {int(calls.good.sum())} give a stream with "
                "observables. Check the priors with `streamkit check`."
            )
        return Start(calls, places, Emulated(space, emulator.of(small), small.add_noise, np.inf), draws)

    def _wave(
        self, factor: Factor, calls: Calls, places: Array | None, seed: list[int]
    ) -> tuple[Emulator, Array, float] | None:
        """Learn from calls; return the emulator, places (n, d) of its posterior, and its own error there."""
        emulator = calls.learn()
        if emulator is None:
            return None
        emulated = Emulated(calls.space, emulator, calls.problem.add_noise, np.inf)
        density, d = self._density(factor, emulated), calls.problem.size
        pool = calls.z if places is None else np.concatenate([calls.z, places])
        population = Population.of(density, pool, np.random.default_rng(seed))
        places = population.come(density, max(LEAST_WALKERS, WALKERS * d), SWEEPS, USED)
        return emulator, places, own_error_of(emulated, places)

    def _density(self, factor: Factor, emulated: Emulated) -> Density:
        alone = Joint([factor.alone], [emulated])
        if self._host is None or not len(factor.own):
            return alone
        return Beside(alone, self._host, np.isin(factor.columns, factor.shared), alone.layout)

    def _known(self, factor: Factor, starts: list[Start], max_calls: int) -> Work[Known]:
        """Call a factor with all particles where its starts have arrived."""
        problem, space = factor.problem, Space(factor.problem)
        places, rng = np.concatenate([each.places for each in starts]), np.random.default_rng([problem.seed, 14])
        if starts[0].calls.problem is problem:
            calls = reduce(add, [each.calls for each in starts])
        else:
            calls = Calls.at(problem, space, rng.permutation(places)[: max(FIRST * problem.size, LEAST_FIRST)])
        while (emulator := (yield calls.learn)) is None:  # between the places, as too few of them have a prediction
            if len(calls) >= max_calls or problem.time_left() <= 0:
                raise StreamkitError(
                    f"too few predictions to learn from: of {len(calls)} calls with all particles only "
                    f"{int(calls.good.sum())} give a stream with observables, where streams of few particles have "
                    "them. Raise sampler.start_particles."
                )
            calls += Calls.at(problem, space, _between(places, rng))
        emulated = Emulated(space, emulator.of(problem), self._noise)
        alone = float(np.max(emulated.ln_likelihood(every_so_often(places, SOME))))
        earlier = len(factor.earlier) > 0
        return Known(factor, calls, emulated, starts, alone, taught=0.0 if earlier else np.inf, is_confirmed=earlier)

    def again(self, known: Known) -> None:
        """Make another start of a factor, and call it with all particles where that has arrived."""
        (start,), problem = self._made([self.one(known.factor, len(known.starts))]), known.factor.problem
        size = max(FIRST * problem.size, LEAST_FIRST) // 2
        known.starts.append(start)
        rng = np.random.default_rng([problem.seed, 15, len(known.starts)])
        known.calls += Calls.at(problem, known.calls.space, rng.permutation(start.places)[:size])


def begin_apart(known: Sequence[Known]) -> list[Array]:
    """Return two sets of places: hosts of any start, and for each stream a place of its start with such a host.

    Each set is of other starts, where a factor has several.
    """
    layout = Joint([each.factor for each in known], []).layout
    rng = np.random.default_rng([known[0].factor.problem.seed, 13])
    host_columns = [np.isin(each.factor.columns, each.factor.shared) for each in known]
    sets = []
    for population in range(2):
        places = [each.starts[population % len(each.starts)].places for each in known]
        hosts = np.concatenate([rng.permutation(some[:, columns])[: 4 * BEGIN]
                                for some, columns in zip(places, host_columns, strict=True)])  # fmt: skip
        z = np.empty((BEGIN, layout.size))
        z[:, layout.shared] = h = hosts[rng.integers(len(hosts), size=BEGIN)]
        for each, some, columns in zip(known, places, host_columns, strict=True):
            own = each.factor.own
            if not len(layout.shared):
                z[:, own] = some[rng.integers(len(some), size=BEGIN)]
            elif len(own):
                near = min(NEAREST, len(some))
                _, rows = cKDTree(some[:, columns]).query(h, near)
                chosen = rows.reshape(BEGIN, near)[np.arange(BEGIN), rng.integers(near, size=BEGIN)]
                z[:, own] = some[chosen][:, ~columns]
        sets.append(z)
    return sets


def own_error_of(emulated: Emulated, z: Array) -> float:
    """Return how much the emulator's own error changes a typical ln likelihood at samples z (n, d)."""
    return float(np.median(np.abs(emulated.change_by_error(every_so_often(z, 500)))))


def _draws(problem: Problem, space: Space, seed: list[int]) -> Calls:
    """Draw from the prior until there are enough predictions."""
    d = problem.size
    size = 1 << int(np.ceil(np.log2(DRAWS * d + FEWEST_DRAWS)))
    sobol = qmc.Sobol(d, scramble=True, rng=np.random.default_rng(seed))
    calls: Calls | None = None
    for _ in range(MOST_BATCHES):
        u = np.clip(sobol.random(size), 1e-9, 1 - 1e-9)  # the ends of a prior may be infinite
        batch = Calls.at(problem, space, norm.ppf(u))
        calls = batch if calls is None else calls + batch
        if calls.good.sum() >= NEEDED * d:
            break
    assert calls is not None  # noqa: S101  there is at least one batch
    return calls


def _between(places: Array, rng: np.random.Generator) -> Array:
    """(`MORE`, d) Return coordinates between and beside places (n, d); none beside fewer than three."""
    if len(places) < 3:
        return places[:0]
    first, one, other = places[rng.integers(len(places), size=(3, MORE))]
    return np.asarray(first + rng.random((MORE, 1)) * (one - other))
