"""Two populations on joint posteriors of many factors, against answers in closed form."""

import numpy as np
import pytest
from joints import HalfEmpty, LinearFactors, Mixture
from scipy.stats import norm

from streamkit.builtin.samplers.emulator.judge.reach import unreached
from streamkit.builtin.samplers.emulator.places import by_width
from streamkit.builtin.samplers.emulator.walk import populations
from streamkit.builtin.samplers.emulator.walk.agreement import Walked, agreement
from streamkit.builtin.samplers.emulator.walk.agreement import judge as judged
from streamkit.builtin.samplers.emulator.walk.density import Layout, Terms
from streamkit.builtin.samplers.emulator.walk.following import Following
from streamkit.builtin.samplers.emulator.walk.mixture import Mixture as BlockMixture
from streamkit.builtin.samplers.emulator.walk.moves import Moves
from streamkit.builtin.samplers.emulator.walk.populations import sample
from streamkit.errors import StreamkitError

pytestmark = pytest.mark.usefixtures("short_walks")
MEAN, WIDTH, WEIGHT = 0.15, 0.15, 0.06  # standard deviations; fractions; of a mode
COSTLY = 25_000  # evaluations of each factor to 1000 independent samples


def assert_right(samples: np.ndarray, mean: np.ndarray, covariance: np.ndarray) -> None:
    """Compare means and widths of all coordinates and of all principal axes of the answer."""
    variances, axes = np.linalg.eigh(covariance)
    for found, centre, sd in (
        (samples, mean, np.sqrt(np.diag(covariance))),
        (samples @ axes, mean @ axes, np.sqrt(variances)),
    ):
        np.testing.assert_allclose((found.mean(axis=0) - centre) / sd, 0.0, atol=MEAN)
        np.testing.assert_allclose(found.std(axis=0) / sd, 1.0, atol=WIDTH)


@pytest.mark.parametrize(
    ("factors", "own"),
    [
        (2, 3),
        *(pytest.param(*each, marks=pytest.mark.slow) for each in ((1, 0), (1, 5), (4, 5), (12, 5))),
        pytest.param(30, 9, marks=[pytest.mark.slow, pytest.mark.timeout(1200)]),  # minutes on an idle core
    ],
)
def test_gaussian_factors(factors: int, own: int) -> None:
    target = LinearFactors(factors, own=own)
    found = sample(target, target.begin(3), [1])
    assert found.agree, (found.r_hat, found.time)
    assert_right(found.samples, *target.answer())
    per_sample = 4 * len(found.samples) / found.independent
    assert 1000 * per_sample < COSTLY


def test_a_walk_of_few_autocorrelation_times_starts_anew_with_other_moves(monkeypatch) -> None:
    """What it walked until then is no part of the samples: moves may not depend on these."""
    target, walked = LinearFactors(2, own=2), []

    def judge(layout: Layout, walk: np.ndarray) -> Walked:
        """As it is, but before the new start as long as the walk."""
        anew = bool(walked) and (len(walk) < len(walked[-1]) or not np.isin(walk[0], walked[0]).all())
        walked.append(walk)
        found = judged(layout, walk)
        return found if anew else found._replace(time=float(len(walk)))

    monkeypatch.setattr(populations, "judge", judge)
    found = sample(target, target.begin(3), [1])
    assert found.agree
    assert_right(found.samples, *target.answer())
    before = [each for each in walked if np.isin(each[0], walked[0]).all()]
    assert len(before[-1]) >= populations.LONG * populations.FIRST_OF_SEVERAL
    assert not np.isin(found.samples, before[-1]).any()


def test_trajectories_along_the_surface_leave_a_gaussian_as_it_is() -> None:
    """With the exact residuals of a Gaussian the surface is flat: nearly all are accepted, and far."""
    target, rng = LinearFactors(3, own=2), np.random.default_rng(1)
    mean, covariance = target.answer()
    z = rng.multivariate_normal(mean, covariance, 2000)
    moves = Moves(target.layout, z, rng)
    moved, terms = moves._follow_surface(target, z, target.terms(z), 1.0, rng)
    assert moves.rates[3] > 0.85
    assert_right(moved, mean, covariance)
    np.testing.assert_allclose(terms.total(1.0), target.terms(moved).total(1.0))


class Bent:
    """Own coordinates on a parabola, and wide where it is high."""

    layout = Layout(np.array([0]), [np.array([1, 2])])

    @staticmethod
    def drawn(n: int, rng: np.random.Generator) -> np.ndarray:
        h = rng.standard_normal(n)
        return np.stack([h, *(h**2 + np.exp(0.4 * h) * rng.standard_normal((2, n)))], axis=1)

    def terms(self, z: np.ndarray) -> Terms:
        h, own = z[:, :1], z[:, 1:]
        prior = np.concatenate([-0.5 * h**2, np.zeros_like(h)], axis=1)
        return Terms(prior, np.sum(-0.5 * ((own - h**2) * np.exp(-0.4 * h)) ** 2 - 0.4 * h, axis=1, keepdims=True))


def test_own_coordinates_follow_along_a_bend_and_with_other_widths() -> None:
    rng, target = np.random.default_rng(1), Bent()
    z = begin = target.drawn(4000, rng)
    moves = Moves(target.layout, z, rng, draws=False, follows=False)
    terms = target.terms(z)
    for _ in range(20):
        z, terms = moves.sweep(target, z, terms, 1.0, rng, follow=False)
    assert moves.rates[0] > 0.9  # 0.6 along a straight line
    for power in (1, 2, 3):
        error = np.std(begin**power, axis=0) / np.sqrt(len(z))
        np.testing.assert_array_less(np.abs(np.mean(z**power, axis=0) - np.mean(begin**power, axis=0)), 6 * error)
    assert np.abs(np.corrcoef(z[:, 0], begin[:, 0])[0, 1]) < 0.1
    straight = Following.of(z[:100, :1], z[:100, 1:])
    assert straight.slopes is None
    assert straight.degree == 1


def test_own_coordinates_that_do_not_bend_follow_a_straight_line() -> None:
    h, own = np.random.default_rng(1).standard_normal((2, 4000, 3))
    found = Following.of(h, own + h)
    assert found.slopes is None
    np.testing.assert_allclose(found.at(h), h, atol=0.2)


def test_a_mixture_of_fewer_places_than_parameters_has_a_component() -> None:
    rng = np.random.default_rng(1)
    places = rng.standard_normal((20, 30))
    new, _ = BlockMixture.of(places, rng).step(places, np.full(20, 0.5), rng)
    assert np.isfinite(new).all()


class TwoModes:
    """A stream with two modes of its own parameters, one with a tenth of it, and a stream of one shared parameter."""

    layout = Layout(np.array([0]), [np.arange(1, 5), np.empty(0, dtype=np.int64)])
    centres, widths, weights = (0.0, 1.5), (0.05, 0.3), (0.9, 0.1)

    def draws(self, n: int, rng: np.random.Generator, mode: int | None = None) -> np.ndarray:
        which = rng.choice(2, size=n, p=self.weights) if mode is None else np.full(n, mode)
        own = np.take(self.centres, which)[:, None] + np.take(self.widths, which)[:, None] * rng.normal(size=(n, 4))
        return np.column_stack([rng.normal(size=n), own])

    def terms(self, z: np.ndarray) -> Terms:
        modes = [np.log(weight) + norm(centre, width).logpdf(z[:, 1:]).sum(axis=1)
                 for centre, width, weight in zip(self.centres, self.widths, self.weights, strict=True)]  # fmt: skip
        prior = -0.5 * np.stack([z[:, 0] ** 2, np.sum(z[:, 1:] ** 2, axis=1), np.zeros(len(z))], axis=1)
        return Terms(prior, np.stack([np.logaddexp(*modes) - prior[:, 1], np.zeros(len(z))], axis=1))


def test_own_parameters_come_from_one_mode_to_another() -> None:
    """Draws of all coordinates are made no more here, as of many streams none is accepted."""
    target, rng, second = TwoModes(), np.random.default_rng(1), []
    moves = Moves(target.layout, target.draws(2000, rng), rng, draws=False)
    z = target.draws(400, rng, mode=1)
    terms = target.terms(z)
    for _ in range(200):
        z, terms = moves.sweep(target, z, terms, 1.0, rng, follow=False)  # type: ignore[arg-type]
        second.append(np.mean(z[:, 1] > 0.75))
    assert np.mean(second[100:]) == pytest.approx(0.1, abs=0.03)
    np.testing.assert_allclose(terms.total(1.0), target.terms(z).total(1.0))


def test_walkers_reach_a_posterior_from_beside_it_and_no_other_mode() -> None:
    """From ten standard deviations beside one mode of two; the other one has 40 % of the samples."""
    rng = np.random.default_rng(4)
    target = Mixture(1, shared=0, own=6, data=12, apart=12.0, weight=0.4)
    (weights, means, covariances) = target.modes()
    modes = [rng.multivariate_normal(*each, 1000) for each in zip(means, covariances, strict=True)]
    direction = np.linalg.eigh(covariances[0])[1][:, -1] * 10 * np.sqrt(np.linalg.eigvalsh(covariances[0])[-1])
    begin = modes[0][:200] + direction
    assert unreached(target, begin, modes[0], [1]) < 0.03
    both = np.concatenate([modes[0][: int(1000 * weights[0])], modes[1][: int(1000 * weights[1])]])
    assert unreached(target, begin, both, [1]) == pytest.approx(weights[1], abs=0.03)
    assert unreached(target, np.concatenate([begin, modes[1][:200]]), both, [1]) < 0.03


def test_half_of_the_calls_are_where_the_width_is_decided() -> None:
    """Of a normal distribution: beyond 2 are 4.55 % of the samples, and 26.1 % of the variance."""
    z = np.random.default_rng(1).standard_normal((200_000, 1))
    beyond = 2 * (norm.sf(2) + 2 * norm.pdf(2))  # of the variance: the integral of z^2
    drawn = by_width(z, np.random.default_rng(2))
    assert np.mean(np.abs(drawn[:5000]) > 2) == pytest.approx(0.5 * 2 * norm.sf(2) + 0.5 * beyond, abs=0.02)
    assert np.array_equal(np.sort(drawn[:, 0]), np.sort(z[:, 0]))


def test_the_terms_are_those_of_the_samples() -> None:
    target = LinearFactors(3, own=2)
    found = sample(target, target.begin(3), [1], walkers=100, most_sweeps=5)
    some = slice(0, None, 97)
    expected = target.terms(found.samples[some])
    for kept, again in zip(found.terms, expected, strict=True):
        np.testing.assert_allclose(kept[some], again, atol=1e-12)


def test_one_posterior_without_shared_coordinates() -> None:
    target = LinearFactors(1, shared=0, own=6)
    assert target.layout.size == Layout.of_one(6).size == 6
    found = sample(target, target.begin(3), [1])
    assert found.agree
    assert_right(found.samples, *target.answer())


def test_a_stream_that_says_nothing_and_one_without_own_parameters() -> None:
    target = LinearFactors(4, own_of=[3, 3, 0, 2])
    target.host[1][:], target.mine[1][:] = 0.0, 0.0
    found = sample(target, target.begin(3), [1])
    assert found.agree
    mean, covariance = target.answer()
    assert np.diag(covariance)[target.layout.own[1]] == pytest.approx(1.0)  # its prior
    assert_right(found.samples, mean, covariance)


def test_streams_in_conflict() -> None:
    target = LinearFactors(3, own=3, strength=6.0)
    shift = np.full(4, 3.0)  # the second stream wants a host many of its standard deviations from that of the first
    target.data[1] = target.data[1] + target.host[1] @ shift
    found = sample(target, target.begin(3), [1])
    mean, covariance = target.answer()
    only = np.linalg.inv(np.eye(4) + target.host[0].T @ target.host[0])
    assert np.abs(mean[:4] @ np.linalg.inv(np.linalg.cholesky(only)).T).max() > 3
    assert found.agree
    assert_right(found.samples, mean, covariance)


def test_a_nuisance_that_two_of_three_streams_share() -> None:
    target = LinearFactors(3, own=3, reads=[(0, 1), (1, 2), (2, 3)])
    found = sample(target, target.begin(3), [1])
    assert found.agree
    assert_right(found.samples, *target.answer())


@pytest.mark.parametrize(
    ("weight", "seed"), [(0.15, 1), *(pytest.param(*each, marks=pytest.mark.slow) for each in ((0.15, 9), (0.5, 1)))]
)
def test_a_mode_in_one_stream_only(weight: float, seed: int) -> None:
    """With a weight of 0.15 its narrow mode holds two walkers of a thousand at middle temperatures."""
    target = Mixture(3, own=3, weight=weight)
    found = sample(target, target.begin(3), [seed])
    weights, means, covariances = target.modes()
    away = [
        np.sum((found.samples - mean) @ np.linalg.inv(covariance) * (found.samples - mean), axis=1)
        for mean, covariance in zip(means, covariances, strict=True)
    ]
    second = away[1] < away[0]
    assert weights[1] == pytest.approx(weight)
    assert found.agree
    assert second.mean() == pytest.approx(weights[1], abs=WEIGHT)
    assert_right(found.samples[~second], means[0], covariances[0])
    assert_right(found.samples[second], means[1], covariances[1])


def test_a_stream_without_predictions_in_half_of_the_hosts_space() -> None:
    target = HalfEmpty(2, own=2, strength=1.0)
    mean, covariance = target.answer()
    found = sample(target, target.begin(3), [1])
    sd = np.sqrt(covariance[0, 0])
    edge = -mean[0] / sd
    hazard = norm.pdf(edge) / norm.sf(edge)
    assert 0.05 < norm.cdf(edge) < 0.95  # a Gaussian cut at zero
    assert found.agree
    assert found.samples[:, 0].min() > 0
    assert found.samples[:, 0].mean() == pytest.approx(mean[0] + sd * hazard, abs=MEAN * sd)
    width = sd * np.sqrt(1 + edge * hazard - hazard**2)
    assert found.samples[:, 0].std() == pytest.approx(width, rel=WIDTH)


def test_populations_in_different_places_do_not_agree() -> None:
    """R-hat of two Gaussians, c standard deviations apart, is about (1 + c^2 / 4)^(1/2); and widths count too."""
    rng = np.random.default_rng(1)
    walks = rng.standard_normal((2, 100, 64, 2))
    assert agreement(walks) < 1.002
    apart = walks.copy()
    apart[1, ..., 0] += 0.4
    assert agreement(apart) == pytest.approx(np.sqrt(1 + 0.04 * 4 / 3), abs=0.01)  # four half chains, two means
    wider = walks.copy()
    wider[1, ..., 1] *= 1.5
    assert agreement(wider) > 1.01


def test_a_walk_that_is_too_short_is_told() -> None:
    target = LinearFactors(2, own=3)
    found = sample(target, target.begin(3), [1], walkers=100, most_sweeps=5)
    assert found.sweeps == 5
    assert not found.agree


def test_the_same_seed_gives_the_same_samples_and_another_one_others() -> None:
    target = LinearFactors(2, own=2)
    first, again, other = (
        sample(target, target.begin(3), [seed], walkers=100, most_sweeps=5).samples for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_no_place_to_begin_from_is_told() -> None:
    target = HalfEmpty(2, own=2)
    y = -np.abs(target.begin(3)[0])
    with pytest.raises(StreamkitError, match="of 640 places to begin from only 0 have a probability"):
        sample(target, (y, y), [1])
