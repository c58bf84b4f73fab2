"""The emulated posterior of one stream alone, with walks at several temperatures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from streamkit.components import EmulatedLikelihood
from streamkit.runfile import Prior
from streamkit.stream import Array, BoolArray, IntArray

# Walkers for each parameter, and steps of a walk; the first part of the steps is left out.
WALKERS, STEPS, BURN = 6, 1200, 0.4


@dataclass(frozen=True, eq=False)
class StreamAlone:
    """One stream with any host.

    Coordinates y are the parameters, or the logarithms of those that are positive by their prior.

    Attributes
    ----------
    likelihood
        Of the p parameters.
    priors
        Theirs.
    shared, own
        Indices of the parameters of the host, and of the stream's own.
    """

    likelihood: EmulatedLikelihood
    priors: Sequence[Prior]
    shared: IntArray
    own: IntArray

    @property
    def is_log(self) -> BoolArray:
        """(p,) Whether a coordinate is a logarithm."""
        return np.array([prior.support[0] > 0 for prior in self.priors])

    def to(self, points: Array) -> Array:
        """(n, p) Coordinates of parameters (n, p)."""
        return np.where(self.is_log, np.log(np.where(self.is_log, points, 1.0)), points)

    def back(self, y: Array) -> Array:
        """(n, p) Parameters at coordinates (n, p)."""
        with np.errstate(over="ignore"):  # infinite: outside the prior
            return np.where(self.is_log, np.exp(np.where(self.is_log, y, 0.0)), y)

    def ends(self) -> tuple[Array, Array]:
        """(d,) each: the ends of the host's coordinates by their priors; infinite for none."""
        with np.errstate(divide="ignore"):
            both = [self.to(np.array([prior.support[side] for prior in self.priors])[None])[0] for side in (0, 1)]
        return both[0][self.shared], both[1][self.shared]

    def ln_prior(self, y: Array, columns: IntArray) -> Array:
        """(n,) ln prior density of some of the coordinates y (n, p); -inf outside."""
        points = self.back(y)
        with np.errstate(over="ignore"):  # the square of a parameter far out
            each = [self.priors[i].lnpdf_of_many(points[:, i]) + (y[:, i] if self.is_log[i] else 0.0) for i in columns]
        return np.asarray(sum(each, np.zeros(len(y))))

    def ln_likelihood(self, y: Array, inside: BoolArray, likelihood: EmulatedLikelihood | None = None) -> Array:
        """(n,) ln likelihood at coordinates y (n, p); -inf where not ``inside`` (n,)."""
        found = np.full(len(y), -np.inf)
        if inside.any():
            found[inside] = (likelihood or self.likelihood).ln_likelihood(self.back(y[inside]))
        return np.where(np.isnan(found), -np.inf, found)

    def walk(self, begin: Array, inverse_temperature: float, seed: Sequence[int]) -> Array:
        """(n, p) Sample the posterior with the likelihood to a power, among the calls, from coordinates (m, p)."""
        import emcee  # slow to import

        every = np.concatenate([self.shared, self.own])

        def ln_density(y: Array) -> Array:
            prior = self.ln_prior(y, every)
            inside = np.isfinite(prior)
            inside[inside] = self.likelihood.is_trusted(self.back(y[inside]))
            lnl = self.ln_likelihood(y, inside)
            return np.where(inside, prior + inverse_temperature * np.where(inside, lnl, 0.0), -np.inf)

        rng, random = np.random.default_rng(seed), np.random.RandomState(seed[0] % 2**32)
        size = len(every)
        walkers = max(WALKERS * size, 48)
        density = ln_density(begin)
        weight = np.exp(density - density.max())
        chosen = begin[rng.choice(len(begin), walkers, p=weight / weight.sum())]
        spread = begin[np.argsort(-density)[: 4 * size]].std(axis=0)
        trial = chosen + 0.05 * spread * rng.standard_normal(chosen.shape)
        start = np.where(np.isfinite(ln_density(trial))[:, None], trial, chosen)
        moves = [(emcee.moves.DEMove(), 0.8), (emcee.moves.DESnookerMove(), 0.1), (emcee.moves.StretchMove(), 0.1)]
        sampler = emcee.EnsembleSampler(walkers, size, ln_density, moves=moves, vectorize=True)
        sampler.random_state = random.get_state()
        sampler.run_mcmc(start, STEPS, skip_initial_state_check=True)
        return np.asarray(sampler.get_chain(discard=int(BURN * STEPS), thin=10, flat=True))
