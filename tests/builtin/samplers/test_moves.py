"""The moves on densities known in closed form or by quadrature: a wrong acceptance factor would fail."""

import math
from dataclasses import replace

import emcee
import numpy as np
import pytest
from scipy import stats
from toys import MEAN, Banana, Gaussian, Heavy, Many, OfPriors, banana_run
from toys import walk as walk_toy

import streamkit as sk
from streamkit.builtin.samplers.ensemble import learner, learning
from streamkit.builtin.samplers.ensemble.called import learn
from streamkit.builtin.samplers.ensemble.coordinates import Space
from streamkit.builtin.samplers.ensemble.learning import LEAST_STEPS, learning_steps
from streamkit.builtin.samplers.ensemble.moves import (
    INVERSE_TEMPERATURES,
    LAST_INVERSE_TEMPERATURE,
    SurrogateMove,
    proposals,
)
from streamkit.convergence import autocorrelation_times
from streamkit.runfile import LogUniform, Normal, TruncatedNormal, Uniform
from streamkit.sample import ChainFile, ChainMemory, Workers, read_chain_file

PRIORS = (
    Uniform(0, 1), Uniform(-1, 1), Normal(1, 2), LogUniform(0.1, 10), TruncatedNormal(0, 1, -0.5, math.inf),
    Uniform(0.5, 8),
)  # fmt: skip
CENTRE, SD, RHO = np.array([0.1, -0.7]), np.array([0.3, 0.6]), 0.7
INVERSE = np.linalg.inv(np.outer(SD, SD) * np.array([[1, RHO], [RHO, 1]]))


LOW, HIGH = np.array([[0, -1, -np.inf, 0.1, -0.5, 0.5], [1, 1, np.inf, 10, np.inf, 8]])


def ln_prior(theta):
    """(n,) The product of these densities at theta (n, 6), up to a constant."""
    inside = ((theta >= LOW) & (theta <= HIGH)).all(axis=1)
    safe = np.where(inside[:, None], theta, 1.0)
    density = -((safe[:, 2] - 1) ** 2) / 8 - np.log(safe[:, 3]) - safe[:, 4] ** 2 / 2
    return np.where(inside, density, -np.inf)


def ln_posterior(theta):
    """A correlated Gaussian cut by two uniform priors, and N(2, 1) times the normal prior."""
    x = theta[:, :2] - CENTRE
    return ln_prior(theta) - 0.5 * np.einsum("ni,ij,nj->n", x, INVERSE, x) - 0.5 * (theta[:, 2] - 2) ** 2


class OffBySigmas:
    """A surrogate: the likelihood with data that are off by more than half a standard error."""

    root = np.linalg.cholesky(INVERSE)

    def ln_likelihood(self, theta):
        away = np.column_stack([(theta[:, :2] - CENTRE) @ self.root, theta[:, 2] - 2]) - [0.6, -0.6, 0.8]
        return -0.5 * (away**2).sum(axis=1)


def drawn(n, seed=8):
    """(n, 6) Places from the prior."""
    rng = np.random.default_rng(seed)
    return np.stack([prior.sample(rng, n) for prior in PRIORS], axis=1)


def sampled(move, ln_density, steps, last=True, walkers=60):
    start = drawn(walkers, 4)
    if isinstance(move, SurrogateMove):
        move.use(OffBySigmas(), drawn(400), 256, seed=7, last=last)
    sampler = emcee.EnsembleSampler(walkers, len(PRIORS), ln_density, moves=move, vectorize=True)
    sampler.run_mcmc(emcee.State(start, random_state=np.random.RandomState(6).get_state()), steps)
    found = sampler.get_chain(discard=steps // 10)
    assert np.isfinite(ln_prior(found[::50].reshape(-1, len(PRIORS)))).all()  # never outside
    return found


def check_moments(chain, expected, precision=0.03):
    """Means of columns (steps, walkers, m) within 4.5 standard errors."""
    flat = chain.reshape(-1, chain.shape[2])
    error = flat.std(axis=0) * np.sqrt(autocorrelation_times(chain) / len(flat))
    assert (error < precision * flat.std(axis=0)).all()
    np.testing.assert_array_less(np.abs(flat.mean(axis=0) - expected) / error, 4.5)


MOVES = [move for move, _ in proposals("surrogate", Space(OfPriors(PRIORS)))]


@pytest.mark.slow
@pytest.mark.parametrize("move", MOVES[1:], ids=["best", "third", "one"])
def test_every_move_alone_samples_the_prior(move):
    found = sampled(move, ln_prior, 4000)
    exact = [
        stats.uniform(0, 1), stats.uniform(-1, 2), stats.norm(1, 2), stats.loguniform(0.1, 10),
        stats.truncnorm(-0.5, np.inf), stats.uniform(0.5, 7.5),
    ]  # fmt: skip
    u = np.stack([density.cdf(found[..., i]) for i, density in enumerate(exact)], axis=2)
    check_moments(u, 0.5)
    check_moments(u**2, 1 / 3)
    check_moments((u < 0.1).astype(float), 0.1)
    check_moments((u > 0.9).astype(float), 0.1)


@pytest.mark.parametrize(
    ("move", "steps", "last"),
    [
        pytest.param(MOVES[0], 150, True, id="surrogate"),
        pytest.param(MOVES[0], 200, False, id="tempered replicas", marks=pytest.mark.slow),
        pytest.param(MOVES[1], 1500, True, id="best", marks=pytest.mark.slow),
        pytest.param(MOVES[2], 1500, True, id="third", marks=pytest.mark.slow),
    ],
)
def test_every_move_alone_samples_a_cut_gaussian(move, steps, last):
    found = sampled(move, ln_posterior, steps, last)
    a, b = np.meshgrid(np.linspace(0, 1, 301), np.linspace(-1, 1, 301), indexing="ij")
    weight = np.exp(ln_posterior(np.stack([a, b, 0 * a + 1, 0 * a + 1, 0 * a, 0 * a + 1], axis=2).reshape(-1, 6)))
    mean = [np.average(value.ravel(), weights=weight) for value in (a, b, a**2, b**2, a * b)]
    x, y, z = found[..., 0], found[..., 1], found[..., 2]
    # N(1, 2) times N(2, 1): precision 1.25, mean (1/4 + 2) / 1.25
    log = np.log(found[..., 3]) / np.log(10)  # uniform between -1 and 1
    flat = (found[..., 5] - 4.25) / 3.75  # walked in its logarithm, and uniform all the same
    values = [x, y, x**2, y**2, x * y, z, (z - 1.8) ** 2, log, log**2, flat, flat**2]
    check_moments(np.stack(values, axis=2), [*mean, 1.8, 0.8, 0, 1 / 3, 0, 1 / 3], 0.05)


def test_an_exchange_gives_the_replica_the_walkers_place(monkeypatch):
    monkeypatch.setattr("streamkit.builtin.samplers.ensemble.moves.EXCHANGES", 1.0)
    (move, _), *_ = proposals("surrogate", Space(OfPriors(PRIORS)))
    move.use(OffBySigmas(), drawn(400), 256, seed=7, last=True)
    here = drawn(8, 4)
    there, _ = move.get_proposal(here, [], np.random.RandomState(1))
    accepted = np.arange(8) % 3 == 0
    state = emcee.State(here.copy(), log_prob=np.zeros(8))
    move.update(state, emcee.State(there, log_prob=np.ones(8)), accepted, np.full(8, True))
    np.testing.assert_array_equal(state.coords, np.where(accepted[:, None], there, here))
    replicas = move.space.back(move.replicas)
    for own, offered, taken in zip(here, there, accepted, strict=True):
        held = [np.isclose(replicas, point).all(axis=1).any() for point in (own, offered)]
        assert held == [taken, not taken]


@pytest.mark.slow
def test_replicas_are_tempered_while_the_surrogate_learns():
    """The third parameter is a Gaussian of variance 1 in the data and 4 in the prior: 1 / (1/4 + beta)."""
    (move, _), *_ = proposals("surrogate", Space(OfPriors(PRIORS)))
    for last in (False, True):
        move.use(OffBySigmas(), drawn(400), 256, seed=7, last=last)
        z = move.replicas[:, 2]
        for i, beta in enumerate(INVERSE_TEMPERATURES):
            expected = 1 / (0.25 + (LAST_INVERSE_TEMPERATURE if last else beta))
            found = np.var(z[i :: len(INVERSE_TEMPERATURES)])
            assert found == pytest.approx(expected, rel=0.6)  # 85 of them: 0.15 standard errors


class Walked:
    """A target whose chain has one step of many walkers, at places uniform between -2 and 2."""

    size, seed, data = 3, 5, Banana.data

    def __init__(self, toy, n):
        self.points = np.random.default_rng(2).uniform(-2, 2, (n, 3))
        found = [toy.evaluate(point) for point in self.points]
        self.lnl = np.array([each.ln_likelihood for each in found])
        mean, variance = (np.array([getattr(each, name) for each in found]) for name in ("mean", "variance"))
        self.found = sk.Evaluations(self.lnl, self.lnl, mean, variance, ("",) * n)

    def chain(self):
        return self.points[None]

    def chain_evaluations(self):
        return self.found

    def from_unit(self, u):
        return 6 * np.asarray(u) - 3

    def ln_prior(self, points):
        return np.where((np.abs(points) <= 3).all(axis=1), -3 * np.log(6), -np.inf)


NOWHERE = np.empty((0, 3))


@pytest.mark.parametrize(("toy", "subject"), [(Banana(), "the observables"), (Heavy(), "ln likelihood")])
def test_the_likelihood_is_learned_from_the_places_of_the_walkers(toy, subject):
    target = Walked(toy, 400)
    surrogate, places, found = learn(target, 1, NOWHERE)
    assert found == subject
    assert len(places) == 400
    theta = np.random.default_rng(3).uniform(-1.5, 1.5, (300, 3))
    exact = np.array([toy.ln_likelihood(point) for point in theta])
    off = surrogate.ln_likelihood(theta) - exact
    near = exact > -4
    assert np.std(off[near]) < (0.05 if toy.__class__ is Banana else 0.3)


def test_where_there_was_no_prediction_the_surrogate_is_lower():
    """Half of the space has none: proposals there were refused."""
    target, refused = Walked(Banana(), 400), np.random.default_rng(4).uniform([-2, -2, -2], [0, 2, 2], (200, 3))
    target.points[:, 0] = np.abs(target.points[:, 0])
    mean = np.array([Banana().mean(point) for point in target.points])
    lnl = np.array([Banana().ln_likelihood(point) for point in target.points])
    target.found = replace(target.found, mean=mean, ln_likelihood=lnl)
    inside, outside = ([[x, 0.2, 1.0]] * np.ones((1, 3)) for x in (1.0, -1.0))
    (knows, _, _), (whole, _, _) = (learn(target, 1, places) for places in (refused, NOWHERE))
    assert abs(knows.ln_likelihood(inside) - whole.ln_likelihood(inside)) < 0.5
    assert knows.ln_likelihood(outside) < whole.ln_likelihood(outside) - 2


def test_too_little_to_learn_from():
    assert learn(Walked(Banana(), 3), 1, NOWHERE) is None
    still = Walked(Banana(), 40)
    still.points[:] = still.points[0]
    assert learn(still, 1, NOWHERE) is None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("toy", "steps", "subject", "off", "faster"),
    [
        (Banana(), 650, "the observables", 0.06, 0.5),
        (Many(), 650, "the observables", 0.08, 0.7),
        (Heavy(), 750, "ln likelihood", 0.08, 0.7),
    ],
    ids=["curved", "dozens of correlated numbers", "a likelihood of its own"],
)
def test_walks_on_the_surrogate_save_calls_and_keep_the_answer(toy, steps, subject, off, faster):
    """Against differential evolution on the same posterior, and against quadrature."""
    chain, plain = ChainMemory(), ChainMemory()
    banana_run(chain, steps, "surrogate", toy=toy)
    banana_run(plain, 400, "de", toy=toy)
    assert chain.last.counts["facts"] == {"surrogate": subject}
    kept, usual = chain.samples()[LEAST_STEPS:], plain.samples()[100:]
    grid = np.stack(np.meshgrid(*(np.linspace(-3, 3, 41),) * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    weight = np.exp([toy.ln_likelihood(point) for point in grid])
    expected = np.average(np.column_stack([grid, grid**2]), axis=0, weights=weight)
    check_moments(np.concatenate([kept, kept**2], axis=2), expected, off)
    assert autocorrelation_times(kept).max() < faster * autocorrelation_times(usual).max()


@pytest.mark.usefixtures("whole_search")
def test_proposals_without_a_prediction_are_kept_while_the_moves_learn(tmp_path):
    """Two of each step, all where there is no stream, inside the prior; also where the run was interrupted."""
    toy, file = Gaussian(cut=True), ChainFile(tmp_path / "chain.h5")
    for steps in (20, 30):
        with Workers({"full": toy, "cheap": toy}) as pool:
            walk_toy(toy, pool, file, walkers=16, steps=steps, moves="surrogate")
        refused = file.last.memory["refused"]
        assert (refused[:, 1] < MEAN[0]).all()
        assert (np.abs(refused[:, 1:]) <= 20).all()
        assert set(refused[:, 0]) <= set(range(1, steps + 1))
        assert np.unique(refused[:, 0], return_counts=True)[1].max() == 2
        assert len(refused) > steps


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A chain of 70 steps that was not interrupted."""
    file = ChainFile(tmp_path_factory.mktemp("whole") / "chain.h5")
    banana_run(file, 70, "surrogate")
    return file


@pytest.mark.parametrize("stop", [17, pytest.param(60, marks=pytest.mark.slow)])
def test_a_chain_that_learns_is_resumed_bit_for_bit(tmp_path, whole, stop):
    parts = ChainFile(tmp_path / "parts.h5")
    banana_run(parts, stop, "surrogate")
    parts = ChainFile(parts.path)
    parts.load()
    banana_run(parts, 70, "surrogate")
    one, two = (read_chain_file(file.path) for file in (whole, parts))
    for name in ("chain", "log_prob", "blobs"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


def walked(*accepted):
    """A chain in which each part, of so many steps, has so many moved proposals of a hundred walkers."""
    moved = np.concatenate([np.arange(100) < share * 100 for steps, share in accepted for _ in range(steps)])
    return np.cumsum(moved.reshape(-1, 100, 1), axis=0).astype(float)


@pytest.mark.parametrize(
    ("chain", "expected"),
    [
        (walked((30, 0.5)), 400),
        (walked((200, 0.1), (200, 0.5), (300, 0.1)), 400),
        (walked((400, 0.1)), 600),
        (walked((400, 0.1), (200, 0.1), (300, 0.5), (900, 0.1)), 900),
        (walked((3000, 0.1)), 1350),
    ],
)
def test_learning_goes_on_until_enough_is_accepted(chain, expected):
    assert learning_steps("surrogate", chain) == expected
    assert learning_steps("de", chain) == 0


@pytest.mark.slow  # a chain that learns as long as usual is resumed above
def test_a_chain_that_learns_for_longer_is_resumed_bit_for_bit(tmp_path, monkeypatch):
    for module in (learning, learner):
        monkeypatch.setattr(module, "LEARNING", (10, 20, 30, 40, 50))
    monkeypatch.setattr(learning, "LEAST_STEPS", 20)
    monkeypatch.setattr(learning, "ACCEPTED", 0.6)
    whole = ChainFile(tmp_path / "whole.h5")
    banana_run(whole, 70, "surrogate")
    assert 20 < learning_steps("surrogate", whole.samples()) < 50
    for stop in (15, 35, 55):
        parts = ChainFile(tmp_path / f"{stop}.h5")
        banana_run(parts, stop, "surrogate")
        parts = ChainFile(parts.path)
        parts.load()
        banana_run(parts, 70, "surrogate")
        np.testing.assert_array_equal(whole.samples(), parts.samples())
        np.testing.assert_array_equal(whole.last.memory["replicas"], parts.last.memory["replicas"])


def test_a_finished_chain_stays_finished(tmp_path):
    chain = ChainFile(tmp_path / "chain.h5")
    banana_run(chain, 9000, "de", tau_factor=2)
    length = chain.iteration
    assert length < 9000
    for steps in (length, 9000):  # nothing left to do, or more allowed than is needed
        banana_run(chain, steps, "de", tau_factor=2)
        assert chain.iteration == length


@pytest.mark.parametrize(
    "prior", [Uniform(1, 5), Uniform(-1, 5), LogUniform(1, 5), Normal(2, 0.5), TruncatedNormal(2, 0.5, 1, 5)]
)
def test_the_prior_in_the_coordinates_of_the_walks_is_the_prior(prior):
    """Its density in y is that in theta times d theta / d y, up to a constant."""
    space, theta = Space(OfPriors([prior])), np.linspace(1.2, 4.8, 7)[:, None]
    y = space.to(theta)
    wanted = np.array([prior.lnpdf(float(x)) for x in theta[:, 0]]) + space.ln_jacobian(y)
    assert np.ptp(space.ln_prior(y) - wanted) < 1e-12
