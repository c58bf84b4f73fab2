"""What calls have given becomes an emulator: weights, whitening, the choice of the polynomial, its own error."""

from __future__ import annotations

import numpy as np
from scipy.linalg import LinAlgError
from scipy.special import expit

from streamkit import Array, BoolArray
from streamkit.builtin.samplers.emulator.emulator import Emulator
from streamkit.builtin.samplers.emulator.kernel import Kernel, learn_kernel
from streamkit.builtin.samplers.emulator.pairs import ENOUGH as ENOUGH_PAIRS
from streamkit.builtin.samplers.emulator.pairs import pairs_of
from streamkit.builtin.samplers.emulator.polynomial import Low, Polynomial, Regression, regress
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
# Effective points that the weights leave at least, for each term of a quadratic.
ENOUGH = 2.0
# Points at least, and for each parameter, on which errors are measured if fewer are close.
LEAST_CLOSE, CLOSE = 40, 3
# Points that count less than this are not used for the lengths of a Gaussian process.
LEAST_WEIGHT = 0.02
# The fit is trusted to |x|^2 of the farthest near point times this.
REACH = 1.5
# Largest squared residual that counts in an error, in units of the typical one.
WILD = 25.0
# The best points by ln likelihood, which is noisy: the best one is this one from the top, a fraction.
BEST = 0.01
# Ridge penalty of the fit of the probability that there is a prediction; its steps, halvings of a step, and least gain.
EXISTS_RIDGE, ITERATIONS, HALVINGS, SETTLED = 1e-3, 40, 20, 1e-6
# A Gaussian process is tried where the error of the best polynomial exceeds the noise by this factor, and this many
# squared errors for each datum.
WORTH, EXACT = 1.15, 1e-3
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
    if close.sum() < y.shape[1] or np.median(np.abs(smooth - lnl)[close]) > 0.3 * NEAR:
        return emulator
    return _fitted(problem, y, answers, smooth)


def learn_predictions(problem: Problem, y: Array, answers: Answers) -> Emulator | None:
    """Fit an emulator for its predictions alone, without calling the likelihood; None where there are too few."""
    if not np.isfinite(answers.ln_likelihood).any():
        return None
    return _fitted(problem, y, answers, answers.ln_likelihood)


def _best(lnl: Array) -> float:
    return float(np.sort(lnl)[-max(int(BEST * len(lnl)), 1)])


def _fitted(problem: Problem, y: Array, answers: Answers, lnl: Array) -> Emulator | None:
    """Fit with weights by this ln likelihood (n,)."""
    used = np.isfinite(problem.values)
    there: BoolArray = np.asarray(np.isfinite(answers.ln_likelihood), dtype=bool)
    z = y[:, problem.coordinates]
    placed, d = z[there], z.shape[1]
    weight = weights(lnl[there], y.shape[1], ENOUGH * count(d, 2))
    close = nearest(lnl[there], y.shape[1])
    effective = weight.sum() ** 2 / np.sum(weight**2)
    centre, whiten = whitening(placed, weight)
    x = (placed - centre) @ whiten
    errors = problem.errors[used]
    target = (answers.mean[there][:, used] - problem.values[used]) / errors
    noise = answers.variance[there][:, used] / errors**2
    pairs = pairs_of(x)
    degrees = [k for k in DEGREES if POINTS_PER_TERM * count(d, k) <= effective and count(d, k) <= MOST_TERMS]
    fits: list[tuple[float, Polynomial | Kernel, Regression]] = []
    best = (np.inf, 1)  # what the best polynomial leaves over, and its degree
    for degree in degrees:
        if degree > best[1] + IN_VAIN:
            break
        terms = monomials(x, degree)
        for ridge in RIDGES:
            try:
                fit = regress(terms, target, weight, ridge)
            except LinAlgError:  # walkers that hardly moved
                continue
            left = float(np.sum(error_of(fit.out_without(pairs)[close] ** 2)))
            best = min(best, (left, degree))
            fits.append((left, Polynomial(degree), fit))
    if not fits:
        return None
    noisy = float(noise[close].mean(axis=0).sum())
    if min(fits, key=_first)[0] > WORTH * noisy + EXACT * len(errors):
        try:
            counted = weight >= LEAST_WEIGHT
            kernel = learn_kernel(x[counted], target[counted], weight[counted], np.random.default_rng(len(x)))
            fit = regress(kernel.terms(x), target, weight, kernel.penalty)
            fits.append((float(np.sum(error_of(fit.out_without(pairs)[close] ** 2))), kernel, fit))
        except LinAlgError:
            pass
    _, basis, fit = min(fits, key=_first)
    degree = basis.degree if isinstance(basis, Polynomial) else 1
    spread2 = error_of((fit.left * fit.out_without(pairs))[close])
    pairs = pairs[close[pairs].all(axis=1) & (x[pairs[:, 0]] != x[pairs[:, 1]]).any(axis=1)]  # one call has one noise
    more2 = unstated(target[pairs], noise[pairs])
    typical = noise[close].mean(axis=0) + more2
    uncertain = 2 / close.sum() + np.where(more2 > 0, 2 / max(len(pairs), 1), 0.0)
    lack2 = np.maximum(spread2 - typical * (1 + CHANCE * np.sqrt(uncertain)), 0.0)
    low = min(max(degrees), 2)
    others, positive = _forms(noise, answers.details[there])
    rest = regress(monomials(x, low), others, weight, RIDGES[-2])
    r2 = np.sum(x**2, axis=1)
    exists = log_odds(monomials((z - centre) @ whiten, low), there.astype(float), EXISTS_RIDGE)
    return Emulator(
        problem=problem,
        centre=centre,
        whiten=whiten,
        basis=basis,
        growth=degree + 1,
        mean=Low.of(fit.coefficients),
        root=fit.root,
        spread2=spread2,
        lack2=lack2,
        typical2=lack2 + spread2 * float(np.mean(fit.leverage[close])),
        more2=more2,
        stated2=typical - more2,
        pairs=len(pairs) if len(pairs) >= ENOUGH_PAIRS else 0,
        low=low,
        rest=Low.of(rest.coefficients),
        positive=positive,
        ends=(others.min(axis=0), others.max(axis=0)),
        typical_r2=float(_quantile(r2, weight, 0.7)),
        trusted_r2=float(REACH * r2[close].max()),
        exists=exists,
    )


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
    top = WILD * np.maximum(np.median(np.abs(squares), axis=0) / 0.455, 1e-300)
    return np.asarray(np.clip(squares, -top, top).mean(axis=0))


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


def _quantile(values: Array, weight: Array, part: float) -> float:
    order = np.argsort(values)
    steps = np.cumsum(weight[order])
    return float(values[order[np.searchsorted(steps, part * steps[-1])]])
