"""Diagnostics of a chain: its drift, and the ranks of its walkers."""

from __future__ import annotations

import numpy as np
from scipy.stats import norm, rankdata

from streamkit.stream import Array


def drift(kept: Array, tau: Array) -> Array:
    """(d,) Difference of the means of the last and the first third of a chain, in its standard errors (Geweke 1992).

    ``kept`` (steps, walkers, d) are the samples after burn-in, ``tau`` (d,) their autocorrelation times in steps. NaN
    for fewer than 6 steps.
    """
    steps, walkers, d = kept.shape
    third = steps // 3
    if third < 2:
        return np.full(d, np.nan)
    first, last = kept[:third], kept[-third:]
    variance = (first.var(axis=(0, 1)) + last.var(axis=(0, 1))) * tau / (third * walkers)
    with np.errstate(all="ignore"):  # a parameter that never moved
        return np.asarray((last.mean(axis=(0, 1)) - first.mean(axis=(0, 1))) / np.sqrt(variance))


def ranks(kept: Array) -> Array:
    """(steps, walkers, d) Rank of every sample among all of its parameter, between 0 and 1 (Vehtari+ 2021, sec. 4)."""
    flat = kept.reshape(-1, kept.shape[2])
    return np.asarray((rankdata(flat, axis=0) - 0.5) / len(flat)).reshape(kept.shape)


def rank_scores(kept: Array, tau: Array) -> Array:
    """(walkers, d) How far each walker's mean rank is from 1/2, in standard errors of its independent samples."""
    steps = len(kept)
    with np.errstate(all="ignore"):
        return np.asarray((ranks(kept).mean(axis=0) - 0.5) / np.sqrt(tau / (12 * steps)))


def chance(scores: Array) -> float:
    """Return the probability that the largest of n independent normal scores is as large; NaN without any."""
    finite = np.abs(scores[np.isfinite(scores)])
    if not finite.size:
        return np.nan
    return float(-np.expm1(finite.size * np.log1p(-2 * norm.sf(finite.max()))))
