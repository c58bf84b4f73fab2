"""The moves of a population: by a Gaussian mixture of it, by differences of it, and along the posterior's surface.

A posterior with several modes is locally Gaussian, which the mixture follows. Differential evolution (ter Braak & Vrugt
2008, without its snooker move) reaches where the mixture is wrong. Both move the shared coordinates, see
`particle_gibbs`, and then those of each factor, which the others do not depend on: each factor accepts for itself. The
third kind moves all coordinates, along a sheet that is thin and bent, see `geodesic`.
"""

from __future__ import annotations

from copy import copy

import numpy as np

from streamkit import Array
from streamkit.builtin.samplers.emulator.walk.density import Density, Layout, Terms, gain
from streamkit.builtin.samplers.emulator.walk.following import Following
from streamkit.builtin.samplers.emulator.walk.geodesic import Surface, trajectory
from streamkit.builtin.samplers.emulator.walk.mixture import Mixture
from streamkit.builtin.samplers.emulator.walk.particle_gibbs import move_shared

# Lengths of Crank-Nicolson steps, of which each walker draws one.
LENGTHS = (0.25, 0.5, 0.8, 1.0)
# Those of several factors have draws of the mixture as well. A stream's own parameters have long ends (a proper motion
# where its extra error is large), from which a walker does not come back by steps for hundreds of sweeps.
LENGTHS_OF_SEVERAL = (*LENGTHS, np.inf, np.inf)
# Lengths of differences in units of the best one for a Gaussian, 2.38 / sqrt(2 d), and the fraction of whole ones.
DIFFERENCES, WHOLE = (1.0, 0.5, 0.2), 0.2
# Fractions of a stream's own coordinates that a difference changes (crossover: Vrugt et al. 2009), where there are
# several. A walker in a narrow neck, where an extra error is small, leaves it along that coordinate alone.
CROSSED = (0.15, 0.4, 1.0)
# Lengths of steps of the shared coordinates: draws of a mixture as well.
LENGTHS_OF_SHARED = (0.25, 0.5, 1.0, np.inf)
# What is added to the diagonal of a covariance, as a fraction.
RIDGE = 1e-9


class Moves:
    """The moves of a population, made from its places (n, d), which they do not change with.

    Attributes
    ----------
    counts
        (2, 4) sums of the fractions of accepted steps: steps and draws by mixtures, differences, trajectories along the
        surface; and how often walkers were moved so.
    """

    def __init__(
        self,
        layout: Layout,
        places: Array,
        rng: np.random.Generator,
        draws: bool = True,
        follows: bool = True,
        beside: Array | None = None,  # (m, d) other places that own coordinates are drawn near
        of_each: int = 1,  # draws of each factor's own coordinates by which the shared ones move
    ) -> None:
        self._layout = layout
        self._follow = [Following.of(places[:, layout.shared], places[:, own]) for own in layout.own]
        self._lefts = [self._left(places, k) for k in range(len(layout.own))]
        self._shared = Mixture.of(places[:, layout.shared], rng).with_long_ends() if len(layout.shared) else None
        drawn = self._lefts
        if beside is not None:
            drawn = [np.concatenate([left, self._left(beside, k)]) for k, left in enumerate(self._lefts)]
        self._own = [Mixture.of(each, rng) if each.shape[1] else None for each in drawn]
        if layout.several:
            self._own = [each and each.with_long_ends() for each in self._own]
        alone = self._own[0] if self._shared is None and len(self._own) == 1 else None
        self._whole = (alone or Mixture.of(places, rng)) if draws else None
        self._follows, self._of_each = follows, of_each
        self._h = places[:, layout.shared]
        self._precision = self._precision_of(places)
        self.counts = np.zeros((2, 4))
        self._blocks = int(self._shared is not None) + int(any(each is not None for each in self._own))

    def _precision_of(self, places: Array) -> Array:
        """(d, d) The precision of the places: of the shared coordinates, and of those of each factor, by themselves."""
        covariance = np.atleast_2d(np.cov(places.T))
        covariance[np.diag_indices_from(covariance)] *= 1 + RIDGE
        precision = np.zeros_like(covariance)
        for block in (self._layout.shared, *self._layout.own):
            precision[np.ix_(block, block)] = np.linalg.inv(covariance[np.ix_(block, block)])
        return precision

    def _left(self, places: Array, k: int) -> Array:
        """(n, k) Residuals of the own coordinates of a factor."""
        return self._follow[k].left(places[:, self._layout.shared], places[:, self._layout.own[k]])

    def sweep(
        self, density: Density, z: Array, terms: Terms, beta: float, rng: np.random.Generator, follow: bool = True
    ) -> tuple[Array, Terms]:
        """Move walkers (w, d) with these terms at an inverse temperature; return the new places and their terms.

        Along the surface they move if they are to ``follow`` it.
        """
        if self._shared is not None:
            z, terms = self._move_shared(density, z, terms, beta, rng)
        for by_mixture in (True, False):
            if any(each is not None for each in self._own):
                z, terms = self._move_own(density, z, terms, beta, rng, self._lengths(len(z), rng, by_mixture))
        self.counts[1, [0, 2]] += 1
        if self._whole is not None:
            z, terms = self._draw(self._whole, density, z, terms, beta, rng)
        return self._follow_surface(density, z, terms, beta, rng) if follow and self._follows else (z, terms)

    @property
    def rates(self) -> Array:
        """(4,) The fractions of accepted steps; zero for steps that were not tried."""
        accepted, tried = self.counts
        return np.asarray(accepted / np.maximum(tried, 1))

    def uncounted(self) -> Moves:
        """Return the same moves, with counts of their own."""
        again = copy(self)
        again.counts = np.zeros_like(self.counts)
        return again

    def count(self, counts: Array) -> None:
        """Add the counts (2, 4) of others."""
        self.counts += counts

    def _lengths(self, n: int, rng: np.random.Generator, by_mixture: bool) -> Array | None:
        return rng.choice(LENGTHS_OF_SEVERAL if self._layout.several else LENGTHS, size=n) if by_mixture else None

    @staticmethod
    def _differences(archive: Array, n: int, rng: np.random.Generator, cross: bool = False) -> Array:
        """(n, k) Differences of two places (m, k), of several lengths; some coordinates differ if they ``cross``."""
        first = rng.integers(len(archive), size=n)
        other = (first + rng.integers(1, len(archive), size=n)) % len(archive)
        changed = np.ones((n, archive.shape[1]), dtype=bool)
        if cross:
            changed = rng.random(changed.shape) < rng.choice(CROSSED, size=n)[:, None]
            changed[np.arange(n), rng.integers(archive.shape[1], size=n)] = True
        length = 2.38 / np.sqrt(2 * changed.sum(axis=1)) * rng.choice(DIFFERENCES, size=n)
        length = np.where(rng.random(n) < WHOLE, 1.0, length * (1 + 0.01 * rng.standard_normal(n)))[:, None]
        return np.where(changed, length * (archive[first] - archive[other]), 0.0)

    def _move_shared(
        self, density: Density, z: Array, terms: Terms, beta: float, rng: np.random.Generator
    ) -> tuple[Array, Terms]:
        """Move h with the other coordinates summed over draws, by the mixture and by differences."""
        shared = self._shared
        assert shared is not None  # noqa: S101  checked by the caller

        def by_mixture(h: Array) -> tuple[Array, Array]:
            return shared.step(h, rng.choice(LENGTHS_OF_SHARED, size=len(h)), rng)

        def by_differences(h: Array) -> tuple[Array, Array]:
            return h + self._differences(self._h, len(h), rng), np.zeros(len(h))

        steps = [by_mixture, by_differences, by_mixture]
        z, terms, rates = move_shared(density, z, terms, beta, rng, self._follow, self._own, self._of_each, steps)
        self.counts[0, [0, 2]] += np.array([(rates[0] + rates[2]) / 2, rates[1]]) / self._blocks
        return z, terms

    def _move_own(
        self, density: Density, z: Array, terms: Terms, beta: float, rng: np.random.Generator, length: Array | None
    ) -> tuple[Array, Terms]:
        """Move s_k of all factors at a time; each is accepted for itself."""
        new, correction, h = z.copy(), np.zeros((len(z), len(self._own))), z[:, self._layout.shared]
        for k, (own, mixture) in enumerate(zip(self._layout.own, self._own, strict=True)):
            if mixture is None:
                continue
            if length is None:
                change = self._differences(self._lefts[k], len(z), rng, cross=self._layout.several)
            else:
                left = self._left(z, k)
                proposed, correction[:, k] = mixture.step(left, length, rng)
                change = proposed - left
            new[:, own] += self._follow[k].changed(h, change)
        others = density.terms(new)
        before = terms.prior[:, 1:] + beta * terms.ln_likelihood
        after = others.prior[:, 1:] + beta * others.ln_likelihood
        accepted = np.log(rng.random(after.shape)) < gain(after, before) + correction
        self.counts[0, 0 if length is not None else 2] += accepted.mean() / self._blocks
        z = z.copy()
        for k, own in enumerate(self._layout.own):
            z[:, own] = np.where(accepted[:, [k]], new[:, own], z[:, own])
        prior, lnl = terms.prior.copy(), np.where(accepted, others.ln_likelihood, terms.ln_likelihood)
        prior[:, 1:] = np.where(accepted, others.prior[:, 1:], prior[:, 1:])
        return z, Terms(prior, lnl)

    def _draw(
        self, whole: Mixture, density: Density, z: Array, terms: Terms, beta: float, rng: np.random.Generator
    ) -> tuple[Array, Terms]:
        """Draw all coordinates from the mixture: from one mode to another."""
        self.counts[1, 1] += 1
        new, correction = whole.step(z, np.full(len(z), np.inf), rng)
        others = density.terms(new)
        accepted = np.log(rng.random(len(z))) < gain(others.total(beta), terms.total(beta)) + correction
        self.counts[0, 1] += accepted.mean()
        return np.where(accepted[:, None], new, z), terms.replaced(others, accepted)

    def _follow_surface(
        self, density: Density, z: Array, terms: Terms, beta: float, rng: np.random.Generator
    ) -> tuple[Array, Terms]:
        """Move all coordinates along the posterior's surface."""
        self.counts[1, 3] += 1
        new, correction = trajectory(Surface(density.tangents, self._layout, beta, self._precision), z, rng)
        others = density.terms(new)
        accepted = np.log(rng.random(len(z))) < gain(others.total(beta), terms.total(beta)) + correction
        self.counts[0, 3] += accepted.mean()
        return np.where(accepted[:, None], new, z), terms.replaced(others, accepted)
