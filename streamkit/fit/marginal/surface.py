"""A smooth function through the integrals at many hosts: a Gaussian process about a quadratic function, its domain."""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.linalg import inv
from scipy.spatial.distance import cdist

from streamkit.errors import StreamkitError
from streamkit.fit.marginal.integral import Marginal, quadratic_terms
from streamkit.stream import Array, BoolArray

# Widths of the kernel in standard deviations of the stream alone, and its amplitudes in ln likelihood, to choose from.
WIDTHS, AMPLITUDES = (1.0, 2.0, 4.0, 8.0), (0.1, 0.5, 2.0, 10.0)
# An integral far below the best needs less accuracy: this part of its depth may be wrong, all of it at the depth
# `DEEP`, and this much in any case.
OF_DEPTH, DEEP, LEAST_ERROR = 0.02, 900.0, 0.01
# An integral counts with so many effective draws at least, and with this part of it among the calls.
EFFECTIVE, TRUSTED = 8.0, 0.9
# The domain ends where more than this part of the hosts does not count; hosts that are looked at together.
DROPPED, TOGETHER = 0.5, 30
INCLUDED = 0.99  # part of the joint posterior of the run that is inside the domain
WANTED = 5.0  # standard deviations that the domain should reach


class Fitted(NamedTuple):
    """The function and its domain.

    Attributes
    ----------
    centre, whiten
        (d,) and (d, d): x = (y - centre) @ whiten has the mean 0 and the covariance 1 for the stream alone.
    used
        (n,) the hosts that it goes through.
    errors
        (n,) the errors with which it goes through them.
    width, amplitude
        Of the Gaussian kernel.
    near, reach
        (n,) hosts in the domain or near it, and the largest |x| of the domain. A place is outside it too where most of
        the nearest hosts are not ``used``.
    kept
        Part of the hosts within `WANTED` standard deviations that is used.
    left_out
        Root of the mean square of ln likelihood minus what the other hosts say of it, for hosts inside the domain
        that are at most d / 2 + 8 below the best.
    """

    centre: Array
    whiten: Array
    used: BoolArray
    errors: Array
    width: float
    amplitude: float
    near: BoolArray
    reach: float
    kept: float
    left_out: float


def fit(marginal: Marginal) -> Fitted:
    """Choose the kernel by leaving out each host in turn, and the domain by the hosts that count."""
    centre, whiten = _whitening(marginal.alone)
    x = (marginal.hosts - centre) @ whiten
    r = np.sqrt(np.sum(x**2, axis=1))
    counts = np.isfinite(marginal.ln_likelihood) & (marginal.effective >= EFFECTIVE) & (marginal.trusted >= TRUSTED)
    d = x.shape[1]
    reach = _reach(r[~marginal.joint], counts[~marginal.joint])
    if marginal.joint.any() and counts[marginal.joint].mean() > 1 - DROPPED:
        reach = max(reach, float(np.quantile(r[marginal.joint], INCLUDED)))
    terms = 1 + d + d * (d + 1) // 2
    near = r <= 1.15 * reach
    used = counts & near
    if used.sum() < 2 * terms:
        raise StreamkitError(
            f"only {used.sum()} of {len(x)} hosts have an integral that can be trusted, {2 * terms} are needed: "
            "more calls, by a larger sampler.max_calls, may help"
        )
    values = marginal.ln_likelihood[used]
    depth = values.max() - values
    errors = np.sqrt(marginal.error[used] ** 2 + (OF_DEPTH * depth + depth**2 / DEEP) ** 2 + LEAST_ERROR**2)
    choices = [(_left_out(x[used], values, errors, *choice), choice) for choice in product(WIDTHS, AMPLITUDES)]
    (_, left), (width, amplitude) = max(choices, key=lambda each: each[0][0])
    likely = (r[used] <= reach) & (depth <= 0.5 * d + 8)
    left_out, kept = float(np.sqrt(np.mean(left[likely] ** 2))), float(counts[r <= WANTED].mean())
    return Fitted(centre, whiten, used, errors, width, amplitude, near, reach, kept, left_out)


def _left_out(x: Array, values: Array, errors: Array, width: float, amplitude: float) -> tuple[float, Array]:
    """Return ln density (a number) of each value given all others, summed, and values minus predictions (n,).

    Both follow from the inverse of the matrix of the whole fit (Dubrule 1983).
    """
    n, basis = len(x), quadratic_terms(x)
    covariance = amplitude**2 * np.exp(-0.5 * cdist(x, x, "sqeuclidean") / width**2) + np.diag(errors**2)
    m = basis.shape[1]
    whole = np.block([[covariance, basis], [basis.T, np.zeros((m, m))]])
    inverse = inv(whole)[:n, :n]
    variance = 1 / np.diag(inverse)
    left = (inverse @ values) * variance
    if not (np.isfinite(left).all() and (variance > 0).all()):  # kernels too wide to be inverted
        return -np.inf, left
    return float(-0.5 * np.sum(left**2 / variance + np.log(variance))), left


def _reach(r: Array, counts: BoolArray) -> float:
    """Return the distance up to which most hosts count, and up to which there are enough of them."""
    order = np.argsort(r)
    inside = counts[order]
    most = float(np.quantile(r, 0.95))
    for first in range(0, len(r) - TOGETHER, TOGETHER // 3):
        if 1 - inside[first : first + TOGETHER].mean() > DROPPED:
            return float(min(r[order[first + TOGETHER // 2]], most))
    return most


def _whitening(y: Array) -> tuple[Array, Array]:
    centre, covariance = y.mean(axis=0), np.atleast_2d(np.cov(y.T))
    covariance[np.diag_indices_from(covariance)] *= 1 + 1e-9
    return centre, np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)).T)
