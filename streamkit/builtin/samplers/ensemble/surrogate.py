"""A polynomial surrogate of the model, learned from the walkers' proposals: of the observables, or of ln likelihood."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, cholesky, solve_triangular
from scipy.special import expit

from streamkit import Array, BoolArray, Data
from streamkit.builtin.samplers.ensemble.polynomial import fit, log_odds, whitening
from streamkit.builtin.samplers.monomials import count, monomials

DEGREES = (3, 2)  # polynomials that are tried, if there are enough points for them
RIDGES = (1e-5, 1e-3)  # ridge penalties that are tried, in units of the mean diagonal of the normal equations
POINTS_PER_TERM = 3.0
# Fraction of the points, the newest, on which the fits are judged: walkers go on to where they have not been.
HELD_OUT = 0.25
MAX_TERMS = 1000
MAX_POINTS = 20000
# Degrees of freedom of the surrogate's likelihood: the first, plus the second times the chi^2 of the best points. Where
# even these are far from the data, a heavier tail would not distinguish them from worse ones.
FREEDOM, MISFIT = 8.0, 3.0
# Power of |x|^2 by which the square of the polynomial's error grows beyond the farthest training point.
EXTRAPOLATED = 2.0
LEAST, WILD = 0.25, 25.0  # least and largest square of a polynomial's error, in units of the typical one
SMOOTH = 1e-2  # ridge penalty of the fit of these squares
UNLIKELY = 0.05  # least probability of an observable: the fit of it is never fully trusted
EXPLAINED = 1e-6  # relative difference up to which a stored ln likelihood is that of the predictions and the data
BEST = 0.02  # fraction of the points that are the best ones
HALF_WEIGHT = 3.0  # standard errors: points with residuals as large have weight 1/2 in the fit
LEAST_WEIGHT = 0.02  # points of less weight do not extend the region in which the fit is trusted
# Power of these weights in a fit of the deviance, whose error grows with it where that of a residual does not: rejected
# points, hundreds below the best, would count most.
STEEP = 3


@dataclass(frozen=True)
class Surrogate:
    """Residuals (prediction - datum) / error, or the deviance, as polynomials of the whitened coordinates.

    The deviance is twice the difference of ln likelihood from its largest value among the training points.
    """

    # (d,) and (d, d): x = (y - centre) @ whiten.
    centre: Array
    whiten: Array
    degree: int
    coefficients: Array  # (terms, m), or (terms, 1) of the deviance
    # (m,) of the data, in units of their own: 1, plus the model's noise if added; none for the deviance.
    variance: Array
    # (quadratic terms, m) coefficients of the square of the polynomial's error, and (m,) its lower bound.
    spread: Array
    least: Array
    # The least chi^2, which is subtracted if there are more data than parameters, and the degrees of freedom of the
    # Student's t that replaces the Gaussian of the rest.
    floor: float
    freedom: float
    reach: float  # largest |x|^2 of the training points without those of large residuals
    points: Array  # (n, d) training points near the data
    exists: Array  # (quadratic terms,) coefficients of the log odds that there is an observable

    @property
    def subject(self) -> str:
        """The fitted quantity: "the observables" or "ln likelihood"."""
        return "the observables" if len(self.variance) else "ln likelihood"

    def ln_likelihood(self, y: Array) -> Array:
        """(n,) ln likelihood at coordinates y (n, d), times the probability that there is an observable at all.

        The error of the polynomial is added to the variance, and Student's t replaces the Gaussian: a walker would
        never leave a place where the surrogate is far too low. Far outside the training points the polynomial is
        meaningless; a penalty keeps walks on the surrogate away from there.
        """
        x = (y - self.centre) @ self.whiten
        terms = monomials(x, self.degree)
        beyond = np.maximum(np.sum(x**2, axis=1) / self.reach, 1.0)
        exists = np.log(np.maximum(expit(terms[:, : len(self.exists)] @ self.exists), UNLIKELY))
        fitted = terms @ self.coefficients
        if len(self.variance):
            error2 = (
                np.maximum(terms[:, : len(self.spread)] @ self.spread, self.least) * beyond[:, None] ** EXTRAPOLATED
            )
            variance = self.variance + error2
            tail = self._tail(np.sum(fitted**2 / variance, axis=1), min(len(self.variance), x.shape[1]))
            tail += 0.5 * np.log(variance).sum(axis=1)
        else:
            tail = self._tail(np.maximum(fitted[:, 0], 0.0), x.shape[1])
        return np.asarray(exists - tail - 0.5 * x.shape[1] * (beyond - 1.0))

    def _tail(self, chi2: Array, m: int) -> Array:
        """(n,) Minus the ln density of Student's t in m dimensions, but for a constant."""
        return np.asarray(0.5 * (self.freedom + m) * np.log1p(np.maximum(chi2 - self.floor, 0.0) / self.freedom))


def learn(points: Array, mean: Array, variance: Array, data: Data, lnl: Array | None = None) -> Surrogate | None:
    """Fit the observables; None if there are too few points, or if they do not span the space.

    Where these do not explain ln likelihood, as the observable has its own or its data depend on a parameter, the
    deviance is fitted. Degree and ridge are those of which a fit to the older points predicts the newest best.

    ``points`` (n, d) are coordinates at which the model was evaluated, the oldest first; ``mean`` and ``variance``
    (n, m) are its predictions there, NaN where there is no observable; ``lnl`` (n,) is ln likelihood there, None or
    NaN if it is the Gaussian one of the data.
    """
    used = np.isfinite(data.values)
    points, mean, variance = points[-MAX_POINTS:], mean[-MAX_POINTS:], variance[-MAX_POINTS:]
    there: BoolArray = np.asarray(np.isfinite(mean[:, used]).all(axis=1), dtype=bool)
    if not there.any():
        return None
    mean, variance, likelihood = mean[there], variance[there], None if lnl is None else lnl[-MAX_POINTS:][there]
    if likelihood is not None and np.isfinite(likelihood).all() and not _explains(mean, variance, likelihood, data):
        deviance = 2 * (likelihood.max() - likelihood)
        return _learn(points, there, deviance[:, None], deviance, np.empty(0))
    residual, noise = _residuals(mean[:, used], variance[:, used], data)
    misfit = np.sum(residual**2, axis=1)
    return _learn(points, there, residual, misfit, 1.0 + np.median(noise, axis=0) * data.add_noise)


def _explains(mean: Array, variance: Array, lnl: Array, data: Data) -> bool:
    """Return whether ln likelihood (n,) is the Gaussian one of means and variances (n, m) and the data."""
    some = np.unique(np.linspace(0, len(lnl) - 1, 50).astype(int))
    gauss = np.array([data.gaussian(mean[i], variance[i]) for i in some])
    return bool(np.allclose(gauss - gauss[0], lnl[some] - lnl[some][0], rtol=EXPLAINED, atol=EXPLAINED))


def _residuals(mean: Array, variance: Array, data: Data) -> tuple[Array, Array]:
    """(n, k) Independent residuals in standard errors, and the model's variance in the same units."""
    used = np.isfinite(data.values)
    away, sigma = mean - data.values[used], data.errors[used]
    if data.covariance is None:
        return away / sigma, variance / sigma**2
    root = cholesky(data.covariance[np.ix_(used, used)], lower=True)
    white = solve_triangular(root, np.eye(len(root)), lower=True)
    return away @ white.T, variance @ (white**2).T


def _learn(points: Array, there: BoolArray, target: Array, misfit: Array, variance: Array) -> Surrogate | None:
    """Fit the target (k, m) at the k points that are there, those with the least misfit (k,) best."""
    y = points[there]
    n, d = y.shape
    floor = float(misfit.min()) if target.shape[1] > d else 0.0
    misfit = misfit - floor
    weight = 1 / (1 + misfit / HALF_WEIGHT**2)
    share = weight if len(variance) else weight**STEEP
    degrees = [k for k in DEGREES if POINTS_PER_TERM * count(d, k) <= n and count(d, k) <= MAX_TERMS]
    choices = [(degree, ridge) for degree in degrees for ridge in RIDGES]
    if not choices:
        return None
    try:
        centre, whiten = whitening(y, weight)
        x = (points - centre) @ whiten
        terms = {degree: monomials(x, degree) for degree in degrees}
        errors = [_error(terms[degree][there], target, weight, share, ridge) for degree, ridge in choices]
        best = int(np.argmin([value.sum() for value in errors]))
        degree, ridge = choices[best]
        quadratic, fitted = terms[degree][:, : count(d, 2)], terms[degree][there]
        coefficients = fit(fitted, target, share, ridge)
        spread = _spread(quadratic[there], target - fitted @ coefficients, weight, errors[best])
        exists = log_odds(quadratic, there.astype(float), RIDGES[0])
    except LinAlgError:  # the walkers hardly moved
        return None
    good = _is_good(weight)
    reach = float(np.max(np.sum(x[there][good | (weight >= LEAST_WEIGHT)] ** 2, axis=1)))
    freedom = FREEDOM + MISFIT * float(np.quantile(misfit, BEST))
    return Surrogate(
        centre,
        whiten,
        degree,
        coefficients,
        variance,
        spread,
        LEAST * errors[best],
        floor,
        freedom,
        reach,
        y[good],
        exists,
    )


def _is_good(weight: Array) -> BoolArray:
    """(n,) Whether a point fits the data, or is among the better half."""
    return np.asarray(weight >= min(0.5, float(np.median(weight))), dtype=bool)


def _spread(terms: Array, left: Array, weight: Array, error: Array) -> Array:
    """(terms, m) A fit of the squared residuals (n, m) of a fit, on the scale of its error (m,) at new points."""
    scale = error / np.maximum(_robust(left[_is_good(weight)]), 1e-12)
    return fit(terms, np.minimum(left**2 * scale, WILD * error), weight, SMOOTH)


def _robust(left: Array) -> Array:
    """(m,) Variance from the median: that of chi^2 with one degree of freedom is 0.455. Outliers do not change it."""
    return np.asarray(np.median(left**2, axis=0) / 0.455)


def _error(terms: Array, residual: Array, weight: Array, share: Array, ridge: float) -> Array:
    """(m,) Variance about a fit to the older points with their shares, at the newest of the good points."""
    old = int((1 - HELD_OUT) * len(terms))
    coefficients = fit(terms[:old], residual[:old], share[:old], ridge)
    good = _is_good(weight[old:])
    return _robust((residual - terms @ coefficients)[old:][good])
