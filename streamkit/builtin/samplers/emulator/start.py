"""The start: waves of calls with few particles, from the whole prior to where the data may be.

The emulator's own error is part of its likelihood, so that nothing is given up before it is certain to be wrong: where
little is certain, the emulated posterior is broad, and new points in it make it narrower (history matching, Vernon,
Goldstein & Bower 2010).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

from streamkit import Array, StreamkitError
from streamkit.builtin.samplers.emulator.calls import Calls
from streamkit.builtin.samplers.emulator.coordinates import Space
from streamkit.builtin.samplers.emulator.emulated import Emulated
from streamkit.builtin.samplers.emulator.problem import Problem

# Draws of the prior for each parameter and in any case, made until so many predictions for each parameter are there,
# and so often at most.
DRAWS, FEWEST_DRAWS, NEEDED, MOST_BATCHES = 20, 60, 8, 16
# New points of a wave for each parameter, and in any case.
WAVE, LEAST_WAVE = 6, 48
# Most waves of a start.
WAVES = 40
# Doubt, in ln likelihood, below which the emulator has arrived: what its own error makes of it at a typical sample.
ARRIVED = 1.5
# Walkers for each parameter and in any case, and their steps in a wave, of which the last are used.
WALKERS, LEAST_WALKERS, STEPS, USED = 10, 128, 60, 20


@dataclass(frozen=True)
class Arrival:
    """Where a start has come to.

    Attributes
    ----------
    calls
        All its calls.
    places
        (n, d) coordinates sampled from its emulated posterior.
    emulated
        The posterior that it has emulated.
    doubt
        What the emulator's own error makes of a typical ln likelihood.
    """

    calls: Calls
    places: Array
    emulated: Emulated
    doubt: float


def walkers_for(d: int) -> int:
    """Return the number of walkers for d parameters; even, as halves move in turn."""
    return max(LEAST_WALKERS, WALKERS * d + WALKERS * d % 2)


def arrive(
    problem: Problem, space: Space, seed: list[int], note: Callable[[str], None], calls: Calls | None = None
) -> Arrival:
    """Make waves until the emulator is sure of its posterior, from draws of the prior or from calls that were made.

    StreamkitError where predictions are too rare.
    """
    d = problem.size
    calls = _draws(problem, space, seed) if calls is None else calls
    rng = np.random.default_rng([*seed, 1])
    places: Array | None = None
    for wave in range(WAVES):
        emulator = calls.learn()
        if emulator is None:
            calls += _more(problem, space, rng)
            continue
        emulated = Emulated(space, emulator, problem.add_noise)
        pool = calls.y if places is None else np.concatenate([calls.y, places])
        chain = emulated.sample(pool, walkers_for(d), STEPS, [*seed, 2, wave])
        places = chain[-USED:].reshape(-1, d)
        doubt = doubt_of(emulated, places)
        note(f"{len(calls)} draws, the emulator doubts {doubt:.1f} in ln L")
        if doubt < ARRIVED:
            break
        chosen = rng.choice(len(places), max(WAVE * d, LEAST_WAVE), replace=False)
        calls += Calls.at(problem, space, places[chosen])
        places = chain[-1]
    if places is None:
        raise StreamkitError(
            f"found no place to start: of {len(calls)} draws only {int(calls.good.sum())} give a stream with "
            "observables. Check the priors with `streamkit check`."
        )
    return Arrival(calls, places, emulated, doubt)


def doubt_of(emulated: Emulated, y: Array) -> float:
    """Return how much the emulator's own error changes a typical ln likelihood at samples y (n, d)."""
    some = y[:: max(len(y) // 500, 1)]
    change = emulated.ln_likelihood(some) - emulated.ln_likelihood(some, fit_error=False)
    return float(np.median(np.abs(change)))


def _draws(problem: Problem, space: Space, seed: list[int]) -> Calls:
    """Draw from the prior until there are enough predictions."""
    d = problem.size
    size = 1 << int(np.ceil(np.log2(DRAWS * d + FEWEST_DRAWS)))
    sobol = qmc.Sobol(d, scramble=True, rng=np.random.default_rng(seed))
    calls: Calls | None = None
    for _ in range(MOST_BATCHES):
        u = np.clip(sobol.random(size), 1e-9, 1 - 1e-9)  # the ends of a prior may be infinite
        batch = Calls.at(problem, space, space.to(problem.from_unit(u)))
        calls = batch if calls is None else calls + batch
        if calls.good.sum() >= NEEDED * d:
            break
    assert calls is not None  # noqa: S101  there is at least one batch
    return calls


def _more(problem: Problem, space: Space, rng: np.random.Generator) -> Calls:
    """Draw more of the prior."""
    return Calls.at(problem, space, space.to(problem.from_unit(rng.random((4 * problem.size, problem.size)))))
