"""One factor of a posterior: its data depend on the shared parameters and on its own alone; its calls and its emulator.

A posterior of one stream is one factor. The sum of the emulated likelihoods of all factors is that of the posterior.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from streamkit import Array, IntArray
from streamkit.builtin.samplers.emulator.emulated import Emulated
from streamkit.builtin.samplers.emulator.joint_density import Layout, Terms
from streamkit.builtin.samplers.emulator.problem import Problem


@dataclass(frozen=True, eq=False)
class Factor:
    """One factor: what can be called.

    Attributes
    ----------
    name
        Of its stream; `[data]` for the data of the host.
    problem, small
        Its posterior alone, with all particles and with few of them.
    shared, own
        Indices of its coordinates among all d: those that all factors share, and its own; their order is that of the
        run file, here as there.
    earlier
        (n, p) parameters at which an earlier run has called it.
    """

    name: str
    problem: Problem
    small: Problem
    shared: IntArray
    own: IntArray
    earlier: Array = field(default_factory=lambda: np.empty((0, 0)))

    @property
    def columns(self) -> IntArray:
        """Indices of its coordinates among all, in rising order."""
        return np.sort(np.concatenate([self.shared, self.own]))


def layout_of(factors: Sequence[Factor]) -> Layout:
    """Return which coordinates the factors share."""
    return Layout(factors[0].shared, [each.own for each in factors])


class JointPosterior:
    """The posterior of all factors, by the emulator of each: a `JointDensity`.

    Parameters
    ----------
    factors
        The factors.
    emulated
        The emulated posterior of each alone.
    """

    def __init__(self, factors: Sequence[Factor], emulated: Sequence[Emulated]) -> None:
        self.factors, self.emulated = tuple(factors), tuple(emulated)
        self._layout = layout_of(factors)
        self._middles = [each.space.to(factor.problem.from_unit(np.full(factor.problem.size, 0.5))[None])
                         for factor, each in zip(factors, emulated, strict=True)]  # fmt: skip

    @property
    def layout(self) -> Layout:
        """Which coordinates belong to which factor."""
        return self._layout

    def with_(self, k: int, emulated: Emulated) -> JointPosterior:
        """Return the posterior with another emulator of factor k."""
        return JointPosterior(self.factors, [emulated if i == k else each for i, each in enumerate(self.emulated)])

    def ln_prior(self, y: Array) -> Array:
        """(n, 1 + K) ln prior of the shared coordinates, and of each factor's own, up to constants; -inf outside.

        The other coordinates are at the middle of their priors, which are independent.
        """
        first = self.factors[0]
        prior = np.empty((len(y), 1 + len(self.factors)))
        prior[:, 0] = self._ln_prior_of(0, y, first.shared)
        for k, factor in enumerate(self.factors):
            prior[:, 1 + k] = self._ln_prior_of(k, y, factor.own)
        return prior

    def _ln_prior_of(self, k: int, y: Array, columns: IntArray) -> Array:
        if not len(columns):
            return np.zeros(len(y))
        some = np.repeat(self._middles[k], len(y), axis=0)
        some[:, np.isin(self.factors[k].columns, columns)] = y[:, columns]
        return self.emulated[k].space.ln_prior(some)

    def terms(self, y: Array) -> Terms:
        """Return the terms of ln density at coordinates y (n, d)."""
        prior = self.ln_prior(y)
        lnl = np.full((len(y), len(self.factors)), -np.inf)
        for k, (factor, emulated) in enumerate(zip(self.factors, self.emulated, strict=True)):
            inside = np.isfinite(prior[:, 0]) & np.isfinite(prior[:, 1 + k])
            if inside.any():
                lnl[inside, k] = emulated.ln_likelihood(y[np.ix_(inside, factor.columns)])
        return Terms(prior, np.where(np.isnan(lnl), -np.inf, lnl))

    def ln_likelihoods(self, y: Array, fit_error: bool = True) -> Array:
        """(n, K) ln likelihood of each factor at coordinates y (n, d) inside the prior."""
        columns = [each.ln_likelihood(y[:, f.columns], fit_error)
                   for f, each in zip(self.factors, self.emulated, strict=True)]  # fmt: skip
        return np.stack(columns, axis=1)

    def redrawn(self, k: int, rng: np.random.Generator) -> Emulated:
        """Return factor k by an emulator that other noise in its calls could have given."""
        return replace(self.emulated[k], emulator=self.emulated[k].emulator.redrawn(rng))


def hosts_prior(factor: Factor, host: Emulated) -> Callable[[Array], Array]:
    """Return the ln prior density of a factor's parameters (n, p), with the likelihood of the host's data."""
    shared = np.isin(factor.columns, factor.shared)

    def ln_prior(points: Array) -> Array:
        lnp = factor.problem.ln_prior(points)
        inside = np.isfinite(lnp)
        if inside.any():
            lnp[inside] += host.ln_likelihood(host.space.to(points[np.ix_(inside, shared)]))
        return lnp

    return ln_prior
