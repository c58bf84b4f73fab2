"""The density of a joint posterior of several factors: a prior, and one likelihood for each stream.

ln p(h, s_1 .. s_K) = ln p(h) + sum over k of [ln p(s_k) + ln L_k(h, s_k)], with the shared parameters h (the host) and
the own parameters s_k of each factor. One posterior alone is the case K = 1 without shared parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from streamkit import Array, BoolArray, IntArray


@dataclass(frozen=True, eq=False)
class Layout:
    """Which of d coordinates are shared by all factors, and which belong to one.

    Attributes
    ----------
    shared
        Indices of the coordinates h.
    own
        Indices of the coordinates s_k of each factor; empty for a factor that depends on h alone.
    """

    shared: IntArray
    own: Sequence[IntArray]

    @classmethod
    def of_one(cls, d: int) -> Layout:
        """Return that of a single posterior of d parameters."""
        return cls(np.empty(0, dtype=np.int64), (np.arange(d),))

    @property
    def size(self) -> int:
        """Number of coordinates d."""
        return len(self.shared) + sum(map(len, self.own))

    def of(self, factor: int) -> IntArray:
        """Indices of all coordinates that a factor depends on, in rising order."""
        return np.sort(np.concatenate([self.shared, self.own[factor]]))


class Terms(NamedTuple):
    """The terms of ln density at n places.

    Attributes
    ----------
    prior
        (n, 1 + K) ln prior of h, and of each s_k; -inf outside.
    ln_likelihood
        (n, K) of each factor; -inf where there is no prediction or outside the prior.
    """

    prior: Array
    ln_likelihood: Array

    def total(self, beta: float) -> Array:
        """(n,) ln density at an inverse temperature: the likelihoods to the power of beta."""
        return np.asarray(self.prior.sum(axis=1) + beta * self.ln_likelihood.sum(axis=1))

    def take(self, rows: IntArray | BoolArray) -> Terms:
        """Return those of some of the places."""
        return Terms(self.prior[rows], self.ln_likelihood[rows])

    def replaced(self, other: Terms, accepted: BoolArray) -> Terms:
        """Return these terms, with those of ``other`` at the accepted places (n,)."""
        rows = accepted[:, None]
        return Terms(*(np.where(rows, new, old) for old, new in zip(self, other, strict=True)))


class JointDensity(Protocol):
    """A density of this form."""

    @property
    def layout(self) -> Layout:
        """Which coordinates belong to which factor."""

    def terms(self, y: Array) -> Terms:
        """Return the terms at coordinates y (n, d)."""
