"""A Gaussian mixture of a population, and steps that leave its density alone."""

from __future__ import annotations

import numpy as np

from streamkit import Array, GaussianMixture

# Places for each parameter that a component has at least, and most components.
PLACES, COMPONENTS = 12, 24
# Of a mixture with long ends: the fraction of each component that is wider, and by which factor.
ENDS, WIDER = 0.2, 2.0


class Mixture(GaussianMixture):
    """A Gaussian mixture, from which walkers draw."""

    @classmethod
    def of(cls, places: Array, rng: np.random.Generator) -> Mixture:
        """Fit places (n, d), with as many components as they can tell apart."""
        n, d = places.shape
        return cls.fitted(places, int(np.clip(n // (PLACES * d), 1, COMPONENTS)), rng)

    def with_long_ends(self) -> Mixture:
        """Return the mixture with a part of each component wider.

        A walker in a long end of a density, where the mixture is far lower, would stay there for hundreds of steps.
        """
        weights = np.concatenate([(1 - ENDS) * self.weights, ENDS * self.weights])
        roots, inverses = (np.concatenate([each, wider]) for each, wider in (
            (self.roots, WIDER * self.roots), (self.inverses, self.inverses / WIDER)))  # fmt: skip
        return Mixture(weights, np.concatenate([self.means, self.means]), roots, inverses)

    def draws(self, n: int, rng: np.random.Generator) -> Array:
        """(n, d) Draw places."""
        k = rng.choice(len(self.weights), n, p=self.weights)
        chance = rng.standard_normal((n, self.means.shape[1]))
        return np.asarray(self.means[k] + np.einsum("nij,nj->ni", self.roots[k], chance))

    def step(self, y: Array, length: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Propose steps of lengths (n,) from y (n, d); return places and what is added to ln of the acceptance (n,).

        A step chooses a component by its probability at the walker, and is a preconditioned Crank-Nicolson step about
        that component (Cotter et al. 2013). The component cancels in the acceptance, min(1, p(y') g(y) / (p(y) g(y')))
        for the mixture g. That is the acceptance of a draw of the mixture, too, which an infinite length is: such draws
        move walkers from one mode to another.
        """
        terms = self.ln_terms(y)
        here, drawn = np.where(np.isinf(length)[:, None], np.log(self.weights), terms), np.minimum(length, 1.0)[:, None]
        k = np.argmax(here + rng.gumbel(size=here.shape), axis=1)
        chance = np.einsum("nij,nj->ni", self.roots[k], rng.standard_normal(y.shape))
        new = self.means[k] + np.sqrt(1 - drawn**2) * (y - self.means[k]) + drawn * chance
        return new, np.logaddexp.reduce(terms, axis=1) - self.ln_density(new)
