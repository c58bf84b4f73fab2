"""The shared parameters without the data of one stream, from the samples of the fit to all of them.

The posterior of the shared parameters h without stream k is p(h | all) / Z_k(h), where Z_k(h) is the likelihood of the
stream's data averaged over the prior of its own parameters o. For any normalised density g(o | h), the mean of
g / (L_k p(o)) over p(o | h, all) is 1 / Z_k(h) (Gelfand & Dey 1994, J. R. Statist. Soc. B 56, 501). Here g is a
Gaussian about a quadratic in h, in coordinates in which each prior is a standard normal, and ln Z_k the quadratic in h
that makes this mean 1 with each of its terms. The samples get weights 1 / Z_k. For a linear model with Gaussian errors
and priors every sample gives Z_k itself; otherwise they scatter about it. Where a mixture of Gaussians is nearer to the
samples, g is one that the other samples were fitted to. One over the mean of 1 / Z_k is the density of the stream's
data, given those of all others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri
from scipy.stats import chi2

from streamkit.fit.judge.predictive import prior_fractions
from streamkit.gaussian_mixture import GaussianMixture
from streamkit.runfile import Factor, Prior
from streamkit.stream import Array

INSIDE = 1e-6  # smallest fraction of a prior below or above a sample: beyond, a coordinate is infinite
INFORMED = 0.03  # a direction counts if the variance of the shared parameters in it rises by this part
FEWEST = 100.0  # effective samples below which there are no intervals
ROUGH = 0.3  # standard error of ln Z_k above which own parameters are too far from a Gaussian for the samples
COMPONENTS, FOLDS = 4, 4  # Gaussians of a mixture; parts of the samples, each compared with the fit to the others
STEPS, SETTLED = 100, 1e-9  # Newton steps to the quadratic, at most; the gain at which they end


@dataclass(frozen=True, eq=False)
class LeftOut:
    """The samples of the shared parameters without one stream's data.

    Attributes
    ----------
    stream
        Its name.
    weights
        (n,) of the samples; their sum is 1.
    error
        Standard error of ln Z_k at a typical sample.
    mean
        (s,) The mean of the shared parameters without the stream minus that with it, in standard deviations of the fit
        to all; NaN where the others leave them undetermined. All priors are Gaussian in these coordinates.
    shift, directions
        Square of that difference in units of its covariance, and the number of directions that the stream informs. It
        has a chi^2 distribution if the stream agrees with the others (Raveri & Hu 2019, PRD 99, 043506).
    ln_density
        ln of the density of the stream's data, given those of all others; NaN where the others leave it undetermined.
    """

    stream: str
    weights: Array
    error: float
    mean: Array
    shift: float
    directions: int
    ln_density: float

    @property
    def independent(self) -> float:
        """The effective number of samples (Kish 1965)."""
        return float(1 / np.sum(self.weights**2))

    @property
    def p_value(self) -> float:
        """The probability of a shift at least as large, if the stream agrees; NaN without a direction."""
        return float(chi2.sf(self.shift, self.directions)) if self.directions else float("nan")

    @property
    def problem(self) -> str:
        """Why the numbers are not to be used; empty if they are."""
        if not np.isfinite(self.mean).all():
            return "not determined by the others"
        return f"own parameters far from Gaussian: ln Z known to {self.error:.1f}" if self.error > ROUGH else ""


def normal_scores(samples: Array, priors: Sequence[Prior]) -> Array:
    """(n, d) Samples in coordinates in which each prior is a standard normal."""
    fractions = [prior_fractions(prior, x) for prior, x in zip(priors, samples.T, strict=True)]
    return np.asarray(ndtri(np.clip(fractions, INSIDE, 1 - INSIDE)).T)


def leave_out(scores: Array, ln_likelihood: Mapping[str, Array], factors: Sequence[Factor]) -> list[LeftOut]:
    """Return the shared parameters without each factor that has a likelihood here.

    Parameters
    ----------
    scores
        (n, d) `normal_scores` of independent samples of the posterior, all of equal weight.
    ln_likelihood
        (n,) of the data of each factor at the samples, by its name.
    factors
        The factors, with the indices of their shared parameters and of their own.
    """
    found = []
    for each in factors:
        if each.name in ln_likelihood and len(each.shared):
            try:
                with np.errstate(all="ignore"):
                    one = _without(scores[:, each.shared], scores[:, each.own], ln_likelihood[each.name], each.name)
            except np.linalg.LinAlgError:  # samples that do not differ in some direction
                nothing = np.full(len(each.shared), np.nan)
                equal = np.full(len(scores), 1 / len(scores))
                one = LeftOut(each.name, equal, float("inf"), nothing, float("nan"), 0, float("nan"))
            found.append(one)
    return found


def _without(h: Array, o: Array, ln_l: Array, name: str) -> LeftOut:
    """Return the shared parameters h (n, s) without the factor of this name, whose own parameters are o (n, p)."""
    x = (h - h.mean(axis=0)) / h.std(axis=0)
    terms, size = _quadratic(x), h.shape[1]
    ln_z = ln_l.copy()
    if o.shape[1]:
        away = o - terms @ np.linalg.lstsq(terms, o, rcond=None)[0]
        covariance = away.T @ away / max(len(o) - terms.shape[1], 1)
        squares = np.einsum("ni,ij,nj->n", away, np.linalg.inv(covariance), away)
        gaussian = -0.5 * (squares + np.linalg.slogdet(covariance)[1])
        mixture = _ln_mixture(away)
        ln_z -= (mixture if mixture.mean() > gaussian.mean() else gaussian) + 0.5 * (o**2).sum(axis=1)
    coefficients, error = _mean_of_inverse(terms, ln_z)
    smooth = terms @ coefficients
    weights = np.exp(smooth.min() - smooth)
    curvature = np.zeros((size, size))
    curvature[np.triu_indices(size)] = coefficients[1 + size :]
    here = np.cov(x.T).reshape(size, size)
    precision = np.linalg.inv(here) + curvature + curvature.T
    mean, shift, directions, ln_density = np.full(size, np.nan), float("nan"), 0, float("nan")
    if np.linalg.eigvalsh(precision)[0] > 0:
        there = np.linalg.inv(precision)
        mean = -there @ coefficients[1 : 1 + size]
        volumes = np.linalg.slogdet(here)[1] + np.linalg.slogdet(precision)[1]
        ln_density = float(coefficients[0] - 0.5 * mean @ precision @ mean + 0.5 * volumes)
        half = np.linalg.inv(np.linalg.cholesky(here))
        values, vectors = np.linalg.eigh(half @ (there - here) @ half.T)
        along, used = vectors.T @ half @ mean, values > INFORMED
        shift, directions = float((along[used] ** 2 / values[used]).sum()), int(used.sum())
    return LeftOut(name, weights / weights.sum(), error, mean, shift, directions, ln_density)


def _ln_mixture(away: Array) -> Array:
    """(n,) ln of the density of samples (n, p) in Gaussian mixtures that the others were fitted to, up to a constant.

    A sample in the fit itself would be where the density is high by chance.
    """
    rng = np.random.default_rng(len(away))
    part, found = rng.permutation(len(away)) % FOLDS, np.empty(len(away))
    for i in range(FOLDS):
        mixture = GaussianMixture.fitted(away[part != i], COMPONENTS, rng)
        found[part == i] = mixture.ln_density(away[part == i])
    return found


def _mean_of_inverse(terms: Array, ln_z: Array) -> tuple[Array, float]:
    """Return coefficients c of terms (n, q) with which the mean of exp(terms c - ln_z) times each term is the term's.

    And the standard error of ``terms c`` at a typical sample. It is the minimum of the mean of exp(terms c - ln_z) -
    terms c, which is convex: Newton's steps go there from the least squares, halved where they go too far.
    """
    n, c = len(terms), np.asarray(np.linalg.lstsq(terms, ln_z, rcond=None)[0], dtype=float)

    def cost(at: Array) -> float:
        return float(np.mean(np.exp(terms @ at - ln_z) - terms @ at))

    for _ in range(STEPS):
        ratio = np.exp(terms @ c - ln_z)
        step = np.linalg.solve(terms.T @ (ratio[:, None] * terms) / n, terms.T @ (ratio - 1) / n)
        length, before = 1.0, cost(c)
        while not cost(c - length * step) <= before and length > 1e-6:
            length *= 0.5
        c = np.asarray(c - length * step)
        if before - cost(c) < SETTLED:
            break
    ratio = np.exp(terms @ c - ln_z)
    inverse = np.linalg.inv(terms.T @ (ratio[:, None] * terms))
    chance = terms * (ratio - 1)[:, None]
    covariance = inverse @ (chance.T @ chance) @ inverse  # of estimating equations (Huber 1967)
    return c, float(np.sqrt(np.mean(np.einsum("ni,ij,nj->n", terms, covariance, terms))))


def _quadratic(x: Array) -> Array:
    """(n, q) One, the columns of x (n, s), and their products."""
    first, second = np.triu_indices(x.shape[1])
    return np.column_stack([np.ones(len(x)), x, x[:, first] * x[:, second]])
