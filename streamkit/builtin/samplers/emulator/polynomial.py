"""Polynomials of several coordinates: their monomials, and weighted ridge regression with its error at new points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular

from streamkit import Array, IntArray
from streamkit.builtin.samplers.monomials import monomials

# Leverage of a point on its own fit, at most: a point beyond would decide its fit alone.
HEAVIEST = 0.95


@dataclass(frozen=True)
class Regression:
    """A weighted ridge regression of many targets on the same terms.

    Attributes
    ----------
    coefficients
        (terms, k).
    root
        (terms, terms): the squared length of ``terms @ root`` is the variance of the fit in units of the target's.
    left
        (n, k) what the fit leaves over at the points.
    leverage
        (n,) how much each point decides the fit there: ``left / (1 - leverage)`` is what a fit without it leaves over.
    """

    coefficients: Array
    root: Array
    left: Array
    leverage: Array

    @property
    def out(self) -> Array:
        """(n, k) The residual of every point about the fit without it."""
        return np.asarray(self.left / (1 - self.leverage[:, None]))

    def out_without(self, pairs: IntArray) -> Array:
        """(n, k) The same, where both points of each pair (p, 2) are left out: each would give the other away.

        With a leverage h of each, what both leave over is (1 - H)^-1 of what they leave over in the fit, H = h in all
        four entries.
        """
        out, h = self.out, np.minimum(self.leverage[pairs].mean(axis=1), 0.5 * HEAVIEST)
        shared = (h / (1 - 2 * h))[:, None] * self.left[pairs].sum(axis=1)
        for side in (0, 1):
            out[pairs[:, side]] = self.left[pairs[:, side]] + shared
        return out


@dataclass(frozen=True)
class Polynomial:
    """The terms of a polynomial of this degree."""

    degree: int

    def terms(self, x: Array) -> Array:
        """(n, terms) The monomials at x (n, c)."""
        return monomials(x, self.degree)

    def unseen(self, terms: Array) -> Array:
        """(n,) Zero: a polynomial is all in its terms."""
        return np.zeros(len(terms))


def regress(terms: Array, target: Array, weight: Array, ridge: float | Array) -> Regression:
    """Fit targets (n, k) by terms (n, t) with weights (n,).

    The ridge penalty is in units of the mean diagonal of the normal equations, and the first term is not penalised; or
    it is given for every term (t,). Raises LinAlgError where points do not span the terms.
    """
    weighted = terms * weight[:, None]
    normal = weighted.T @ terms
    if isinstance(ridge, float):
        scale = ridge * np.trace(normal) / len(normal)
        ridge = np.where(np.arange(len(normal)) > 0, scale, 1e-12 * scale)
    normal[np.diag_indices_from(normal)] += ridge
    lower = cholesky(normal, lower=True)
    coefficients = np.asarray(cho_solve((lower, True), weighted.T @ target))
    root = np.asarray(solve_triangular(lower, np.eye(len(lower)), lower=True).T)
    leverage = np.minimum(weight * np.sum((terms @ root) ** 2, axis=1), HEAVIEST)
    return Regression(coefficients, root, target - terms @ coefficients, leverage)
