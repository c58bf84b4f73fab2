"""The emulator over factors: an emulator for each stream, and the joint posterior sampled on all of them.

1. Each factor starts alone, the data of the host first: what they say of the host is part of the prior of all others.
2. Two populations come from places of these starts to the joint posterior.
3. Rounds: each factor that is not known yet is called at places of the joint posterior, and learns from its calls.
4. Where the joint posterior has settled, fresh calls test each factor, and the sum of what they would change.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from streamkit import Array, IntArray
from streamkit.builtin.samplers.emulator.calls import Calls
from streamkit.builtin.samplers.emulator.certificate import MOVED, certify, changes_by_trend, fresh_calls
from streamkit.builtin.samplers.emulator.changes import change_of, changes_of, with_axes
from streamkit.builtin.samplers.emulator.coordinates import Space
from streamkit.builtin.samplers.emulator.emulated import Emulated
from streamkit.builtin.samplers.emulator.factor import Factor, JointPosterior
from streamkit.builtin.samplers.emulator.factor_starts import (
    SOME,
    UNCERTAIN,
    Known,
    every_so_often,
    nearest_places,
    start_factors,
)
from streamkit.builtin.samplers.emulator.pairs import paired
from streamkit.builtin.samplers.emulator.populations import Populations, go_on, sample, tempered
from streamkit.builtin.samplers.emulator.rounds import LEAST_ROUND, PAIRED, ROUND, ROUNDS, SETTLED
from streamkit.builtin.samplers.emulator.start import ARRIVED, doubt_of

# Inverse temperature of the copy that shows where a factor may be too low, and the share of new calls from it.
WARM, FROM_WARM = 0.4, 0.4
# Emulators of each factor that the noise of its calls could have given as well.
REDRAWN = 16
# Fraction of trends by chance that may be larger than one that counts.
LEVEL = 0.05
# Factor by which the covariance of the warm copy is widened for the tilt of the weights.
WIDER = 2.0


@dataclass(frozen=True)
class JointProgress:
    """How far the joint posterior is.

    Attributes
    ----------
    known
        What is known of each factor.
    joint
        The emulated posterior of all.
    populations
        Samples of it.
    moved, uncertain
        In standard deviations: since `ROUNDS` rounds ago, and by the noise of all calls.
    trend, trend_by_chance
        What the trends of the fresh calls of all factors would move together; NaN before they are made.
    missing
        What is still asked for; empty if nothing is.
    """

    known: Sequence[Known]
    joint: JointPosterior
    populations: Populations
    moved: float
    uncertain: float
    trend: float
    trend_by_chance: float
    missing: str


class Factored:
    """The sampling from the starts of all factors to their certificates.

    Parameters
    ----------
    factors
        The factors; those without parameters of their own, the data of the host, may stand anywhere.
    space
        Of all parameters.
    noise
        Whether the variance of one call is part of the likelihood.
    starts
        Independent ones of each factor: two populations begin from different ones.
    note
        Called with a line about the progress.
    together
        Called with parameters (n, p) by factor before each factor is called at them: all may be called at a time.
    """

    def __init__(
        self,
        factors: Sequence[Factor],
        space: Space,
        noise: bool,
        starts: int = 1,
        note: Callable[[str], None] = lambda _: None,
        together: Callable[[Mapping[str, Array]], None] = lambda _: None,
    ) -> None:
        self._factors, self._space, self._noise, self._note = tuple(factors), space, noise, note
        self._starts_of_each, self._together = starts, together
        self._seed = factors[0].problem.seed

    def run(self, max_calls: int) -> Iterator[JointProgress]:
        """Yield how far the sampling is after every round; ``max_calls`` are those of each factor."""
        known = start_factors(self._factors, self._noise, self._starts_of_each, self._note)
        begin = nearest_places(known)
        result: Populations | None = None
        turn = 0
        while True:
            joint = JointPosterior(self._factors, [each.emulated for each in known])
            seed = [self._seed, 11, turn]
            result = sample(joint, begin, seed) if result is None else go_on(joint, result.last, seed)
            samples = every_so_often(result.samples, 4 * SOME)
            warm = tempered(joint, result.last, WARM, [*seed, 1])
            moved = self._moved(known, joint, samples)
            uncertain = self._uncertain(known, joint, samples, seed)
            for each in known:
                each.doubt = doubt_of(each.emulated, samples[:, each.factor.columns])
                each.before = [*each.before, each.emulated][-ROUNDS:]
            self._note(self._line(known, moved, uncertain))
            missing, trend = self._missing(known, moved, uncertain), (np.nan, np.nan)
            over = self._is_over(known, max_calls)
            if not missing or over:
                result = sample(joint, self._again(known, result), [*seed, 2])
                if not result.agree:
                    missing = missing or _apart(result)
            if not missing:
                trend = self._certify(known, result, max_calls, seed)
                faults = [(each.factor.name, each.certificate.faults) for each in known if each.certificate is not None]
                missing = "; ".join(f"{name}: {fault}" for name, each in faults for fault in each)
                if trend[0] > max(MOVED, trend[1]):
                    both = f"all streams together move the posterior by {trend[0]:.2f} standard deviations"
                    missing = "; ".join(filter(None, [missing, f"trends of the residuals of {both}"]))
                before = JointPosterior(self._factors, [each.emulated for each in known])
                self._learn(known, samples, warm)
                change = self._change(known, before, samples)
                if not missing and change >= SETTLED:
                    missing = f"the fresh calls move the posterior by {change:.2f} standard deviations"
                joint = JointPosterior(self._factors, [each.emulated for each in known])
                if not missing:
                    result = sample(joint, self._again(known, result), [*seed, 3])
                self._note(missing or "certified")
                over = self._is_over(known, max_calls)
            yield JointProgress(known, joint, result, moved, uncertain, *trend, missing)
            if not missing or over:
                return
            self._call(known, samples, warm, max_calls, seed)
            self._learn(known, samples, warm)
            turn += 1

    # A round

    def _again(self, known: Sequence[Known], result: Populations) -> list[Array]:
        """Return two sets of places to come to the joint posterior anew: those of the starts, and the last ones."""
        return [np.concatenate(pair) for pair in zip(nearest_places(known), result.last, strict=True)]

    def _learn(self, known: Sequence[Known], samples: Array, warm: Array) -> None:
        """Learn every factor from its calls: those at likely places count, by its ln L and what the others say of h."""
        for each in known:
            emulator = each.calls.learn(self._tilt(each, warm))
            if emulator is not None:
                each.emulated = Emulated(each.calls.space, emulator, self._noise)

    def _tilt(self, each: Known, warm: Array) -> Array | None:
        """(n,) What all factors say of the hosts of a factor's calls, as a Gaussian; None for a single factor.

        A stream in tension with the others is learned where the joint posterior is, and not where it alone would be.
        """
        shared = each.factor.shared
        if len(self._factors) == 1 or not len(shared):
            return None
        h = warm[:, shared]
        calls = each.calls.y[:, np.isin(each.factor.columns, shared)]
        covariance = WIDER * np.atleast_2d(np.cov(h.T))
        covariance[np.diag_indices(len(shared))] *= 1 + 1e-9
        white = np.linalg.solve(np.linalg.cholesky(covariance), (calls - h.mean(axis=0)).T)
        return np.asarray(-0.5 * np.sum(white**2, axis=0))

    def _call(self, known: Sequence[Known], samples: Array, warm: Array, max_calls: int, seed: list[int]) -> None:
        """Call each factor that is not learned at places of the joint posterior."""
        rng = np.random.default_rng([*seed, 4])
        waiting = [each for each in known if not each.is_learned] or list(known)
        chosen: list[tuple[Known, Array]] = []
        for each in waiting:
            size = max(ROUND * each.factor.problem.size, LEAST_ROUND)
            if len(each.calls) >= max_calls:
                continue
            few = int(FROM_WARM * size)
            columns = each.factor.columns
            here = samples[rng.choice(len(samples), size - few, replace=False)][:, columns]
            pairs = 0 if each.emulated.emulator.is_silent else int(PAIRED * len(here)) // 2
            there = warm[rng.choice(len(warm), few, replace=False)][:, columns]
            chosen.append((each, np.concatenate([paired(here, pairs), there])))
        self._together({each.factor.name: each.calls.space.back(y) for each, y in chosen})
        for each, y in chosen:
            each.calls += Calls.at(each.factor.problem, each.calls.space, y)

    # What is known

    def _moved(self, known: Sequence[Known], joint: JointPosterior, samples: Array) -> float:
        """Return how much the posterior has moved since `ROUNDS` rounds ago; infinite before there are so many."""
        if any(len(each.before) < ROUNDS for each in known):
            return np.inf
        here, moving = joint.ln_likelihoods(samples).sum(axis=1), with_axes(samples[:, self._watched()])
        changes = []
        for i in range(ROUNDS):
            old = JointPosterior(self._factors, [each.before[i] for each in known])
            changes.append(change_of(moving, old.ln_likelihoods(samples).sum(axis=1) - here))
        return max(changes)

    def _change(self, known: Sequence[Known], before: JointPosterior, samples: Array) -> float:
        """Return how much what has been learned changes of the posterior."""
        now = JointPosterior(self._factors, [each.emulated for each in known])
        change = (now.ln_likelihoods(samples) - before.ln_likelihoods(samples)).sum(axis=1)
        return change_of(with_axes(samples[:, self._watched()]), change)

    def _watched(self) -> IntArray:
        """Indices of the coordinates that are asked for: the shared ones; all of a single factor."""
        shared = self._factors[0].shared
        return shared if len(shared) else self._factors[0].columns

    def _uncertain(self, known: Sequence[Known], joint: JointPosterior, samples: Array, seed: list[int]) -> float:
        """Return what the noise of all calls leaves uncertain, in standard deviations; note each factor's share."""
        rng = np.random.default_rng([*seed, 5])
        some = every_so_often(samples, SOME)
        moving = with_axes(some[:, self._watched()])
        total: Array = np.zeros((2, moving.shape[1]))
        for k, each in enumerate(known):
            columns = each.factor.columns
            here = each.emulated.ln_likelihood(some[:, columns])
            changes = [
                changes_of(moving, joint.redrawn(k, rng).ln_likelihood(some[:, columns]) - here) for _ in range(REDRAWN)
            ]
            variance = np.mean(np.square(changes), axis=0)
            each.share = len(known) * float(variance.max())
            total += variance
        return float(np.sqrt(total.max()))

    def _missing(self, known: Sequence[Known], moved: float, uncertain: float) -> str:
        """Say what is missing before fresh calls may test the emulators."""
        worst = max(known, key=lambda each: each.doubt)
        if worst.doubt >= ARRIVED:
            return f"the error of the emulator of {worst.factor.name} still changes ln L by {worst.doubt:.1f}"
        if not np.isfinite(moved):
            return "too few rounds"
        if moved >= SETTLED:
            return f"the posterior still moves by {moved:.2f} standard deviations"
        if uncertain >= UNCERTAIN:
            return f"the noise of the calls leaves a mean or a width uncertain by {uncertain:.2f} standard deviations"
        return ""

    def _is_over(self, known: Sequence[Known], max_calls: int) -> bool:
        return all(len(each.calls) >= max_calls for each in known) or self._factors[0].problem.time_left() <= 0

    # The end

    def _certify(
        self, known: Sequence[Known], result: Populations, max_calls: int, seed: list[int]
    ) -> tuple[float, float]:
        """Test each factor by fresh calls, and keep these; return what all trends move together, and chance would."""
        rng = np.random.default_rng([*seed, 6])
        samples = every_so_often(result.samples, 4 * SOME)
        trends, some = [], every_so_often(samples, SOME)
        for each in known:
            mine = samples[:, each.factor.columns]
            level = 1 - LEVEL / len(known)
            fresh, trend = fresh_calls(
                each.emulated, each.factor.problem, mine, rng, level, max_calls - len(each.calls)
            )
            each.certificate = certify(each.emulated, fresh, trend, mine, rng)
            each.calls += fresh
            trends.append(changes_by_trend(each.emulated, fresh, some[:, each.factor.columns], rng))
        moving = with_axes(some[:, self._watched()])
        total = np.sum([each for each in trends if each is not None], axis=0)  # (1 + TRIES, n)
        measured, *by_chance = (change_of(moving, each) for each in total)
        return measured, float(np.quantile(by_chance, 1 - LEVEL))

    def _line(self, known: Sequence[Known], moved: float, uncertain: float) -> str:
        rows = ", ".join(f"{each.factor.name} {len(each.calls)} (error {each.doubt:.1f})" for each in known)
        return f"calls: {rows}; moved {moved:.2f} sd, uncertain by {uncertain:.2f} sd"


def _apart(result: Populations) -> str:
    return f"two populations of the joint posterior do not agree (R-hat {result.r_hat:.3f})"
