"""A Gaussian process as a basis: what a polynomial leaves over varies smoothly, on a length of its own per coordinate.

The kernel is the squared exponential with a length for each coordinate, beside a linear function, the same for all
data in units of their errors (Rasmussen & Williams 2006, chapters 2 and 5). It is represented by some of the points
(their section 8.3.4, with the missing variance added as in 8.3.6), so that all points count. It is learned with terms
of equal prior variance, and predicts by features, the kernel itself, with matrices that are made once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, eigh, solve_triangular
from scipy.optimize import minimize

from streamkit import Array, IntArray
from streamkit.builtin.samplers.emulator.learn.polynomial import Leverage, LowRank, Slopes

# Points that represent the process, those that its lengths are learned from, and steps of learning.
INDUCING, LEARNED_FROM, STEPS = 600, 400, 25
# Lengths in half standard deviations of the points that are expected before any are learned, and how surely in ln.
EXPECTED, SURE = 4.0, 1.5
# Logarithms of amplitudes, in variances of the targets, that learning begins from, each with a draw of points of its
# own, and the largest one. The marginal likelihood has a maximum of long lengths with an amplitude of hundreds, and one
# of short lengths and noise. Which is higher, and how long a length is, depends on the draw.
BEGINS, LARGEST = (5.0, 5.0, 0.0), 10.0
# What is added to the diagonal of the kernel, so that it can be inverted.
JITTER = 1e-7
# Variance that need not be represented: as a fraction of the noise, and in any case as one of the process itself.
UNSEEN, LEAST_UNSEEN = 0.003, 1e-7
# Directions of which the points know less than this, in units of what is expected of them, count as unknown.
UNKNOWN = 0.2


@dataclass(frozen=True, eq=False)
class Kernel:
    """The terms of a Gaussian process, and the ridge penalties that make a regression on them one.

    Attributes
    ----------
    places
        (q, c) points that represent it.
    lengths
        (c,) of the squared exponential.
    amplitude, noise
        Variances of the process and of a point about it, squared errors of the data.
    inverse
        (q, k) makes terms of equal prior variance of the kernel at the places: its principal components there.
    """

    places: Array
    lengths: Array
    amplitude: float
    noise: float
    inverse: Array

    def features(self, x: Array) -> Array:
        """(n, 1 + c + q) One, x (n, c), and the kernel between x and the places."""
        near = squared_exponential(x, self.places, self.lengths)
        return np.concatenate([np.ones((len(x), 1)), x, near], axis=1)

    def of_features(self, coefficients: Array) -> Array:
        """(1 + c + q, m) Return what gives with features what coefficients (1 + c + k, m) give with terms."""
        line = 1 + len(self.lengths)
        return np.concatenate([coefficients[:line], self.inverse @ coefficients[line:]])

    def leverage(self, root: Array) -> Leverage:
        """Return the leverage of a fit with this root, see `Regression`, by features.

        What the process has beyond the terms is unknown as well. With the precision N + p of the coefficients of the
        terms t, p their penalty, the leverage of the process is t' (N + p)^-1 t and the unknown rest (1 - t' t) / p:
        together the prior variance 1 / p but for the directions of which N tells something. Those that N tells little
        of are left out.
        """
        line, penalty = 1 + len(self.lengths), self.noise / self.amplitude
        lower = solve_triangular(root, np.eye(len(root)))
        precision = lower.T @ lower
        process = precision[line:, line:]
        known, vectors = eigh(process)
        seen = np.maximum(known - penalty, 0.0)
        kept = seen > UNKNOWN * penalty
        seen_by = vectors[:, kept] * np.sqrt(seen[kept] / known[kept] / penalty)
        head = np.linalg.cholesky(root[:line] @ root[:line].T)
        follow = -np.linalg.solve(process, precision[line:, :line]) @ head
        return Leverage(
            self.of_features(np.concatenate([head, follow])),
            1 / penalty,
            self.of_features(np.concatenate([np.zeros((line, seen_by.shape[1])), seen_by])),
        )

    @property
    def penalty(self) -> Array:
        """(terms,) Ridge penalties: none for the linear part, noise over amplitude for the process."""
        linear = np.full(1 + len(self.lengths), 1e-9)
        return np.concatenate([linear, np.full(self.inverse.shape[1], self.noise / self.amplitude)])

    def terms(self, x: Array) -> Array:
        """(n, 1 + c + k) The terms at x (n, c)."""
        line, features = 1 + len(self.lengths), self.features(x)
        return np.concatenate([features[:, :line], features[:, line:] @ self.inverse], axis=1)

    def along(self, coefficients: LowRank) -> Slopes:
        """Return processes with coefficients (features, m), and their slopes, as a function of x."""
        c, lengths, places = len(self.lengths), self.lengths, self.places
        whole = coefficients.whole
        line, weights = whole[: 1 + c], whole[1 + c :]
        weighed = np.concatenate([places[:, i, None] * weights for i in range(c)], axis=1)  # (q, c m)

        def slopes(x: Array) -> tuple[Array, Array]:
            near = squared_exponential(x, places, lengths)
            process = near @ weights
            toward = (near @ weighed).reshape(len(x), c, -1) - x[:, :, None] * process[:, None]
            values = line[0] + x @ line[1:] + process
            return values, line[1:] + toward / lengths[:, None] ** 2

        return slopes


def squared_exponential(a: Array, b: Array, lengths: Array) -> Array:
    """(n, q) exp(-r^2 / 2) between points a (n, c) and b (q, c), r in units of the lengths."""
    a, b = a / lengths, b / lengths
    # the squares as two more coordinates: an array of this size costs as much as its exponentials
    a = np.column_stack([a, -0.5 * np.sum(a**2, axis=1), np.ones(len(a))])
    b = np.column_stack([b, np.ones(len(b)), -0.5 * np.sum(b**2, axis=1)])
    near = a @ b.T
    return np.exp(near, out=near)


def learn_kernel(
    x: Array, target: Array, weight: Array, rng: np.random.Generator, least_noise: float = 0.0, begin: float = BEGINS[0]
) -> Kernel:
    """Learn lengths, amplitude and noise from targets (n, m), in errors of the data, at x (n, c) with weights (n,).

    They maximise the marginal likelihood of the residuals of a linear fit at some of the points; ``begin`` is the
    logarithm of the first amplitude that is tried. Where points are few, the marginal likelihood may have a maximum
    without noise, at short lengths: ``least_noise``, in squared errors, is the least noise that there surely is.
    """
    c = x.shape[1]
    chosen = _some(weight, LEARNED_FROM, rng)
    some, scale = x[chosen], 1 / np.maximum(weight[chosen], 1e-3)
    line = np.concatenate([np.ones((len(some), 1)), some], axis=1)
    root = np.sqrt(weight[chosen])[:, None]
    left = target[chosen] - line @ np.linalg.lstsq(line * root, target[chosen] * root, rcond=None)[0]
    typical = max(float(np.average(np.mean(left**2, axis=1), weights=weight[chosen])), 1e-12)
    left = left / np.sqrt(typical)

    def cost(p: Array) -> tuple[float, Array]:
        """Minus ln marginal likelihood for each datum, with a broad prior on the lengths, and its gradient."""
        lengths, amplitude, noise = np.exp(p[:c]), np.exp(p[c]), np.exp(p[c + 1])
        process = amplitude * squared_exponential(some, some, lengths)
        total = process.copy()
        total[np.diag_indices_from(total)] += noise * scale + JITTER * amplitude
        lower = cholesky(total, lower=True)
        half = solve_triangular(lower, np.eye(len(lower)), lower=True)
        inverse = half.T @ half
        alpha = inverse @ left
        away = (p[:c] - np.log(EXPECTED)) / SURE
        value = 0.5 * np.sum(left * alpha) / left.shape[1] + np.log(np.diag(lower)).sum() + 0.5 * np.sum(away**2)
        slope = 0.5 * (inverse - alpha @ alpha.T / left.shape[1])
        shared = slope * process
        sums, z = shared.sum(axis=1), some / lengths
        by_length = 2 * (sums @ z**2 - np.sum(z * (shared @ z), axis=0)) + away / SURE
        by_noise = noise * np.sum(np.diag(slope) * scale)
        return float(value), np.concatenate([by_length, [shared.sum(), by_noise]])

    least = float(np.log(np.clip(least_noise / typical, 1e-7, 6.0)))
    bounds = [(np.log(0.3), np.log(100.0))] * c + [(-7.0, LARGEST), (least, 2.0)]
    first = [np.log(EXPECTED)] * c + [begin, max(np.log(0.1), least)]
    p = minimize(cost, first, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": STEPS}).x
    lengths, amplitude, noise = np.exp(p[:c]), typical * float(np.exp(p[c])), typical * float(np.exp(p[c + 1]))
    places = x[_spread(x / lengths, weight, INDUCING)]
    return Kernel(places, lengths, amplitude, noise, _principal(places, lengths, UNSEEN * noise / amplitude))


def _principal(places: Array, lengths: Array, unseen: float) -> Array:
    """(q, k) Return the principal components of the kernel at places (q, c), but for this fraction of its variance."""
    variances, vectors = eigh(squared_exponential(places, places, lengths))
    rest = np.cumsum(variances) / len(places)  # from the smallest on; each point has a variance of one
    first = int(np.searchsorted(rest, max(unseen, LEAST_UNSEEN)))
    return np.asarray(vectors[:, first:] / np.sqrt(variances[first:]))


def _spread(x: Array, weight: Array, most: int) -> IntArray:
    """(k,) Indices of so many points x (n, c) at most, in units of the lengths, that represent the process best.

    One after another, each is where those before leave most variance times weight (pivoted Cholesky: Fine & Scheinberg
    2001). Points drawn at random leave thin ends of a posterior without any.
    """
    left, rows, chosen = np.ones(len(x)), np.empty((min(most, len(x)), len(x))), []
    for i in range(len(rows)):
        new = int(np.argmax(left * weight))
        if left[new] < LEAST_UNSEEN:
            break
        near = np.exp(-0.5 * np.sum((x - x[new]) ** 2, axis=1))
        rows[i] = (near - rows[:i, new] @ rows[:i]) / np.sqrt(left[new])
        left = np.maximum(left - rows[i] ** 2, 0.0)
        chosen.append(new)
    return np.array(chosen)


def _some(weight: Array, most: int, rng: np.random.Generator) -> IntArray:
    """(k,) Indices of all points, or of so many drawn by their weights (n,)."""
    n = len(weight)
    return np.arange(n) if n <= most else rng.choice(n, most, replace=False, p=weight / weight.sum())
