"""Mixtures of Gaussians: their density, and the step of expectation maximisation that fits them."""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np

from streamkit import Array


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

    def ln_terms(self, y: Array) -> Array:
        """(n, k) ln of the weighted density of each component at y (n, d), up to a common constant."""
        k, d = self.means.shape
        middle = np.einsum("kij,kj->ki", self.inverses, self.means)
        white = (y @ self.inverses.reshape(k * d, d).T).reshape(-1, k, d) - middle
        volumes = np.log(np.einsum("kii->ki", self.inverses)).sum(axis=1)
        return np.asarray(np.log(self.weights) + volumes - 0.5 * np.einsum("nki,nki->nk", white, white))
