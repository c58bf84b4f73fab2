"""Moves of the ensemble: differential evolution, and exchanges and walks on a surrogate that never leave the prior."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import emcee
import numpy as np
from emcee.moves.red_blue import RedBlueMove

from streamkit import Array, EmulatedLikelihood, IntArray
from streamkit.builtin.samplers.ensemble.coordinates import Space

# Fraction of the moves with a surrogate that exchange walkers with replicas; the others are walks.
EXCHANGES = 0.6
# Factors of the surrogate's ln likelihood for the replicas, in equal numbers, as long as it learns. Tempered replicas
# explore regions where no walker has been: without them a chain may miss a thin tail.
INVERSE_TEMPERATURES = (1.0, 0.3, 0.1)
# The same after learning, for all replicas. A walker stays for long where the surrogate is too low. With this factor
# it leaves three times as soon, and a fifth fewer proposals are accepted.
LAST_INVERSE_TEMPERATURE = 0.8
SETTLE, STIR = 200, 2  # steps of the replicas, per parameter: after learning, and before an exchange
# Lengths of the steps of walks, in units of differential evolution's. A short walk ends where the surrogate's error
# is similar. It frees a walker where the surrogate is far too low, or the posterior very narrow.
WALKS = (1.0, 0.1)
SURROGATE_SHARE = 0.9  # fraction of the ensemble's steps that rely on the surrogate


class SurrogateMove(RedBlueMove):  # type: ignore[misc]
    """Exchanges with replicas that sample a cheap surrogate of the posterior, and short walks on it.

    The replicas are walkers of their own, whose density is the surrogate: many, and stirred all the time by
    differential evolution. A walker and a replica exchange their places, accepted with the ratio that preserves the
    product of all densities. The walker's new point is independent of its old one
    (replica exchange, Swendsen & Wang 1986, with a surrogate in place of a temperature). Walks are short: each
    step is reversible under the surrogate, so that the end is accepted with the ratio of the surrogates as its factor
    (surrogate transition, Liu 2001, section 9.4.3). How good the surrogate is only decides how many are accepted.
    Reflection at the prior's ends would not do: it is symmetric only for steps whose components are independent.

    Without a surrogate it is differential evolution.
    """

    def __init__(self, space: Space, gammas: Sequence[tuple[float, float]]) -> None:
        super().__init__()
        self.space = space
        self.replicas: Array = np.empty((0, 0))  # (k, d) coordinates, stored with the chain; none without a surrogate
        self._gammas, self._parts = np.array(gammas).T
        self._plain = [_differential(gamma) for gamma in self._gammas]
        self._surrogate: EmulatedLikelihood | None = None
        self._places: Array = np.empty((0, 0))
        self._beta: Array = np.empty(0)
        self._offered: tuple[IntArray, Array] | None = None

    def use(self, surrogate: EmulatedLikelihood, places: Array, number: int, seed: int, last: bool) -> None:
        """Use a new surrogate, and let so many replicas settle on it; ``last`` if no other follows.

        Their steps are differences of places (n, d), where the walkers have been.
        """
        self._surrogate, self._places, random = surrogate, self.space.to(places), np.random.RandomState(seed)
        lnp = self._ln_density(self._places)
        weight = np.exp(lnp - lnp.max())
        chosen = random.choice(len(places), number, p=weight / weight.sum())
        self._beta = np.full(number, LAST_INVERSE_TEMPERATURE) if last else np.resize(INVERSE_TEMPERATURES, number)
        self.replicas, _, _ = self._walk(self._places[chosen], SETTLE, 1.0, random, self._beta)

    def get_proposal(self, s: Array, c: list[Array], random: Any) -> tuple[Array, Array]:
        """Return proposals (n, d) for the walkers s, and their terms (n,) of ln acceptance."""
        self._offered = None
        if self._surrogate is None:
            new, factor = self._plain[random.choice(len(self._plain), p=self._parts)].get_proposal(s, c, random)
            return new, factor
        start = self.space.to(s)
        if random.rand() < EXCHANGES:
            self.replicas, _, lnp = self._walk(self.replicas, STIR, 1.0, random, self._beta)
            chosen = random.choice(len(lnp), len(s), replace=False)
            self._offered, y = (chosen, start), self.replicas[chosen]
            factor = self._ln_density(start, self._beta[chosen]) - lnp[chosen]
        else:
            y, first, lnp = self._walk(start, 1, WALKS[random.randint(len(WALKS))], random)
            factor = first - lnp
        return self.space.back(y), factor + self.space.ln_jacobian(y) - self.space.ln_jacobian(start)

    def update(self, old: Any, new: Any, accepted: Array, subset: Array | None = None) -> Any:
        """Give accepted walkers their new places, and the replicas of an exchange the old ones."""
        if self._offered is not None:
            chosen, start = self._offered
            taken = accepted if subset is None else accepted[subset]
            self.replicas[chosen[taken]] = start[taken]
        return super().update(old, new, accepted, subset)

    def _walk(
        self, y: Array, steps: int, scale: float, random: Any, beta: Array | float = 1.0
    ) -> tuple[Array, Array, Array]:
        """Walk on the surrogate from y (n, d), so many steps per parameter; return the ends, and ln p at both ends.

        ``beta`` is the inverse temperature, of each walker or of all.
        """
        first = lnp = self._ln_density(y, beta)
        for gamma in scale * random.choice(self._gammas, p=self._parts, size=steps * y.shape[1]):
            new = y + gamma * _differences(self._places, len(y), random)
            lnp_new = self._ln_density(new, beta)
            taken = np.log(random.rand(len(y))) < lnp_new - lnp
            y, lnp = np.where(taken[:, None], new, y), np.where(taken, lnp_new, lnp)
        return y, first, lnp

    def _ln_density(self, y: Array, beta: Array | float = 1.0) -> Array:
        """(n,) ln density of the replicas at coordinates y (n, d)."""
        assert self._surrogate is not None  # noqa: S101  checked by the callers
        lnp = self.space.ln_prior(y)
        inside = np.isfinite(lnp)
        if inside.any():
            lnp[inside] += np.broadcast_to(beta, len(y))[inside] * self._surrogate.ln_likelihood(
                self.space.back(y[inside])
            )
        return np.where(np.isnan(lnp), -np.inf, lnp)


def proposals(name: str, space: Space) -> list[tuple[emcee.moves.Move, float]]:
    """Return the moves of the ensemble, with the fraction of the steps that each takes.

    "de": mostly the length that is best for a Gaussian, a third of it where the posterior is curved, sometimes 1,
    which leads from one mode to another. "surrogate": replicas and walks on a surrogate, and a share of "de" that does
    not rely on it. "stretch": Goodman & Weare's (2010). emcee's snooker move is not used: it mixes the units of the
    parameters, and its acceptance rule is not that of ter Braak & Vrugt (2008), so that it narrows the posterior.
    """
    if name == "stretch":
        return [(emcee.moves.StretchMove(), 1.0)]
    best = 2.38 / np.sqrt(2 * space.size)
    gammas = [(best, 0.6), (best / 3, 0.3), (1.0, 0.1)]
    differential = [(_differential(gamma), part) for gamma, part in gammas]
    if name == "de":
        return differential
    share = 1 - SURROGATE_SHARE
    return [
        (SurrogateMove(space, gammas), SURROGATE_SHARE),
        *((move, share * part) for move, part in differential),
    ]


def _differential(gamma: float) -> emcee.moves.DEMove:
    """Return the move along the difference of two walkers, times gamma (emcee calls inputs before proposing)."""
    move = emcee.moves.DEMove(gamma0=gamma)
    move.setup(np.empty((0, 1)))
    return move


def _differences(points: Array, n: int, random: Any) -> Array:
    """(n, d) Differences between two different points each."""
    first = random.randint(len(points), size=n)
    second = (first + random.randint(1, len(points), size=n)) % len(points)
    return np.asarray(points[first] - points[second])
