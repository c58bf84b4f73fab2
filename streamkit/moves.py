"""Moves of the ensemble: differential evolution, and walks on a surrogate that never leave the prior."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import emcee
import numpy as np
from emcee.moves.red_blue import RedBlueMove

from streamkit.phase import Array
from streamkit.priors import LogUniform, Normal, Prior, TruncatedNormal, Uniform
from streamkit.surrogate import Surrogate

WALKS = ((100, 1.0), (25, 1.0), (1, 1.0), (1, 0.1))
"""Walks on the surrogate, equally often: steps per parameter, and their length in units of differential evolution's.
Its autocorrelation time is about 25 steps per parameter, more into and out of curved tails. The short walks end nearby,
where the surrogate errs alike: where it is far too low, or the posterior very narrow, they lead a walker out."""
SURROGATE_SHARE = 0.9
"""Fraction of the ensemble's steps that are walks on the surrogate; the others do not rely on it."""

LEARNING = (25, 50, 100, 200, 400)
"""Steps after which the surrogate is learned from all steps so far: the last time for good."""


def learning_steps(name: str) -> int:
    """Return the steps during which the moves of this name still change."""
    return LEARNING[-1] if name == "surrogate" else 0


class Space:
    """The coordinates y of the walks: the parameters, or the logarithms of those that are positive by their prior.

    Masses, lengths and speeds enter the model as products of powers, which polynomials of the logarithms follow better.
    """

    def __init__(self, priors: Sequence[Prior]) -> None:
        uniform = np.array([isinstance(prior, Uniform) and prior.low > 0 for prior in priors])
        self._log = np.array([isinstance(prior, LogUniform) for prior in priors]) | uniform
        self._slope = uniform.astype(float)
        self._low, self._high = np.array([prior.support for prior in priors]).T
        normal = [(p.mean, p.sd) if isinstance(p, Normal | TruncatedNormal) else (0.0, np.inf) for p in priors]
        self._mean, self._sd = np.array(normal).T

    def to(self, theta: Array) -> Array:
        """(n, d) Coordinates of parameters (n, d)."""
        with np.errstate(invalid="ignore", divide="ignore"):  # not positive: outside the prior
            return np.where(self._log, np.log(np.where(self._log, theta, 1.0)), theta)

    def back(self, y: Array) -> Array:
        """(n, d) Parameters at coordinates (n, d)."""
        return np.where(self._log, np.exp(np.where(self._log, y, 0.0)), y)

    def ln_prior(self, y: Array) -> Array:
        """(n,) ln density of the prior in the coordinates, up to a constant; -inf outside."""
        theta = self.back(y)
        inside = ((theta >= self._low) & (theta <= self._high)).all(axis=1)
        density = np.sum(self._slope * y - 0.5 * ((y - self._mean) / self._sd) ** 2, axis=1)
        return np.where(inside, density, -np.inf)

    def ln_jacobian(self, y: Array) -> Array:
        """(n,) ln |d theta / d y|."""
        return np.asarray(np.sum(y[:, self._log], axis=1))


class SurrogateMove(RedBlueMove):  # type: ignore[misc]
    """A Metropolis walk on a cheap surrogate of the posterior, whose end the posterior accepts or refuses.

    Each step of the walk, differential evolution between training points that is refused outside the prior, is
    reversible under the surrogate, and so is the walk: with the ratio of the surrogates as its factor, the move leaves
    the posterior exactly as it is (surrogate transition: Liu 2001, section 9.4.3; delayed acceptance: Christen & Fox
    2005). How good the surrogate is only decides how many ends are accepted. Reflection at the prior's ends would not
    do: it is symmetric only for steps whose components are independent.

    Without a surrogate it is differential evolution.

    Attributes
    ----------
    surrogate
        What has been learned; may be set between two steps of the ensemble.
    """

    def __init__(self, space: Space, gammas: Sequence[tuple[float, float]]) -> None:
        super().__init__()
        self.space = space
        self._gammas, self._parts = np.array(gammas).T
        self._plain = [_differential(gamma) for gamma in self._gammas]
        self.surrogate: Surrogate | None = None

    def get_proposal(self, s: Array, c: list[Array], random: Any) -> tuple[Array, Array]:
        """Return the ends (n, d) of walks from s, and what they add to ln acceptance (n,)."""
        if self.surrogate is None:
            new, factor = self._plain[random.choice(len(self._plain), p=self._parts)].get_proposal(s, c, random)
            return new, factor
        start = y = self.space.to(s)
        first = lnp = self._ln_density(self.surrogate, y)
        steps, scale = WALKS[random.randint(len(WALKS))]
        for gamma in scale * random.choice(self._gammas, p=self._parts, size=steps * y.shape[1]):
            new = y + gamma * _differences(self.surrogate.points, len(y), random)
            lnp_new = self._ln_density(self.surrogate, new)
            taken = np.log(random.rand(len(y))) < lnp_new - lnp
            y, lnp = np.where(taken[:, None], new, y), np.where(taken, lnp_new, lnp)
        jacobian = self.space.ln_jacobian(y) - self.space.ln_jacobian(start)
        return self.space.back(y), first - lnp + jacobian

    def _ln_density(self, surrogate: Surrogate, y: Array) -> Array:
        return self.space.ln_prior(y) + surrogate.ln_likelihood(y)


def proposals(name: str, priors: Sequence[Prior]) -> list[tuple[emcee.moves.Move, float]]:
    """Return the moves of the ensemble, with the fraction of the steps that each takes.

    "de": mostly the length that is best for a Gaussian, a third of it where the posterior is curved, sometimes 1,
    which leads from one mode to another. "surrogate": walks on a surrogate, and a share of "de" that does not rely on
    it. "stretch": Goodman & Weare's (2010). emcee's snooker move is not used: it mixes the units of the parameters,
    and its acceptance rule is not that of ter Braak & Vrugt (2008), so that it narrows the posterior.
    """
    if name == "stretch":
        return [(emcee.moves.StretchMove(), 1.0)]
    best = 2.38 / np.sqrt(2 * len(priors))
    gammas = [(best, 0.6), (best / 3, 0.3), (1.0, 0.1)]
    differential = [(_differential(gamma), part) for gamma, part in gammas]
    if name == "de":
        return differential
    share = 1 - SURROGATE_SHARE
    return [
        (SurrogateMove(Space(priors), gammas), SURROGATE_SHARE),
        *((move, share * part) for move, part in differential),
    ]


def _differential(gamma: float) -> emcee.moves.DEMove:
    """Return the move along the difference of two walkers, times gamma (emcee calls setup before proposing)."""
    move = emcee.moves.DEMove(gamma0=gamma)
    move.setup(np.empty((0, 1)))
    return move


def _differences(points: Array, n: int, random: Any) -> Array:
    """(n, d) Differences between two different points each."""
    first = random.randint(len(points), size=n)
    second = (first + random.randint(1, len(points), size=n)) % len(points)
    return np.asarray(points[first] - points[second])
