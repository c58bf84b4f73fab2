"""The sampling code on posteriors known in closed form: quantiles, counts, resumption, start, diagnostics."""

from pathlib import Path

import emcee
import numpy as np
import pytest
from emcee.backends import Backend
from toys import COVARIANCE, MEAN, PRIORS, Gaussian, sampling

import streamkit as sk
from streamkit.sample import (
    ChainFile,
    Evaluation,
    Limits,
    Workers,
    autocorrelation_times,
    burn_in,
    read_chain_file,
    split_r_hat,
    stuck_walkers,
)
from streamkit.sample.convergence import CHECK
from streamkit.sample.moves import proposals
from streamkit.sample.start import Search
from streamkit.spec import Uniform


def toy_chain(backend, steps, seed=5, moves="de", walkers=24, cut=False):
    toy = Gaussian(cut)
    with Workers({"full": toy, "cheap": toy}) as pool:
        run = sampling(pool, backend, seed, walkers, moves)
        run.begin()
        status = run.advance(steps)
    return run, status


@pytest.mark.parametrize("moves", ["de", "stretch"])
def test_a_gaussian_is_recovered(moves):
    backend = Backend()
    _, status = toy_chain(backend, Limits(1500, tau_factor=1e9), moves=moves)
    samples = backend.get_chain(discard=300, flat=True)
    sd = np.sqrt(np.diag(COVARIANCE))
    tau = autocorrelation_times(backend.get_chain(discard=300)).max()
    error = np.sqrt(tau / len(samples))  # of a mean, in standard deviations
    assert status == "steps"
    assert (np.abs(samples.mean(axis=0) - MEAN) < 4 * error * sd).all()
    np.testing.assert_allclose(np.cov(samples.T), COVARIANCE, atol=8 * error * sd.max() ** 2)
    for q, z in ((16, -0.9945), (84, 0.9945), (97.5, 1.96)):  # normal quantiles
        assert (np.abs(np.percentile(samples, q, axis=0) - MEAN - z * sd) < 12 * error * sd).all()


def test_it_stops_when_the_chain_is_long_enough():
    backend = Backend()
    _, status = toy_chain(backend, Limits(20000, tau_factor=20))
    assert status == "converged"
    assert backend.iteration > 20 * autocorrelation_times(backend.get_chain()).max()


def test_it_goes_on_until_the_walkers_agree():
    backend = Backend()
    _, status = toy_chain(backend, Limits(20000, tau_factor=5, r_hat=1.01))
    assert status == "converged"
    kept = [backend.get_chain()[:length] for length in (backend.iteration - CHECK, backend.iteration)]
    before, after = (split_r_hat(part[burn_in(part) :]).max() for part in kept)
    assert after < 1.01 <= before
    assert backend.iteration > 10 * autocorrelation_times(backend.get_chain()).max()


def test_every_rejection_is_counted_and_no_walker_stands_on_one():
    backend = Backend()
    run, _ = toy_chain(backend, Limits(50, tau_factor=1e9), cut=True)
    counts = run.totals()
    assert counts["calls"] == 50 * 24
    assert counts["reasons"]["no stream on this side"] > 50
    assert (backend.get_chain()[..., 0] >= MEAN[0]).all()


def test_a_resumed_chain_equals_an_uninterrupted_one(tmp_path):
    whole, parts = (ChainFile(str(tmp_path / f"{name}.h5")) for name in ("whole", "parts"))
    toy_chain(whole, Limits(30))
    first, _ = toy_chain(parts, Limits(17))
    toy = Gaussian()
    with Workers({"full": toy, "cheap": toy}) as pool:
        second = sampling(pool, ChainFile(parts.filename))
        second.resume(read_chain_file(Path(parts.filename)).attributes["counts"])
        second.advance(Limits(30))
    for name in ("chain", "log_prob", "blobs", "accepted"):
        one, two = (getattr(read_chain_file(Path(file.filename)), name) for file in (whole, parts))
        np.testing.assert_array_equal(one, two)
    assert second.totals()["calls"] == 30 * 24
    assert second.totals()["search_calls"] == first.totals()["search_calls"]


def test_the_start_is_spread_over_the_posterior():
    toy = Gaussian(cut=True)
    with Workers({"full": toy, "cheap": toy}) as pool:
        search = Search(PRIORS, pool.evaluate, 40, np.random.default_rng(1))
        points, results = search.run()
    assert len(np.unique(points, axis=0)) == 40
    assert np.isfinite([r.lnp for r in results]).all()
    assert search.calls < 4000
    sd = np.sqrt(np.diag(COVARIANCE))
    spread = points.std(axis=0) / sd
    assert (spread[1:] > 0.5).all()
    assert (spread[1:] < 2).all()
    assert 0.3 < spread[0] < 1.2  # half of a Gaussian: 0.6


def test_a_start_that_cannot_be_found_says_why():
    class Barren:
        def evaluate(self, theta):
            reason = "no apocentre" if theta[0] < 0 else "no stream"
            return Evaluation(-np.inf, -np.inf, np.full(2, np.nan), np.full(2, np.nan), reason)

    with (
        Workers({"full": Barren(), "cheap": Barren()}) as pool,
        pytest.raises(sk.StreamkitError, match=r"only 0 .*no apocentre: 1024 of 2048"),
    ):
        sampling(pool, Backend()).begin()


def test_autocorrelation_time_of_an_ar1_process():
    rng, a = np.random.default_rng(0), 0.9
    x = np.zeros((20000, 8, 1))
    for i in range(1, len(x)):
        x[i] = a * x[i - 1] + rng.standard_normal((8, 1))
    assert autocorrelation_times(x)[0] == pytest.approx((1 + a) / (1 - a), rel=0.1)
    assert burn_in(x) == pytest.approx(57, abs=6)
    assert split_r_hat(x)[0] == pytest.approx(1.0, abs=0.01)


def test_r_hat_of_walkers_that_disagree():
    x = np.random.default_rng(0).standard_normal((1000, 4, 1)) + np.array([0, 0, 5, 5])[None, :, None]
    # within 1, between chains of means (0, 0, 5, 5) twice: 8 values, variance 50/7
    assert split_r_hat(x)[0] == pytest.approx(np.sqrt(1 + 50 / 7), rel=0.02)
    assert np.isnan(split_r_hat(x[:2])).all()
    assert np.isnan(autocorrelation_times(np.ones((50, 4, 2)))).all()


def test_stranded_walkers_are_recognised():
    """Of 32 walkers one stands still far out, one is caught by a small island, one rests at the maximum."""
    rng = np.random.default_rng(3)
    x = rng.standard_normal((400, 32, 3))
    assert len(stuck_walkers(x, -0.5 * (x**2).sum(axis=2))) == 0
    x[150:, 4] = [3, 3, 3]
    x[:, 9] = [0, 5, 0] + 0.1 * x[:, 9]
    x[:, 20] *= 0.01
    lnp = -0.5 * (x**2).sum(axis=2)
    assert stuck_walkers(x, lnp).tolist() == [4, 9]
    # a walker that is low but roams as far as the others is on an excursion
    x[:, 4] = 3 + rng.standard_normal((400, 3))
    assert stuck_walkers(x, -0.5 * (x**2).sum(axis=2)).tolist() == [9]
    assert len(stuck_walkers(x[:10], lnp[:10])) == 0


@pytest.mark.parametrize("name", ["de", "stretch"])
def test_every_move_alone_samples_a_gaussian_whatever_the_units(name):
    """Standard deviations within 6 %, for parameters whose scales differ by 10^8 (snooker: off by 15 %)."""
    scale = np.array([1.0, 1e8, 1e-2, 30.0])
    for move, _ in proposals(name, [Uniform(-1e12, 1e12)] * 4):
        sampler = emcee.EnsembleSampler(
            40, 4, lambda x: -0.5 * (x**2 / scale**2).sum(axis=1), moves=move, vectorize=True
        )
        start = scale * np.random.default_rng(2).standard_normal((40, 4))
        state = emcee.State(start, random_state=np.random.RandomState(3).get_state())
        sampler.run_mcmc(state, 6000)
        found = sampler.get_chain(discard=500, flat=True)
        np.testing.assert_allclose(found.std(axis=0) / scale, 1.0, atol=0.06)
        assert sampler.acceptance_fraction.mean() > 0.05
