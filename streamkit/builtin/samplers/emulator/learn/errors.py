"""What a fit errs by: its noise, what it does not describe, and how surely its coefficients are known."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from streamkit import Array
from streamkit.builtin.samplers.emulator.learn.growth import Growth
from streamkit.builtin.samplers.emulator.learn.kernel import Kernel
from streamkit.builtin.samplers.emulator.learn.pairs import ENOUGH
from streamkit.builtin.samplers.emulator.learn.points import Points
from streamkit.builtin.samplers.emulator.learn.polynomial import Leverage, Polynomial, Regression

# Standard errors by which a measured variance must exceed the stated noise before it counts as a lack of fit.
CHANCE = 1.5
# Least factor of the variance of a Gaussian process that fits without a point lead to.
LEAST_ERROR = 0.25
# Largest squared residual that counts in an error, in units of the typical one.
OUTLIER = 25.0


class Errors(NamedTuple):
    """Variances in squared errors of the data, (m,), and what belongs to them: see `Emulator`."""

    residual: Array
    correlation: Array
    leverage: Leverage
    lack_of_fit: Array
    growth: Growth
    unstated: Array
    stated: Array
    pairs: int

    @classmethod
    def of(cls, points: Points, basis: Polynomial | Kernel, fit: Regression) -> Errors:
        """Measure the error of a fit, and how much of it is noise of the calls."""
        out, x, noise = fit.out_without(points.pairs)[points.close], points.x[points.close], points.noise[points.close]
        squares, r2 = fit.left[points.close] * out, np.sum(x**2, axis=1)
        residual = error_of(squares)
        both = points.close[points.pairs].all(axis=1)
        apart = (points.x[points.pairs[:, 0]] != points.x[points.pairs[:, 1]]).any(axis=1)  # one call has one noise
        pairs = points.pairs[both & apart]
        more = unstated(points.target[pairs], points.noise[pairs])
        stated = points.typical_noise
        uncertain = 2 / points.close.sum() + np.where(more > 0, 2 / max(len(pairs), 1), 0.0)
        lack = np.maximum(residual - (stated + more) * (1 + CHANCE * np.sqrt(uncertain)), 0.0)
        guard = 1 + basis.degree if isinstance(basis, Polynomial) else 1
        # Where noise is stated too large, the others' lack of fit would be lost in what it seems to exceed.
        growth = Growth.of(r2, np.sum((limited(squares) - noise - more)[:, lack > 0], axis=1), guard)
        leverage = basis.leverage(fit.root)
        if isinstance(basis, Kernel):
            said = residual.sum() * leverage.at(basis.features(x)) / (1 - fit.leverage[points.close])
            made = np.sum(limited(out**2) - noise - more - lack * growth.at(r2)[:, None], axis=1)
            leverage = leverage.times(_calibration(made, said))
        known = len(pairs) if len(pairs) >= ENOUGH else 0
        return cls(residual, _correlation(out), leverage, lack, growth, more, stated, known)


def _calibration(made: Array, said: Array) -> float:
    """Return the factor of a process's variance by which it becomes the squared errors of fits without a point.

    ``made`` and ``said`` (n,) are these squares, and what the process expects of them. The amplitude that has the
    highest marginal likelihood is often too large (Bachoc 2013, CSDA 66, 55).
    """
    most = made.mean() + CHANCE * made.std() / np.sqrt(len(made))
    return float(np.clip(most / max(said.mean(), 1e-300), LEAST_ERROR, 1.0))


def _correlation(residuals: Array) -> Array:
    """(m, m) Return the correlation of residuals (n, m), the largest ones limited."""
    some = np.sign(residuals) * np.sqrt(limited(residuals**2))
    some /= np.sqrt(np.mean(some**2, axis=0) + 1e-300)
    return np.asarray(some.T @ some / len(some))


def unstated(targets: Array, noise: Array) -> Array:
    """(m,) Return the noise, in squared errors, that observables do not state; 0 where it may be chance.

    From targets (p, 2, m) of pairs of calls, and the noise (p, 2, m) that is stated.
    """
    pairs, _, m = targets.shape
    if pairs < ENOUGH:
        return np.zeros(m)
    measured, stated = error_of(0.5 * (targets[:, 0] - targets[:, 1]) ** 2), noise.mean(axis=(0, 1))
    return np.where(measured - stated > CHANCE * np.sqrt(2 / pairs) * stated, measured - stated, 0.0)


def error_of(squares: Array) -> Array:
    """(k,) Means of squares (n, k), the largest ones limited."""
    return np.asarray(limited(squares).mean(axis=0))


def limited(squares: Array) -> Array:
    """(n, k) Squares, limited to `OUTLIER` times the typical one."""
    most = OUTLIER * np.maximum(np.median(np.abs(squares), axis=0) / 0.455, 1e-300)
    return np.asarray(np.clip(squares, -most, most))
