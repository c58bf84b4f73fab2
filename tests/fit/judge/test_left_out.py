"""The shared parameters without a stream, against linear models with Gaussian errors, where the answer is exact."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2, laplace, loggamma, multivariate_normal, norm

from streamkit.fit.judge.left_out import leave_out, normal_scores
from streamkit.runfile import Factor, Normal, Uniform

STREAMS, SHARED, OWN, DATA = 4, 2, 2, 6


class Linear:
    """Streams whose data are linear in shared and own parameters, all with standard normal priors."""

    def __init__(self, seed: int, pull: float = 0.0) -> None:
        rng = np.random.default_rng(seed)
        d = SHARED + STREAMS * OWN
        self.matrices = []
        self.factors = []
        for k in range(STREAMS):
            own = SHARED + k * OWN + np.arange(OWN)
            matrix = np.zeros((DATA, d))
            matrix[:, :SHARED] = rng.normal(0, 0.7, (DATA, SHARED))
            matrix[:, own] = rng.normal(0, 2, (DATA, OWN))
            self.matrices.append(matrix)
            self.factors.append(Factor(f"s{k}", np.arange(SHARED), own))
        truth = rng.normal(0, 1, d)
        self.data = [matrix @ truth + rng.normal(0, 1, DATA) for matrix in self.matrices]
        self.data[0] = self.data[0] + pull * self.matrices[0][:, 0]

    def posterior(self, without: int | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Mean and covariance of all parameters, in closed form."""
        used = [k for k in range(STREAMS) if k != without]
        precision = np.eye(SHARED + STREAMS * OWN) + sum(self.matrices[k].T @ self.matrices[k] for k in used)
        covariance = np.linalg.inv(precision)
        return covariance @ sum(self.matrices[k].T @ self.data[k] for k in used), covariance

    def sampled(self, n: int, seed: int = 1) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        samples = np.random.default_rng(seed).multivariate_normal(*self.posterior(), n)
        ln_l = {
            factor.name: multivariate_normal(np.zeros(DATA)).logpdf(data - samples @ matrix.T)
            for factor, matrix, data in zip(self.factors, self.matrices, self.data, strict=True)
        }
        return samples, ln_l


def test_mean_and_covariance_are_those_of_the_fit_without_the_stream() -> None:
    model, n = Linear(3), 20000
    samples, ln_l = model.sampled(n)
    for k, left in enumerate(leave_out(samples, ln_l, model.factors)):
        mean, covariance = (part[..., :SHARED] for part in model.posterior(without=k))
        covariance = covariance[:SHARED]
        found = left.weights @ samples[:, :SHARED]
        sd = np.sqrt(np.diag(model.posterior()[1])[:SHARED])
        np.testing.assert_allclose(left.mean, (mean - model.posterior()[0][:SHARED]) / sd, atol=0.05)
        error = np.sqrt(np.diag(covariance) / left.independent)
        assert (np.abs(found - mean) < 4 * error).all()
        spread = np.cov(samples[:, :SHARED].T, aweights=left.weights)
        np.testing.assert_allclose(spread, covariance, atol=6 * covariance.max() / np.sqrt(left.independent))
        assert left.error < 0.01  # every sample gives Z; the covariance of o comes from samples
        assert not left.problem


def test_the_density_of_the_data_given_all_others_is_that_of_the_closed_form() -> None:
    model = Linear(3, pull=1.0)
    samples, ln_l = model.sampled(40000)
    for k, left in enumerate(leave_out(samples, ln_l, model.factors)):
        mean, covariance = model.posterior(without=k)
        matrix = model.matrices[k]
        expected = multivariate_normal(matrix @ mean, np.eye(DATA) + matrix @ covariance @ matrix.T)
        assert left.ln_density == pytest.approx(expected.logpdf(model.data[k]), abs=0.1)


def test_own_parameters_far_from_a_gaussian_are_averaged_over() -> None:
    """p(o | h, all) is a Laplace density whose width depends on h, and ln Z is a quadratic in h."""
    rng, n = np.random.default_rng(2), 20000
    h = rng.normal(0.3, 0.5, n)
    width = np.exp(-1 + 0.6 * h)
    o = rng.laplace(0, width)
    ln_z = -1.2 + 0.7 * h - 0.4 * h**2
    ln_l = ln_z + laplace(0, width).logpdf(o) - norm.logpdf(o)
    (left,) = leave_out(np.column_stack([h, o]), {"s": ln_l}, [Factor("s", np.arange(1), 1 + np.arange(1))])
    assert not left.problem
    expected = np.exp(-ln_z) / np.exp(-ln_z).sum()
    assert left.weights @ h == pytest.approx(expected @ h, abs=4 * left.error * 0.5)
    assert left.ln_density == pytest.approx(-np.log(np.mean(np.exp(-ln_z))), abs=4 * left.error)
    assert left.error < 0.02


def test_a_mixture_knows_skew_own_parameters_from_fewer_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three own parameters are logarithms of gamma distributed numbers, and ln Z is a quadratic in h."""
    rng, n, p, skew = np.random.default_rng(8), 1000, 3, loggamma(0.5)
    h, o = rng.normal(0.3, 0.5, n), skew.rvs((n, p), random_state=rng)
    ln_z = -1.2 + 0.7 * h - 0.4 * h**2
    ln_l = ln_z + (skew.logpdf(o) - norm.logpdf(o)).sum(axis=1)
    expected = -np.log(np.mean(np.exp(-ln_z)))
    factor = Factor("s", np.arange(1), 1 + np.arange(p))
    (left,) = leave_out(np.column_stack([h, o]), {"s": ln_l}, [factor])
    assert not left.problem
    assert left.ln_density == pytest.approx(expected, abs=3 * left.error)
    monkeypatch.setattr("streamkit.fit.judge.left_out.COMPONENTS", 1)
    (gaussian,) = leave_out(np.column_stack([h, o]), {"s": ln_l}, [factor])
    assert left.error < 0.8 * gaussian.error


def test_the_shift_is_that_of_the_closed_form() -> None:
    model = Linear(3, pull=2.0)
    samples, ln_l = model.sampled(40000)
    left = leave_out(samples, ln_l, model.factors)[0]
    (with_all, tight), (without, wide) = (
        (mean[:SHARED], covariance[:SHARED, :SHARED]) for mean, covariance in (model.posterior(), model.posterior(0))
    )
    moved = with_all - without
    shift = moved @ np.linalg.solve(wide - tight, moved)
    assert left.directions == SHARED
    assert left.shift == pytest.approx(shift, rel=0.1)
    assert left.p_value == pytest.approx(chi2.sf(shift, SHARED), rel=0.5)


def test_p_values_of_streams_that_agree_are_even() -> None:
    """Of 40 data sets drawn from the prior: the chance to fall below a half is a half, and below 0.05 is small."""
    p = []
    for seed in range(40):
        model = Linear(100 + seed)
        samples, ln_l = model.sampled(3000, seed)
        p += [left.p_value for left in leave_out(samples, ln_l, model.factors)[:1] if left.directions]
    assert len(p) > 30
    assert abs(np.mean(p) - 0.5) < 4 / np.sqrt(12 * len(p))
    assert np.sum(np.array(p) < 0.05) <= 7


def test_a_stream_that_pulls_is_found() -> None:
    model = Linear(5, pull=6.0)
    samples, ln_l = model.sampled(40000)
    assert leave_out(samples, ln_l, model.factors)[0].p_value < 1e-3


def test_others_that_leave_the_shared_parameters_free_are_a_problem() -> None:
    """All data but those of one stream say nothing, and the prior of the shared parameters is left out too."""
    h = np.random.default_rng(0).normal(0, 0.1, (2000, 2))
    ln_l = {"s0": -0.6 * (h**2).sum(axis=1) / 0.1**2}
    (left,) = leave_out(h, ln_l, [Factor("s0", np.arange(2), np.arange(0))])
    assert left.problem == "not determined by the others"


def test_samples_that_do_not_differ_are_a_problem() -> None:
    rng = np.random.default_rng(0)
    for scores in (np.ones((200, 4)), np.column_stack([rng.normal(size=(200, 2)), np.ones((200, 2))])):
        (left,) = leave_out(scores, {"s0": rng.normal(size=200)}, [Factor("s0", np.arange(2), 2 + np.arange(2))])
        assert left.problem


def test_scores_are_standard_normal_where_samples_are_the_prior() -> None:
    u = np.random.default_rng(0).random(1000)
    samples = np.column_stack([3 + 2 * u, norm(5, 0.5).ppf(u)])
    scores = normal_scores(samples, [Uniform(3, 5), Normal(5, 0.5)])
    np.testing.assert_allclose(scores, np.column_stack([norm.ppf(u)] * 2), atol=2e-3)
