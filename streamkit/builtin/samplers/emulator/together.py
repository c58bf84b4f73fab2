"""The test of all factors by fresh calls: of each for itself, and of the sum of what their trends would change."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from streamkit import Array, IntArray
from streamkit.builtin.samplers.emulator.calls import Calls
from streamkit.builtin.samplers.emulator.certificate import (
    BLIND,
    FRESH,
    MOST_BATCHES,
    MOVED,
    Trend,
    certify,
    changes_by_trend,
    fresh_calls,
    trend_of,
)
from streamkit.builtin.samplers.emulator.changes import change_of, every_so_often, with_axes
from streamkit.builtin.samplers.emulator.places import to_call
from streamkit.builtin.samplers.emulator.start import SOME, Known

# Fraction of trends by chance that may be larger than one that counts.
LEVEL = 0.05


def tested_together(
    known: Sequence[Known], samples: Array, watched: IntArray, max_calls: int, rng: np.random.Generator
) -> tuple[Trend, list[str]]:
    """Test each factor by fresh calls at samples (n, d) of the posterior, and keep these calls and the certificate.

    Return what the trends of all factors move together, and all faults.

    What all trends together move are the ``watched`` coordinates. Where that of trends by chance is large, a fault of
    many factors would not show, however little is wrong with each: those by which chance moves most are called again.
    """
    tests = [_Test(each, samples[:, each.factor.columns], 1 - LEVEL / len(known), rng) for each in known]
    for test in tests:
        test.begin(max_calls)
    moving = with_axes(every_so_often(samples, SOME)[:, watched])
    several = len(known) > 1
    trend = measured, by_chance = _together(moving, tests)
    while several and measured <= max(MOVED, by_chance) and by_chance > BLIND and not any(map(_Test.faults, tests)):
        more = [each for each in tests if each.has_more(max_calls)]
        if not more:
            break
        max(more, key=lambda each: each.gains(moving)).go_on()
        trend = measured, by_chance = _together(moving, tests)
    faults = [f"{test.known.factor.name}: {fault}" for test in tests for fault in test.kept()]
    if several and measured > max(MOVED, by_chance):
        faults.append(f"trends of the residuals of all streams together move the posterior by {measured:.2f} "
                      "standard deviations")  # fmt: skip
    elif several and by_chance > BLIND and not faults:
        faults.append(f"the fresh calls of all streams together are too few: a mean or a width off by {by_chance:.2f} "
                      "standard deviations would not show")  # fmt: skip
    return trend, faults


def _together(moving: Array, tests: Sequence[_Test]) -> Trend:
    """Return what all trends together move of samples (n, d); NaN where none is known."""
    found = [test.changes for test in tests if test.changes is not None]
    if not found:
        return Trend(np.nan, np.nan)
    measured, *tries = (change_of(moving, each) for each in np.sum(found, axis=0))  # (1 + tries, n)
    return Trend(measured, float(np.quantile(tries, 1 - LEVEL)))


class _Test:
    """The test of one factor, at samples (n, d) of its coordinates."""

    def __init__(self, known: Known, samples: Array, level: float, rng: np.random.Generator) -> None:
        self.known, self._samples, self._level, self._rng = known, samples, level, rng
        self.changes: Array | None = None

    def begin(self, max_calls: int) -> None:
        """Make fresh calls until a trend of this factor can be told from chance."""
        emulated, problem = self.known.emulated, self.known.factor.problem
        left = max_calls - len(self.known.calls)
        self._judge(*fresh_calls(emulated, problem, self._samples, self._rng, self._level, left))

    def has_more(self, max_calls: int) -> bool:
        """Whether it may be called again."""
        made = len(self._fresh)
        return self.changes is not None and made < min(MOST_BATCHES * FRESH, max_calls - len(self.known.calls) - FRESH)

    def gains(self, moving: Array) -> float:
        """Return what a call more would take from what its trends by chance move of samples (n, d), squared."""
        assert self.changes is not None  # noqa: S101  `has_more` says so
        return float(np.mean([change_of(moving, each) ** 2 for each in self.changes[1:]])) / len(self._fresh)

    def go_on(self) -> None:
        """Make more fresh calls, at other samples."""
        emulated, made = self.known.emulated, {row.tobytes() for row in self._fresh.theta}
        left = np.array([row.tobytes() not in made for row in emulated.space.points(self._samples)])
        places = to_call(emulated, self._samples[left], FRESH, self._rng)
        fresh = self._fresh + Calls.at(self.known.factor.problem, emulated.space, places)
        self._judge(fresh, trend_of(emulated, fresh, self._samples, self._rng, self._level))

    def faults(self) -> tuple[str, ...]:
        """Return those of the certificate."""
        return self._certificate.faults

    def kept(self) -> tuple[str, ...]:
        """Keep the calls and the certificate; return its faults."""
        self.known.calls += self._fresh
        self.known.certificate = self._certificate
        return self.faults()

    def _judge(self, fresh: Calls, trend: Trend | None) -> None:
        known, samples, rng = self.known, self._samples, self._rng
        self._fresh = fresh
        self._certificate = certify(known.emulated, fresh, trend, samples, rng, self._level, known.calls)
        self.changes = changes_by_trend(known.emulated, fresh, every_so_often(samples, SOME), rng)
