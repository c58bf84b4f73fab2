"""Moves of walkers on one posterior: by a Gaussian mixture of their population, and by differences of it.

A posterior with bends or several modes is locally Gaussian. A step chooses a component k of the mixture g by its
probability at the walker, and is a preconditioned Crank-Nicolson step about that component (Cotter et al. 2013). The
component cancels in the acceptance, min(1, p(y') g(y) / (p(y) g(y'))), which is that of a new draw of g, too: such
draws move walkers from one mode to another. Differential evolution (ter Braak & Vrugt 2008, without its snooker move)
reaches where the mixture is wrong.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.cluster.vq import kmeans2
from scipy.special import logsumexp

from streamkit import Array
from streamkit.builtin.samplers.emulator.joint_density import JointDensity, Layout, Terms

# Places for each parameter that a component has at least, most components, and steps of their fit.
PLACES, COMPONENTS, STEPS = 12, 24, 12
# Lengths of Crank-Nicolson steps, of which each walker draws one.
LENGTHS = (0.25, 0.5, 0.8, 1.0)
# Lengths of differences in units of the best one for a Gaussian, 2.38 / sqrt(2 d), and the fraction of whole ones.
DIFFERENCES, WHOLE = (1.0, 0.5, 0.2), 0.15
# What is added to the diagonal of covariances, as a fraction of the whole population's.
RIDGE = 1e-6


class Mixture(NamedTuple):
    """A Gaussian mixture: weights (k,), means (k, d), lower roots of the covariances (k, d, d), and their inverses."""

    weights: Array
    means: Array
    roots: Array
    inverses: Array

    @classmethod
    def of(cls, places: Array, rng: np.random.Generator) -> Mixture:
        """Fit places (n, d) by expectation maximisation, from clusters."""
        n, d = places.shape
        count = int(np.clip(n // (PLACES * d), 1, COMPONENTS))
        spread = np.maximum(places.std(axis=0), 1e-300)
        z = (places - places.mean(axis=0)) / spread
        _, labels = kmeans2(z, count, minit="++", rng=rng) if count > 1 else (None, np.zeros(n, dtype=int))
        share = np.eye(count)[labels]
        for _ in range(STEPS if count > 1 else 1):
            share = share[:, share.sum(axis=0) > d + 2]
            total = share.sum(axis=0)
            means = (share.T @ z) / total[:, None]
            away = z[None] - means[:, None]
            covariances = np.einsum("nk,kni,knj->kij", share, away, away, optimize=True) / total[:, None, None]
            roots = np.linalg.cholesky(covariances + RIDGE * np.eye(d))
            mixture = cls(total / total.sum(), means, roots, np.linalg.inv(roots))
            share = np.exp(mixture.ln_shares(z))
        means = mixture.means * spread + places.mean(axis=0)
        return cls(mixture.weights, means, mixture.roots * spread[:, None], mixture.inverses / spread)

    def ln_terms(self, y: Array) -> Array:
        """(n, k) ln of the weighted density of each component, up to a common constant."""
        k, d = self.means.shape
        white = (y @ self.inverses.reshape(k * d, d).T).reshape(-1, k, d) - np.einsum(
            "kij,kj->ki", self.inverses, self.means
        )
        volumes = np.log(np.einsum("kii->ki", self.inverses)).sum(axis=1)
        return np.asarray(np.log(self.weights) + volumes - 0.5 * np.einsum("nki,nki->nk", white, white))

    def ln_shares(self, y: Array) -> Array:
        """(n, k) ln probability of each component at y (n, d)."""
        terms = self.ln_terms(y)
        return np.asarray(terms - logsumexp(terms, axis=1, keepdims=True))

    def step(self, y: Array, length: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Propose steps of lengths (n,) from y (n, d); return places and what is added to ln of the acceptance (n,).

        An infinite length is a draw of the mixture.
        """
        terms = self.ln_terms(y)
        here, drawn = np.where(np.isinf(length)[:, None], np.log(self.weights), terms), np.minimum(length, 1.0)[:, None]
        k = np.argmax(here + rng.gumbel(size=here.shape), axis=1)
        chance = np.einsum("nij,nj->ni", self.roots[k], rng.standard_normal(y.shape))
        new = self.means[k] + np.sqrt(1 - drawn**2) * (y - self.means[k]) + drawn * chance
        return new, logsumexp(terms, axis=1) - logsumexp(self.ln_terms(new), axis=1)


class MixtureMoves:
    """The moves of a population, made from its places (n, d), which they do not change with.

    Attributes
    ----------
    accepted, sweeps
        (2,) sums of the fractions of accepted steps, by the mixture and by differences; and the sweeps.
    steps
        Evaluations of the density for each walker in a sweep.
    """

    def __init__(self, layout: Layout, places: Array) -> None:
        if len(layout.own) != 1 or len(layout.shared):
            raise ValueError("moves by a mixture are for one posterior; `BlockMoves` are for several factors")
        self._mixture, self._archive = Mixture.of(places, np.random.default_rng(len(places))), places
        self.accepted, self.sweeps, self.steps = np.zeros(2), 0, 3

    def sweep(
        self, density: JointDensity, y: Array, terms: Terms, beta: float, rng: np.random.Generator
    ) -> tuple[Array, Terms]:
        """Move walkers (w, d) with these terms; return the new places and their terms."""
        n = len(y)
        for length in (rng.choice(LENGTHS, size=n), np.full(n, np.inf)):
            y, terms, accepted = _decide(density, y, terms, *self._mixture.step(y, length, rng), beta, rng)
            self.accepted[0] += 0.5 * accepted
        y, terms, accepted = _decide(density, y, terms, y + self._differences(n, rng), np.zeros(n), beta, rng)
        self.accepted[1] += accepted
        self.sweeps += 1
        return y, terms

    def _differences(self, n: int, rng: np.random.Generator) -> Array:
        """(n, d) Differences of two of the archive, of several lengths."""
        first = rng.integers(len(self._archive), size=n)
        other = (first + rng.integers(1, len(self._archive), size=n)) % len(self._archive)
        length = 2.38 / np.sqrt(2 * self._archive.shape[1]) * rng.choice(DIFFERENCES, size=n)
        length = np.where(rng.random(n) < WHOLE, 1.0, length * (1 + 0.01 * rng.standard_normal(n)))[:, None]
        return np.asarray(length * (self._archive[first] - self._archive[other]))


def _decide(
    density: JointDensity, y: Array, terms: Terms, new: Array, correction: Array, beta: float, rng: np.random.Generator
) -> tuple[Array, Terms, float]:
    """Accept or refuse proposals new (n, d); return the places, their terms, and the accepted fraction."""
    others = density.terms(new)
    accepted = np.log(rng.random(len(y))) < others.total(beta) - terms.total(beta) + correction
    return np.where(accepted[:, None], new, y), terms.replaced(others, accepted), float(accepted.mean())
