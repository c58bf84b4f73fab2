"""An emulator from calls: the choice of a polynomial or a Gaussian process, and the fits that belong to it."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
from scipy.linalg import LinAlgError
from scipy.special import expit

from streamkit import Array, BoolArray
from streamkit.builtin.samplers.emulator.learn.emulator import Emulator
from streamkit.builtin.samplers.emulator.learn.errors import Errors, error_of
from streamkit.builtin.samplers.emulator.learn.kernel import BEGINS, LEARNED_FROM, Kernel, learn_kernel
from streamkit.builtin.samplers.emulator.learn.points import NEAR, Points, best_of
from streamkit.builtin.samplers.emulator.learn.polynomial import LowRank, Polynomial, Regression, regress
from streamkit.builtin.samplers.emulator.learn.problem import Answers, Problem
from streamkit.builtin.samplers.monomials import count, monomials

# Polynomials that are tried: degrees, most terms, effective points for each term, and ridge penalties in units of the
# mean diagonal of the normal equations. Penalties of terms above the first degree are also tried larger by one of
# these factors for each degree more: the higher terms of a smooth function are small, and noise is not.
DEGREES, MOST_TERMS, POINTS_PER_TERM = (1, 2, 3, 4, 5, 6, 7, 8), 1000, 1.6
RIDGES = (1e-8, 1e-6, 1e-4, 1e-2)
STEEPER = (10.0, 100.0, 1000.0)
# A fit of more terms is taken where its leave-one-out error is below this fraction of that of a simpler one. Else a
# degree that is better by chance makes each walk several times as long.
SIMPLER = 0.98
# Degrees above the best one that are tried in vain before no higher one is: two, as a function may be even or odd.
IN_VAIN = 2
# Part of `NEAR` by which ln likelihoods of a fit and of its calls may differ, beside some typical changes by noise: in
# the median, and where noise has brought a call near the data.
UNLIKE, LUCKY = 0.3, 4.0
# Points that count less than this are not used for the lengths of a Gaussian process.
LEAST_WEIGHT = 0.02
# The fit is trusted to |x|^2 of the farthest near point times this.
REACH = 1.5
# Standard deviation of a combination of predictions near the data, in its errors, from which walkers follow it.
FOLLOWED = 0.05
# Ridge penalty of the fit of the probability that there is a prediction; its steps, halvings of a step, and least gain.
EXISTS_RIDGE, ITERATIONS, HALVINGS, SETTLED = 1e-3, 40, 20, 1e-6
# A Gaussian process is tried where the error of the best polynomial exceeds the noise by this factor, and this many
# squared errors for each datum.
WORTH, EXACT = 1.15, 1e-3
# Fraction of the stated noise that there is surely.
SURELY = 0.5
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
    best = best_of(lnl[there])
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


def _fitted(problem: Problem, y: Array, answers: Answers, lnl: Array) -> Emulator | None:
    """Fit with weights by this ln likelihood (n,); None where the points do not span the terms."""
    there: BoolArray = np.asarray(np.isfinite(answers.ln_likelihood), dtype=bool)
    points = Points.of(problem, y[there], answers.take(there), lnl[there])
    found = _best_regression(points)
    if found is None:
        return None
    basis, fit = found
    errors = Errors.of(points, basis, fit)
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
        leverage=errors.leverage,
        chance=basis.of_features(fit.by_noise(basis.terms(points.x), points.weight)),
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


def _directions(points: Points, fit: Regression, error: Array) -> Array:
    """(m, k) Return the combinations of data, in their errors (m,), along which a fit changes near the data."""
    near = (points.target - fit.left)[points.close] / error
    near -= near.mean(axis=0)
    _, sizes, along = np.linalg.svd(near, full_matrices=False)
    kept = max(int(np.sum(sizes > FOLLOWED * np.sqrt(len(near)))), 1)
    return np.asarray(along[:kept].T / error[:, None])


def _highest_degree(points: Points) -> int:
    """Return the highest degree of a polynomial that there are points for; 0 if there is none."""
    effective, d = points.weight.sum() ** 2 / np.sum(points.weight**2), points.x.shape[1]
    enough = [k for k in DEGREES if POINTS_PER_TERM * count(d, k) <= effective and count(d, k) <= MOST_TERMS]
    return max(enough, default=0)


def _best_regression(points: Points) -> tuple[Polynomial | Kernel, Regression] | None:
    """Return the polynomial, or the Gaussian process, whose fits without a point predict that point best."""
    best: tuple[float, Polynomial | Kernel, Regression] | None = None
    lowest = (np.inf, 1)  # the lowest leave-one-out error of a polynomial, and its degree
    for degree in (k for k in DEGREES if k <= _highest_degree(points)):
        if degree > lowest[1] + IN_VAIN:
            break
        if (found := _best_ridge(points, degree)) is None:
            continue
        lowest = min(lowest, (found[0], degree))
        if best is None or found[0] < SIMPLER * best[0]:
            best = found[0], Polynomial(degree), found[1]
    if best is None:
        return None
    noisy, m = float(points.typical_noise.sum()), points.target.shape[1]
    if lowest[0] > WORTH * noisy + EXACT * m and (kernel := _best_kernel(points, SURELY * noisy / m)) is not None:
        best = kernel if kernel[0] < SIMPLER * best[0] else best
    return best[1:]


def _best_ridge(points: Points, degree: int) -> tuple[float, Regression] | None:
    """Return the lowest leave-one-out error of a polynomial of a degree, and its fit; None if points do not span it.

    The best ridge is made steeper as long as that helps.
    """
    terms, d = monomials(points.x, degree), points.x.shape[1]
    scale = float(np.mean(points.weight @ terms**2))
    of_degree = np.diff([0, *(count(d, k) for k in range(degree + 1))])
    above_first = np.repeat(np.maximum(np.arange(degree + 1) - 1, 0), of_degree)
    fits: list[tuple[float, float, Regression]] = []

    def add(ridge: float, steeper: float = 1.0) -> float:
        penalty = scale * ridge * steeper**above_first
        penalty[0] = 1e-12 * scale * ridge
        with suppress(LinAlgError):  # walkers that hardly moved
            fit = regress(terms, points.target, points.weight, penalty)
            fits.append((_left_over(points, fit), ridge, fit))
            return fits[-1][0]
        return np.inf

    for ridge in RIDGES:
        add(ridge)
    if not fits:
        return None
    least, ridge, _ = min(fits, key=_first)
    for steeper in STEEPER if degree > 1 else ():
        if (left := add(ridge, steeper)) >= least:
            break
        least = left
    left, _, fit = min(fits, key=_first)
    return left, fit


def _best_kernel(points: Points, noise: float) -> tuple[float, Kernel, Regression] | None:
    """Return the lowest leave-one-out error of a Gaussian process with at least this noise, the process and its fit."""
    counted, rng = points.weight >= LEAST_WEIGHT, np.random.default_rng(len(points.x))
    x, target, weight = points.x[counted], points.target[counted], points.weight[counted]
    best: tuple[float, Kernel, Regression] | None = None
    for begin in BEGINS if len(x) > LEARNED_FROM else dict.fromkeys(BEGINS):  # all points are one draw
        try:
            kernel = learn_kernel(x, target, weight, rng, noise, begin)
            fit = regress(kernel.terms(points.x), points.target, points.weight, kernel.penalty)
        except LinAlgError:
            break
        if (left := _left_over(points, fit)) < (best[0] if best else np.inf):
            best = left, kernel, fit
    return best


def _first(fit: tuple[float, float, Regression]) -> float:
    return fit[0]


def _left_over(points: Points, fit: Regression) -> float:
    """Return the sum over the data of the mean square that fits without a point, or its pair, leave over there."""
    return float(np.sum(error_of(fit.out_without(points.pairs)[points.close] ** 2)))


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
