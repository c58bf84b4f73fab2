"""The emulator's own error, what changes by chance, and what the emulator has given up though it is not sure there."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from emulated import OfToy
from posteriors import Toy, TwoModes
from scipy.stats import norm

from streamkit.builtin.samplers.emulator.certificate import BLURRED, blur_of, changes_by_trend, trend_of
from streamkit.builtin.samplers.emulator.changes import change_of, real_change_of
from streamkit.builtin.samplers.emulator.judge.remembered import given_up
from streamkit.builtin.samplers.emulator.learn import from_calls
from streamkit.builtin.samplers.emulator.learn.calls import Calls
from streamkit.builtin.samplers.emulator.learn.growth import Growth
from streamkit.builtin.samplers.emulator.learn.space import Space
from streamkit.builtin.samplers.emulator.walk.density import Emulated


class Kinked(Toy):
    """Kinked: what no smooth function follows."""

    box = ((-6.0, 6.0),) * 4
    values, errors = (0.0,) * 4, (1.0,) * 4

    def mean(self, theta):
        theta = np.asarray(theta)
        return theta + np.abs(np.roll(theta, 1, axis=0))


class Overstated(OfToy):
    """States much more noise of the first datum than there is."""

    def evaluate(self, points):
        answers = super().evaluate(points)
        answers.variance[:, 0] = 1.0
        return answers


@pytest.mark.parametrize(
    ("of_toy", "degrees", "worth"),
    [(OfToy, (3,), np.inf), (Overstated, (3,), np.inf), (OfToy, (1, 2), 1.15)],
    ids=["a cubic", "noise of one datum overstated", "a process"],
)
@pytest.mark.parametrize("seed", [1, 2])
def test_the_own_error_is_what_new_calls_show(monkeypatch, seed, of_toy, degrees, worth):
    """By the distance from the middle of the calls: half, 30, 15 and 5 % of the places of new calls."""
    monkeypatch.setattr(from_calls, "DEGREES", degrees)
    monkeypatch.setattr(from_calls, "WORTH", worth)
    problem, rng = of_toy(Kinked(), noise=0.1), np.random.default_rng(seed)
    emulator = Calls.of(problem, Space(problem), rng.normal(size=(500, 4))).learn()
    new = rng.normal(size=(4000, 4))
    predicted, true = emulator.predict(new), problem.toy.mean(new.T).T
    distance = np.sum(((new - emulator.centre) @ emulator.whiten) ** 2, axis=1)
    shells = np.digitize(distance, np.quantile(distance, [0.5, 0.8, 0.95]))
    data = slice(1 if of_toy is Overstated else 0, None)
    for shell in range(4):
        there = shells == shell
        ratio = predicted.fit_variance[there, data].mean() / np.mean((predicted.mean - true)[there, data] ** 2)
        assert 0.5 < ratio < 2.0


def test_the_growth_is_that_of_the_calls_and_is_assumed_beyond_them():
    r2 = np.random.default_rng(1).chisquare(8, 4000)
    growth = Growth.of(r2, 0.3 * r2**1.5, 4)
    assert growth.power == pytest.approx(1.5, abs=0.1)
    assert growth.at(np.minimum(r2, growth.far)).mean() == pytest.approx(1, rel=1e-12)
    inner = r2[(r2 > 0.5 * growth.typical) & (r2 < growth.far)]
    np.testing.assert_allclose(growth.at(inner), inner**1.5 / np.mean(r2**1.5), rtol=0.15)
    assert growth.at(np.array([6.0]))[0] / growth.at(np.array([12.0]))[0] == pytest.approx(0.5**1.5, rel=0.1)
    far = growth.at(np.array([1.0, 2.0, 4.0]) * growth.far)
    np.testing.assert_allclose(far[1:] / far[:-1], 2.0**4)


def test_few_calls_far_outside_do_not_make_the_lack_of_fit_of_the_others_smaller():
    r2 = np.random.default_rng(1).chisquare(8, 4000)
    r2[:100] *= 20
    growth = Growth.of(r2, np.ones(4000), 4)
    np.testing.assert_allclose(growth.at(r2[100:][r2[100:] < growth.far]), 1.0)


@pytest.mark.parametrize(("excess", "power"), [(np.ones(400), 0.0), (-np.ones(400), 0.0)], ids=["even", "chance"])
def test_a_lack_of_fit_that_does_not_grow(excess, power):
    r2 = np.random.default_rng(1).chisquare(8, 400)
    growth = Growth.of(r2, excess, 4)
    assert growth.power == power
    assert np.ptp(growth.at(r2[r2 < growth.far])) == 0
    assert Growth.of(r2, np.where(r2 > np.median(r2), 1.0, 0.0), 4).power == 4


def test_what_the_own_error_changes_is_not_decided_by_one_sample_in_a_thousand():
    z = norm.ppf((np.arange(3000) + 0.5) / 3000)[:, None]

    def blur(taken):
        return blur_of(SimpleNamespace(change_by_error=lambda _: -taken), z)

    assert blur(np.where(z[:, 0] > 0, 0.5, 0.0)) == pytest.approx(np.tanh(0.25) * np.sqrt(2 / np.pi), abs=1e-3)
    assert blur(np.where(z[:, 0] > 3.1, 4.0, 0.0)) < 0.5 * BLURRED  # one in a thousand
    assert blur(np.where(z[:, 0] > 1.5, 5.0, 0.0)) > BLURRED  # one in 15


def test_the_level_of_many_streams_is_kept():
    """Of thirty streams each has a level of 0.998: so many trends by chance are smaller, and not 39 of 40."""
    problem, rng = OfToy(Kinked(), noise=1.0), np.random.default_rng(5)
    space = Space(problem)
    emulated = Emulated(space, Calls.of(problem, space, rng.normal(size=(400, 4))).learn(), noise=False)
    fresh, samples = Calls.of(problem, space, rng.normal(size=(128, 4))), rng.normal(size=(1000, 4))
    tries = changes_by_trend(emulated, fresh, samples, rng, 2000)[1:]
    by_chance = np.array([change_of(samples, each) for each in tries])
    levels = [trend_of(emulated, fresh, samples, rng, 1 - 0.05 / 30).by_chance for _ in range(5)]
    assert np.mean([np.mean(by_chance > level) for level in levels]) < 0.006


def test_what_weights_change_by_chance_is_no_change():
    """Of ln weights that spread by 1.5 and follow no coordinate; and of those that follow one as well, by 0.3 sd."""
    rng, found = np.random.default_rng(4), []
    for _ in range(20):
        samples, loose = rng.normal(size=(1000, 12)), 1.5 * rng.normal(size=1000)
        tilted = loose + 0.3 * samples[:, 0]
        found.append([change_of(samples, loose), *(real_change_of(samples, each, rng) for each in (loose, tilted))])
    by_chance, real, by_tilt = np.mean(found, axis=0)
    assert real < 0.5 * by_chance
    assert by_tilt == pytest.approx(0.3, abs=0.06)
    assert real_change_of(samples, 0.3 * samples[:, 0], rng) == pytest.approx(0.3, abs=0.04)


@pytest.mark.parametrize(("learned", "found"), [(1.0, 0.5), (-9.0, 0.0)], ids=["in one mode", "in both"])
def test_places_of_a_start_where_the_emulator_is_unsure_are_called(learned, found):
    """Two equal modes at x = -2.2 and 1.9; calls beyond x = 1 know one of them, and nothing of the other."""
    problem, rng = OfToy(TwoModes()), np.random.default_rng(1)
    space = Space(problem)
    theta = rng.uniform([-3.0, -1.0, -1.5, -1.0], [3.0, 1.5, 1.5, 2.0], size=(6000, 4))
    lnl = problem.compare(theta, problem.toy.mean(theta.T).T, np.zeros((6000, 4)), None)
    theta = theta[np.log(rng.random(6000)) < lnl - lnl.max()]
    start = Calls.of(problem, space, theta[:400])
    known = Calls.of(problem, space, theta[:400][theta[:400, 0] > learned])
    as_one = [Emulated(space, each.learn(), noise=False) for each in (start, known)]
    state = SimpleNamespace(factor=SimpleNamespace(problem=problem), calls=known, emulated=as_one[1],
                            starts=[SimpleNamespace(places=space.normal(theta), emulated=as_one[0])])  # fmt: skip
    said = given_up(state, rng)
    assert (len(state.calls) > len(known)) == bool(found)
    share = float(re.search(r"find (\d+) %", said)[1]) / 100 if said else 0.0
    assert share == pytest.approx(found, abs=0.15)


def test_an_emulator_that_is_unsure_and_right_has_given_up_nothing():
    """Its own error may bring the predictions nearer to the data, by 5 in ln L, at every other place of a start."""
    problem, rng = OfToy(TwoModes()), np.random.default_rng(1)
    space, theta = Space(problem), rng.uniform([-3.0, -1.0, -1.5, -1.0], [3.0, 1.5, 1.5, 2.0], size=(1000, 4))

    def true(z: np.ndarray) -> np.ndarray:
        at = space.points(z)
        return problem.compare(at, problem.toy.mean(at.T).T, np.zeros((len(at), 4)), None)

    half = np.arange(1000) % 2 == 0
    # as emulated: right, given up at every other place, and there by more than a number can hold above all calls so far
    for lower, below, share in ((0.0, 0.0, 0.0), (8.0, 0.0, 0.5), (8.0, 1e3, 1.0)):
        emulated = SimpleNamespace(
            ln_likelihood=lambda z, low=lower, below=below: true(z) - low * half[: len(z)] - below,
            at_best=lambda z, sigmas, below=below: true(z) + 5.0 * half[: len(z)] - below,
        )
        calls = Calls.of(problem, space, theta[:8])
        calls = replace(calls, answers=calls.answers._replace(ln_likelihood=calls.answers.ln_likelihood - below))
        state = SimpleNamespace(factor=SimpleNamespace(problem=problem), calls=calls, emulated=emulated,
                                starts=[SimpleNamespace(places=space.normal(theta),
                                                        emulated=SimpleNamespace(ln_likelihood=true))])  # fmt: skip
        said = given_up(state, rng)
        assert len(state.calls) > 8
        assert (float(re.search(r"find (\d+) %", said)[1]) / 100 if said else 0.0) == pytest.approx(share, abs=0.1)
