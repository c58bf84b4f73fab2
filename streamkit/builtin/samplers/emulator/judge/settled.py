"""Whether the posterior has settled: how far it has moved, and what the noise of all calls leaves uncertain of it.

Both weigh samples by other emulators: those of some rounds before, and those that other noise could have given.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from streamkit import Array, IntArray
from streamkit.builtin.samplers.emulator.at_once import AtOnce, in_turn
from streamkit.builtin.samplers.emulator.changes import (
    beyond_chance,
    changes_of,
    real_change_of,
    with_axes,
)
from streamkit.builtin.samplers.emulator.known import Known
from streamkit.builtin.samplers.emulator.walk.density import Emulated, Joint

# The posterior is compared with that of the emulators of so many rounds before.
ROUNDS = 2
# Emulators of each factor that the noise of its calls could have given as well, and the fraction of them that count.
REDRAWN, LIKELY = 32, 0.9


def moved_by(
    known: Sequence[Known], joint: Joint, samples: Array, watched: IntArray, rng: np.random.Generator
) -> float:
    """Return how far samples (n, d) of the posterior have moved in `ROUNDS` rounds; infinite before.

    It is the most that a mean or a width of the ``watched`` coordinates changes, in standard deviations. Note each
    factor's part.
    """
    if any(len(each.before) < ROUNDS for each in known):
        return np.inf
    here, moving = joint.ln_likelihoods(samples), with_axes(samples[:, watched])
    olds = [Joint(joint.factors, [each.before[i] for each in known]) for i in range(ROUNDS)]
    changes = np.array([old.ln_likelihoods(samples) - here for old in olds])  # (rounds, n, K)
    for k, each in enumerate(known):
        each.moves = max(real_change_of(moving, change[:, k], rng) for change in changes)
    return max(real_change_of(moving, change.sum(axis=1), rng) for change in changes)


def uncertain_by(
    known: Sequence[Known], samples: Array, watched: IntArray, rng: np.random.Generator, at_once: AtOnce = in_turn
) -> float:
    """Return what the noise of all calls moves of any mean or width at most, in standard deviations.

    In `LIKELY` of the cases it is less. What weights in another order move is chance, see `real_change_of`. Note each
    factor's share.
    """
    moving = with_axes(samples[:, watched])
    mine = [samples[:, each.factor.columns] for each in known]
    rngs = rng.spawn(len(known)) if len(known) > 1 else [rng]
    works = [partial(_by_noise, each.emulated, z, its, moving) for each, z, its in zip(known, mine, rngs, strict=True)]
    total, by_chance = np.zeros((2, REDRAWN, 2, moving.shape[1]))
    for each, (changes, shuffled) in zip(known, at_once(works), strict=True):
        left = np.mean(changes**2, axis=0).max() - np.mean(shuffled**2, axis=0).max()
        each.share = len(known) * max(float(left), 0.0)
        total, by_chance = total + changes, by_chance + shuffled
    measured, chance = (float(np.quantile(np.abs(one).max(axis=(1, 2)), LIKELY)) for one in (total, by_chance))
    return beyond_chance(measured, chance)


def _by_noise(emulated: Emulated, mine: Array, rng: np.random.Generator, moving: Array) -> tuple[Array, Array]:
    """(REDRAWN, 2, d) Return what other noise in a factor's calls changes of samples, and in another order."""
    others = emulated.of_other_noise(mine, rng, REDRAWN) - emulated.ln_likelihood(mine)
    changes = np.array([changes_of(moving, change) for change in others])
    return changes, np.array([changes_of(moving, rng.permutation(change)) for change in others])
