"""Moves of walkers on a joint posterior, block by block: the shared coordinates, then all of every factor's own.

A walk in all coordinates at once slows down as their number grows, and a random step of the host alone is refused, as
each stream's own parameters fit that host. So a step of the host takes the own parameters along, by their linear
regression on the host's in the population: a shift, whose Jacobian is one. Given the host the factors are independent,
so that one evaluation of all of them decides a step of each. Half of the steps are preconditioned Crank-Nicolson steps
about the population's Gaussian (Neal 1999; Cotter et al. 2013, Statistical Science 28, 424), which are reversible with
respect to it: where the posterior is that Gaussian, a step of any length is accepted. The others are differential
evolution from an archive that does not change (ter Braak & Vrugt 2008), which knows other modes and long tails.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from streamkit import Array, IntArray
from streamkit.builtin.samplers.emulator.joint_density import JointDensity, Layout, Terms

# Lengths of Crank-Nicolson steps, of which each walker draws one: 1 is a new draw of the Gaussian.
LENGTHS = (0.3, 0.6, 0.9, 1.0)
# Lengths of differences, in units of the best one for a Gaussian, 2.38 / sqrt(2 n); and the fraction of differences
# that are taken whole, which lead from one mode to another.
DIFFERENCES, WHOLE = (1.0, 0.5, 0.2), 0.25
# What is added to the diagonal of a covariance, as a fraction.
RIDGE = 1e-9


@dataclass(frozen=True, eq=False)
class _Gaussian:
    """The Gaussian of a population (n, m), and the population itself as an archive of differences."""

    mean: Array
    root: Array
    archive: Array

    @classmethod
    def of(cls, places: Array) -> _Gaussian:
        n, m = places.shape
        mean = places.mean(axis=0)
        away = places - mean
        covariance = away.T @ away / max(n - 1, 1)
        scale = np.maximum(np.diag(covariance), 1e-300)
        covariance[np.diag_indices(m)] += RIDGE * scale
        return cls(mean, np.linalg.cholesky(covariance), places)

    def ln_density(self, places: Array) -> Array:
        """(n,) Up to a constant."""
        white = np.linalg.solve(self.root, (places - self.mean).T)
        return np.asarray(-0.5 * np.sum(white**2, axis=0))

    def crank_nicolson(self, places: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Propose places; return them, and (n,) what is added to the difference of ln density for acceptance."""
        length = rng.choice(LENGTHS, size=(len(places), 1))
        steps = rng.standard_normal(places.shape) @ self.root.T
        new = self.mean + np.sqrt(1 - length**2) * (places - self.mean) + length * steps
        return new, self.ln_density(places) - self.ln_density(new)

    def difference(self, n: int, rng: np.random.Generator) -> Array:
        """(n, m) Return differences of two of the archive, of several lengths, with a little noise."""
        m = self.archive.shape[1]
        first = rng.integers(len(self.archive), size=n)
        other = (first + rng.integers(1, len(self.archive), size=n)) % len(self.archive)
        length = 2.38 / np.sqrt(2 * m) * rng.choice(DIFFERENCES, size=n)
        length = np.where(rng.random(n) < WHOLE, 1.0, length)[:, None]
        noise = 1e-4 * rng.standard_normal((n, m)) @ self.root.T
        return np.asarray(length * (self.archive[first] - self.archive[other]) + noise)


class BlockMoves:
    """The moves of a population, made from its places (n, d), which they do not change with.

    Attributes
    ----------
    accepted, sweeps
        (2,) sums of the fractions of accepted steps: of the shared coordinates, of the own ones; and the sweeps.
    steps
        Evaluations of the density for each walker in a sweep.
    """

    def __init__(self, layout: Layout, places: Array) -> None:
        self._layout = layout
        self._shared = _Gaussian.of(places[:, layout.shared]) if len(layout.shared) else None
        self._follow = [self._regression(places, own) for own in layout.own]
        self._own = [_Gaussian.of(self._left(places, k)) if len(own) else None for k, own in enumerate(layout.own)]
        self.accepted, self.sweeps = np.zeros(2), 0
        self.steps = 2 if self._shared is None else 4

    def _regression(self, places: Array, own: IntArray) -> Array:
        """(h, k) The coefficients of the own coordinates on the shared ones."""
        if self._shared is None or not len(own):
            return np.zeros((len(self._layout.shared), len(own)))
        white = np.linalg.solve(self._shared.root, (places[:, self._layout.shared] - self._shared.mean).T)
        slope = white @ (places[:, own] - places[:, own].mean(axis=0)) / len(places)
        return np.asarray(np.linalg.solve(self._shared.root.T, slope))

    def _left(self, places: Array, k: int) -> Array:
        """(n, k) Residuals of the own coordinates of a factor in the regression."""
        own = places[:, self._layout.own[k]]
        if self._shared is None:
            return own
        return np.asarray(own - (places[:, self._layout.shared] - self._shared.mean) @ self._follow[k])

    def sweep(
        self, density: JointDensity, y: Array, terms: Terms, beta: float, rng: np.random.Generator
    ) -> tuple[Array, Terms]:
        """Move walkers (w, d) with these terms: every block twice. Return the new places and their terms."""
        for gaussian_step in (True, False):
            if self._shared is not None:
                y, terms = self._move_shared(density, y, terms, beta, rng, gaussian_step)
            y, terms = self._move_own(density, y, terms, beta, rng, gaussian_step)
        self.sweeps += 1
        return y, terms

    def _move_shared(
        self, density: JointDensity, y: Array, terms: Terms, beta: float, rng: np.random.Generator, gaussian_step: bool
    ) -> tuple[Array, Terms]:
        assert self._shared is not None  # noqa: S101  checked by the caller
        h = y[:, self._layout.shared]
        if gaussian_step:
            new_h, correction = self._shared.crank_nicolson(h, rng)
        else:
            new_h, correction = h + self._shared.difference(len(h), rng), np.zeros(len(h))
        new = y.copy()
        new[:, self._layout.shared] = new_h
        for own, follow in zip(self._layout.own, self._follow, strict=True):
            new[:, own] += (new_h - h) @ follow
        others = density.terms(new)
        gain = _gain(others.total(beta), terms.total(beta)) + correction
        accepted = np.log(rng.random(len(y))) < gain
        self.accepted[0] += 0.5 * accepted.mean()
        return np.where(accepted[:, None], new, y), terms.replaced(others, accepted)

    def _move_own(
        self, density: JointDensity, y: Array, terms: Terms, beta: float, rng: np.random.Generator, gaussian_step: bool
    ) -> tuple[Array, Terms]:
        new, correction = y.copy(), np.zeros((len(y), len(self._layout.own)))
        for k, (own, gaussian) in enumerate(zip(self._layout.own, self._own, strict=True)):
            if gaussian is None:
                continue
            if gaussian_step:
                left = self._left(y, k)
                proposed, correction[:, k] = gaussian.crank_nicolson(left, rng)
                new[:, own] += proposed - left
            else:
                new[:, own] += gaussian.difference(len(y), rng)
        others = density.terms(new)
        before = terms.prior[:, 1:] + beta * terms.ln_likelihood
        after = others.prior[:, 1:] + beta * others.ln_likelihood
        accepted = np.log(rng.random(after.shape)) < _gain(after, before) + correction
        moves = [len(own) > 0 for own in self._layout.own]
        self.accepted[1] += 0.5 * accepted[:, moves].mean() if any(moves) else 0.0
        y = y.copy()
        for k, own in enumerate(self._layout.own):
            y[:, own] = np.where(accepted[:, [k]], new[:, own], y[:, own])
        prior, lnl = terms.prior.copy(), np.where(accepted, others.ln_likelihood, terms.ln_likelihood)
        prior[:, 1:] = np.where(accepted, others.prior[:, 1:], prior[:, 1:])
        return y, Terms(prior, lnl)


def _gain(after: Array, before: Array) -> Array:
    """Return differences of ln densities; those of walkers that are nowhere yet are infinite."""
    with np.errstate(invalid="ignore"):
        return np.where(np.isneginf(before), np.where(np.isneginf(after), -np.inf, np.inf), after - before)
