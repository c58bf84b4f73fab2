"""A quantity averaged over families: the mixture of their posteriors, and how much of its variance is between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import softmax

from streamkit.stream import Array

LEVELS = {"": 50.0, "lo68": 16.0, "hi68": 84.0, "lo95": 2.5, "hi95": 97.5}
STACKED, STEPS = 400, 2000  # choices of the streams, and steps of expectation maximisation
TRIES = 2000  # draws of ln evidence within its errors, for the errors of weights


def weights_of(ln_evidence: Array, errors: Array, seed: int) -> tuple[Array, Array]:
    """(k,) and (k,) Return posterior probabilities of families of equal prior probability, and their errors."""
    drawn = ln_evidence + errors * np.random.default_rng(seed).standard_normal((TRIES, len(errors)))
    return np.asarray(softmax(ln_evidence)), np.asarray(softmax(drawn, axis=1).std(axis=0))


def stacking_weights(ln_density: Array, seed: int) -> tuple[Array, Array]:
    """(k,) and (k,) Return weights of families that together predict each stream by all others best, and their errors.

    They maximise the sum over streams of ln of the weighted densities of its data, ``ln_density`` (n, k) being those of
    n streams by k families (stacking: Yao et al. 2018, Bayesian Analysis 13, 917, eq. 3). The priors of the hosts count
    for less than in an evidence, and no family needs to be right. Errors are those of the choice of the streams (the
    Bayesian bootstrap: Rubin 1981).
    """
    n = len(ln_density)
    drawn = np.random.default_rng(seed).dirichlet(np.ones(n), STACKED)
    density = np.exp(ln_density - ln_density.max(axis=1, keepdims=True))
    return _stacked(density, np.full((1, n), 1 / n))[0], np.asarray(_stacked(density, drawn).std(axis=0))


def _stacked(density: Array, counts: Array) -> Array:
    """(t, k) Weights for densities (n, k), each stream counting as in counts (t, n), by expectation maximisation."""
    weights = np.full((len(counts), density.shape[1]), 1 / density.shape[1])
    for _ in range(STEPS):
        weights = weights * ((counts / (weights @ density.T)) @ density)
    return weights


@dataclass(frozen=True)
class Averaged:
    """A quantity at m places, averaged over families.

    Attributes
    ----------
    levels
        (m,) median and intervals of the mixture, by the names of `LEVELS`.
    within, between
        (m,) standard deviations: of the families' own posteriors, and of their means. Their squares add to the
        variance of the mixture.
    spread
        (m,) standard deviation of the families' means with equal weights: what the choice of a family moves.
    """

    levels: dict[str, Array]
    within: Array
    between: Array
    spread: Array


def average(samples: Sequence[Array], weights: Array) -> Averaged:
    """Average samples (n_k, m) of each family k with weights (k,) whose sum is 1."""
    means, variances = (np.array([getattr(each, what)(axis=0) for each in samples]) for what in ("mean", "var"))
    both = np.concatenate(samples)
    each = np.concatenate([np.full(len(s), w / len(s)) for s, w in zip(samples, weights, strict=True)])
    order = np.argsort(both, axis=0)
    ordered, shares = np.take_along_axis(both, order, axis=0), each[order]
    below = np.cumsum(shares, axis=0) - 0.5 * shares
    levels = {
        name: np.array([np.interp(level / 100, below[:, i], ordered[:, i]) for i in range(both.shape[1])])
        for name, level in LEVELS.items()
    }
    middle = weights @ means
    between = np.sqrt(weights @ (means - middle) ** 2)
    return Averaged(levels, np.sqrt(weights @ variances), between, means.std(axis=0, ddof=1))
