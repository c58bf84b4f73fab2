"""The sampling code on posteriors known in closed form: quantiles, counts, resumption, start, diagnostics."""

import os
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from time import monotonic, sleep

import emcee
import numpy as np
import pytest
from scipy.stats import norm, rankdata
from toys import COVARIANCE, MEAN, PRIORS, Gaussian, OfPriors, walk

import streamkit as sk
from streamkit.builtin.samplers.ensemble.coordinates import Space
from streamkit.builtin.samplers.ensemble.moves import proposals
from streamkit.convergence import CHECK, Convergence, autocorrelation_times, burn_in, rank_r_hat, stuck_walkers
from streamkit.runfile import Uniform
from streamkit.sample import ChainFile, ChainMemory, Evaluation, Workers, read_chain_file
from streamkit.sample.calls.search import Search
from streamkit.sample.calls.serving import evaluate_sent


def toy_chain(chain, steps, seed=5, cut=False, **fields):
    """Fill a chain; return whether it ended before its number of steps."""
    toy = Gaussian(cut)
    with Workers({"full": toy, "cheap": toy}) as pool:
        walk(toy, pool, chain, seed=seed, steps=steps, **fields)
    return chain.iteration < steps


@pytest.mark.parametrize("moves", ["de", pytest.param("stretch", marks=pytest.mark.slow)])
def test_a_gaussian_is_recovered(moves):
    chain = ChainMemory()
    converged = toy_chain(chain, 900, moves=moves)
    late = chain.samples()[200:]
    samples = late.reshape(-1, 3)
    sd = np.sqrt(np.diag(COVARIANCE))
    tau = autocorrelation_times(late).max()
    error = np.sqrt(tau / len(samples))  # of a mean, in standard deviations
    assert not converged
    assert (np.abs(samples.mean(axis=0) - MEAN) < 4 * error * sd).all()
    np.testing.assert_allclose(np.cov(samples.T), COVARIANCE, atol=8 * error * sd.max() ** 2)
    for q, z in ((16, -0.9945), (84, 0.9945), (97.5, 1.96)):  # normal quantiles
        assert (np.abs(np.percentile(samples, q, axis=0) - MEAN - z * sd) < 12 * error * sd).all()


def test_it_stops_when_the_chain_is_long_enough():
    chain = ChainMemory()
    assert toy_chain(chain, 20000, tau_factor=20)
    assert chain.iteration > 20 * autocorrelation_times(chain.samples()).max()


@pytest.mark.slow
def test_it_goes_on_until_the_walkers_agree():
    stored = ChainMemory()
    assert toy_chain(stored, 20000, tau_factor=5, r_hat=1.02)
    chain = stored.samples()
    before, after = (rank_r_hat(part[burn_in(part) :]).max() for part in (chain[:-CHECK], chain))
    assert after < 1.02 <= before
    assert Convergence(chain, 0, 5, 1.02)
    assert not Convergence(chain[:-CHECK], 0, 5, 1.02)
    assert len(chain) > 10 * autocorrelation_times(chain).max()


def test_every_rejection_is_counted_and_no_walker_stands_on_one():
    chain = ChainMemory()
    toy_chain(chain, 50, cut=True)
    counts = chain.last.counts
    assert counts["calls"] == 50 * 24
    assert counts["reasons"]["no stream on this side"] > 50
    assert (chain.samples()[..., 0] >= MEAN[0]).all()


def test_a_resumed_chain_equals_an_uninterrupted_one(tmp_path):
    whole, parts = (ChainFile(tmp_path / f"{name}.h5") for name in ("whole", "parts"))
    toy_chain(whole, 30)
    toy_chain(parts, 17)
    toy, resumed = Gaussian(), ChainFile(parts.path)
    resumed.load()
    with Workers({"full": toy, "cheap": toy}) as pool:
        walk(toy, pool, resumed, steps=30)
    for name in ("chain", "log_prob", "blobs", "accepted"):
        one, two = (getattr(read_chain_file(file.path), name) for file in (whole, parts))
        np.testing.assert_array_equal(one, two)
    assert resumed.last.counts["calls"] == 30 * 24
    assert resumed.last.counts["search_calls"] == parts.last.counts["search_calls"]


@pytest.mark.usefixtures("whole_search")
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
        walk(Gaussian(), pool, ChainMemory())


def test_autocorrelation_time_of_an_ar1_process():
    rng, a = np.random.default_rng(0), 0.9
    x = np.zeros((20000, 8, 1))
    for i in range(1, len(x)):
        x[i] = a * x[i - 1] + rng.standard_normal((8, 1))
    assert autocorrelation_times(x)[0] == pytest.approx((1 + a) / (1 - a), rel=0.1)
    assert burn_in(x) == pytest.approx(57, abs=6)
    assert rank_r_hat(x)[0] == pytest.approx(1.0, abs=0.01)


def vehtari(chain):
    """R-hat of one parameter (steps, walkers), eqs. 1-4, 14 and section 4 of Vehtari+ 2021, written out."""
    half = len(chain) // 2
    parts = np.concatenate([chain[:half], chain[-half:]], axis=1)

    def of_ranks(values):
        z = norm.ppf((rankdata(values).reshape(values.shape) - 0.375) / (values.size + 0.25))
        between = half * z.mean(axis=0).var(ddof=1)
        within = z.var(axis=0, ddof=1).mean()
        return np.sqrt(((half - 1) / half * within + between / half) / within)

    return max(of_ranks(parts), of_ranks(np.abs(parts - np.median(parts))))


def test_r_hat_is_the_rank_normalised_one():
    """Walkers in two places, of two widths, with a heavy tail, and alike: all that the classical one cannot tell."""
    rng = np.random.default_rng(0)
    x = rng.standard_normal((301, 8, 4))
    x[:, 4:, 0] += 30
    x[:, 4:, 1] *= 3
    x[..., 2] = rng.standard_cauchy((301, 8)) + np.arange(8)
    result = rank_r_hat(x)
    assert result == pytest.approx([vehtari(column) for column in np.moveaxis(x, 2, 0)], rel=1e-9)
    assert (result[:3] > 1.1).all()
    assert result[3] < 1.02


def test_where_nothing_can_be_judged_nothing_has_converged():
    x = np.random.default_rng(0).standard_normal((1000, 4, 2))
    still = np.broadcast_to(x[0], x.shape)
    assert Convergence(x, 0, 50, 1.02)
    for chain in (x[:2], x[:, :1], x[:0]):
        assert np.isnan(rank_r_hat(chain)).all()
        assert not Convergence(chain, 0, 50, 1.02)
    for chain in (still, np.ones_like(x)):
        assert np.isnan(autocorrelation_times(chain)).all()
        assert "too little" in Convergence(chain, 0, 50, 1.02).missing(["a", "b"])
    one_still = np.concatenate([x[..., :1], 0 * x[..., :1]], axis=2)
    assert rank_r_hat(one_still)[0] < 1.02
    assert np.isnan(rank_r_hat(one_still)[1])
    assert not Convergence(one_still, 0, 50, 1.02)


def test_the_rule_says_what_is_missing():
    x = np.random.default_rng(0).standard_normal((1000, 8, 2))
    assert Convergence(x, 0, 50, 1.02).missing("ab") == ""
    assert "8000 are wanted" in Convergence(x, 0, 8000, 1.02).missing("ab")
    assert "900 steps after learning" in Convergence(x, 100, 8000, 1.02).missing("ab")
    assert "not stable" in Convergence(x[:450], 400, 5, 1.02).missing("ab")  # nothing to compare with
    x[:, 4:, 1] += 30
    apart = Convergence(x, 0, 50, 1.02)
    assert (apart.span > 50, apart.is_stable, bool(apart)) == (True, True, False)
    assert apart.missing(["one", "two"]) == f"R-hat is not below 1.02 for two ({vehtari(x[..., 1]):.3g})"


def test_any_executor_evaluates_and_is_left_running():
    toy = Gaussian(cut=True)
    points = np.random.default_rng(0).standard_normal((20, 3))
    with ThreadPoolExecutor(2) as mine:
        with Workers({"full": toy}, mine) as workers:
            outcome = workers.evaluate(points)
        assert mine.submit(int).result() == 0
    assert [result.lnp for result in outcome] == [toy.evaluate(point).lnp for point in points]
    assert workers.calls["full"] == 20
    assert workers.reasons["full"]["no stream on this side"] == sum(points[:, 0] < MEAN[0])


def test_processes_are_forked_before_any_thread_is_started(monkeypatch, capsys):
    """A fork copies no thread but its own, and whatever locks the others held stay locked for ever."""
    before, forks, fork = set(threading.enumerate()), [], os.fork

    def watched():
        forks.append(set(threading.enumerate()) - before)
        return fork()

    monkeypatch.setattr(os, "fork", watched)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    toy = Gaussian()
    with Workers({"full": toy, "cheap": toy}, 2) as workers:
        walk(toy, workers, ChainMemory(), progress=True, walkers=8, steps=3)
        names = {type(thread).__name__ for thread in set(threading.enumerate()) - before}
    assert forks == [set(), set()]
    assert "TMonitor" not in names
    assert "3/3" in capsys.readouterr().err


def test_stuck_walkers_are_recognised():
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


@pytest.mark.slow  # test_a_gaussian_is_recovered has the same moves, all in turn
@pytest.mark.parametrize("name", ["de", "stretch"])
def test_every_move_alone_samples_a_gaussian_whatever_the_units(name):
    """Standard deviations within 6 %, for parameters whose scales differ by 10^8 (snooker: off by 15 %)."""
    scale = np.array([1.0, 1e8, 1e-2, 30.0])
    for move, _ in proposals(name, Space(OfPriors([Uniform(-1e12, 1e12)] * 4))):
        sampler = emcee.EnsembleSampler(
            80, 4, lambda x: -0.5 * (x**2 / scale**2).sum(axis=1), moves=move, vectorize=True
        )
        start = scale * np.random.default_rng(2).standard_normal((80, 4))
        state = emcee.State(start, random_state=np.random.RandomState(3).get_state())
        sampler.run_mcmc(state, 2000)
        result = sampler.get_chain(discard=250, flat=True)
        np.testing.assert_allclose(result.std(axis=0) / scale, 1.0, atol=0.06)
        assert sampler.acceptance_fraction.mean() > 0.05


def test_a_worker_that_does_not_know_a_class_says_what_to_do():
    """The pickle of a class that is in no module of the worker's."""
    with pytest.raises(sk.PluginError, match=r"a worker cannot find .*under plugins in the run file"):
        evaluate_sent(b"cno_such_module\nPosterior\n.", "full", np.zeros(1))


class Scarce(Gaussian):
    """Hardly any stream, and each takes its time."""

    def evaluate(self, theta):
        sleep(1e-3)
        rejected = Evaluation(-np.inf, -np.inf, np.full(2, np.nan), np.full(2, np.nan), "no stream here")
        return super().evaluate(theta) if theta[0] > 19.9 and theta[1] > 19 else rejected


@pytest.mark.usefixtures("whole_search")
def test_a_time_limit_ends_a_search_that_finds_nothing(monkeypatch):
    monkeypatch.setattr("streamkit.sample.calls.search.GRACE", 0.3)
    posterior, begin = Scarce(), monotonic()
    search = Search(
        PRIORS, lambda points, _: [posterior.evaluate(p) for p in points], 24, np.random.default_rng(1), begin + 0.2
    )
    with pytest.raises(sk.StreamkitError, match=r"found no place to start in \d+ s: of \d+ draws .*no stream here"):
        search.run()
    assert monotonic() - begin < 1.5


class Corner(Gaussian):
    """A stream in one of 4000 parts of the prior, as where the domains of several files meet; the Gaussian is there."""

    def evaluate(self, theta):
        rejected = Evaluation(-np.inf, -np.inf, np.full(2, np.nan), np.full(2, np.nan), "outside")
        return super().evaluate(theta) if (np.abs(theta) < self.half).all() else rejected


@pytest.mark.usefixtures("whole_search")
def test_a_start_is_found_where_one_draw_in_4000_has_a_stream():
    posterior = Corner()
    low, high = np.array([prior.support for prior in PRIORS]).T
    posterior.half = 0.5 * (high - low).min() * 4000 ** (-1 / len(PRIORS))
    search = Search(PRIORS, lambda points, _: [posterior.evaluate(p) for p in points], 24, np.random.default_rng(2))
    points, found = search.run()
    assert search.calls > 8192
    assert (np.abs(points) < posterior.half).all()
    assert len({point.tobytes() for point in points}) == len(found) == 24
