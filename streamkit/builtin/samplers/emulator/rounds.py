"""The algorithm: an emulator for each stream, and the posterior of all sampled on them.

1. Each factor starts alone, the data of the host first: what they say of the host is part of the prior of all others.
2. Two populations come from places of these starts to the emulated posterior.
3. Rounds: each factor that is not known yet is called at places of the posterior and of tempered copies of it, and
   learns from its calls.
4. Where the posterior has settled, two populations sample it to its end, from independent starts. Fresh calls test each
   factor there, and the sum of what they would change; other calls look where the emulators know nothing, and beyond
   all calls. Of several streams, those that an earlier run has made or a test has confirmed are tested by calls held
   out of their own.
5. All calls are learned from, and the posterior is sampled anew: what was tested and what is given must agree. Where
   they do not, what would be given is tested.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from streamkit import Array, IntArray
from streamkit.builtin.samplers.emulator.at_once import AtOnce, in_turn
from streamkit.builtin.samplers.emulator.certificate import Trend, blur_of
from streamkit.builtin.samplers.emulator.changes import difference, every_so_often, real_change_of, with_axes
from streamkit.builtin.samplers.emulator.judge.extrapolated import extrapolated
from streamkit.builtin.samplers.emulator.judge.held_out import held_out
from streamkit.builtin.samplers.emulator.judge.missing import (
    apart,
    before_a_test,
    blurred,
    new_calls,
    noise_matters,
    to_be_called,
    with_calls_left,
)
from streamkit.builtin.samplers.emulator.judge.reach import leading
from streamkit.builtin.samplers.emulator.judge.recall import Recall, recall
from streamkit.builtin.samplers.emulator.judge.remembered import given_up
from streamkit.builtin.samplers.emulator.judge.settled import ROUNDS, moved_by, uncertain_by
from streamkit.builtin.samplers.emulator.judge.together import tested_together
from streamkit.builtin.samplers.emulator.known import SOME, Known
from streamkit.builtin.samplers.emulator.learn.calls import Calls
from streamkit.builtin.samplers.emulator.learn.pairs import paired
from streamkit.builtin.samplers.emulator.places import least_known, to_call
from streamkit.builtin.samplers.emulator.start import Starter, begin_apart, own_error_of
from streamkit.builtin.samplers.emulator.tilt import tilt
from streamkit.builtin.samplers.emulator.walk.density import Emulated, Factor, Joint
from streamkit.builtin.samplers.emulator.walk.populations import (
    GIVEN,
    TESTED,
    Asked,
    Populations,
    go_on,
    sample,
    tempered,
)

# Inverse temperatures of the copies that new points come from, and the share of each. Tempered ones see regions where
# the emulator may be too low.
COPIES = ((1.0, 0.4), (0.5, 0.2), (0.25, 0.2))
# Share of a round's new points that are samples of the posterior where the emulator's own error counts most; and where
# it counts too much: thin ends, of which few calls tell, may hold a fifth of a width.
LEAST_KNOWN, ENDS = 0.2, 0.6
# Fraction of a round's new points of the posterior that are pairs: two calls at one place differ by their noise alone.
PAIRED = 0.5
# Standard deviations by which the posterior that fresh calls have tested and the one that is given may differ: two sets
# of samples differ by 0.1 by chance.
CHANGED = 0.15
# Starts that must lead to all of the posterior, and how many are made for that at most.
AGREEING, MOST_STARTS = 2, 4
# Before calls test anything.
UNKNOWN = Trend(np.nan, np.nan)


@dataclass(frozen=True)
class Progress:
    """How far the sampling is.

    Attributes
    ----------
    known
        What is known of each factor.
    joint
        The emulated posterior of all.
    populations
        Samples of it.
    moved, uncertain
        In standard deviations: since two rounds ago, and by the noise of all calls, see `settled`; infinite where it is
        not asked.
    trend
        What the trends of the calls that test all factors would move together; NaN before they are made.
    recall
        What calls find where the emulators know nothing; None before they are made.
    changed
        By how much the posterior differs from the one that was tested, where that is too much; NaN elsewhere.
    missing
        What is still asked for; empty if nothing is.
    """

    known: Sequence[Known]
    joint: Joint
    populations: Populations
    moved: float
    uncertain: float
    trend: Trend = UNKNOWN
    recall: Recall | None = None
    changed: float = np.nan
    missing: str = ""

    @property
    def is_refused_together(self) -> bool:
        """Whether each factor was confirmed, and the trend of all is more than chance makes."""
        return self.trend.counts and all(each.is_confirmed for each in self.known)


class Rounds:
    """The sampling from the starts of all factors to their certificates.

    Parameters
    ----------
    factors
        The factors; those without parameters of their own, the data of the host, may stand anywhere.
    noise
        Whether the variance of one call is part of the likelihood.
    starts
        Independent ones of each factor: two populations begin from different ones.
    note
        Called with a line about the progress.
    together
        Called with parameters (n, p) by factor before each factor is called at them: all may be called at a time.
    at_once
        Runs tasks in several processes.
    """

    def __init__(
        self,
        factors: Sequence[Factor],
        noise: bool,
        starts: int = AGREEING,
        note: Callable[[str], None] = lambda _: None,
        together: Callable[[Mapping[str, Array]], None] = lambda _: None,
        at_once: AtOnce = in_turn,
    ) -> None:
        self._factors, self._noise, self._note, self._together = tuple(factors), noise, note, together
        self._starts_of_each, self._starter = starts, Starter(noise, note, at_once)
        self._at_once, self._seed = at_once, factors[0].problem.seed

    def run(self, max_calls: int) -> Iterator[Progress]:
        """Yield how far the sampling is after every round; ``max_calls`` are those of each factor.

        Raises StreamkitError where too few calls with all particles give a prediction.
        """
        known = self._starter.all(self._factors, self._starts_of_each, max_calls)
        result: Populations | None = None
        turn = 0
        while True:
            joint, seed = self._joint(known), [self._seed, 11, turn]
            if result is None:
                self._note("all starts are made: two populations come to the emulated posterior")
                result = sample(joint, begin_apart(known), seed, most_sweeps=10, at_once=self._at_once)
                if len(known) > 1 and any(len(each.factor.earlier) for each in known):
                    # Nothing of the other streams was known when an earlier run's calls were learned from.
                    self._learn(known, self._tempered(joint, result.last, COPIES[1][0], [*seed, 5, 1, 0]))
                    joint = self._joint(known)
            result = go_on(joint, result.last, [*seed, 0], self._at_once)
            copies = self._copies(joint, result, seed)
            now = self._measured(known, joint, result, max_calls, seed)
            over, to_test = self._is_over(known, max_calls), not now.missing
            if to_test:
                now = self._ended(known, now, copies, max_calls, seed)
                result, over = now.populations, self._is_over(known, max_calls)
                copies[0] = _by_population(result)
                self._note(now.missing or "certified")
            elif over:
                now = replace(now, populations=self._sample(joint, self._begin(known, result), [*seed, 2]))
            yield now
            if not now.missing or over:
                return
            samples = every_so_often(result.samples, 4 * SOME)
            wanted = to_be_called(known, samples, now.moved, now.uncertain, max_calls, now.is_refused_together)
            before = [each.emulated for each in wanted]
            self._call(known, wanted, copies, max_calls, seed)
            self._learn(known, copies[1])
            self._taught(wanted, before, samples)
            turn += 1

    # A round

    def _joint(self, known: Sequence[Known]) -> Joint:
        return Joint(self._factors, [each.emulated for each in known])

    def _copies(self, joint: Joint, result: Populations, seed: list[int]) -> list[Array]:
        """Return samples (2, n, d) of the posterior and of its tempered copies, each walked to from the one before."""
        copies = [_by_population(result)]
        for i, (beta, _) in enumerate(COPIES[1:]):
            copies.append(self._tempered(joint, result.last if i == 0 else copies[-1], beta, [*seed, 1, i]))
        return copies

    def _begin(self, known: Sequence[Known], result: Populations) -> list[Array]:
        """Return two sets of places to come to the posterior anew: those of the starts, and the last ones."""
        return [np.concatenate(pair) for pair in zip(begin_apart(known), result.last, strict=True)]

    def _call(
        self, known: Sequence[Known], wanted: Sequence[Known], copies: Sequence[Array], max_calls: int, seed: list[int]
    ) -> None:
        """Call factors at places of the posterior and of its copies, and where they are least known."""
        rng, several = np.random.default_rng([*seed, 4]), len(self._factors) > 1
        least = ENDS if blurred(known) else LEAST_KNOWN
        shares = least + sum(share for _, share in COPIES)
        chosen: list[tuple[Known, Array]] = []
        for each, asked in zip(known, new_calls(known), strict=True):
            if each not in wanted:
                continue
            places, size = [], min(asked, int((max_calls - len(each.calls)) / shares))
            for (_, share), copy in zip(COPIES, copies, strict=True):
                some = np.unique(copy.reshape(-1, copy.shape[2])[:, each.factor.columns], axis=0)  # a walker may rest
                places.append(to_call(each.emulated, some, int(share * size), rng))
                if len(places) == 1:
                    places.append(least_known(each.emulated, some, int(least * size), rng))
            pairs = 0 if each.emulated.emulator.is_silent else int(PAIRED * len(places[0])) // 2
            places[0] = paired(places[0], pairs)
            chosen.append((each, np.concatenate(places)))
        if several and chosen:
            self._together({each.factor.name: each.calls.space.points(z) for each, z in chosen})
        for each, z in chosen:
            each.calls += Calls.at(each.factor.problem, each.calls.space, z)
            each.is_confirmed = False

    def _taught(self, called: Sequence[Known], before: Sequence[Emulated], samples: Array) -> None:
        """Note what the last calls of factors have changed of the posterior of samples (n, d), and where they were."""
        for each, emulated in zip(called, before, strict=True):
            each.called_at = mine = samples[:, each.factor.columns]
            change = each.emulated.ln_likelihood(mine) - emulated.ln_likelihood(mine)
            each.taught = real_change_of(with_axes(mine), change, np.random.default_rng([self._seed, 16]))

    def _learn(self, known: Sequence[Known], warm: Array) -> None:
        """Learn every factor from its calls: those at likely places count, by its ln L and what the others say of h.

        The latter is that of samples (2, n, d) of the ``warm`` copy, the first tempered one.
        """
        found = self._at_once([partial(each.calls.learn, tilt(each.factor, warm, each.calls.z)) for each in known])
        for each, emulator in zip(known, found, strict=True):
            if emulator is not None:
                each.emulated = replace(each.emulated, emulator=emulator.of(each.calls.problem))

    # What is known

    def _measured(
        self, known: Sequence[Known], joint: Joint, result: Populations, max_calls: int, seed: list[int]
    ) -> Progress:
        """Return how far the posterior has moved, what is uncertain, and what is missing before a test."""
        samples = every_so_often(result.samples, 4 * SOME)
        moved = moved_by(known, joint, samples, self._watched(), np.random.default_rng([*seed, 10]))
        uncertain, rng = np.inf, np.random.default_rng([*seed, 5])
        if noise_matters(known, moved):
            uncertain = uncertain_by(known, samples, self._watched(), rng, self._at_once)
        for each in known:
            mine = samples[:, each.factor.columns]
            each.own_error = own_error_of(each.emulated.unlimited(), mine)
            each.blur = blur_of(each.emulated, mine)
            each.before = [*each.before, each.emulated][-ROUNDS:]
        more = with_calls_left(known, max_calls)
        rows = ", ".join(
            f"{each.factor.name} {len(each.calls)} (error {each.own_error:.1f}"
            f"{'' if each in more else ', sampler.max_calls are made'})"
            for each in known
        )
        missing = before_a_test(known, samples, moved, uncertain)
        sizes = {"moved": moved, "uncertain by": uncertain}  # infinite where they are not known
        known_sizes = [f"{name} {size:.2f} sd" for name, size in sizes.items() if np.isfinite(size)]
        self._note("; ".join([f"calls: {rows}", *known_sizes, missing or "tested now"]))
        return Progress(known, joint, result, moved, uncertain, missing=missing)

    def _watched(self) -> IntArray:
        """Indices of the coordinates that are asked for: the shared ones; all of a single factor."""
        shared = self._factors[0].shared
        return shared if len(shared) else self._factors[0].columns

    def _is_over(self, known: Sequence[Known], max_calls: int) -> bool:
        return not with_calls_left(known, max_calls) or self._factors[0].problem.time_left() <= 0

    # The end

    def _ended(
        self, known: Sequence[Known], now: Progress, copies: Sequence[Array], max_calls: int, seed: list[int]
    ) -> Progress:
        """Sample the posterior to its end and test it.

        Where fresh calls confirm it and move it nevertheless, the posterior that they have moved is tested, before a
        round makes more calls.
        """
        self._note("two populations sample the emulated posterior to its end")
        now = replace(now, populations=self._sampled(known, now, copies, [*seed, 2]))
        now = self._tested(known, now, copies, max_calls, seed)
        if np.isnan(now.changed) or self._is_over(known, max_calls):
            return now
        self._note(f"{now.missing}: this one is tested")
        return self._tested(known, now, copies, max_calls, [*seed, 12])

    def _tested(
        self, known: Sequence[Known], now: Progress, copies: Sequence[Array], max_calls: int, seed: list[int]
    ) -> Progress:
        """Test the posterior where it is sampled, learn from all calls, and sample it anew."""
        tested = now.populations
        for each in known:
            each.blur = blur_of(each.emulated, every_so_often(tested.samples, 4 * SOME)[:, each.factor.columns])
        if fault := apart(tested) or blurred(known) or self._unseen(known, tested, [*seed, 9]):
            return replace(now, missing=fault)
        samples, rng = every_so_often(tested.samples, 4 * SOME), np.random.default_rng([*seed, 6])
        held = held_out(known, samples, copies[1], self._at_once, rng)
        trend, faults = tested_together(known, held, samples, self._watched(), max_calls, rng)
        begin = np.concatenate([*tested.last, *copies[-1]])
        beyond = recall(known, now.joint, begin, [*seed, 7])
        faults += ([beyond.fault] if beyond.fault else []) + extrapolated(known, now.joint, begin, [*seed, 13])
        now = replace(now, trend=trend, recall=beyond, missing="; ".join(faults))
        self._learn(known, copies[1])
        if faults:
            return now
        joint = self._joint(known)
        beta = COPIES[-1][0]
        given = self._sample(joint, list(self._tempered(joint, tested.last, beta, [*seed, 8])), [*seed, 3], beta)
        now = replace(now, joint=joint, populations=given, missing=apart(given))
        changed = difference(tested.samples[:, self._watched()], given.samples[:, self._watched()])
        if now.missing or changed < CHANGED:
            return now
        missing = f"what fresh calls have taught moves the posterior by {changed:.2f} standard deviations"
        return replace(now, changed=changed, missing=missing)

    def _sampled(self, known: Sequence[Known], now: Progress, copies: Sequence[Array], seed: list[int]) -> Populations:
        """Sample the posterior to its end: from the starts, or for several streams from the warmest copies.

        A start of one stream alone may not have been where all of them together are, and the way from there is long.
        """
        if len(known) == 1:
            return self._sample(now.joint, self._begin(known, now.populations), seed, asked=TESTED)
        return self._sample(now.joint, list(copies[-1]), seed, COPIES[-1][0], asked=TESTED)

    def _sample(
        self, joint: Joint, begin: Sequence[Array], seed: list[int], beta: float = 0.0, asked: Asked = GIVEN
    ) -> Populations:
        return sample(joint, begin, seed, beta, asked=asked, at_once=self._at_once)

    def _tempered(self, joint: Joint, begin: Array, beta: float, seed: list[int]) -> Array:
        return tempered(joint, begin, beta, seed, self._at_once)

    def _unseen(self, known: Sequence[Known], result: Populations, seed: list[int]) -> str:
        """Say whether too few starts lead to all of the posterior, and make another one then; or what they give up.

        A stream of several is not asked: its start alone need not have been where all of them together are.
        """
        if len(known) > 1:
            return ""
        samples = every_so_often(result.samples, SOME)
        for each in known:
            wanted, mine = min(AGREEING, self._starts_of_each, len(each.starts)), samples[:, each.factor.columns]
            alone, made = Joint([each.factor.alone], [each.emulated]), len(each.starts)
            each.seen = seen = leading(each.starts, alone, mine, seed)
            if seen >= wanted:
                if fault := given_up(each, np.random.default_rng([*seed, 0])):
                    return fault
                continue
            if made < MOST_STARTS:
                self._note(f"{each.factor.name}: {seen} of {made} starts lead to all of the posterior: another one")
                self._starter.again(each)
            return (f"only {seen} of {made} starts of {each.factor.name} lead to all of the posterior: there may be "
                    "modes that none of them saw")  # fmt: skip
        return ""


def _by_population(result: Populations) -> Array:
    """(2, n, d) Return the samples of each population."""
    return result.samples.reshape(2, -1, result.samples.shape[1])
