"""Polynomials of several coordinates: their monomials, and weighted ridge regression with its error at new points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_solve, cholesky, get_blas_funcs, solve_triangular

from streamkit import Array, IntArray
from streamkit.builtin.samplers.monomials import differentiated, monomials

# From places x (n, c): values (n, m), and their slopes (n, c, m).
Slopes = Callable[[Array], tuple[Array, Array]]
# Singular values of coefficients below this fraction of the largest are left out.
NEGLIGIBLE = 1e-6
# Leverage of a point on its own fit, at most: a point beyond would decide its fit alone.
HEAVIEST = 0.95


class LowRank(NamedTuple):
    """Coefficients (terms, k), as a product of two thinner matrices where that is less work."""

    left: Array
    right: Array | None = None

    @classmethod
    def of(cls, coefficients: Array) -> LowRank:
        """Take coefficients apart where they have a low rank."""
        if min(coefficients.shape) < 8:
            return cls(coefficients)
        u, s, v = np.linalg.svd(coefficients, full_matrices=False)
        rank = int(np.sum(s > NEGLIGIBLE * s[0])) or 1
        if rank * sum(coefficients.shape) >= coefficients.size:
            return cls(coefficients)
        return cls(np.ascontiguousarray(u[:, :rank] * s[:rank]), np.ascontiguousarray(v[:rank]))

    @property
    def whole(self) -> Array:
        """(terms, k) The coefficients."""
        return self.left if self.right is None else self.left @ self.right

    def at(self, terms: Array) -> Array:
        """(n, k) The polynomials with terms (n, t)."""
        first = terms @ self.left
        return np.asarray(first if self.right is None else first @ self.right)


@dataclass(frozen=True)
class Regression:
    """A weighted ridge regression of many targets on the same terms.

    Attributes
    ----------
    coefficients
        (terms, k).
    root
        (terms, terms) upper triangle: the squared length of ``terms @ root`` is the variance of the fit in units of the
        target's.
    left
        (n, k) what the fit leaves over at the points.
    leverage
        (n,) how much each point decides the fit there: ``left / (1 - leverage)`` is what a fit without it leaves over.
    penalty
        (terms,) the ridge penalty of each coefficient.
    """

    coefficients: Array
    root: Array
    left: Array
    leverage: Array
    penalty: Array

    def by_noise(self, terms: Array, weight: Array) -> Array:
        """(terms, terms) Return what makes changes of the coefficients of independent normal numbers.

        The noise of all points (n, terms) is the same, whatever their weights (n,): a point that counts less moves the
        fit less. ``root`` would be right for points whose variance is the inverse of their weight.
        """
        weighted = terms * weight[:, None]
        both = weighted.T @ weighted
        both[np.diag_indices_from(both)] += self.penalty
        return np.asarray(self.root @ (self.root.T @ cholesky(both, lower=True)))

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


class Leverage(NamedTuple):
    """The variance of a fit at new points, in units of that of the points about it, by features f (n, t).

    It is |f @ root|^2, and where a prior variance is all that is known, that variance minus |f @ seen|^2.

    Attributes
    ----------
    root, prior, seen
        (t, k), a number, and (t, r). Without a prior the root is an upper triangle in single precision: an error of a
        millionth does not matter, and half of the time does.
    """

    root: Array
    prior: float = 0.0
    seen: Array | None = None

    def at(self, features: Array) -> Array:
        """(n,) The leverage with features (n, t)."""
        if self.seen is None:
            single = times_triangular(features.astype(np.float32), self.root)
            return np.asarray(np.sum(single**2, axis=1, dtype=float))
        rest = self.prior - np.sum((features @ self.seen) ** 2, axis=1)
        return np.asarray(np.sum((features @ self.root) ** 2, axis=1) + np.maximum(rest, 0.0))

    def times(self, factor: float) -> Leverage:
        """Return the leverage of which the variance is this factor of that of this one."""
        root = float(np.sqrt(factor))
        return Leverage(root * self.root, factor * self.prior, None if self.seen is None else root * self.seen)


@dataclass(frozen=True)
class Polynomial:
    """The terms of a polynomial of this degree, which are its features."""

    degree: int

    def terms(self, x: Array) -> Array:
        """(n, terms) The monomials at x (n, c)."""
        return monomials(x, self.degree)

    features = terms

    def of_features(self, coefficients: Array) -> Array:
        """Return coefficients of the features: those of the terms."""
        return coefficients

    def leverage(self, root: Array) -> Leverage:
        """Return the leverage of a fit with this root, see `Regression`."""
        return Leverage(np.asfortranarray(root, dtype=np.float32))

    def along(self, coefficients: LowRank) -> Slopes:
        """Return polynomials with coefficients (terms, m), and their slopes, as a function of x."""
        slope_coefficients: Array | None = None

        def slopes(x: Array) -> tuple[Array, Array]:
            nonlocal slope_coefficients
            if slope_coefficients is None:
                slope_coefficients = differentiated(coefficients.left, x.shape[1], self.degree)
            terms = self.terms(x)
            lower, c, k = slope_coefficients.shape
            along = (terms[:, :lower] @ slope_coefficients.reshape(lower, c * k)).reshape(-1, c, k)
            return coefficients.at(terms), along if coefficients.right is None else along @ coefficients.right

        return slopes


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
    root = np.asfortranarray(solve_triangular(lower, np.eye(len(lower)), lower=True).T)
    leverage = np.minimum(weight * np.sum(times_triangular(terms, root) ** 2, axis=1), HEAVIEST)
    return Regression(coefficients, root, target - terms @ coefficients, leverage, np.broadcast_to(ridge, len(lower)))


def times_triangular(terms: Array, root: Array) -> Array:
    """(n, t) ``terms @ root`` of an upper triangle (t, t), in half the time of a whole matrix."""
    return np.asarray(get_blas_funcs("trmm", (root,))(1.0, root, terms, side=1))
