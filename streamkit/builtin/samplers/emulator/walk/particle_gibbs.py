"""Moves of the coordinates that all streams share, with the own ones of each stream summed over draws.

A step of the shared coordinates h takes the own ones of all streams along, and each stream may refuse it: the more
streams, the shorter the steps. So h moves by the integral over the own coordinates s_k instead, which N draws of
residuals u_k estimate,

    p(h) prod over k of [1 / N sum over i of w_k(h, u_ki)],  w_k = p(s_k) L_k(h, s_k) |ds_k / du_k| / q_k(u_k),

with s_k = s_k(h, u_k) of `Following` and a mixture q_k. One of the draws is the walker's place. Both sides of a step
have the same draws, so that most of the error of the estimate cancels. At the end a draw of each stream is chosen by
its weight. However few the draws are, this leaves the posterior of h and all s_k as it is (particle Gibbs: Andrieu,
Doucet & Holenstein 2010, J. R. Statist. Soc. B 72, 269). With one draw it is a step of h that the own coordinates
follow.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from streamkit import Array, BoolArray, IntArray
from streamkit.builtin.samplers.emulator.walk.density import Density, Terms, gain
from streamkit.builtin.samplers.emulator.walk.following import Following
from streamkit.builtin.samplers.emulator.walk.mixture import Mixture

# From h (n, q): where a step goes, and what is added to ln of its acceptance (n,).
Step = Callable[[Array], tuple[Array, Array]]


class Draws(NamedTuple):
    """Draws of the own coordinates of all streams, at n places of the shared ones.

    Attributes
    ----------
    places, terms
        (n, N, d), the i-th draws of all streams are one place; and the terms of these n N places.
    ln_weights
        (n, N, K) ln w of each.
    ln_density
        (n,) of the shared coordinates, up to a constant.
    """

    places: Array
    terms: Terms
    ln_weights: Array
    ln_density: Array

    def replaced(self, other: Draws, accepted: BoolArray) -> Draws:
        """Return these, with those of ``other`` where it is accepted (n,)."""
        rows, count = accepted[:, None, None], self.places.shape[1]
        return Draws(
            np.where(rows, other.places, self.places),
            self.terms.replaced(other.terms, np.repeat(accepted, count)),
            np.where(rows, other.ln_weights, self.ln_weights),
            np.where(accepted, other.ln_density, self.ln_density),
        )

    def chosen(self, own: Sequence[IntArray], rng: np.random.Generator) -> tuple[Array, Terms]:
        """Choose a draw of each stream by its weight (Gumbel's way); return the places (n, d) and their terms."""
        n, count, streams = self.ln_weights.shape
        which = np.argmax(self.ln_weights + rng.gumbel(size=self.ln_weights.shape), axis=1)  # (n, K)
        z, every = self.places[:, 0].copy(), np.arange(n)
        for k, columns in enumerate(own):
            z[:, columns] = self.places[every[:, None], which[:, [k]], columns]
        rows, stream = every[:, None] * count + which, np.arange(streams)
        prior = np.concatenate([self.terms.prior[::count, :1], self.terms.prior[rows, 1 + stream]], axis=1)
        return z, Terms(prior, self.terms.ln_likelihood[rows, stream])


def move_shared(
    density: Density,
    z: Array,
    terms: Terms,
    beta: float,
    rng: np.random.Generator,
    follow: Sequence[Following],
    mixtures: Sequence[Mixture | None],
    count: int,
    steps: Sequence[Step],
) -> tuple[Array, Terms, list[float]]:
    """Move walkers z (n, d), which have these terms, by steps of the shared coordinates.

    Parameters
    ----------
    density, beta
        The density and its inverse temperature.
    follow, mixtures
        How the own coordinates of each stream follow, and a mixture of their residuals.
    count
        Number of draws N.
    steps
        They are made one after another, with the same draws.

    Returns the new places (n, d), their terms, and the fraction of walkers that each step moved.
    """
    layout, n = density.layout, len(z)
    h = z[:, layout.shared]
    residuals, ln_drawn = _residuals(z, h, layout.own, rng, follow, mixtures, count)

    def at(h: Array, known: Terms | None = None) -> Draws:
        places, ln_volumes = np.empty((n, count, z.shape[1])), np.empty((n, len(layout.own)))
        places[:, :, layout.shared] = h[:, None]
        for k, own in enumerate(layout.own):
            places[:, :, own], ln_volumes[:, k] = follow[k].placed(h, residuals[k])
        terms = known or density.terms(places.reshape(n * count, -1))
        each = terms.prior[:, 1:] + beta * terms.ln_likelihood
        ln_weights = each.reshape(n, count, -1) + ln_volumes[:, None] - ln_drawn
        of_streams = np.logaddexp.reduce(ln_weights, axis=1).sum(axis=1)
        return Draws(places, terms, ln_weights, terms.prior[::count, 0] + of_streams)

    here, rates = at(h, terms if count == 1 else None), []
    for step in steps:
        new, correction = step(h)
        there = at(new)
        accepted = np.log(rng.random(n)) < gain(there.ln_density, here.ln_density) + correction
        h, here = np.where(accepted[:, None], new, h), here.replaced(there, accepted)
        rates.append(float(accepted.mean()))
    return *here.chosen(layout.own, rng), rates


def _residuals(
    z: Array,
    h: Array,
    all_own: Sequence[IntArray],
    rng: np.random.Generator,
    follow: Sequence[Following],
    mixtures: Sequence[Mixture | None],
    count: int,
) -> tuple[list[Array], Array]:
    """Return the residuals (n, N, k) of each stream, those of the walkers first, and ln q of all (n, N, K)."""
    n, found, ln_drawn = len(z), [], np.zeros((len(z), count, len(all_own)))
    for k, (own, mixture) in enumerate(zip(all_own, mixtures, strict=True)):
        each = np.repeat(follow[k].left(h, z[:, own])[:, None], count, axis=1)
        if mixture is not None and count > 1:
            each[:, 1:] = mixture.draws(n * (count - 1), rng).reshape(n, count - 1, len(own))
            ln_drawn[:, :, k] = mixture.ln_density(each.reshape(n * count, len(own))).reshape(n, count)
        found.append(each)
    return found, ln_drawn
