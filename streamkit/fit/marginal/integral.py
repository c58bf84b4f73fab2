"""The integral of a stream's likelihood over its own parameters, at many hosts, by importance sampling."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import gammaln

from streamkit.fit.marginal.stream_alone import StreamAlone
from streamkit.stream import Array, BoolArray, IntArray

# Inverse temperatures of the walks that place a part of the hosts.
TEMPERATURES, WALKED = (1.0, 0.25), 0.4
# More hosts, as a share of these, where all streams of the run agree: half of them are samples of its posterior, the
# others lie about them, this many times as far from their mean.
JOINT, WIDER = 0.3, 2.0
# The others are at distances up to this many standard deviations of the stream alone, in every direction.
FARTHEST = 7.0
# Hosts for each coefficient of a quadratic function, in all at least and at most.
HOSTS_PER_TERM, FEWEST_HOSTS, MOST_HOSTS = 30, 240, 900
# Degrees of freedom of the draws, and draws of each round of improvement.
HEAVY_TAILS, ROUNDS = 6.0, (150, 150, 200, 200)
# Draws for the integral are made by so many until there are so many effective ones, at most so many times, for so many
# hosts together, which bounds the memory.
BATCH, ENOUGH, MOST_BATCHES, GROUP = 400, 50.0, 10, 64
# Emulators that the noise of the calls could have given as well, and draws by which each is compared.
REDRAWN, COMPARED = 6, 60
# With so many effective draws, the mean and covariance of a host's own draws count as much as those of all hosts.
LEARNED = 40.0


class Marginal(NamedTuple):
    """The integral at n hosts.

    Attributes
    ----------
    hosts
        (n, d) coordinates.
    ln_likelihood, error
        (n,) ln of the integral, and its standard error: by the number of draws, and by the noise of the calls.
    effective
        (n,) effective number of draws.
    trusted
        (n,) part of the integral that lies among the calls.
    alone
        (m, d) the hosts of the stream alone, by the prior of its run.
    joint
        (n,) whether a host is a sample of the posterior of all streams.
    """

    hosts: Array
    ln_likelihood: Array
    error: Array
    effective: Array
    trusted: Array
    alone: Array
    joint: BoolArray


def integrate(stream: StreamAlone, points: Array, seed: int, joint: Array | None = None) -> Marginal:
    """Integrate the likelihood of a stream over its own parameters, at hosts about those that it allows.

    ``points`` (m, p) are parameters of calls, from which the walks begin. ``joint`` (k, d) are hosts of the posterior
    of all streams of a run, which may be far from those of this one: there the calls of the run are, and other fits
    need the function there. The same seed gives the same result.
    """
    begin = stream.to(points)
    walks = [stream.walk(begin, beta, [seed, 31, i]) for i, beta in enumerate(TEMPERATURES)]
    rng = np.random.default_rng([seed, 32])
    alone = walks[0][:, stream.shared]
    agreed = _agreed(stream, alone, joint, np.random.default_rng([seed, 33]))
    h = np.concatenate([agreed, _hosts(stream, walks, alone, rng)])
    of_joint = np.arange(len(h)) < (len(agreed) + 1) // 2
    if not len(stream.own):
        y = h[:, np.argsort(stream.shared)]
        value = stream.ln_likelihood(y, np.ones(len(y), dtype=bool))
        error = _noise(stream, y[:, None], np.zeros((len(y), 1)), rng)
        trusted = stream.likelihood.is_trusted(stream.back(y)).astype(float)
        return Marginal(h, value, error, np.full(len(y), np.inf), trusted, alone, of_joint)
    draws, quadratic = _first(walks, stream, h), quadratic_terms((h - h.mean(axis=0)) / h.std(axis=0))
    for size in ROUNDS:
        y, ln_w = draws.made(stream, h, size, rng)
        draws = draws.improved(quadratic, y[:, :, stream.own], ln_w)
    value, error, effective, trusted = (np.empty(len(h)) for _ in range(4))
    order = np.argsort(_effective(ln_w))  # hosts of one group need as many draws
    for rows in np.array_split(order, -(-len(h) // GROUP)):
        y, ln_w = draws.of(rows).enough(stream, h[rows], rng)
        y, ln_equal = _resampled(y, _normalised(ln_w), rng)
        value[rows] = np.logaddexp.reduce(ln_w, axis=1) - np.log(ln_w.shape[1])
        effective[rows] = _effective(ln_w)
        inside = stream.likelihood.is_trusted(stream.back(y.reshape(-1, y.shape[2])))
        trusted[rows] = inside.reshape(ln_equal.shape).mean(axis=1)
        of_draws = np.sqrt(np.maximum(1 / np.maximum(effective[rows], 1.0) - 1 / ln_w.shape[1], 0.0))
        error[rows] = np.hypot(of_draws, _noise(stream, y, ln_equal, rng))
    return Marginal(h, value, error, effective, trusted, alone, of_joint)


def quadratic_terms(x: Array) -> Array:
    """(n, m) Return the terms of a quadratic function at places x (n, d)."""
    d = x.shape[1]
    pairs = [x[:, i] * x[:, j] for i in range(d) for j in range(i, d)]
    return np.stack([np.ones(len(x)), *x.T, *pairs], axis=1)


def _number(d: int) -> int:
    """Return the number of hosts for d parameters."""
    return int(np.clip(HOSTS_PER_TERM * (1 + d + d * (d + 1) // 2), FEWEST_HOSTS, MOST_HOSTS))


def _agreed(stream: StreamAlone, alone: Array, joint: Array | None, rng: np.random.Generator) -> Array:
    """(k, d) Return hosts of the posterior of all streams and, after these, hosts about them; none without it."""
    if joint is None:
        return alone[:0]
    size = int(JOINT * _number(alone.shape[1]))
    samples, others = (joint[rng.choice(len(joint), many)] for many in (size, 20 * size))
    wider = joint.mean(axis=0) + WIDER * (others - joint.mean(axis=0))
    low, high = stream.ends()
    inside = ((low <= wider) & (wider <= high)).all(axis=1)
    return np.concatenate([samples[: size - size // 2], wider[inside][: size // 2]])


def _hosts(stream: StreamAlone, walks: list[Array], alone: Array, rng: np.random.Generator) -> Array:
    """(n, d) Return the hosts: some of the walks, and others about them, all inside the prior."""
    d = len(stream.shared)
    n = _number(d)
    size = int(WALKED * n) // len(walks)
    walked = [walk[rng.choice(len(walk), size, replace=False)][:, stream.shared] for walk in walks]
    centre, root = alone.mean(axis=0), np.linalg.cholesky(np.atleast_2d(np.cov(alone.T)) + 1e-12 * np.eye(d))
    direction = rng.standard_normal((20 * n, d))
    direction /= np.sqrt(np.sum(direction**2, axis=1))[:, None]
    about = centre + FARTHEST * rng.random((20 * n, 1)) * direction @ root.T
    low, high = stream.ends()
    inside = ((low <= about) & (about <= high)).all(axis=1)
    return np.concatenate([*walked, about[inside][: n - size * len(walks)]])


@dataclass(frozen=True)
class _Draws:
    """Multivariate Student-t distributions of the stream's own coordinates, one for each of n hosts.

    Attributes
    ----------
    middle, root
        (n, q) and (n, q, q): s = middle + root @ t.
    """

    middle: Array
    root: Array

    def made(self, stream: StreamAlone, h: Array, size: int, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw for each host; return coordinates (n, size, p) and ln of the weights (n, size)."""
        n, q = self.middle.shape
        normal = rng.standard_normal((n, size, q))
        scale = np.sqrt(HEAVY_TAILS / rng.chisquare(HEAVY_TAILS, (n, size)))
        t = normal * scale[:, :, None]
        y = np.empty((n, size, len(stream.shared) + q))
        y[:, :, stream.shared] = h[:, None]
        y[:, :, stream.own] = self.middle[:, None] + np.einsum("nij,nkj->nki", self.root, t)
        ln_det = np.log(np.abs(np.diagonal(self.root, axis1=1, axis2=2))).sum(axis=1)
        ln_t = (
            gammaln(0.5 * (HEAVY_TAILS + q)) - gammaln(0.5 * HEAVY_TAILS) - 0.5 * q * np.log(HEAVY_TAILS * np.pi)
            - ln_det[:, None] - 0.5 * (HEAVY_TAILS + q) * np.log1p(np.sum(t**2, axis=2) / HEAVY_TAILS)
        )  # fmt: skip
        flat = y.reshape(n * size, -1)
        prior = stream.ln_prior(flat, stream.own)
        target = np.where(np.isfinite(prior), prior, 0.0) + stream.ln_likelihood(flat, np.isfinite(prior))
        return y, target.reshape(n, size) - ln_t

    def enough(self, stream: StreamAlone, h: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw until most hosts have `ENOUGH` effective draws; return what `made` returns."""
        batches = [self.made(stream, h, BATCH, rng)]
        while len(batches) < MOST_BATCHES:
            ln_w = np.concatenate([each[1] for each in batches], axis=1)
            if np.quantile(_effective(ln_w), 0.1) >= ENOUGH:
                break
            batches.append(self.made(stream, h, BATCH, rng))
        y, ln_w = (np.concatenate(each, axis=1) for each in zip(*batches, strict=True))
        return y, ln_w

    def of(self, rows: IntArray) -> _Draws:
        """Return the distributions of some hosts."""
        return _Draws(self.middle[rows], self.root[rows])

    def improved(self, terms: Array, s: Array, ln_w: Array) -> _Draws:
        """Return distributions by the draws s (n, size, q) of each host and, where few of these count, of all hosts.

        All together give a mean that is a quadratic function of the host, by its ``terms`` (n, m), and one covariance.
        """
        weights, effective = _normalised(ln_w), _effective(ln_w)
        if not effective.any():
            return self
        own = np.einsum("nk,nkq->nq", weights, s)
        root = np.sqrt(effective)[:, None]
        coefficients, *_ = np.linalg.lstsq(terms * root, own * root, rcond=None)
        of_all = terms @ coefficients
        away = s - of_all[:, None]
        count = weights * (effective / effective.sum())[:, None]
        common = np.einsum("nk,nki,nkj->ij", count, away, away, optimize=True)
        share = (effective / (effective + LEARNED))[:, None]
        middle = share * own + (1 - share) * of_all
        away = s - middle[:, None]
        covariance = np.einsum("nk,nki,nkj->nij", weights, away, away)
        new = share[:, :, None] * covariance + (1 - share[:, :, None]) * common
        diagonal = np.arange(new.shape[1])
        new[:, diagonal, diagonal] *= 1 + 1e-9
        return _Draws(middle, np.linalg.cholesky(new))


def _normalised(ln_w: Array) -> Array:
    """(n, k) Return weights of the sum 1 for each host; equal ones for a host without a draw inside the prior."""
    total = np.logaddexp.reduce(ln_w, axis=1)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(np.isfinite(total)[:, None], np.exp(ln_w - total[:, None]), 1 / ln_w.shape[1]))


def _effective(ln_w: Array) -> Array:
    """(n,) Return effective numbers of draws; 0 for a host without a draw inside the prior."""
    number = 1 / np.sum(_normalised(ln_w) ** 2, axis=1)
    return np.asarray(np.where(np.isfinite(ln_w).any(axis=1), number, 0.0))


def _first(walks: list[Array], stream: StreamAlone, h: Array) -> _Draws:
    """Return the linear conditional Gaussian of the stream's own coordinates at hosts (n, d)."""
    samples = np.concatenate(walks[:2])
    hosts, own = samples[:, stream.shared], samples[:, stream.own]
    middle = hosts.mean(axis=0)
    slope, *_ = np.linalg.lstsq(hosts - middle, own - own.mean(axis=0), rcond=None)
    left = own - own.mean(axis=0) - (hosts - middle) @ slope
    covariance = np.atleast_2d(np.cov(left.T))
    covariance[np.diag_indices_from(covariance)] *= 1 + 1e-9
    root = np.linalg.cholesky(covariance)
    return _Draws(own.mean(axis=0) + (h - middle) @ slope, np.repeat(root[None], len(h), axis=0))


def _resampled(y: Array, weights: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return draws (n, k, p) with equal weights, and ln of these (n, k)."""
    n = len(y)
    edges = np.cumsum(weights, axis=1)
    u = (np.arange(COMPARED) + rng.random((n, 1))) / COMPARED
    rows = np.array([np.searchsorted(edge / edge[-1], each) for edge, each in zip(edges, u, strict=True)])
    rows = np.minimum(rows, weights.shape[1] - 1)
    return np.take_along_axis(y, rows[:, :, None], axis=1), np.full((n, COMPARED), -np.log(COMPARED))


def _noise(stream: StreamAlone, y: Array, ln_weights: Array, rng: np.random.Generator) -> Array:
    """(n,) Return the standard deviation that the noise of the calls leaves of ln of the integral over draws y."""
    flat, shape = y.reshape(-1, y.shape[2]), y.shape[:2]
    whole = np.ones(len(flat), dtype=bool)
    here = stream.ln_likelihood(flat, whole)
    others = [stream.ln_likelihood(flat, whole, stream.likelihood.redrawn(rng)) - here for _ in range(REDRAWN)]
    changes = np.array([np.logaddexp.reduce(each.reshape(shape) + ln_weights, axis=1) for each in others])
    return np.asarray(np.sqrt(np.mean((changes - changes.mean(axis=0)) ** 2, axis=0) * REDRAWN / (REDRAWN - 1)))
