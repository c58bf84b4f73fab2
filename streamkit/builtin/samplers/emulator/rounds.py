"""The rounds: calls at samples of the emulated posterior, until it has settled and fresh calls confirm it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import emcee
import numpy as np

from streamkit import Array, StreamkitError
from streamkit.builtin.samplers.emulator.agreement import MISSED, missed_by
from streamkit.builtin.samplers.emulator.calls import Calls
from streamkit.builtin.samplers.emulator.certificate import Certificate, certify, fresh_calls
from streamkit.builtin.samplers.emulator.changes import moved_by, uncertainty
from streamkit.builtin.samplers.emulator.coordinates import Space
from streamkit.builtin.samplers.emulator.emulated import Emulated
from streamkit.builtin.samplers.emulator.pairs import paired
from streamkit.builtin.samplers.emulator.problem import Problem
from streamkit.builtin.samplers.emulator.start import ARRIVED, Arrival, arrive, doubt_of, walkers_for
from streamkit.builtin.samplers.emulator.walk import walk

# Inverse temperatures of the copies that new points come from, and the share of each. Tempered ones see regions where
# the emulator may be too low.
COPIES = ((1.0, 0.5), (0.5, 0.25), (0.25, 0.25))
# New points of a round for each parameter, and in any case.
ROUND, LEAST_ROUND = 8, 80
# Calls of the full model where the starts have arrived, for each parameter and in any case.
FIRST, LEAST_FIRST = 16, 160
# Fraction of a round's new points of the posterior that are pairs: two calls at one place differ by their noise alone.
PAIRED = 0.5
# Steps of the walks of a round, of which the first are not used.
STEPS, SETTLING = 120, 40
# Standard deviations that a parameter, or a principal axis, may move between an emulator and those of so many rounds
# before, and the fraction by which its width may change.
SETTLED, ROUNDS = 0.1, 2
# Largest standard error of a mean or a width, in standard deviations, that the noise of the calls may leave.
UNCERTAIN = 0.1
# Steps of the walk that gives the answer, of which the first are not used. It goes on until it has given so many
# independent samples, which leave a median uncertain by 0.03 standard deviations, or for so many steps.
LAST_STEPS, LAST_SETTLING, INDEPENDENT, MOST_STEPS = 500, 100, 1600, 4000
# Samples of the last round that the walkers of the answer begin from.
POOL = 4000
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
    uncertain
        How uncertain the noise of the calls leaves a mean, in standard deviations, or a width, as a fraction.
    certificate
        What fresh calls say; None before the end.
    missing
        What is still asked for; empty if nothing is.
    """

    calls: Calls
    emulated: Emulated
    samples: Array
    uncertain: float
    certificate: Certificate | None
    missing: str


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
        places = np.concatenate([each.places[-walkers_for(problem.size) :] for each in self._arrivals])
        self._pools = {beta: places for beta, _ in COPIES}
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
            copies = [self._walk(emulated, beta, turn, i) for i, (beta, _) in enumerate(COPIES)]
            samples = copies[0]
            moved = moved_by(self._before, emulated, samples) if len(self._before) == ROUNDS else np.inf
            doubt = doubt_of(emulated, samples)
            uncertain = uncertainty(emulated, samples, self._rng)
            self._before = [*self._before, emulated][-ROUNDS:]
            self._note(
                f"{len(self._calls)} calls, moved {moved:.2f} sd, uncertain by {uncertain:.2f} sd, the emulator doubts "
                f"{doubt:.1f} in ln L"
            )
            certificate, missing = None, _missing(moved, uncertain, doubt)
            tested: Emulated | None = None  # the emulator that the samples are independent samples of
            if not missing:
                missing = self._unseen(emulated, samples, turn)
                if not missing:
                    samples = self._last(emulated, samples, turn)  # independent ones: with few, chance moves more
                    tested = emulated
                    certificate = self._certify(emulated, samples)
                    missing = "; ".join(certificate.faults)
                if not missing:
                    emulated, missing = self._with_all(emulated, samples)
                self._note(missing or "certified")
            over = len(self._calls) >= max_calls or self._problem.time_left() <= 0
            if (not missing or over) and emulated is not tested:
                samples = self._last(emulated, samples, turn)
            yield Progress(self._calls, emulated, samples, uncertain, certificate, missing)
            if not missing or over:
                return
            new = [self._some(places, share) for places, (_, share) in zip(copies, COPIES, strict=True)]
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

    def _walk(self, emulated: Emulated, beta: float, turn: int, copy: int) -> Array:
        """(n, d) Sample the emulated posterior at an inverse temperature."""
        d, seed = self._problem.size, [self._problem.seed, 3, turn, copy]
        pool = np.concatenate([self._calls.y[self._calls.good], self._pools[beta]])
        chain = emulated.sample(pool, walkers_for(d), STEPS, seed, beta)
        self._pools[beta] = chain[-1]
        return chain[SETTLING:].reshape(-1, d)

    def _last(self, emulated: Emulated, samples: Array, turn: int) -> Array:
        """(n, d) Sample the emulated posterior for long: independent samples."""
        d, seed = self._problem.size, [self._problem.seed, 5, turn]
        chain = emulated.sample(samples[-POOL:], 2 * walkers_for(d), LAST_STEPS, seed)
        while len(answer := _independent(chain[LAST_SETTLING:])) < INDEPENDENT and len(chain) < MOST_STEPS:
            more, _ = walk(emulated.ln_density, chain[-1], LAST_STEPS, [*seed, len(chain)])
            chain = np.concatenate([chain, more])
        return answer

    def _some(self, places: Array, share: float) -> Array:
        """Choose the share of a round's new points."""
        size = int(share * max(ROUND * self._problem.size, LEAST_ROUND))
        places = np.unique(places, axis=0)  # a walker that has rested is one place
        return places[self._rng.choice(len(places), size, replace=False)]

    def _certify(self, emulated: Emulated, samples: Array) -> Certificate:
        """Compare the emulator with fresh calls, and keep these."""
        fresh, trend = fresh_calls(emulated, self._problem, samples, self._rng)
        self._calls += fresh
        return certify(emulated, fresh, trend, samples, self._rng)

    def _with_all(self, emulated: Emulated, samples: Array) -> tuple[Emulated, str]:
        """Learn from the fresh calls too; say how much that moves the posterior if it is too much."""
        emulator = self._calls.learn()
        assert emulator is not None  # noqa: S101  fewer calls were enough
        learned = replace(emulated, emulator=emulator)
        moved = moved_by([learned], emulated, samples)
        if moved < SETTLED:
            return learned, ""
        return learned, f"the fresh calls move the posterior by {moved:.2f} standard deviations"

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


def _independent(chain: Array) -> Array:
    """(n, d) Take one place of every walker for each of the longest autocorrelation times of a chain (steps, w, d)."""
    time = emcee.autocorr.integrated_time(chain, tol=0).max()
    return chain[:: max(int(np.ceil(time)), 1)].reshape(-1, chain.shape[2])


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
