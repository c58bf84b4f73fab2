"""The Gaussian posterior by regressions (tests/support/gaussian_fit.py) of streams whose predictions are lines.

The posterior of lines with Gaussian errors and priors is known in closed form. The streams are made here, without a
model, and have the noise of particles.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import gaussian_fit
import numpy as np
import pytest
from gaussian_fit import GaussianFit, coverage, quantiles, settle

from streamkit import OutOfDomain
from streamkit.runfile.priors import Normal
from streamkit.stream import Array, Prediction

NAMES = ["potential.m", "potential.q", "stream.a.progenitor.d", "stream.a.progenitor.v", "stream.b.progenitor.d"]
WHICH = {"a": [0, 1, 2, 3], "b": [0, 1, 4]}
DATA, ERROR = 14, 0.5


class Lines:
    """A model whose streams are lines in the normal quantiles of all priors, with noise of variance `noise`**2."""

    def __init__(self, rng: np.random.Generator, noise: float) -> None:
        self.rng, self.noise = rng, noise
        self.slopes = {name: rng.normal(size=(DATA, len(which))) for name, which in WHICH.items()}
        self.true = rng.normal(0, 0.7, len(NAMES))
        self.spec = SimpleNamespace(names=NAMES, priors=[Normal(0.0, 1.0)] * len(NAMES), bind_all=self.bound)

    def bound(self, theta: Array) -> Any:
        """Return parameters as the run file binds them; the normal quantiles are the parameters themselves."""
        return SimpleNamespace(potentials={}, bodies={}, numbers={}, streams={name: (name, theta) for name in WHICH})

    def measured(self, _: Any) -> list[Any]:
        """Return data with noise of the true lines; one of each stream is missing."""
        found = []
        for name in WHICH:
            values = self.mean(name, self.true) + self.rng.normal(0, ERROR, DATA)
            values[3] = np.nan
            measurement = SimpleNamespace(scatter=lambda prediction: np.full(len(prediction.mean), ERROR))
            found.append(SimpleNamespace(stream=name, data=SimpleNamespace(values=values), measurement=measurement))
        return found

    def mean(self, name: str, z: Array) -> Array:
        """(DATA,) Return the noiseless prediction."""
        return self.slopes[name] @ z[WHICH[name]]

    def observe(self, inputs: tuple[str, Array], _: Any) -> tuple[None, Prediction]:
        """Return a prediction with noise; where the first parameter is large there is no stream."""
        name, z = inputs
        if z[0] > 3:
            raise OutOfDomain("no stream there")
        noise = self.rng.normal(0, self.noise, DATA)
        labels = tuple(f"x at {i}" for i in range(DATA))
        return None, Prediction(labels, self.mean(name, z) + noise, np.full(DATA, self.noise**2))

    def exact(self, fit: GaussianFit) -> tuple[Array, Array]:
        """Return mean and covariance of the posterior of the fit's data, by the normal equations."""
        information, pull = np.eye(len(NAMES)), np.zeros(len(NAMES))
        for name, one in fit.measured.items():
            values = one.data.values
            used = np.isfinite(values)
            j = np.zeros((DATA, len(NAMES)))
            j[:, WHICH[name]] = self.slopes[name]
            information += j[used].T @ j[used] / ERROR**2
            pull += j[used].T @ values[used] / ERROR**2
        covariance = np.linalg.inv(information)
        return covariance @ pull, covariance


@pytest.fixture(autouse=True)
def _no_host(monkeypatch: pytest.MonkeyPatch) -> None:
    """A host is not needed: the lines have none."""
    monkeypatch.setattr(gaussian_fit, "Host", lambda *_, **__: None)


def fitted(seed: int, noise: float, without: int | None = None) -> tuple[Lines, GaussianFit]:
    model = Lines(np.random.default_rng(seed), noise)
    if without is not None:
        model.slopes["a"][:, without] = 0.0
    fit = GaussianFit(model, {}, seed)  # type: ignore[arg-type]
    settle(fit)
    return model, fit


def test_lines_without_noise_have_the_posterior_of_the_normal_equations() -> None:
    model, fit = fitted(1, noise=0.0)
    mean, covariance = model.exact(fit)
    np.testing.assert_allclose(fit.found[0], mean, atol=1e-8)
    np.testing.assert_allclose(fit.found[1], covariance, atol=1e-8)


def test_noise_of_particles_moves_neither_means_nor_widths() -> None:
    """Noise is a fifth of the errors. In the slopes of some 150 draws it moves a mean by up to 0.1 of a width."""
    pulls, ratios = [], []
    for seed in range(12):
        model, fit = fitted(seed, noise=0.1)
        mean, covariance = model.exact(fit)
        width = np.sqrt(np.diag(covariance))
        pulls.append((fit.found[0] - mean) / width)
        ratios.append(np.sqrt(np.diag(fit.found[1])) / width)
    assert np.abs(np.mean(pulls, axis=0)).max() < 0.05
    assert np.std(pulls) < 0.15
    np.testing.assert_allclose(np.mean(ratios, axis=0), 1.0, atol=0.03)


def test_noise_of_slopes_is_no_information() -> None:
    """A number that no datum depends on keeps its prior, where calls are as noisy as the data."""
    widths = [np.sqrt(fitted(seed, ERROR, without=2)[1].found[1][2, 2]) for seed in range(12)]
    assert np.mean(widths) == pytest.approx(1.0, abs=0.03)


def test_a_stream_that_was_moved_is_not_predicted_by_the_others() -> None:
    model = Lines(np.random.default_rng(3), 0.0)
    model.slopes["a"][:, 0] *= 3  # so that the first number of the host is known by each stream alone
    fit = GaussianFit(model, {}, 3)  # type: ignore[arg-type]
    settle(fit)
    assert min(fit.pulls().values()) > 0.01
    fit.measured["b"].data.values[:] += 4 * model.slopes["b"][:, 0]  # as if the number were larger by 4
    settle(fit)
    assert fit.pulls()["b"] < 1e-3


def test_quantiles_and_coverage_count_intervals_that_hold_the_truth() -> None:
    each = [{"m": value} for value in np.linspace(0, 1, 1001).tolist()]
    assert quantiles(each) == {"m": pytest.approx([0.025, 0.16, 0.5, 0.84, 0.975])}
    rows = [quantiles(each) | {"truth": {"m": truth}} for truth in (0.5, 0.2, 0.1, 0.01)]
    assert "m         of 4, 68 %: 2, 95 %: 3;" in coverage(rows)[0]
