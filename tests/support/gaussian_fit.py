"""A Gaussian posterior of a run file with streams by regressions: minutes in place of the sampler's hour.

Predictions are linear in the normal quantiles of all priors, by a regression for each stream on the draws that are the
nearest ones to the last Gaussian. What the lines leave beyond the noise of the particles is part of the error of each
datum. The slopes' own noise would be information: its mean is taken away. The extra errors of tracks have probabilities
of their own beside the Gaussian (variational Bayes, mean field). The Gaussian follows from data and priors. It is made
again with more draws until it stays. No other mode is found.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri
from scipy.stats import chi2 as chi2_law
from scipy.stats import qmc

import streamkit as sk
from streamkit.builtin.observables.track.extra_error import ExtraError, squares_of
from streamkit.model import Host
from streamkit.stream import Array

DRAWS, MORE = 64, 12  # draws at first, and of each later round
FEWEST = 6  # times the coefficients of a regression: the fewest draws it takes, of half of all
ROUNDS, LEAST = 40, 20  # the most and the fewest regressions
SETTLED = 0.3  # the largest move, in standard deviations, of a Gaussian that stays
WIDER = 2.0  # factor on the standard deviations of the last Gaussian, within which its lines are trusted
EXTRA = "_extra_error"
LEAST_EXTRA, SIZES = 1e-6, 16  # the quantile of extra errors in the draws, and how many of each are tried
TOLD = 0.1  # the least information of a stream in one direction, in units of that of all others, that pulls
LEVELS = 0.025, 0.16, 0.5, 0.84, 0.975
WIDE, FIRST = 0.3, 0.05  # standard deviations of the first draws, in normal quantiles: of others and known numbers


class GaussianFit:
    """The mean (d,) and covariance (d, d) of normal quantiles z of the priors: of the posterior, and of the draws."""

    def __init__(self, model: sk.Model, start: Mapping[str, float], seed: int) -> None:
        """Begin at the quantiles `start` of known numbers of progenitors, and in the middle of all other priors."""
        self.model, self.spec = model, model.spec
        self.names = list(model.spec.names)
        self.extra = [i for i, name in enumerate(self.names) if name.endswith(EXTRA)]
        fitted = [i for i in range(len(self.names)) if i not in self.extra]
        self.shared = [i for i in fitted if not self.names[i].startswith("stream.")]
        self.mean = np.array([ndtri(start.get(name, 0.5)) for name in self.names])
        self.mean[self.extra] = ndtri(LEAST_EXTRA)
        measured = model.measured(model.spec.bind_all(self.theta(self.mean)))  # without extra errors, all but
        self.measured = {one.stream: one for one in measured}
        self.own = {
            stream: [i for i in fitted if self.names[i].startswith(f"stream.{stream}.")] for stream in self.measured
        }
        self.covariance = np.diag([(FIRST if name in start else WIDE) ** 2 for name in self.names])
        self.points = qmc.Sobol(len(self.names), seed=seed)
        self.made: dict[str, list[tuple[Array, ...]]] = {name: [] for name in self.measured}
        self.found = self.mean, self.covariance
        self.factors: dict[str, tuple[Array, Array]] = {}
        self.calls = 0

    def theta(self, z: Array) -> Array:
        """(d,) Return the parameters at quantiles."""
        u = ndtr(z)
        return np.array([prior.ppf(u[i : i + 1])[0] for i, prior in enumerate(self.spec.priors)])

    def draw(self, n: int) -> None:
        """Make the streams of n draws: z (d,), and by datum the prediction, its variance and that of the datum."""
        root = np.linalg.cholesky(self.covariance)
        u = np.clip(self.points.random(n), 1e-6, 1 - 1e-6)
        away = ndtri(u) @ root.T
        away[:, self.extra] = 0.0
        for z in self.mean + away:
            bound = self.spec.bind_all(self.theta(z))
            host = Host(bound.potentials, bound.bodies, numbers=bound.numbers)
            for name, one in self.measured.items():
                self.calls += 1
                try:
                    prediction = self.model.observe(bound.streams[name], host)[1]
                except sk.OutOfDomain:
                    continue
                if prediction is not None and not prediction.why_not and np.isfinite(prediction.mean).all():
                    error = np.asarray(one.measurement.scatter(prediction))
                    self.made[name].append((z, prediction.mean, prediction.variance, error**2))

    def nearest(self, name: str) -> list[Array]:
        """Return the draws of a stream that are the nearest in the metric of the Gaussian, as `draw` has them."""
        which = self.shared + self.own[name]
        if len(self.made[name]) < len(which) + 8:
            raise SystemExit(f"{name}: too few draws have a stream")
        z, *rest = map(np.array, zip(*self.made[name], strict=True))
        away = (z - self.mean)[:, which]
        metric = np.linalg.inv(self.covariance[np.ix_(which, which)])
        near = np.argsort(np.einsum("ni,ij,nj->n", away, metric, away))[: max(FEWEST * (len(which) + 1), len(z) // 2)]
        return [away[near], *(each[near] for each in rest)]

    def renew(self) -> tuple[float, float]:
        """Renew the Gaussian by the draws; return how far it moved in standard deviations, and chi^2 of a datum.

        The Gaussian of before, `WIDER`, is a prior of the one of the next draws, near which lines hold, not of `found`.
        """
        d = len(self.names)
        information, pull, chi2, count = np.eye(d), np.zeros(d), 0.0, 0
        for name, one in self.measured.items():
            which, data = self.shared + self.own[name], one.data.values
            away, means, noises, variances = self.nearest(name)
            x = np.column_stack([np.ones(len(away)), away])
            inverse = np.linalg.inv(x.T @ x)
            slopes = inverse @ x.T @ means
            spread = ((means - x @ slopes) ** 2).sum(axis=0) / (len(x) - x.shape[1])
            unfit = np.maximum(spread - np.median(noises, axis=0), 0)  # the particles' noise is averaged by the lines
            s2 = np.median(variances, axis=0) + unfit
            used = np.isfinite(data)
            j, residual = slopes[1:, used].T, (data - slopes[0])[used]
            known = j @ self.found[1][np.ix_(which, which)] @ j.T
            precision = self.precision(name, s2, np.outer(residual, residual) + known, used)
            here = j.T @ precision @ j - (spread[used] * np.diag(precision)).sum() * inverse[1:, 1:]
            value, vector = np.linalg.eigh(here)
            factor = (vector * np.maximum(value, 0)) @ vector.T, j.T @ precision @ residual
            information[np.ix_(which, which)] += factor[0]
            pull[which] += factor[1]
            self.factors[name] = self.of_host(name, *factor)
            chi2, count = chi2 + residual @ precision @ residual, count + used.sum()
        pull -= self.mean  # of the prior, a normal of mean 0 and variance 1
        pull[self.extra] = 0.0  # they stay where they do not count: `precision` has them
        self.factors[""] = np.eye(len(self.shared)), -self.mean[self.shared]
        covariance = np.linalg.inv(information)
        self.found = self.mean + covariance @ pull, covariance
        self.covariance = np.linalg.inv(information + np.linalg.inv(WIDER**2 * self.covariance))
        move = self.covariance @ pull
        self.mean = self.mean + move
        return float(np.abs(move / np.sqrt(np.diag(covariance))).max()), float(chi2 / count)

    def precision(self, name: str, s2: Array, squares: Array, used: Array) -> Array:
        """(k, k) Return the inverse covariance of the data in use, a mean over the extra errors.

        `s2` (m,) are the variances of all data without them, `squares` (k, k) the mean products of the residuals.
        """
        found = np.diag(1 / s2[used])
        track, start, end = self.measured[name].measurement, 0, 0
        for column, (phi1, *_) in getattr(track, "given", {}).items():
            start, end = end, end + len(phi1)
            full = f"stream.{name}.observable.{column}{EXTRA}"
            if full not in self.names:
                continue
            kept = used[start:end]
            rows = np.arange(used[:start].sum(), used[:end].sum())
            block = np.ix_(rows, rows)
            squares_of_phi1, length = squares_of(phi1[kept]), track.extra_error_length
            sizes = self.spec.priors[self.names.index(full)].ppf((np.arange(SIZES) + 0.5) / SIZES)
            extra = [ExtraError(squares_of_phi1, size, length).covariance() for size in sizes]
            inverses = [np.linalg.inv(np.diag(s2[start:end][kept]) + each) for each in extra]
            ln_p = [0.5 * np.linalg.slogdet(each)[1] - 0.5 * (each * squares[block]).sum() for each in inverses]
            found[block] = np.tensordot(np.exp(ln_p - np.logaddexp.reduce(ln_p)), inverses, axes=1)
        return found

    def of_host(self, name: str, information: Array, pull: Array) -> tuple[Array, Array]:
        """Return the information and the pull of a stream on the host's numbers, without those of its progenitor."""
        n = len(self.shared)
        own = np.linalg.inv(information[n:, n:] + np.eye(len(self.own[name]))) @ information[n:, :n]
        shift = own.T @ (pull[n:] - self.mean[self.own[name]])
        return information[:n, :n] - information[:n, n:] @ own, pull[:n] - shift

    def pulls(self) -> dict[str, float]:
        """Return by stream how probable a larger shift of the host's Gaussian by it is, after all the others."""
        found = {}
        for name in self.measured:
            rest = [factor for other, factor in self.factors.items() if other != name]
            covariance = np.linalg.inv(sum(information for information, _ in rest))
            root = np.linalg.cholesky(covariance)
            information, pull = self.factors[name]
            value, vector = np.linalg.eigh(root.T @ information @ root)
            told = value > TOLD
            before = covariance @ sum(pull for _, pull in rest)  # the shift to where the others have it
            moved = vector.T @ root.T @ (pull - information @ before)
            if told.any():
                found[name] = float(chi2_law.sf((moved**2 / (value * (1 + value)))[told].sum(), told.sum()))
        return found


def fit(
    model: sk.Model, start: Mapping[str, float], seed: int, numbers: Callable[[Array], dict[str, float]]
) -> dict[str, Any]:
    """Return quantiles of `numbers` of parameters (d,), the last move, chi^2 of a datum, calls and CPU seconds."""
    begin, one = time.process_time(), GaussianFit(model, start, seed)
    settled, moved, chi2 = settle(one)
    z = np.random.default_rng(seed).multivariate_normal(*one.found, 400, method="cholesky")
    found = quantiles([numbers(one.theta(each)) for each in z])
    told = {"settled": settled, "moved": moved, "chi2": chi2, "pulls": one.pulls(), "calls": one.calls}
    return {**found, **told, "cpu": round(time.process_time() - begin)}


def settle(one: GaussianFit) -> tuple[bool, float, float]:
    """Renew a Gaussian until it stays; return whether it does, its last move, and chi^2 of a datum."""
    moves = list[float]()
    one.draw(DRAWS)
    while True:
        moved, chi2 = one.renew()
        moves.append(moved)
        print(f"    moved by {moved:.2f} sd, chi^2 of a datum {chi2:.2f}", flush=True)
        settled = max(moves[-3:]) < SETTLED
        if len(moves) == ROUNDS or (settled and len(moves) >= LEAST):
            return settled, moved, chi2
        one.draw(MORE)


def quantiles(each: list[dict[str, float]]) -> dict[str, list[float]]:
    """Return the quantiles `LEVELS` of numbers."""
    return {key: np.quantile([one[key] for one in each], LEVELS).tolist() for key in each[0]}


def coverage(rows: list[dict[str, Any]]) -> list[str]:
    """Return for each number how many intervals hold the truth, and the shifts; rows as `fit`, with the `truth`."""
    lines = []
    for number in rows[0]["truth"]:
        ours = [row for row in rows if number in row]
        if not ours:
            continue
        found = np.array([row[number] for row in ours])
        true = np.array([row["truth"][number] for row in ours])
        half = 0.5 * (found[:, 3] - found[:, 1])
        shift, error = (found[:, 2] - true) / half, found[:, 2] / true - 1
        held = [((found[:, k] < true) & (true < found[:, 4 - k])).sum() for k in (1, 0)]
        mean = f"{error.mean():+.3f}" + (f" +- {error.std(ddof=1) / np.sqrt(len(ours)):.3f}" if len(ours) > 1 else "")
        lines.append(
            f"  {number:9s} of {len(ours)}, 68 %: {held[0]}, 95 %: {held[1]}; off by {mean} of the truth, rms "
            f"{np.sqrt((error**2).mean()):.3f}; in sd {shift.mean():+.2f}, rms {np.sqrt((shift**2).mean()):.2f}; "
            f"half width {np.mean(half / true):.3f}"
        )
    return lines
