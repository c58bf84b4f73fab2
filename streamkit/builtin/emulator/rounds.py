"""The rounds: calls at samples of the emulated posterior, until it has settled and fresh calls confirm it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from streamkit import Array
from streamkit.builtin.emulator.certificate import Certificate, certify, shift
from streamkit.builtin.emulator.coordinates import Space
from streamkit.builtin.emulator.emulated import Emulated
from streamkit.builtin.emulator.known import Known
from streamkit.builtin.emulator.problem import Problem
from streamkit.builtin.emulator.start import ARRIVED, Arrival, arrive, doubt_of, walkers_for

# Inverse temperatures of the copies that new points come from, and the share of each. Tempered ones see regions where
# the emulator may be too low.
COPIES = ((1.0, 0.5), (0.5, 0.25), (0.25, 0.25))
# New points of a round for each parameter, and in any case.
ROUND, LEAST_ROUND = 8, 80
# Steps of the walks of a round, of which the first are not used.
STEPS, SETTLING = 120, 40
# Standard deviations that a parameter may move between an emulator and the one two rounds before.
SETTLED = 0.1
# Fresh calls of a certificate.
FRESH = 128
# Walkers and steps of the samples that are the answer, of which the first are not used.
LAST_STEPS, LAST_SETTLING = 800, 150
# Fraction of the samples that a start may have taken for impossible, and what that is in ln density below its best.
MISSED, IMPOSSIBLE = 0.02, 12.0
# Starts that must have seen all of the posterior, and how many are made for that at most.
AGREEING, MOST_STARTS = 2, 4


@dataclass(frozen=True)
class Progress:
    """How far the rounds are.

    Attributes
    ----------
    known
        All calls with the full model.
    cheap
        How many were made with few particles.
    emulated
        The emulated posterior.
    samples
        (n, d) coordinates sampled from it.
    moved
        Standard deviations that a parameter has moved over two rounds.
    certificate
        What fresh calls say; None before the end.
    missing
        What is still asked for; empty if nothing is.
    """

    known: Known
    cheap: int
    emulated: Emulated
    samples: Array
    moved: float
    certificate: Certificate | None
    missing: str


def sample(
    problem: Problem,
    cheap: Problem,
    noise: bool,
    max_calls: int,
    starts: int = 2,
    note: Callable[[str], None] = lambda _: None,
) -> Iterator[Progress]:
    """Yield how far the sampling is, now and then; the last is the result.

    Parameters
    ----------
    problem, cheap
        With all particles, and with few of them, for the start.
    noise
        Whether the variance of one call is part of the likelihood.
    max_calls
        Calls of the full model at most.
    starts
        Independent ones: a mode that one of them has missed is found by another.
    """
    space = Space(problem)
    arrivals = [arrive(cheap, space, [problem.seed, 1, start], note) for start in range(starts)]
    known = _first(problem, space, arrivals)
    before: list[Emulated] = []
    pools: dict[float, Array] = {beta: np.concatenate([each.places[-200:] for each in arrivals]) for beta, _ in COPIES}
    rng = np.random.default_rng([problem.seed, 2])
    d, turn = problem.size, 0
    while True:
        emulator = known.learn()
        if emulator is None:
            chosen = rng.permutation(np.concatenate([each.places for each in arrivals]))[: ROUND * d]
            known += Known.at(problem, space, chosen)
            continue
        emulated = Emulated(space, emulator, noise)
        new = []
        for copy, (beta, share) in enumerate(COPIES):
            pool = np.concatenate([known.y[known.good], pools[beta]])
            chain = emulated.sample(pool, walkers_for(d), STEPS, [problem.seed, 3, turn, copy], beta)
            places = chain[SETTLING:].reshape(-1, d)
            pools[beta] = chain[-1]
            if beta == 1.0:
                samples = places
            size = int(share * max(ROUND * d, LEAST_ROUND))
            new.append(places[rng.choice(len(places), size, replace=False)])
        moved = _moved(before, emulated, samples)
        before = [*before[-1:], emulated]
        doubt = doubt_of(emulated, samples)
        note(f"{len(known)} calls, moved {moved:.2f} sd, the emulator doubts {doubt:.1f} in ln L")
        certificate = None
        if moved < SETTLED and doubt < ARRIVED:
            fresh = Known.at(problem, space, samples[rng.choice(len(samples), FRESH, replace=False)])
            certificate = certify(emulated, fresh, samples, [problem.seed, 4, turn])
            known += fresh
            seen = sum(_covers(arrival, samples) for arrival in arrivals)
            if not certificate.faults and seen < min(AGREEING, starts) and len(arrivals) < MOST_STARTS:
                note(f"{seen} of {len(arrivals)} starts saw all of the posterior: another one")
                arrivals.append(arrive(cheap, space, [problem.seed, 1, len(arrivals)], note))
                known += _first(problem, space, arrivals[-1:])
                before = []
            elif not certificate.faults:
                chain = emulated.sample(
                    np.concatenate([pools[1.0], samples[-2000:]]), 2 * walkers_for(d), LAST_STEPS,
                    [problem.seed, 5, turn],
                )  # fmt: skip
                samples = chain[LAST_SETTLING:].reshape(-1, d)
                missed = "" if seen >= min(AGREEING, starts) else (
                    f"only {seen} of {len(arrivals)} starts saw all of the posterior: there may be modes that none of "
                    "them saw"
                )
                yield Progress(known, _cheap(arrivals), emulated, samples, moved, certificate, missed)
                return
            else:
                note("; ".join(certificate.faults))
        missing = _missing(moved, doubt, certificate)
        yield Progress(known, _cheap(arrivals), emulated, samples, moved, certificate, missing)
        if len(known) >= max_calls or problem.time_left() <= 0:
            return
        known += Known.at(problem, space, np.concatenate(new))
        turn += 1


def _first(problem: Problem, space: Space, arrivals: list[Arrival]) -> Known:
    """Call the full model where the starts have arrived."""
    rng = np.random.default_rng([problem.seed, 6])
    size = max(2 * ROUND * problem.size, 2 * LEAST_ROUND) // len(arrivals)
    return Known.at(
        problem, space, np.concatenate([rng.permutation(each.places)[:size] for each in arrivals])
    )


def _moved(before: list[Emulated], now: Emulated, samples: Array) -> float:
    """Return the standard deviations that a parameter has moved over the last two rounds; infinite before."""
    if len(before) < 2:
        return np.inf
    some = samples[:: max(len(samples) // 2000, 1)]
    here = now.ln_density(some)
    return max(shift(some, each.ln_density(some) - here) for each in before)


def _cheap(arrivals: list[Arrival]) -> int:
    return sum(len(arrival.known) for arrival in arrivals)


def _covers(arrival: Arrival, samples: Array) -> bool:
    """Say whether a start had taken none of the posterior for impossible."""
    some = samples[:: max(len(samples) // 2000, 1)]
    best = np.quantile(arrival.emulated.ln_density(arrival.places), 0.9)
    lost = arrival.emulated.ln_density(some) < best - IMPOSSIBLE - samples.shape[1]
    return bool(np.mean(lost) <= MISSED)


def _missing(moved: float, doubt: float, certificate: Certificate | None) -> str:
    if certificate is not None:
        return "; ".join(certificate.faults)
    if doubt >= ARRIVED:
        return f"the emulator's own error still changes ln L by {doubt:.1f}"
    return "the emulated posterior still moves" if not np.isfinite(moved) else f"it still moves by {moved:.2f} sd"
