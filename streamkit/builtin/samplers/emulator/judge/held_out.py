"""Calls that are held out of what an emulator learns: they test it in place of fresh ones.

Of several streams, those that an earlier run has made, and those that fresh calls have confirmed since they were last
called, need no new calls: a part of their own, chosen by chance, is left out, and the emulator that has learned from
the others is compared with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from streamkit import Array, BoolArray
from streamkit.builtin.samplers.emulator.at_once import AtOnce
from streamkit.builtin.samplers.emulator.changes import with_axes
from streamkit.builtin.samplers.emulator.known import Known
from streamkit.builtin.samplers.emulator.learn.calls import Calls
from streamkit.builtin.samplers.emulator.learn.emulator import Emulator
from streamkit.builtin.samplers.emulator.tilt import tilt
from streamkit.builtin.samplers.emulator.walk.density import Emulated

# One in so many calls at the posterior is held out, and so many at least: fewer test nothing.
PART, LEAST = 4, 64
# A call is at the posterior if its density is at least that of this fraction of the samples.
LOWEST = 0.02
# Standard deviations by which the mean of these calls may differ from that of the samples, and the fraction of the
# samples' widths that theirs are at least: else samples are where no calls are. Calls are spread more evenly.
ELSEWHERE, NARROW = 1.0, 0.7


@dataclass(frozen=True)
class HeldOut:
    """The calls that were held out, and what was emulated without them."""

    calls: Calls
    emulated: Emulated


def held_out(
    known: Sequence[Known], samples: Array, warm: Array, at_once: AtOnce, rng: np.random.Generator
) -> list[HeldOut | None]:
    """Hold out calls of each factor that may be tested by them at samples (n, d) of the posterior; None of others.

    The others are learned from as all of them are: beside samples (2, m, d) of the ``warm`` copy. A single
    factor is tested by fresh calls.
    """
    several = len(known) > 1
    chosen = [_chosen(each, samples, rng) if several and each.is_confirmed else None for each in known]
    works = [
        partial(each.calls.take(~rows).learn, tilt(each.factor, warm, each.calls.z[~rows]))
        for each, rows in zip(known, chosen, strict=True)
        if rows is not None
    ]
    learned = iter(at_once(works))
    return [None if rows is None else _without(each, rows, next(learned))
            for each, rows in zip(known, chosen, strict=True)]  # fmt: skip


def _without(each: Known, rows: BoolArray, emulator: Emulator | None) -> HeldOut | None:
    if emulator is None:
        return None
    return HeldOut(each.calls.take(rows), replace(each.emulated, emulator=emulator.of(each.calls.problem)))


def _chosen(each: Known, samples: Array, rng: np.random.Generator) -> BoolArray | None:
    """Choose calls at the posterior; None where there are too few of them, or the posterior is elsewhere.

    What is emulated at a call says whether it is there, and not what it gave: its noise would choose it.
    """
    mine, z, matters = samples[:, each.factor.columns], each.calls.z, each.factor.problem.coordinates
    lowest = np.quantile(_ln_density(each, samples, mine), LOWEST)
    inside = np.flatnonzero(_ln_density(each, samples, z) >= lowest)
    size = len(inside) // PART
    if size < LEAST or not _are_there(z[np.ix_(inside, matters)], mine[:, matters]):
        return None
    rows = np.zeros(len(z), dtype=bool)
    rows[rng.choice(inside, size, replace=False)] = True
    return rows


def _are_there(calls: Array, samples: Array) -> bool:
    """Whether calls (n, d) are where samples (m, d) are, along each coordinate and each principal axis."""
    both = with_axes(np.concatenate([samples, calls]), len(samples))
    ours, theirs = both[: len(samples)], both[len(samples) :]
    width = np.maximum(ours.std(axis=0), 1e-300)
    away = np.abs(theirs.mean(axis=0) - ours.mean(axis=0)) / width
    return bool(away.max() < ELSEWHERE and (theirs.std(axis=0) / width).min() > NARROW)


def _ln_density(each: Known, samples: Array, z: Array) -> Array:
    """(n,) Return ln density of all factors' posterior at coordinates z (n, p) of one, but for a constant."""
    own = z[:, np.isin(each.factor.columns, each.factor.own)]
    prior = -0.5 * np.sum(own**2, axis=1)
    return np.asarray(each.emulated.ln_likelihood(z) + prior + tilt(each.factor, samples, z))
