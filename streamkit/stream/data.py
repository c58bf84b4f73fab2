"""The data that predictions are compared with, and their Gaussian likelihood."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from streamkit.stream.arrays import Array

# Variances of predictions below this fraction of the least one of the data change no likelihood.
NEGLIGIBLE = 1e-4


@dataclass(frozen=True)
class Data:
    """Data with Gaussian errors.

    Attributes
    ----------
    values, errors
        (m,) values, NaN where there is none, and their standard errors.
    add_noise
        Whether the variance of the model's own estimate is added to that of the data.
    covariance
        (m, m) of the errors; None where they are independent.
    """

    values: Array
    errors: Array
    add_noise: bool = False
    covariance: Array | None = None

    def gaussian(self, mean: Array, variance: Array) -> float:
        """Return the ln likelihood of a prediction under Gaussian errors; a NaN datum is not used.

        Parameters
        ----------
        mean, variance
            (m,) prediction, and the variance of its estimate, which is added to the variance of the data if
            `add_noise`.
        """
        used = np.isfinite(self.values)
        noise = variance[used] if self.add_noise else 0.0
        if self.covariance is None:
            total = self.errors[used] ** 2 + noise
            chi2 = (self.values[used] - mean[used]) ** 2 / total
            return float(-0.5 * np.sum(chi2 + np.log(2 * np.pi * total)))
        from scipy.linalg import cholesky, solve_triangular  # slow to load, and only a covariance needs it

        root = cholesky(self.covariance[np.ix_(used, used)] + np.diag(noise * np.ones(used.sum())), lower=True)
        white = solve_triangular(root, self.values[used] - mean[used], lower=True)
        return float(-0.5 * (white @ white + len(white) * np.log(2 * np.pi)) - np.log(np.diag(root)).sum())

    def gaussian_of_many(self, mean: Array, variance: Array) -> Array:
        """(n,) ln likelihood of predictions (n, m) under Gaussian errors; a NaN datum is not used.

        Their variances (n, m) are added to those of the data, whatever `add_noise` says.
        """
        used = np.isfinite(self.values)
        away, noise = self.values[used] - mean[:, used], variance[:, used]
        if self.covariance is None:
            total = self.errors[used] ** 2 + noise
            return np.asarray(-0.5 * np.sum(away**2 / total + np.log(2 * np.pi * total), axis=1))
        from scipy.linalg import cholesky, solve_triangular  # slow to load, and only a covariance needs it

        covariance, m = self.covariance[np.ix_(used, used)], int(used.sum())
        root = cholesky(covariance, lower=True)
        white, spread = solve_triangular(root, away.T, lower=True).T, np.full(len(away), np.log(np.diag(root)).sum())
        noisy = noise.max(axis=1, initial=0.0) > NEGLIGIBLE * np.linalg.eigvalsh(covariance)[0]
        if noisy.any():  # each place has its own covariance
            roots = np.linalg.cholesky(covariance + noise[noisy][:, :, None] * np.eye(m))
            white[noisy] = np.linalg.solve(roots, away[noisy][:, :, None])[:, :, 0]
            spread[noisy] = np.log(np.diagonal(roots, axis1=1, axis2=2)).sum(axis=1)
        return np.asarray(-0.5 * (white**2).sum(axis=1) - spread - 0.5 * m * np.log(2 * np.pi))

    def residuals(self, mean: Array, variance: Array) -> Array:
        """(m,) Data minus prediction in standard deviations of the likelihood; NaN without a datum.

        Correlations between data are not used. The arguments are those of `gaussian`.
        """
        total = self.errors**2 + (variance if self.add_noise else 0.0)
        return np.asarray((self.values - mean) / np.sqrt(total))

    def gaussian_of_each(self, mean: Array, variance: Array) -> Array:
        """(m,) ln likelihood of each datum, conditional on all others if they correlate; NaN without a datum.

        Burkner, Gabry & Vehtari 2021, equation 5, for a covariance. The arguments are those of `gaussian`.
        """
        away, total = self.values - mean, self.errors**2 + (variance if self.add_noise else 0.0)
        if self.covariance is not None:
            used = np.isfinite(self.values)
            inverse = np.linalg.inv((self.covariance + np.diag(total - self.errors**2))[np.ix_(used, used)])
            total, away = np.full(len(total), np.nan), np.array(away)
            total[used] = 1 / np.diag(inverse)
            away[used] = inverse @ away[used] * total[used]
        return np.asarray(-0.5 * (away**2 / total + np.log(2 * np.pi * total)))

    def drawn(self, mean: Array, variance: Array, rng: np.random.Generator) -> Array:
        """(m,) New data about a prediction; NaN without a datum. The arguments are those of `gaussian`."""
        used = np.isfinite(self.values)
        noise = variance[used] if self.add_noise else np.zeros(used.sum())
        covariance = np.diag(self.errors[used] ** 2) if self.covariance is None else self.covariance[np.ix_(used, used)]
        values = np.full(len(self.values), np.nan)
        root = np.linalg.cholesky(covariance + np.diag(noise))
        values[used] = mean[used] + root @ rng.standard_normal(used.sum())
        return values
