"""Streams that are known already are tested by calls held out of what is learned, against joint posteriors."""

from dataclasses import replace

import numpy as np
import pytest
from joints import LinearFactors, factors_of

from streamkit.builtin.samplers.emulator.at_once import in_turn
from streamkit.builtin.samplers.emulator.certificate import MOVED, trend_of
from streamkit.builtin.samplers.emulator.judge import together
from streamkit.builtin.samplers.emulator.judge.held_out import LEAST, PART, held_out
from streamkit.builtin.samplers.emulator.known import Known
from streamkit.builtin.samplers.emulator.learn.calls import Calls
from streamkit.builtin.samplers.emulator.learn.space import Space
from streamkit.builtin.samplers.emulator.rounds import Rounds
from streamkit.builtin.samplers.emulator.tilt import tilt
from streamkit.builtin.samplers.emulator.walk.density import Emulated

pytestmark = pytest.mark.usefixtures("short_walks")
OWN_OF = [2, 2, 0]


def known_of(target: LinearFactors, learned: np.ndarray, noise: float, seed: int) -> list[Known]:
    """What is known of all factors after calls at places (n, d)."""
    known = []
    for factor in factors_of(target, noise=noise, seed=seed):
        calls = Calls.at(factor.problem, Space(factor.problem), learned[:, factor.columns])
        emulated = Emulated(calls.space, calls.learn(tilt(factor, learned, calls.z)), False)
        known.append(Known(factor, calls, emulated, [], 0.0, is_confirmed=True))
    return known


def drawn(target: LinearFactors, n: int, seed: int, widened: float = 1.0) -> np.ndarray:
    mean, covariance = target.answer()
    return np.random.default_rng(seed).multivariate_normal(mean, widened * covariance, size=n)


def test_a_quarter_of_the_calls_at_the_posterior_is_held_out() -> None:
    target = LinearFactors(3, own_of=OWN_OF)
    samples = drawn(target, 3000, seed=1)
    learned = np.concatenate([drawn(target, 500, seed=2), drawn(target, 500, seed=3, widened=16.0)])
    known = known_of(target, learned, noise=0.3, seed=1)
    known[1].is_confirmed = False
    first, second, _ = held_out(known, samples, samples, in_turn, np.random.default_rng(4))
    assert second is None  # it is called anew
    columns = known[0].factor.columns
    mean, covariance = target.answer()
    away = first.calls.z - mean[columns]
    squares = np.sum(away @ np.linalg.inv(covariance[np.ix_(columns, columns)]) * away, axis=1)
    # 98 of 100 samples of six Gaussian coordinates are within 15.0; most of the wide calls are beyond it.
    assert np.quantile(squares, 0.95) < 15.0
    assert 480 / PART < len(first.calls) < 700 / PART
    others = known[0].calls.take(~np.isin(known[0].calls.theta[:, 0], first.calls.theta[:, 0]))
    assert len(others) == 1000 - len(first.calls)
    alone = others.learn(tilt(known[0].factor, samples, others.z))
    np.testing.assert_array_equal(first.emulated.emulator.mean.whole, alone.mean.whole)


def test_calls_that_are_few_or_elsewhere_do_not_test() -> None:
    target = LinearFactors(3, own_of=OWN_OF)
    samples, learned = drawn(target, 3000, seed=1), drawn(target, PART * LEAST + 100, seed=2)
    sd = samples.std(axis=0)

    def found(places: np.ndarray) -> list[bool]:
        known = known_of(target, places, noise=0.3, seed=1)
        return [each is not None for each in held_out(known, samples, samples, in_turn, np.random.default_rng(4))]

    assert found(learned) == [True, True, True]
    assert found(learned[: PART * LEAST - 50]) == [False, False, False]
    assert found(np.concatenate([learned, learned]) + 2 * sd) == [False, False, False]


def test_right_emulators_are_seldom_refused_together_and_wrong_ones_are() -> None:
    """The noise of the calls that were learned from is no fault: by chance one of twenty tests says so."""
    target, shift = LinearFactors(3, own_of=OWN_OF), 0.5
    samples, host = drawn(target, 2000, seed=1), target.layout.shared
    sd = samples.std(axis=0)[0]
    refused, moved = [], []
    for seed in range(8):
        known = known_of(target, drawn(target, 600, seed=100 + seed), noise=0.1, seed=seed)
        rng = np.random.default_rng(seed)
        held = held_out(known, samples, samples, in_turn, rng)
        trend, _ = together.tested_together(known, held, samples, host, 4000, rng)
        refused.append(trend.measured > max(MOVED, trend.by_chance))
        assert [len(each.calls) for each in known] == [600, 600, 600]  # no call is made
        assert [each.certificate.held_out for each in known] == [len(each.calls) for each in held]
        # All calls that test are those of a host whose first coordinate is smaller.
        for k, each in enumerate(held):
            mean = each.calls.answers.mean + shift * sd * target.host[k][:, 0]
            answers = each.calls.answers._replace(mean=mean)
            held[k] = replace(each, calls=replace(each.calls, answers=answers))
        trend, faults = together.tested_together(known, held, samples, host, 4000, rng)
        assert trend.measured > max(MOVED, trend.by_chance)
        assert "all streams together" in faults[-1]
        moved.append(trend.measured)
    assert sum(refused) <= 2  # 0.4 are expected
    assert np.mean(moved) == pytest.approx(shift, rel=0.2)  # the prior of the host has little to say


def test_the_noise_of_the_calls_that_were_learned_from_counts_by_their_number() -> None:
    """Of a linear model, m calls that test and n that were learned from leave variances of 1 / m and 1 / n."""
    target = LinearFactors(3, own_of=OWN_OF)
    samples, learned = drawn(target, 2000, seed=1), drawn(target, 600, seed=2)
    rng = np.random.default_rng(3)
    for are_held in (True, False):
        known = known_of(target, learned, noise=0.1, seed=1)
        held = held_out(known, samples, samples, in_turn, rng) if are_held else [None] * len(known)
        trend, _ = together.tested_together(known, held, samples, target.layout.shared, 4000, rng)
        test = np.mean([each.certificate.calls for each in known])
        left = len(learned) - (test if are_held else 0)
        assert trend.by_chance / trend.by_calls == pytest.approx(np.sqrt(1 + test / left), rel=0.1)
    for each in known:
        assert each.certificate.trend_by_chance > trend_of_calls(each, samples)


def trend_of_calls(each: Known, samples: np.ndarray) -> float:
    """What chance makes of the calls that test alone."""
    calls = each.calls.take(np.arange(len(each.calls)) >= len(each.calls) - each.certificate.calls)
    mine = samples[:, each.factor.columns]
    return trend_of(each.emulated, calls, mine, np.random.default_rng(1), 1 - together.LEVEL / 3).by_calls


@pytest.mark.slow
@pytest.mark.parametrize("streams", [2, 3])
def test_no_stream_of_an_earlier_run_is_called(streams: int) -> None:
    """Two of them have 1500 calls near the posterior, as by an earlier run, and a third one has none."""
    target, learned = LinearFactors(streams, own=2), drawn(LinearFactors(streams, own=2), 1500, seed=2, widened=2.0)
    factors = factors_of(target, noise=0.2, seed=1)
    for k in range(2):
        factors[k] = replace(factors[k], earlier=learned[:, factors[k].columns])
    *_, last = Rounds(factors, False).run(3000)
    assert last.missing == ""
    assert [len(each.calls) for each in last.known[:2]] == [1500, 1500]
    assert [each.certificate.held_out > 0 for each in last.known] == [True, True, False][:streams]
    mean, covariance = target.answer()
    samples, sd = last.populations.samples, np.sqrt(np.diag(covariance))
    np.testing.assert_allclose((samples.mean(axis=0) - mean) / sd, 0.0, atol=0.2)
    np.testing.assert_allclose(samples.std(axis=0) / sd, 1.0, atol=0.15)
