"""What calls have given becomes an emulator: weights, whitening, the choice of the polynomial, its own error."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError
from scipy.special import expit

from streamkit import Array, BoolArray, IntArray
from streamkit.builtin.samplers.emulator.emulator import SILENCE, Emulator
from streamkit.builtin.samplers.emulator.growth import Growth
from streamkit.builtin.samplers.emulator.kernel import BEGINS, LEARNED_FROM, Kernel, learn_kernel
from streamkit.builtin.samplers.emulator.pairs import ENOUGH as ENOUGH_PAIRS
from streamkit.builtin.samplers.emulator.pairs import pairs_of
from streamkit.builtin.samplers.emulator.polynomial import LowRank, Polynomial, Regression, regress
from streamkit.builtin.samplers.emulator.problem import Answers, Problem
from streamkit.builtin.samplers.monomials import count, monomials

# Polynomials that are tried: degrees, most terms, effective points for each term, and ridge penalties in units of the
# mean diagonal of the normal equations.
DEGREES, MOST_TERMS, POINTS_PER_TERM = (1, 2, 3, 4, 5, 6, 7, 8), 1000, 1.6
RIDGES = (1e-8, 1e-6, 1e-4, 1e-2)
# Degrees above the best one that are tried in vain before no higher one is: two, as a function may be even or odd.
IN_VAIN = 2
# Points lower in ln likelihood than the best by so much, plus half the number of parameters, count a quarter.
NEAR = 10.0
# Part of `NEAR` by which ln likelihoods of a fit and of its calls may differ, beside some typical changes by noise: in
# the median, and where noise has brought a call near the data.
UNLIKE, LUCKY = 0.3, 4.0
# Effective points that the weights leave at least, for each term of a quadratic.
ENOUGH = 2.0
# Points at least, and for each parameter, on which errors are measured if fewer are close.
LEAST_CLOSE, CLOSE = 40, 3
# A call counts less if its stated noise is larger than that of most calls, this fraction of them, by this factor: one
# such call could decide the lengths of a process alone.
MOST, NOISY = 0.9, 10.0
# Points that count less than this are not used for the lengths of a Gaussian process.
LEAST_WEIGHT = 0.02
# The fit is trusted to |x|^2 of the farthest near point times this.
REACH = 1.5
# Standard deviation of a combination of predictions near the data, in its errors, from which walkers follow it.
FOLLOWED = 0.05
# Largest squared residual that counts in an error, in units of the typical one.
OUTLIER = 25.0
# The best points by ln likelihood, which is noisy: the best one is this one from the top, a fraction.
BEST = 0.01
# Ridge penalty of the fit of the probability that there is a prediction; its steps, halvings of a step, and least gain.
EXISTS_RIDGE, ITERATIONS, HALVINGS, SETTLED = 1e-3, 40, 20, 1e-6
# A Gaussian process is tried where the error of the best polynomial exceeds the noise by this factor, and this many
# squared errors for each datum.
WORTH, EXACT = 1.15, 1e-3
# Fraction of the stated noise that there is surely.
SURELY = 0.5
# Least factor of the variance of a Gaussian process that fits without a point lead to.
LEAST_ERROR = 0.25
# Standard errors by which a measured variance must exceed the stated noise before it counts as a lack of fit.
CHANCE = 1.5
# Least variance of a prediction, in squared errors of the data, whose logarithm is fitted.
SILENT = 1e-10


def learn(problem: Problem, y: Array, answers: Answers, theta: Array, tilt: Array | None = None) -> Emulator | None:
    """Fit an emulator to answers at coordinates y (n, d), parameters theta (n, d).

    None where there are too few, or they do not span the space. Degree and ridge are those whose fits without a point
    predict that point best, points near the data counting most. What is near is decided by the emulated likelihood, in
    a second pass: points whose noise happens to bring them near would lead the fit. Where other data decide too what
    is near, ``tilt`` (n,) is what they add to the ln likelihoods.
    """
    there: BoolArray = np.asarray(np.isfinite(answers.ln_likelihood), dtype=bool)
    if not there.any():
        return None
    other = np.zeros(len(y)) if tilt is None else tilt
    lnl = answers.ln_likelihood + other
    emulator = _fitted(problem, y, answers, lnl)
    if emulator is None:
        return None
    smooth = emulator.ln_likelihood(y, theta, problem.add_noise, most_by_error=0.0) + other
    best = _best(lnl[there])
    close = there & (lnl > best - NEAR - 0.5 * y.shape[1])
    if close.sum() < y.shape[1]:
        return emulator
    by_noise = _changed_by_noise(emulator, y[close], theta[close])
    if np.median(np.abs(smooth - lnl)[close]) > UNLIKE * NEAR + 2 * by_noise:
        return emulator
    missed = close & (lnl - smooth > UNLIKE * NEAR + LUCKY * by_noise)  # a mode that calls find and the fit excludes
    return _fitted(problem, y, answers, np.where(missed, lnl, smooth))


def _changed_by_noise(emulator: Emulator, y: Array, theta: Array) -> float:
    """Return the median change of ln likelihood by the noise of calls, as far as it is stated or measured by pairs."""
    predicted, problem = emulator.predict(y), emulator.problem
    noise, rng = predicted.noise, np.random.default_rng(len(y))
    variance = noise if problem.add_noise else np.zeros_like(noise)
    of_call = predicted.mean + rng.standard_normal(noise.shape) * np.sqrt(noise)
    there, here = (problem.compare(theta, mean, variance, predicted.details) for mean in (of_call, predicted.mean))
    return float(np.median(np.abs(there - here)))


def learn_predictions(problem: Problem, y: Array, answers: Answers) -> Emulator | None:
    """Fit an emulator for its predictions alone, without calling the likelihood; None where there are too few."""
    if not np.isfinite(answers.ln_likelihood).any():
        return None
    return _fitted(problem, y, answers, answers.ln_likelihood)


def _best(lnl: Array) -> float:
    return float(np.sort(lnl)[-max(int(BEST * len(lnl)), 1)])


@dataclass(frozen=True, eq=False)
class _Points:
    """The calls that gave a prediction, as points of a regression.

    Attributes
    ----------
    centre, whiten
        Of the coordinates x, see `Emulator`.
    x
        (n, c) whitened coordinates.
    target, noise
        (n, m) differences from the data and stated variances, in errors of the data and in squared ones.
    weight, close
        (n,) how much a point counts, and whether errors are measured on it.
    pairs
        (p, 2) indices of calls at one place.
    """

    centre: Array
    whiten: Array
    x: Array
    target: Array
    noise: Array
    weight: Array
    close: BoolArray
    pairs: IntArray

    @property
    def typical_noise(self) -> Array:
        """(m,) The mean of the stated variances near the data."""
        return np.asarray(np.average(self.noise[self.close], axis=0, weights=self.weight[self.close]))


def _fitted(problem: Problem, y: Array, answers: Answers, lnl: Array) -> Emulator | None:
    """Fit with weights by this ln likelihood (n,); None where the points do not span the terms."""
    there: BoolArray = np.asarray(np.isfinite(answers.ln_likelihood), dtype=bool)
    points = _points(problem, y[there], answers.take(there), lnl[there])
    found = _best_regression(points)
    if found is None:
        return None
    basis, fit = found
    errors = _errors(points, basis, fit)
    of_fit = np.sqrt(1 + errors.lack_of_fit + errors.residual * float(np.mean(fit.leverage[points.close])))
    degree = min(2, _highest_degree(points))
    others, positive = _forms(points.noise, answers.details[there])
    secondary = regress(monomials(points.x, degree), others, points.weight, RIDGES[-2])
    every = monomials((y[:, problem.coordinates] - points.centre) @ points.whiten, degree)
    r2 = np.sum(points.x**2, axis=1)
    return Emulator(
        problem=problem,
        centre=points.centre,
        whiten=points.whiten,
        basis=basis,
        growth=errors.growth,
        mean=LowRank.of(basis.of_features(fit.coefficients)),
        directions=np.eye(1) if problem.is_ln_likelihood else _directions(points, fit, of_fit),
        leverage=basis.leverage(fit.root).times(_calibrated(points, basis, fit, errors)),
        chance=basis.of_features(fit.root),
        residual_variance=errors.residual,
        correlation=errors.correlation,
        lack_of_fit=errors.lack_of_fit,
        unstated_variance=errors.unstated,
        stated_variance=errors.stated,
        pairs=errors.pairs,
        secondary_degree=degree,
        secondary=LowRank.of(secondary.coefficients),
        positive=positive,
        secondary_range=(others.min(axis=0), others.max(axis=0)),
        trusted_r2=float(REACH * r2[points.close].max()),
        exists=log_odds(every, there.astype(float), EXISTS_RIDGE),
    )


def _directions(points: _Points, fit: Regression, error: Array) -> Array:
    """(m, k) Return the combinations of data, in their errors (m,), along which a fit changes near the data."""
    near = (points.target - fit.left)[points.close] / error
    near -= near.mean(axis=0)
    _, sizes, along = np.linalg.svd(near, full_matrices=False)
    kept = max(int(np.sum(sizes > FOLLOWED * np.sqrt(len(near)))), 1)
    return np.asarray(along[:kept].T / error[:, None])


def _points(problem: Problem, y: Array, answers: Answers, lnl: Array) -> _Points:
    """Weigh and whiten calls with predictions at coordinates y (n, d)."""
    used, z = np.isfinite(problem.values), y[:, problem.coordinates]
    weight = weights(lnl, y.shape[1], ENOUGH * count(z.shape[1], 2))
    errors = problem.errors[used]
    noise = answers.variance[:, used] / errors**2
    typical = np.maximum(NOISY * np.quantile(noise, MOST, axis=0), SILENCE)
    weight /= np.max(np.maximum(noise / typical, 1.0), axis=1)
    centre, whiten = whitening(z, weight)
    x = (z - centre) @ whiten
    target = (answers.mean[:, used] - problem.values[used]) / errors
    return _Points(centre, whiten, x, target, noise, weight, nearest(lnl, y.shape[1]), pairs_of(x))


def _highest_degree(points: _Points) -> int:
    """Return the highest degree of a polynomial that there are points for; 0 if there is none."""
    effective, d = points.weight.sum() ** 2 / np.sum(points.weight**2), points.x.shape[1]
    enough = [k for k in DEGREES if POINTS_PER_TERM * count(d, k) <= effective and count(d, k) <= MOST_TERMS]
    return max(enough, default=0)


def _best_regression(points: _Points) -> tuple[Polynomial | Kernel, Regression] | None:
    """Return the polynomial, or the Gaussian process, whose fits without a point predict that point best."""
    fits: list[tuple[float, Polynomial | Kernel, Regression]] = []
    best = (np.inf, 1)  # what the best polynomial leaves over, and its degree
    for degree in (k for k in DEGREES if k <= _highest_degree(points)):
        if degree > best[1] + IN_VAIN:
            break
        terms = monomials(points.x, degree)
        for ridge in RIDGES:
            try:
                fit = regress(terms, points.target, points.weight, ridge)
            except LinAlgError:  # walkers that hardly moved
                continue
            best = min(best, (_left_over(points, fit), degree))
            fits.append((_left_over(points, fit), Polynomial(degree), fit))
    if not fits:
        return None
    noisy = float(points.typical_noise.sum())
    m = points.target.shape[1]
    if min(fits, key=_first)[0] > WORTH * noisy + EXACT * m:
        counted, rng = points.weight >= LEAST_WEIGHT, np.random.default_rng(len(points.x))
        x, target, weight = points.x[counted], points.target[counted], points.weight[counted]
        try:
            for begin in BEGINS if len(x) > LEARNED_FROM else dict.fromkeys(BEGINS):  # all points are one draw
                kernel = learn_kernel(x, target, weight, rng, SURELY * noisy / m, begin)
                fit = regress(kernel.terms(points.x), points.target, points.weight, kernel.penalty)
                fits.append((_left_over(points, fit), kernel, fit))
        except LinAlgError:
            pass
    _, basis, fit = min(fits, key=_first)
    return basis, fit


def _left_over(points: _Points, fit: Regression) -> float:
    """Return the sum over the data of the mean square that fits without a point, or its pair, leave over there."""
    return float(np.sum(error_of(fit.out_without(points.pairs)[points.close] ** 2)))


class _Errors(NamedTuple):
    """Variances in squared errors of the data, (m,), their growth, and the number of pairs of calls: see `Emulator`."""

    residual: Array
    correlation: Array
    lack_of_fit: Array
    growth: Growth
    unstated: Array
    stated: Array
    pairs: int


def _errors(points: _Points, basis: Polynomial | Kernel, fit: Regression) -> _Errors:
    """Measure the error of a fit, and how much of it is noise of the calls."""
    out = fit.out_without(points.pairs)[points.close]
    squares = fit.left[points.close] * out
    residual = error_of(squares)
    both = points.close[points.pairs].all(axis=1)
    apart = (points.x[points.pairs[:, 0]] != points.x[points.pairs[:, 1]]).any(axis=1)  # one call has one noise
    pairs = points.pairs[both & apart]
    more = unstated(points.target[pairs], points.noise[pairs])
    stated = points.typical_noise
    uncertain = 2 / points.close.sum() + np.where(more > 0, 2 / max(len(pairs), 1), 0.0)
    lack_of_fit = np.maximum(residual - (stated + more) * (1 + CHANCE * np.sqrt(uncertain)), 0.0)
    r2, wild = np.sum(points.x[points.close] ** 2, axis=1), _wild(squares)
    excess = np.sum(np.clip(squares, -wild, wild) - points.noise[points.close] - more, axis=1)
    growth = Growth.of(r2, excess, 1 + basis.degree if isinstance(basis, Polynomial) else 1)
    known = len(pairs) if len(pairs) >= ENOUGH_PAIRS else 0
    return _Errors(residual, _correlation(out), lack_of_fit, growth, more, stated, known)


def _calibrated(points: _Points, basis: Polynomial | Kernel, fit: Regression, errors: _Errors) -> float:
    """Return by which factor the variance of a fit must be smaller to be the squares that fits without a point err by.

    The amplitude of a Gaussian process with the highest marginal likelihood is often too large (Bachoc 2013, CSDA 66,
    55). A polynomial has no amplitude.
    """
    if isinstance(basis, Polynomial):
        return 1.0
    squares = fit.out_without(points.pairs)[points.close] ** 2
    wrong = np.minimum(squares, _wild(squares)) - points.noise[points.close] - errors.unstated
    x = points.x[points.close]
    wrong -= errors.lack_of_fit * errors.growth.at(np.sum(x**2, axis=1))[:, None]
    said = basis.leverage(fit.root).at(basis.features(x)) / (1 - fit.leverage[points.close])
    each = wrong.sum(axis=1)
    most = each.mean() + CHANCE * each.std() / np.sqrt(len(each))
    return float(np.clip(most / max(errors.residual.sum() * said.mean(), 1e-300), LEAST_ERROR, 1.0))


def _correlation(residuals: Array) -> Array:
    """(m, m) Return the correlation of residuals (n, m), the wildest cut."""
    wild = np.sqrt(_wild(residuals**2))
    some = np.clip(residuals, -wild, wild)
    some /= np.sqrt(np.mean(some**2, axis=0) + 1e-300)
    return np.asarray(some.T @ some / len(some))


def unstated(targets: Array, noise: Array) -> Array:
    """(m,) Return the noise, in squared errors, that observables do not state; 0 where it may be chance.

    From targets (p, 2, m) of pairs of calls, and the noise (p, 2, m) that is stated.
    """
    pairs, _, m = targets.shape
    if pairs < ENOUGH_PAIRS:
        return np.zeros(m)
    measured, stated = error_of(0.5 * (targets[:, 0] - targets[:, 1]) ** 2), noise.mean(axis=(0, 1))
    return np.where(measured - stated > CHANCE * np.sqrt(2 / pairs) * stated, measured - stated, 0.0)


def _first(fit: tuple[float, Polynomial | Kernel, Regression]) -> float:
    return fit[0]


def weights(lnl: Array, d: int, wanted: float) -> Array:
    """(n,) Weights of points with ln likelihood (n,): one near the best, falling so that enough points count."""
    away = np.maximum(_best(lnl) - lnl, 0.0)
    scale, wanted = NEAR + 0.5 * d, min(wanted, 0.6 * len(lnl))
    for _ in range(80):
        weight = 1 / (1 + away / scale) ** 2
        if weight.sum() ** 2 / np.sum(weight**2) >= wanted:
            break
        scale *= 1.25
    return np.asarray(weight)


def nearest(lnl: Array, d: int) -> BoolArray:
    """(n,) Whether points with ln likelihood (n,) are near the data: errors are measured there, as others err more."""
    away = _best(lnl) - lnl
    least = np.sort(away)[min(LEAST_CLOSE + CLOSE * d, len(lnl)) - 1]
    return np.asarray(away <= max(NEAR + 0.5 * d, least), dtype=bool)


def whitening(y: Array, weight: Array) -> tuple[Array, Array]:
    """(d,) and (d, d) Centre and matrix of x = (y - centre) @ matrix: half a standard deviation is 1.

    The powers of x then stay of order one.
    """
    covariance = np.atleast_2d(np.cov(y.T, aweights=weight))
    covariance[np.diag_indices_from(covariance)] *= 1 + 1e-9
    centre = np.asarray(np.average(y, axis=0, weights=weight), dtype=float)
    return centre, np.asarray(0.5 * np.linalg.inv(np.linalg.cholesky(covariance)).T, dtype=float)


def error_of(squares: Array) -> Array:
    """(k,) Means of squares (n, k), the wildest cut."""
    top = _wild(squares)
    return np.asarray(np.clip(squares, -top, top).mean(axis=0))


def _wild(squares: Array) -> Array:
    """(k,) Return the squares (n, k) beyond which residuals are cut."""
    return np.asarray(OUTLIER * np.maximum(np.median(np.abs(squares), axis=0) / 0.455, 1e-300))


def log_odds(terms: Array, there: Array, penalty: float) -> Array:
    """(terms,) Coefficients of the log odds of 1 against 0 in there (n,): logistic regression with a ridge penalty.

    Newton steps, halved until they lead uphill: the penalised likelihood has one maximum.
    """
    coefficients = np.zeros(terms.shape[1])
    if there.all():
        coefficients[0] = 20.0
        return coefficients

    def value(trial: Array) -> float:
        odds = terms @ trial
        return float(np.sum(there * odds - np.logaddexp(0.0, odds)) - 0.5 * penalty * trial @ trial)

    reached = value(coefficients)
    for _ in range(ITERATIONS):
        p = expit(terms @ coefficients)
        curvature = (terms * (p * (1 - p))[:, None]).T @ terms
        curvature[np.diag_indices_from(curvature)] += penalty
        step = np.linalg.solve(curvature, terms.T @ (there - p) - penalty * coefficients)
        gained = 0.0
        for _ in range(HALVINGS):
            gained = value(coefficients + step) - reached
            if gained > 0:
                break
            step = 0.5 * step
        if gained <= SETTLED:
            break
        coefficients, reached = coefficients + step, reached + gained
    return coefficients


def _forms(noise: Array, details: Array) -> tuple[Array, BoolArray]:
    """Return ln variance and the details, (n, m + k), and which of the latter are logarithms as well (k,)."""
    positive: BoolArray = np.asarray((details > 0).all(axis=0), dtype=bool)
    logs = np.log(np.where(positive, details, 1.0))
    return np.concatenate([np.log(np.maximum(noise, SILENT)), np.where(positive, logs, details)], axis=1), positive
