"""The rounds: calls at samples of the emulated posterior, until it has settled and fresh calls confirm it.

1. Starts find where the data may be, by calls with few particles (`start`).
2. A round learns an emulator from all calls with all particles, and samples its posterior and tempered copies of it
   from the prior on (`populations`). New calls are made there.
3. Where the posterior has settled, two large populations give the answer. They must agree.
4. Fresh calls at samples of the answer, and where the emulator says that there is nothing, test it (`certificate`).
5. All calls together give the last emulator. Its answer must be that of the tested one, both ways.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from streamkit import Array, StreamkitError
from streamkit.builtin.samplers.emulator.agreement import MISSED, missed_by
from streamkit.builtin.samplers.emulator.calls import Calls
from streamkit.builtin.samplers.emulator.certificate import Certificate, certify, fresh_calls, recall_calls
from streamkit.builtin.samplers.emulator.changes import differs, lacked, moved_by, uncertainty
from streamkit.builtin.samplers.emulator.coordinates import Space
from streamkit.builtin.samplers.emulator.emulated import Emulated
from streamkit.builtin.samplers.emulator.mixture_moves import MixtureMoves
from streamkit.builtin.samplers.emulator.pairs import paired
from streamkit.builtin.samplers.emulator.populations import Populations, copies, sample
from streamkit.builtin.samplers.emulator.problem import Problem
from streamkit.builtin.samplers.emulator.start import ARRIVED, Arrival, arrive, doubt_of, walkers_for

# Inverse temperatures of the copies that new points come from, and the share of each. Tempered ones see regions where
# the emulator may be too low.
COPIES = ((1.0, 0.5), (0.5, 0.25), (0.25, 0.25))
# New points of a round for each parameter, and in any case.
ROUND, LEAST_ROUND = 8, 80
# Calls of the full model where the starts have arrived, for each parameter and in any case.
FIRST, LEAST_FIRST = 16, 160
# Fraction of a round's new points of the posterior that are pairs: two calls at one place differ by their noise alone.
PAIRED = 0.5
# Draws of the prior that a population begins from, and the walkers of a round and of each population of the answer.
DRAWS, WALKERS, ANSWERING = 4000, 400, 1000
# Sweeps of a stage on the way to the answer, how often its walks may be doubled, and their autocorrelation times: the
# ends of a bent posterior are seldom visited, and its width is that of the ends.
STAGE, DOUBLED, TIMES = 10, 6, 50.0
# Standard deviations that a parameter, or a principal axis, may move between an emulator and those of so many rounds
# before, and the fraction by which its width may change.
SETTLED, ROUNDS = 0.1, 2
# Largest standard error of a mean or a width, in standard deviations, that the noise of the calls may leave.
UNCERTAIN = 0.1
# Samples that are given at most; neighbours in a walk say the same.
MOST_SAMPLES = 8000
# Fraction of one answer that may lie where the other has nothing.
LACKED = 0.02
# Starts that must have seen all of the posterior, and how many are made for that at most.
AGREEING, MOST_STARTS = 2, 4


@dataclass(frozen=True)
class Progress:
    """How far the rounds are.

    Attributes
    ----------
    calls
        All calls with the full model.
    emulated
        The emulated posterior.
    samples
        (n, d) coordinates sampled from it.
    populations
        The two populations of the answer; None before the end.
    uncertain
        How uncertain the noise of the calls leaves a mean, in standard deviations, or a width, as a fraction.
    certificate
        What fresh calls say; None before the end.
    missing
        What is still asked for; empty if nothing is.
    draws
        Draws of the prior that all starts have made: they decide which modes could be missed.
    """

    calls: Calls
    emulated: Emulated
    samples: Array
    populations: Populations | None
    uncertain: float
    certificate: Certificate | None
    missing: str
    draws: int


class Rounds:
    """The sampling from its start to its certificate.

    Parameters
    ----------
    problem, cheap
        The posterior with all particles, and with few of them for the start.
    noise
        Whether the variance of one call is part of the likelihood.
    starts
        Independent ones: a mode that one of them has missed is found by another.
    note
        Called with a line about the progress.
    """

    def __init__(
        self,
        problem: Problem,
        cheap: Problem,
        noise: bool,
        starts: int = AGREEING,
        note: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._problem, self._cheap, self._noise, self._note = problem, cheap, noise, note
        self._space, self._rng = Space(problem), np.random.default_rng([problem.seed, 2])
        self._arrivals = [self._start(i) for i in range(starts)]
        self._agreeing = min(AGREEING, starts)
        self._calls = self._evaluated(self._arrivals)
        self._before: list[Emulated] = []

    def run(self, max_calls: int) -> Iterator[Progress]:
        """Yield how far the sampling is after every round; the last is the result.

        Raises StreamkitError where too few calls with all particles give a prediction.
        """
        turn = 0
        while True:
            emulator = self._calls.learn()
            if emulator is None:
                self._calls += self._between(max_calls)
                continue
            emulated = Emulated(self._space, emulator, self._noise)
            tempered = self._copies(emulated, turn)
            samples, answer = tempered[0], None
            moved = moved_by(self._before, emulated, samples) if len(self._before) == ROUNDS else np.inf
            doubt = doubt_of(emulated, samples)
            uncertain = uncertainty(emulated, samples, self._rng)
            self._before = [*self._before, emulated][-ROUNDS:]
            self._note(
                f"{len(self._calls)} calls, moved {moved:.2f} sd, uncertain by {uncertain:.2f} sd, the emulator doubts "
                f"{doubt:.1f} in ln L"
            )
            certificate, missing = None, _missing(moved, uncertain, doubt)
            if not missing:
                missing = self._unseen(emulated, samples, turn)
                if not missing:
                    answer = self._answer(emulated, [turn, 0])
                    samples, missing = _thinned(answer), _apart(answer)
                if not missing:
                    certificate = self._certify(emulated, samples, tempered)
                    missing = "; ".join(certificate.faults)
                if not missing:
                    tested, before = emulated, samples
                    emulated = self._with_all(tested)
                    answer = self._answer(emulated, [turn, 1])
                    samples = _thinned(answer)
                    missing = _apart(answer) or _changed(tested, before, emulated, samples)
                self._note(missing or "certified")
            over = len(self._calls) >= max_calls or self._problem.time_left() <= 0
            if over and answer is None:
                answer = self._answer(emulated, [turn, 0])
                samples = _thinned(answer)
            draws = sum(each.draws for each in self._arrivals)
            yield Progress(self._calls, emulated, samples, answer, uncertain, certificate, missing, draws)
            if not missing or over:
                return
            new = [self._some(places, share) for places, (_, share) in zip(tempered, COPIES, strict=True)]
            new[0] = paired(new[0], 0 if emulator.is_silent else int(PAIRED * len(new[0])) // 2)
            self._calls += Calls.at(self._problem, self._space, np.concatenate(new))
            turn += 1

    def _start(self, number: int) -> Arrival:
        return arrive(self._cheap, self._space, [self._problem.seed, 1, number], self._note)

    def _evaluated(self, arrivals: list[Arrival]) -> Calls:
        """Call the full model where starts have arrived."""
        size = max(FIRST * self._problem.size, LEAST_FIRST) // len(arrivals)
        places = [self._rng.permutation(each.places)[:size] for each in arrivals]
        return Calls.at(self._problem, self._space, np.concatenate(places))

    def _between(self, max_calls: int) -> Calls:
        """Call the full model between the places where the starts have arrived, which have too few predictions."""
        if len(self._calls) >= max_calls or self._problem.time_left() <= 0:
            raise StreamkitError(
                f"too few predictions to learn from: of {len(self._calls)} calls with all particles only "
                f"{int(self._calls.good.sum())} give a stream with observables, where streams of few particles have "
                "them. Raise sampler.start_particles."
            )
        places = np.concatenate([each.places for each in self._arrivals])
        size = max(ROUND * self._problem.size, LEAST_ROUND)
        begin, one, other = places[self._rng.integers(len(places), size=(3, size))]
        return Calls.at(self._problem, self._space, begin + self._rng.random((size, 1)) * (one - other))

    def _prior(self, seed: list[int]) -> Array:
        """(n, d) Draw from the prior."""
        rng = np.random.default_rng([self._problem.seed, 3, *seed])
        return self._space.to(self._problem.from_unit(rng.random((DRAWS, self._problem.size))))

    def _copies(self, emulated: Emulated, turn: int) -> list[Array]:
        """Sample the emulated posterior at the inverse temperatures of `COPIES`."""
        betas = sorted(beta for beta, _ in COPIES)
        seed = [self._problem.seed, 4, turn]
        found = dict(zip(betas, copies(emulated, self._prior([turn]), betas, seed, WALKERS, MixtureMoves), strict=True))
        return [found[beta] for beta, _ in COPIES]

    def _answer(self, emulated: Emulated, seed: list[int]) -> Populations:
        """Sample the emulated posterior by two populations from the prior on."""
        begin = [self._prior([*seed, i]) for i in (0, 1)]
        whole = [self._problem.seed, 5, *seed]
        return sample(emulated, begin, whole, ANSWERING, DOUBLED, MixtureMoves, STAGE, TIMES)

    def _some(self, places: Array, share: float) -> Array:
        """Choose the share of a round's new points."""
        size = int(share * max(ROUND * self._problem.size, LEAST_ROUND))
        places = np.unique(places, axis=0)  # a walker that has rested is one place
        return places[self._rng.choice(len(places), size, replace=False)]

    def _certify(self, emulated: Emulated, samples: Array, tempered: list[Array]) -> Certificate:
        """Compare the emulator with fresh calls, and keep these."""
        fresh, trend = fresh_calls(emulated, self._problem, samples, self._rng)
        self._calls += fresh
        certificate = certify(emulated, fresh, trend, samples, self._rng)
        if certificate.faults:
            return certificate
        recall, missed, faults = recall_calls(emulated, self._problem, tempered[-1], COPIES[-1][0], samples, self._rng)
        self._calls += recall
        return replace(certificate, missed=missed, faults=faults, calls=certificate.calls + len(recall))

    def _with_all(self, emulated: Emulated) -> Emulated:
        """Learn from the fresh calls too."""
        emulator = self._calls.learn()
        return emulated if emulator is None else replace(emulated, emulator=emulator)

    def _unseen(self, emulated: Emulated, samples: Array, turn: int) -> str:
        """Say whether too few starts saw all of the posterior, and make another one then; empty if enough did."""
        walkers, made = walkers_for(self._problem.size), len(self._arrivals)
        missed = [
            missed_by(each.places, emulated, samples, walkers, [self._problem.seed, 6, turn, i])
            for i, each in enumerate(self._arrivals)
        ]
        seen = sum(each <= MISSED for each in missed)
        if seen >= self._agreeing:
            return ""
        if made < MOST_STARTS:
            self._note(f"{seen} of {made} starts saw all of the posterior: another one")
            self._arrivals.append(self._start(made))
            self._calls += self._evaluated(self._arrivals[-1:])
        return f"only {seen} of {made} starts saw all of the posterior: there may be modes that none of them saw"


def _thinned(answer: Populations) -> Array:
    """(n, d) Take as many of the samples as are independent, at most `MOST_SAMPLES`, at equal distances."""
    wanted = int(np.clip(answer.independent if np.isfinite(answer.independent) else 0, 1000, MOST_SAMPLES))
    return answer.samples[:: max(len(answer.samples) // wanted, 1)]


def _apart(answer: Populations) -> str:
    """Say that two populations do not agree, or have not walked for long enough; empty if all is well."""
    if answer.agree:
        return ""
    return (
        f"two populations of the emulated posterior do not agree (R-hat {answer.r_hat:.3f}, {answer.independent:.0f} "
        f"independent samples, {answer.sweeps / answer.time:.0f} autocorrelation times)"
    )


def _changed(tested: Emulated, before: Array, given: Emulated, samples: Array) -> str:
    """Say how much the posterior that is given differs from the tested one, of whose samples `before` are."""
    moved = differs(before, samples)
    if moved >= SETTLED:
        return f"the fresh calls move the posterior by {moved:.2f} standard deviations"
    lost = max(lacked(tested, before, samples), lacked(given, samples, before))
    return f"the fresh calls change where {100 * lost:.0f} % of the posterior lie" if lost > LACKED else ""


def _missing(moved: float, uncertain: float, doubt: float) -> str:
    """Say what is missing before fresh calls may test an emulator."""
    if doubt >= ARRIVED:
        return f"the emulator's own error still changes ln L by {doubt:.1f}"
    if not np.isfinite(moved):
        return "too few rounds"
    if moved >= SETTLED:
        return f"the posterior still moves by {moved:.2f} standard deviations"
    if uncertain >= UNCERTAIN:
        return f"the noise of the calls leaves a mean or a width uncertain by {uncertain:.2f} standard deviations"
    return ""
