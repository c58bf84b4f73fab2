"""Is the chain long enough: autocorrelation time, effective samples, R-hat, burn-in, stuck walkers; the one rule."""

from __future__ import annotations

from dataclasses import dataclass

import emcee
import numpy as np

from streamkit.stream import Array, IntArray

LOW = 5.0
"""A stranded walker's mean ln p lies below the others' by so many standard deviations of such means."""
NARROW = 0.5
"""And it roams less than this fraction of what the median walker does."""


def autocorrelation_times(chain: Array) -> Array:
    """(d,) Integrated autocorrelation times in steps of a chain (steps, walkers, d) (Goodman & Weare 2010).

    NaN where it cannot be estimated: fewer than 8 steps, or walkers that never moved.
    """
    steps, _, d = chain.shape
    if steps < 8:
        return np.full(d, np.nan)
    with np.errstate(all="ignore"):
        tau = np.asarray(emcee.autocorr.integrated_time(chain, tol=0, quiet=True), dtype=float)
    return np.where(np.isfinite(tau) & (tau > 0), tau, np.nan)


def burn_in(chain: Array) -> int:
    """Return the steps to discard: three times the longest autocorrelation time, at most half the chain."""
    tau = autocorrelation_times(chain)
    half = len(chain) // 2
    return half if np.isnan(tau).any() else min(int(np.ceil(3 * tau.max())), half)


def effective_samples(chain: Array, tau: Array) -> Array:
    """(d,) Number of independent samples that a chain (steps, walkers, d) is worth, at tau (d,)."""
    steps, walkers, _ = chain.shape
    return np.asarray(steps * walkers / tau)


def split_r_hat(chain: Array) -> Array:
    """(d,) Split R-hat of a chain (steps, walkers, d): each half walker is a chain (Gelman+ 2013, 11.4)."""
    half = len(chain) // 2
    if half < 2:
        return np.full(chain.shape[2], np.nan)
    parts = np.concatenate([chain[:half], chain[half : 2 * half]], axis=1)
    within = parts.var(axis=0, ddof=1).mean(axis=0)
    between = half * parts.mean(axis=0).var(axis=0, ddof=1)
    with np.errstate(all="ignore"):
        r_hat = np.sqrt(((half - 1) / half * within + between / half) / within)
    return np.where(np.isfinite(r_hat), r_hat, np.nan)


def stuck_walkers(chain: Array, log_prob: Array) -> IntArray:
    """Return the numbers of the walkers that are stuck on a false maximum, or do not move at all.

    Over the last half of the chain, such a walker's mean ln p lies far below the ensemble's, by the robust standard
    deviation (from the median absolute deviation) of the walkers' means; and it roams less than half as far as
    the median walker, by the largest of its standard deviations in units of the ensemble's. One that is only on
    an excursion into a tail moves, and one that rests near the maximum is not low.

    Parameters
    ----------
    chain, log_prob
        (steps, walkers, d) and (steps, walkers); fewer than 16 steps tell nothing.
    """
    steps = len(chain)
    if steps < 16:
        return np.empty(0, dtype=np.int64)
    late, lnp = chain[steps // 2 :], log_prob[steps // 2 :].mean(axis=0)
    deviation = np.median(lnp) - lnp
    low = deviation > LOW * 1.4826 * np.median(np.abs(deviation))
    whole = late.std(axis=(0, 1))
    roams = np.max(late.std(axis=0) / np.where(whole > 0, whole, 1.0), axis=1)
    return np.flatnonzero(low & (roams < NARROW * np.median(roams)))


CHECK = 100
"""Steps between two looks at the autocorrelation time."""
STABLE = 0.05
"""The autocorrelation time must have changed by less than this fraction since the last look."""


@dataclass(frozen=True)
class Limits:
    """When the sampling ends: at ``steps``, at ``deadline`` (`time.monotonic`), or with a long enough chain.

    Long enough means longer than ``tau_factor`` times the longest autocorrelation time, if that is stable, and a split
    R-hat below ``r_hat`` for every parameter; the steps in which the moves still learn do not count.
    """

    steps: int
    tau_factor: float = 50.0
    r_hat: float = np.inf
    deadline: float = np.inf


def longest_time(chain: Array) -> float:
    """Return the longest autocorrelation time of a chain (steps, walkers, d)."""
    return float(np.max(autocorrelation_times(chain)))
