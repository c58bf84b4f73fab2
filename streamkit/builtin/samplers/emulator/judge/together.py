"""The test of all factors by calls that were not learned from: of each for itself, and of what all would change."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from streamkit import Array, IntArray
from streamkit.builtin.samplers.emulator.certificate import (
    BLIND,
    FRESH,
    MOST_BATCHES,
    TRIES,
    Trend,
    certify,
    changes_by_trend,
    fresh_calls,
    trend_of,
)
from streamkit.builtin.samplers.emulator.changes import change_of, every_so_often, with_axes
from streamkit.builtin.samplers.emulator.judge.held_out import HeldOut
from streamkit.builtin.samplers.emulator.known import SOME, Known
from streamkit.builtin.samplers.emulator.learn.calls import Calls
from streamkit.builtin.samplers.emulator.places import to_call

# Fraction of trends by chance that may be larger than one that counts.
LEVEL = 0.05


def tested_together(
    known: Sequence[Known],
    held: Sequence[HeldOut | None],
    samples: Array,
    watched: IntArray,
    max_calls: int,
    rng: np.random.Generator,
) -> tuple[Trend, list[str]]:
    """Test each factor at samples (n, d) of the posterior, and keep the certificate and new calls.

    A factor is tested by the calls ``held`` out of what it has learned, or where there are none by fresh ones. Return
    what the trends of all factors move together, and all faults.

    What all trends together move are the ``watched`` coordinates. Where that of trends by chance is large, a fault of
    many factors would not show, however little is wrong with each: those by which chance moves most are called again.
    They are called whatever the trends are by then, unless one is surely too large: who looks often, and ends at the
    first that is, finds one by chance.
    """
    level = 1 - LEVEL / len(known)
    several = len(known) > 1
    tests = [_Test(each, its, samples[:, each.factor.columns], level, several, rng)
             for each, its in zip(known, held, strict=True)]  # fmt: skip
    for test in tests:
        test.begin(max_calls)
    moving = with_axes(every_so_often(samples, SOME)[:, watched])
    trend = _together(moving, tests)
    while several and trend.by_calls > BLIND and not (trend.counts_surely or any(map(_Test.fails_surely, tests))):
        more = [each for each in tests if each.has_more(max_calls)]
        if not more:
            break
        max(more, key=lambda each: each.gains(moving)).go_on()
        trend = _together(moving, tests)
    faults = [f"{test.known.factor.name}: {fault}" for test in tests for fault in test.kept(moving)]
    if several and trend.counts:
        faults.append("trends of the residuals of all streams together move the posterior by "
                      f"{trend.measured:.2f} standard deviations")  # fmt: skip
    elif several and trend.by_calls > BLIND and not faults:
        faults.append("the calls that test all streams together are too few: a mean or a width off by "
                      f"{trend.by_chance:.2f} standard deviations would not show")  # fmt: skip
    return trend, faults


def _together(moving: Array, tests: Sequence[_Test]) -> Trend:
    """Return what all trends together move of samples (n, d); NaN where none is known."""
    found = [(test.changes, test) for test in tests if test.changes is not None]
    if not found:
        return Trend(np.nan, np.nan)
    total = np.sum([changes for changes, _ in found], axis=0)  # (1 + tries, n)
    by_calls = [change_of(moving, each) for each in total[1:]]
    trend = Trend(change_of(moving, total[0]), float(np.quantile(by_calls, 1 - LEVEL)))
    if len(tests) == 1:
        return trend
    return _with_noise(trend, moving, total[1:], np.sum([test.by_noise for _, test in found], axis=0))


def _with_noise(trend: Trend, moving: Array, by_calls: Array, by_noise: Array) -> Trend:
    """Return a trend of which the noise of the calls that were learned from is chance as well.

    Each emulator is off by some of it, and more calls that test do not lower it. What the calls that test and the
    noise of the others add to ln L by chance, (tries, n) at samples (n, d), say how much larger it makes a trend.
    """
    of_calls, of_noise = (np.mean([change_of(moving, each) ** 2 for each in some]) for some in (by_calls, by_noise))
    return trend._replace(by_learned=float(trend.by_calls * np.sqrt(of_noise / np.maximum(of_calls, 1e-300))))


class _Test:
    """The test of one factor, at samples (n, d) of its coordinates, by calls held out or by fresh ones.

    Of one of ``several`` factors the noise of the calls that were learned from is chance too.
    """

    def __init__(
        self,
        known: Known,
        held: HeldOut | None,
        samples: Array,
        level: float,
        several: bool,
        rng: np.random.Generator,
    ) -> None:
        self.known, self._held, self._samples, self._level, self._rng = known, held, samples, level, rng
        self._several, self._some = several, every_so_often(samples, SOME)
        self._emulated = known.emulated if held is None else held.emulated
        self.changes: Array | None = None

    @cached_property
    def by_noise(self) -> Array:
        """(tries, n) What other noise in the calls that were learned from would add to ln L at the samples."""
        return self._emulated.of_other_noise(self._some, self._rng, TRIES) - self._emulated.ln_likelihood(self._some)

    def begin(self, max_calls: int) -> None:
        """Take the calls that were held out, or make fresh ones until a trend can be told from chance."""
        if self._held is not None:
            self._calls = self._held.calls
            self._judge(self._measured())
            return
        left, problem = max_calls - len(self.known.calls), self.known.factor.problem
        self._calls, trend = fresh_calls(self._emulated, problem, self._samples, self._rng, self._level, left)
        self._judge(trend)

    def has_more(self, max_calls: int) -> bool:
        """Whether it may be called again."""
        made = len(self._calls)
        return self.changes is not None and made < min(MOST_BATCHES * FRESH, max_calls - len(self.known.calls) - FRESH)

    def gains(self, moving: Array) -> float:
        """Return what a call more would take from what its trends by chance move of samples (n, d), squared."""
        assert self.changes is not None  # noqa: S101  `has_more` says so
        return float(np.mean([change_of(moving, each) ** 2 for each in self.changes[1:]])) / len(self._calls)

    def go_on(self) -> None:
        """Make more fresh calls, at other samples."""
        emulated, made = self._emulated, {row.tobytes() for row in self._calls.theta}
        left = np.array([row.tobytes() not in made for row in emulated.space.points(self._samples)])
        places = to_call(emulated, self._samples[left], FRESH, self._rng)
        self._calls += Calls.at(self.known.factor.problem, emulated.space, places)
        self._judge(self._measured())

    def fails_surely(self) -> bool:
        """Whether more calls cannot confirm it."""
        return self._trend is None or self._trend.counts_surely

    def kept(self, moving: Array) -> tuple[str, ...]:
        """Keep the new calls, the certificate, and what the trend moves of samples (n, d); return the faults."""
        known, faults = self.known, self._certificate.faults
        known.calls += self._calls.take(np.arange(len(self._calls)) >= self._certificate.held_out)
        known.certificate, known.is_confirmed = self._certificate, not faults
        known.trend = np.inf if self.changes is None else change_of(moving, self.changes[0])
        return faults

    def _measured(self) -> Trend | None:
        return trend_of(self._emulated, self._calls, self._samples, self._rng, self._level)

    def _judge(self, trend: Trend | None) -> None:
        emulated, calls, samples, rng = self._emulated, self._calls, self._samples, self._rng
        before, held = (self.known.calls, 0) if self._held is None else (None, len(self._held.calls))
        self.changes = changes_by_trend(emulated, calls, self._some, rng.spawn(1)[0], by_sign=True)
        if self._several and trend is not None and self.changes is not None:
            trend = _with_noise(trend, self._some, self.changes[1:], self.by_noise)
        self._trend = trend
        self._certificate = replace(certify(emulated, calls, trend, samples, rng, self._level, before), held_out=held)
