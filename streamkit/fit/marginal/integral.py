"""The integral of a stream's likelihood over its own parameters, at many hosts, by importance sampling."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import gammaln

from streamkit.fit.marginal.stream_alone import StreamAlone
from streamkit.stream import Array, BoolArray

# Inverse temperatures of the walks that place a part of the hosts.
TEMPERATURES, WALKED = (1.0, 0.25), 0.4
# More hosts, as a share of these, where all streams of the run agree: half of them are samples of its posterior, the
# others lie about them, this many times as far from their mean.
JOINT, WIDER = 0.3, 2.0
# The others are at distances up to this many standard deviations of the stream alone, in every direction.
FARTHEST = 7.0
# Hosts for each coefficient of a quadratic function, in all at least and at most.
HOSTS_PER_TERM, FEWEST_HOSTS, MOST_HOSTS = 30, 240, 900
# Degrees of freedom of the draws; draws of each round of improvement, and of the last one.
HEAVY_TAILS, ROUNDS, LAST = 6.0, (150, 200), 400
# Emulators that the noise of the calls could have given as well, and draws by which each is compared.
REDRAWN, COMPARED = 6, 60
# Share of a weighted covariance in an improved one: few effective draws say little.
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
    draws = _first(walks, stream, h)
    for size in ROUNDS:
        y, weights, _ = draws.made(stream, h, size, rng)
        draws = draws.improved(y[:, :, stream.own], weights)
    y, weights, ln_mean = draws.made(stream, h, LAST, rng)
    effective = 1 / np.sum(weights**2, axis=1)
    trusted = stream.likelihood.is_trusted(stream.back(y.reshape(-1, y.shape[2]))).reshape(weights.shape)
    noise = _noise(stream, *_resampled(y, weights, rng), rng)
    return Marginal(
        h, ln_mean, np.hypot(np.sqrt(np.maximum(1 / effective - 1 / LAST, 0.0)), noise), effective,
        np.sum(weights * trusted, axis=1), alone, of_joint,
    )  # fmt: skip


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

    def made(self, stream: StreamAlone, h: Array, size: int, rng: np.random.Generator) -> tuple[Array, Array, Array]:
        """Draw for each host; return coordinates (n, size, p), normalised weights (n, size), ln of their mean (n,)."""
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
        ln_w = target.reshape(n, size) - ln_t
        total = np.logaddexp.reduce(ln_w, axis=1)
        with np.errstate(invalid="ignore"):  # a host without a single draw inside the prior
            weights = np.where(np.isfinite(total)[:, None], np.exp(ln_w - total[:, None]), 1 / size)
        return y, weights, total - np.log(size)

    def improved(self, s: Array, weights: Array) -> _Draws:
        """Return distributions with the weighted means and covariances of the draws s (n, size, q)."""
        middle = np.einsum("nk,nkq->nq", weights, s)
        away = s - middle[:, None]
        covariance = np.einsum("nk,nki,nkj->nij", weights, away, away)
        share = (1 / np.sum(weights**2, axis=1))[:, None, None]
        share = share / (share + LEARNED)
        old = np.einsum("nij,nkj->nik", self.root, self.root)
        new = share * covariance + (1 - share) * old
        diagonal = np.arange(new.shape[1])
        new[:, diagonal, diagonal] *= 1 + 1e-9
        return _Draws(middle, np.linalg.cholesky(new))


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
