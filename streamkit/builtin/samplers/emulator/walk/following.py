"""How the own coordinates of a stream follow those that all streams share, when these are moved.

A step of the shared coordinates h is accepted as often as the own ones s go along with what the posterior makes of
them. s = m(h) + L exp(l(h)) L^-1 r, with residuals r that stay: a regression m of first or second degree, and ln widths
l that change with h, along the rows of a Cholesky factor L. Twelve streams have some hundred own coordinates: each that
bends or widens a little holds h where it is. A hundred coefficients that are noise do the same. So each stream gets the
form by which one half of the places predicts the other one best.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from streamkit import Array
from streamkit.builtin.samplers.monomials import count, monomials

# Residuals in standard deviations below which ln |r| says nothing of a width: it is a number near to nothing by chance.
TINY = 0.05
# Most that a ln width changes by.
MOST = 1.0
# Places for each coefficient of a regression of second degree: those of a walk, and not those of some hundred walkers
# on their way to the posterior, which would lose narrow modes.
ENOUGH = 80


@dataclass(frozen=True)
class Following:
    """What own coordinates (n, k) are at shared ones h (n, q).

    Attributes
    ----------
    middle, scale
        (q,) of h.
    degree, coefficients
        Of the regression, and its (t, k).
    root, slopes
        (k, k) L, and (q, k) those of l; None where widths do not change.
    """

    middle: Array
    scale: Array
    degree: int
    coefficients: Array
    root: Array
    slopes: Array | None = None

    @classmethod
    def of(cls, h: Array, own: Array) -> Following:
        """Learn from places: h (n, q), own (n, k); of few of them a straight line of constant width."""
        if not h.shape[1] or not own.shape[1]:
            none, own_size = np.zeros(h.shape[1]), own.shape[1]
            return cls(none, none + 1, 0, np.zeros((1, own_size)), np.eye(own_size))
        if len(h) < ENOUGH * count(h.shape[1], 2):
            return cls._learned(h, own, degree=1, widths=False)
        half, forms = len(h) // 2, [(1, False), (1, True), (2, False), (2, True)]
        predicted = [cls._learned(h[:half], own[:half], *form)._predicts(h[half:], own[half:]) for form in forms]
        return cls._learned(h, own, *forms[int(np.argmax(predicted))])

    @classmethod
    def _learned(cls, h: Array, own: Array, degree: int, widths: bool) -> Following:
        middle, scale = h.mean(axis=0), np.maximum(h.std(axis=0), 1e-300)
        terms = monomials((h - middle) / scale, degree)
        coefficients = np.asarray(np.linalg.lstsq(terms, own)[0])
        left = own - terms @ coefficients
        covariance = np.atleast_2d(left.T @ left) / len(left)
        covariance += np.diag(1e-9 * np.diag(covariance) + 1e-300)  # walkers may all be at one value, or be few
        found = cls(middle, scale, degree, coefficients, np.asarray(np.linalg.cholesky(covariance), dtype=float))
        if not widths:
            return found
        ln = np.log(np.maximum(np.abs(found._white(left)), TINY))
        slopes = np.asarray(np.linalg.lstsq(terms[:, : 1 + len(middle)], ln)[0])[1:]
        return replace(found, slopes=slopes)

    def at(self, h: Array) -> Array:
        """(n, k) The middle of the own coordinates at h (n, q)."""
        return np.asarray(monomials((h - self.middle) / self.scale, self.degree) @ self.coefficients)

    def left(self, h: Array, own: Array) -> Array:
        """(n, k) The residuals of own coordinates (n, k) at h (n, q)."""
        return self._stretched(own - self.at(h), -self._ln_widths(h))

    def changed(self, h: Array, change: Array) -> Array:
        """(n, k) What a change (n, k) of residuals changes of the own coordinates at h (n, q)."""
        return self._stretched(change, self._ln_widths(h))

    def placed(self, h: Array, residuals: Array) -> tuple[Array, Array]:
        """Return the own coordinates (n, N, k) at h (n, q) of residuals (n, N, k), and ln |ds / du| there (n,)."""
        n, count, k = residuals.shape
        ln = self._ln_widths(h)
        stretched = self._stretched(residuals.reshape(n * count, k), np.repeat(ln, count, axis=0))
        return self.at(h)[:, None] + stretched.reshape(n, count, k), ln.sum(axis=1)

    def _ln_widths(self, h: Array) -> Array:
        """(n, k) l at h (n, q)."""
        if self.slopes is None:
            return np.zeros((len(h), self.coefficients.shape[1]))
        return np.clip((h - self.middle) / self.scale @ self.slopes, -MOST, MOST)

    def _white(self, away: Array) -> Array:
        """(n, k) L^-1 of differences (n, k)."""
        return np.asarray(np.linalg.solve(self.root, away.T).T)

    def _stretched(self, away: Array, ln: Array) -> Array:
        """(n, k) L exp(ln) L^-1 of differences (n, k)."""
        return away if self.slopes is None else (self._white(away) * np.exp(ln)) @ self.root.T

    def _predicts(self, h: Array, own: Array) -> float:
        """Return the mean ln density of own coordinates (n, k) at h (n, q), if their residuals are Gaussian."""
        ln = self._ln_widths(h)
        white = self._white(own - self.at(h)) * np.exp(-ln)
        volume = np.log(np.diag(self.root)).sum() + ln.sum(axis=1).mean()
        return float(-0.5 * np.mean(np.sum(white**2, axis=1)) - volume)
