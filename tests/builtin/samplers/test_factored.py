"""The emulator over factors: calls of each stream alone, against joint posteriors in closed form."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from joints import LinearFactors, factors_of
from shortened import take_few_steps

from streamkit.builtin.samplers.emulator import certificate
from streamkit.builtin.samplers.emulator.certificate import Certificate
from streamkit.builtin.samplers.emulator.judge import missing, together
from streamkit.builtin.samplers.emulator.judge.missing import (
    FAR,
    FEW,
    LEFT,
    NOISE,
    SETTLED,
    before_a_test,
    moved_away,
    new_calls,
)
from streamkit.builtin.samplers.emulator.known import Known
from streamkit.builtin.samplers.emulator.learn.calls import Calls
from streamkit.builtin.samplers.emulator.learn.space import Space
from streamkit.builtin.samplers.emulator.rounds import Rounds
from streamkit.builtin.samplers.emulator.walk.density import Emulated

pytestmark = pytest.mark.usefixtures("short_walks")
MEAN, WIDTH = 0.2, 0.15  # standard deviations, fractions


def fit(target, noise=0.3, seed=1, max_calls=3000):
    factors = factors_of(target, noise=noise, seed=seed)
    *_, last = Rounds(factors, False).run(max_calls)
    return last, [each.problem.calls for each in factors]


def assert_right(target, progress) -> None:
    mean, covariance = target.answer()
    samples, sd = progress.populations.samples, np.sqrt(np.diag(covariance))
    np.testing.assert_allclose((samples.mean(axis=0) - mean) / sd, 0.0, atol=MEAN)
    np.testing.assert_allclose(samples.std(axis=0) / sd, 1.0, atol=WIDTH)


def test_two_streams_and_data_of_the_host() -> None:
    target = LinearFactors(3, own_of=[2, 2, 0])
    progress, calls = fit(target, seed=2)  # one of twenty tests is refused by chance, and seed 1 twice
    assert progress.missing == ""
    assert [each.factor.name for each in progress.known] == ["stream 0", "stream 1", "stream 2"]
    assert [len(each.calls) for each in progress.known] == calls
    assert max(each.taught for each in progress.known) < SETTLED  # each was called where the joint posterior is
    assert_right(target, progress)
    assert before_a_test(progress.known, progress.populations.samples, moved=0.0, uncertain=0.0) == ""
    progress.known[1].called_at += 0.55 * progress.known[1].called_at.std(axis=0)
    left = before_a_test(progress.known, progress.populations.samples, moved=0.0, uncertain=0.0)
    assert left == "the posterior has moved away from the last calls of stream 1"
    assert moved_away(progress.known[1], progress.populations.samples) < FAR  # by 0.55 in each coordinate
    first, samples = progress.known[0], progress.populations.samples
    matters = first.factor.problem.coordinates
    assert matters.all()
    first.called_at[:, 0] += 2 * first.called_at[:, 0].std()
    assert moved_away(first, samples) > FAR
    matters[0] = False  # no prediction depends on it
    assert moved_away(first, samples) < LEFT
    first.called_at = np.empty((0, 0))
    assert moved_away(first, samples) >= LEFT
    first.factor = replace(first.factor, earlier=first.calls.theta)  # a run that takes the calls of an earlier one
    assert moved_away(first, samples) < LEFT


def test_fresh_calls_are_made_until_a_fault_of_all_streams_together_would_show(monkeypatch) -> None:
    def certified(emulated, fresh, *others):  # the test of each stream alone is another one
        return Certificate(len(fresh), *[np.nan] * 12, faults=())

    monkeypatch.setattr(together, "certify", certified)
    monkeypatch.setattr(certificate, "MOVED", np.inf)  # one trend in twenty is larger than chance says
    monkeypatch.setattr(together._Test, "by_noise", np.zeros((1, 1000)))  # fresh calls make it no less
    target, rng = LinearFactors(3, own_of=[2, 2, 0]), np.random.default_rng(2)
    learned, samples = np.split(rng.multivariate_normal(*target.answer(), size=6000), [2000])
    known = []
    for factor in factors_of(target, noise=0.3, seed=1):
        space = Space(factor.problem)
        calls = Calls.at(factor.problem, space, learned[:, factor.columns])
        known.append(Known(factor, calls, Emulated(space, calls.learn(), False), [], 0.0))

    def tested(blind: float, max_calls: int = 9000) -> tuple[together.Trend, list[str]]:
        monkeypatch.setattr(together, "BLIND", blind)
        return together.tested_together(known, [None] * 3, samples, factor.shared, max_calls, rng)

    def fresh() -> int:
        return sum(each.certificate.calls for each in known)

    (first, faults), few = tested(blind=1.0), fresh()
    assert not faults
    assert sum(len(each.calls) for each in known) == 6000 + few  # all are kept
    second, faults = tested(blind=0.6 * first.by_chance)
    assert not faults
    assert second.by_chance < 0.6 * first.by_chance
    assert few < fresh() < 4 * few  # the noise of n calls falls as n^-1/2, and the loudest stream is called most
    _, faults = tested(blind=0.1 * first.by_chance, max_calls=max(len(each.calls) for each in known) + 300)
    assert "too few" in faults[-1]


def shared(calls: list[int], left: list[float], blur: float = 1.0) -> list[int]:
    """Return all calls of streams after a round, where those so far leave these variances in `NOISE` squared."""
    rest = {"factor": SimpleNamespace(problem=SimpleNamespace(size=5)), "blur": blur, "certificate": None}
    known = [SimpleNamespace(calls=range(n), share=len(calls) * v * NOISE**2, **rest)
             for n, v in zip(calls, left, strict=True)]  # fmt: skip
    return [n + new for n, new in zip(calls, new_calls(known), strict=True)]


def test_calls_are_shared_by_the_noise_that_they_leave() -> None:
    """The variance that calls leave falls as 1 / calls, and the fewest calls are as its roots (Neyman 1934)."""
    first, second = shared([1000, 1000], [0.9, 0.5])
    assert 900 / first + 500 / second == pytest.approx(1.0, abs=0.01)
    assert first / second == pytest.approx(np.sqrt(0.9 / 0.5), abs=0.01)
    # The second would get 2200 more beside the 12 700 that the first needs in all; the first is doubled before that.
    assert shared([300, 3000], [30.0, 0.5]) == [600, 3450]
    assert shared([300, 3000], [30.0, 0.5], blur=0.0) == [600, 3160]  # known well: it gets the least


def test_streams_that_are_all_learned_are_called_where_they_move_the_posterior(monkeypatch) -> None:
    monkeypatch.setattr(missing, "moved_away", lambda each, _: each.away)

    def stream(moves: float, away: float = 0.0, taught: float = 0.0, calls: int = 100) -> SimpleNamespace:
        return SimpleNamespace(
            certificate=None, blur=0.0, share=0.0, taught=taught, moves=moves, away=away, calls=range(calls)
        )

    def called(known: list[SimpleNamespace], moved: float) -> list[int]:
        return [known.index(each) for each in missing.to_be_called(known, np.empty((0, 1)), moved, 0.0, 1000)]

    quiet, moving = stream(0.01), stream(0.06)
    assert called([quiet, moving, quiet, quiet], 0.2) == [1]
    assert called([stream(0.01), stream(0.02)], 0.2) == [0, 1]  # they move it together
    assert called([quiet, moving], np.inf) == []  # how far it moves is not known yet
    assert called([quiet, stream(0.0, away=LEFT), stream(0.0, taught=SETTLED)], np.inf) == [2]
    assert called([quiet, stream(0.0, away=LEFT)], 0.0) == [1]
    assert called([stream(0.2, calls=1000), quiet], 0.2) == [1]  # no calls are left


def test_where_the_trend_of_all_is_refused_those_that_make_it_are_called(monkeypatch) -> None:
    monkeypatch.setattr(missing, "moved_away", lambda *_: 0.0)

    def stream(trend: float, held_out: int) -> SimpleNamespace:
        tested = SimpleNamespace(faults=(), held_out=held_out)
        return SimpleNamespace(certificate=tested, blur=0.0, share=0.0, taught=0.0, trend=trend, calls=range(100))

    def called(held_out: int) -> list[float]:
        known = [stream(trend, held_out) for trend in (0.02, 0.15, 0.04, 0.09)]
        wanted = missing.to_be_called(known, np.empty((0, 1)), 0.0, 0.0, 1000, trend=True)
        return [each.trend for each in wanted]

    assert called(held_out=0) == []  # fresh calls tested all: they are learned from, and others are held out
    assert called(held_out=200) == [0.15, 0.09]


def test_a_move_within_the_noise_of_all_calls_asks_for_no_more_of_them() -> None:
    assert [missing.moves(moved, 0.13) for moved in (0.09, 0.12, 0.14)] == [False, False, True]
    assert [missing.moves(0.12, uncertain) for uncertain in (0.0, 0.11, 0.13)] == [True, True, False]
    assert missing.moves(0.16, uncertain=0.3)  # noise as large as that is no excuse


@pytest.mark.slow
@pytest.mark.parametrize(
    ("factors", "own", "noise", "most"), [(1, 5, 0.3, 2000), (4, 4, 0.5, 6000), (12, 5, 0.3, 2000)]
)
def test_gaussian_factors(factors: int, own: int, noise: float, most: int) -> None:
    target = LinearFactors(factors, own=own)
    progress, calls = fit(target, noise, max_calls=8000)
    assert progress.missing == ""
    assert max(calls) < most
    assert_right(target, progress)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.1, 0.3])
def test_streams_in_conflict_are_learned_where_the_joint_posterior_is(noise: float) -> None:
    target = LinearFactors(3, own=3, strength=5.0)
    target.data[1] = target.data[1] + target.host[1] @ np.full(4, 3.0)
    progress, _ = fit(target, noise)
    if noise > 0.1:  # stream 1 is 15 errors off: noise of a call counts as much more in its ln L
        assert "the noise of the calls" in progress.missing
        assert "that of stream 1, which needs more particles" in progress.missing
        return
    assert progress.missing == ""
    assert_right(target, progress)


def test_calls_of_an_earlier_run_are_learned_where_the_joint_posterior_is_before_they_are_measured(monkeypatch) -> None:
    tilts, learn = [], Calls.learn
    monkeypatch.setattr(Calls, "learn", lambda calls, tilt=None: tilts.append(tilt) or learn(calls, tilt))
    prior = np.random.default_rng(3)
    factors = [replace(each, earlier=prior.standard_normal((400, len(each.columns))))
               for each in factors_of(LinearFactors(2, own=2), noise=0.3, seed=1)]  # fmt: skip
    first = next(Rounds(factors, False).run(3000))
    assert [len(each.calls) for each in first.known] == [400, 400]
    assert [tilt is not None for tilt in tilts[-2:]] == [True, True]  # of each stream, what all say of the host


def test_too_few_calls_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    take_few_steps(monkeypatch)
    target = LinearFactors(2, own=2)
    progress, _ = fit(target, noise=2.0, max_calls=700)
    assert progress.missing
    assert 700 - FEW < max(len(each.calls) for each in progress.known) <= 700
