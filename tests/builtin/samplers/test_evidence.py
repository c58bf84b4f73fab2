"""The evidence of emulated posteriors: Gaussians in closed form, two modes, and the sampler of a run."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from streamkit.builtin.samplers.emulator.walk.density import Layout, Tangent, Terms
from streamkit.builtin.samplers.emulator.walk.evidence import ln_evidence
from streamkit.builtin.samplers.emulator.walk.populations import sample


class Gaussians:
    """Likelihoods that are sums of Gaussians in coordinates whose prior is a standard normal."""

    def __init__(self, d: int, means: list[float], widths: list[float]) -> None:
        rng = np.random.default_rng(d)
        turn = np.linalg.qr(rng.standard_normal((d, d)))[0]
        self.layout = Layout.of_one(d)
        self.means = [mean * turn[0] for mean in means]
        scale = np.linspace(0.3, 1.0, d)
        self.covariances = [width**2 * (turn.T * scale**2) @ turn for width in widths]

    def terms(self, z: np.ndarray) -> Terms:
        each = [multivariate_normal(m, c).logpdf(z) for m, c in zip(self.means, self.covariances, strict=True)]
        prior = [np.zeros(len(z)), -0.5 * np.sum(z**2, axis=1)]
        return Terms(np.stack(prior, axis=1), np.reshape(logsumexp(each, axis=0), (-1, 1)))

    def tangents(self, z: np.ndarray) -> list[Tangent]:
        root = np.linalg.cholesky(np.linalg.inv(self.covariances[0]))
        return [Tangent.of((z - self.means[0]) @ root, np.tile(root, (len(z), 1, 1)), np.arange(z.shape[1]))]

    @property
    def ln_evidence(self) -> float:
        """Each Gaussian times the prior is the Gaussian of the sum of both covariances at its mean."""
        wide = [c + np.eye(len(c)) for c in self.covariances]
        return float(
            logsumexp([multivariate_normal(0 * m, w).logpdf(m) for m, w in zip(self.means, wide, strict=True)])
        )


@pytest.mark.usefixtures("short_walks")
@pytest.mark.parametrize(
    ("d", "means", "widths"),
    [
        (2, [1.0], [0.3]),
        (3, [-2.0, 2.5], [0.2, 0.4]),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in ((5, [3.0], [0.1]), (12, [1.0], [0.5]), (2, [0.5], [30.0]))
        ),
    ],
)
def test_the_evidence_of_gaussians_is_that_of_the_formula(d: int, means: list[float], widths: list[float]) -> None:
    density = Gaussians(d, means, widths)
    begin = [np.random.default_rng([1, i]).standard_normal((2000, d)) for i in (0, 1)]
    value, error = ln_evidence(density, sample(density, begin, [3]), [5])
    assert error < 0.05
    assert value == pytest.approx(density.ln_evidence, abs=max(4 * error, 0.01))
