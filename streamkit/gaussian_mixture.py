"""Mixtures of Gaussians: their density, and their fit by expectation maximisation."""

from __future__ import annotations

import warnings
from typing import NamedTuple, Self

import numpy as np

from streamkit.stream import Array

STEPS = 12  # of a fit from clusters
RIDGE = 1e-6  # added to the diagonal of covariances, as a fraction of the variance of all places


class GaussianMixture(NamedTuple):
    """A Gaussian mixture: weights (k,), means (k, d), lower roots of the covariances (k, d, d), and their inverses."""

    weights: Array
    means: Array
    roots: Array
    inverses: Array

    @classmethod
    def of_shares(cls, places: Array, share: Array, floor: Array) -> Self:
        """Return the mixture of places (n, d) that belong to components by shares (n, k).

        ``floor`` (d, d) is added to the covariances. It is the step of maximisation of Dempster, Laird & Rubin 1977.
        """
        total = share.sum(axis=0)
        means = (share.T @ places) / total[:, None]
        away = places[None] - means[:, None]
        covariances = np.einsum("nk,kni,knj->kij", share, away, away, optimize=True) / total[:, None, None]
        roots = np.linalg.cholesky(covariances + floor)
        return cls(total / total.sum(), means, roots, np.linalg.inv(roots))

    @classmethod
    def fitted(cls, places: Array, count: int, rng: np.random.Generator) -> Self:
        """Return the mixture of so many components, or fewer, that is fitted to places (n, d), from clusters."""
        d = places.shape[1]
        spread = np.maximum(places.std(axis=0), 1e-300)
        white = (places - places.mean(axis=0)) / spread
        share = np.eye(count)[_clusters(white, count, rng)]
        for _ in range(STEPS if count > 1 else 1):
            held = share.sum(axis=0)
            share = share[:, held > min(d + 2, 0.99 * held.max())]  # one is left, of however few places
            mixture = cls.of_shares(white, share, RIDGE * np.eye(d))
            share = np.exp(mixture.ln_shares(white))
        means = mixture.means * spread + places.mean(axis=0)
        return cls(mixture.weights, means, mixture.roots * spread[:, None], mixture.inverses / spread)

    def ln_shares(self, y: Array) -> Array:
        """(n, k) ln probability of each component at y (n, d)."""
        terms = self.ln_terms(y)
        return np.asarray(terms - np.logaddexp.reduce(terms, axis=1, keepdims=True))

    def ln_terms(self, y: Array) -> Array:
        """(n, k) ln of the weighted density of each component at y (n, d), up to a common constant."""
        k, d = self.means.shape
        middle = np.einsum("kij,kj->ki", self.inverses, self.means)
        white = (y @ self.inverses.reshape(k * d, d).T).reshape(-1, k, d) - middle
        volumes = np.log(np.einsum("kii->ki", self.inverses)).sum(axis=1)
        return np.asarray(np.log(self.weights) + volumes - 0.5 * np.einsum("nki,nki->nk", white, white))

    def ln_density(self, y: Array) -> Array:
        """(n,) ln of the density at y (n, d), up to the constant of `ln_terms`."""
        return np.asarray(np.logaddexp.reduce(self.ln_terms(y), axis=1))


def _clusters(white: Array, count: int, rng: np.random.Generator) -> Array:
    """(n,) Return the number of a cluster for each place."""
    if count == 1:
        return np.zeros(len(white), dtype=int)
    from scipy.cluster.vq import kmeans2  # slow to import, and few commands need it

    with warnings.catch_warnings():  # an empty cluster is left out
        warnings.filterwarnings("ignore", message="One of the clusters is empty")
        return np.asarray(kmeans2(white, count, minit="++", rng=rng)[1])
