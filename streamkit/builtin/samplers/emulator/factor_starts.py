"""The starts of the factors: each alone, and the places from which two populations come to the joint posterior."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import reduce
from operator import add

import numpy as np
from scipy.spatial import cKDTree

from streamkit import Array, StreamkitError
from streamkit.builtin.samplers.emulator.calls import Calls
from streamkit.builtin.samplers.emulator.certificate import Certificate
from streamkit.builtin.samplers.emulator.coordinates import Space
from streamkit.builtin.samplers.emulator.emulated import Emulated
from streamkit.builtin.samplers.emulator.factor import Factor, hosts_prior, layout_of
from streamkit.builtin.samplers.emulator.start import ARRIVED, arrive

# Calls with all particles where a start with few has arrived, for each parameter and in any case.
FIRST, LEAST_FIRST = 16, 160
# New calls at a time where too few of them have a prediction.
MORE = 80
# Standard deviations that the noise of the calls may leave in all; the part of it, squared, that one factor may have
# without new calls is this divided by the number of factors.
UNCERTAIN, SHARE = 0.1, 0.5
# Samples for which the best ln likelihood alone is computed.
SOME = 1000
# Nearest places of a start, one of which a walker gets beside its host; walkers to choose from.
NEAREST, BEGIN = 15, 2000


@dataclass
class Known:
    """What is known of a factor.

    Attributes
    ----------
    factor
        The factor.
    calls
        All its calls with all particles.
    emulated
        Its emulated posterior.
    places
        (n, p) coordinates where each of its starts has arrived.
    alone
        The best emulated ln likelihood of the stream alone.
    doubt
        What its emulator's own error changes of ln L at the joint posterior.
    share
        Its part of the variance that the noise of the calls leaves, in standard deviations squared.
    certificate
        What fresh calls say of it; None before the end.
    """

    factor: Factor
    calls: Calls
    emulated: Emulated
    places: list[Array]
    alone: float
    doubt: float = np.inf
    share: float = np.inf
    certificate: Certificate | None = None
    before: list[Emulated] = field(default_factory=list)

    @property
    def is_learned(self) -> bool:
        """Whether it needs no more calls at the joint posterior, as far as is known."""
        passed = self.certificate is None or not self.certificate.faults
        return passed and self.doubt < ARRIVED and self.share < SHARE * UNCERTAIN**2


def start_factors(
    factors: Sequence[Factor], noise: bool, starts: int, note: Callable[[str], None]
) -> list[Known]:
    """Start each factor alone, so many times; those of the host's data first. ``note`` shows a line of progress."""
    known: dict[str, Known] = {}
    host: Emulated | None = None
    for factor in sorted(factors, key=lambda each: len(each.own)):
        known[factor.name] = _start(factor, host, noise, starts, note)
        if not len(factor.own) and host is None:
            host = known[factor.name].emulated
    return [known[factor.name] for factor in factors]


def _start(
    factor: Factor, host: Emulated | None, noise: bool, starts: int, note: Callable[[str], None]
) -> Known:
    """Start a factor alone; a stream's place in the run file does not change its calls, its name decides."""
    prior = None if host is None or not len(factor.own) else hosts_prior(factor, host)
    seed = [factor.problem.seed, 12, *factor.name.encode()]
    restricted = Space(factor.problem, prior)
    earlier: Calls | None = None
    if len(factor.earlier):
        earlier = Calls.at(factor.problem, restricted, restricted.to(factor.earlier), factor.earlier)
    arrivals = [
        arrive(
            factor.small if earlier is None else factor.problem, restricted, [*seed, i],
            lambda line: note(f"{factor.name}: {line}"), earlier,
        )
        for i in range(starts if earlier is None else 1)
    ]  # fmt: skip
    places = np.concatenate([each.places for each in arrivals])
    space, rng = Space(factor.problem), np.random.default_rng([*seed, 1])
    if factor.small is factor.problem or earlier is not None:
        parts = [Calls(factor.problem, space, *(getattr(each.calls, n) for n in ("y", "theta", "answers")))
                 for each in arrivals]  # fmt: skip
        calls = reduce(add, parts)
    else:
        size = max(FIRST * factor.problem.size, LEAST_FIRST)
        calls = Calls.at(factor.problem, space, rng.permutation(places)[:size])
    emulator = calls.learn()
    while emulator is None:  # few of the full calls have a prediction: between the places where the start arrived
        if len(calls) > 20 * MORE:
            raise StreamkitError(
                f"{factor.name}: too few predictions to learn from: of {len(calls)} calls with all particles only "
                f"{int(calls.good.sum())} give a stream with observables. Raise sampler.start_particles."
            )
        first, one, other = places[rng.integers(len(places), size=(3, MORE))]
        calls += Calls.at(factor.problem, space, first + rng.random((MORE, 1)) * (one - other))
        emulator = calls.learn()
    emulated = Emulated(space, emulator, noise)
    there = [each.places[np.isfinite(space.ln_prior(each.places))] for each in arrivals]
    alone = float(np.max(emulated.ln_likelihood(every_so_often(np.concatenate(there), SOME))))
    return Known(factor, calls, emulated, there, alone)


def nearest_places(known: Sequence[Known]) -> tuple[Array, Array]:
    """Return two sets of places: hosts of any start, and for each stream a place of its start with such a host."""
    layout, rng = layout_of([each.factor for each in known]), np.random.default_rng([known[0].factor.problem.seed, 13])
    host_columns = [np.isin(each.factor.columns, each.factor.shared) for each in known]
    sets = []
    for population in range(2):
        places = [each.places[population % len(each.places)] for each in known]
        hosts = np.concatenate([rng.permutation(some[:, columns])[: 4 * BEGIN]
                                for some, columns in zip(places, host_columns, strict=True)])  # fmt: skip
        y = np.empty((BEGIN, layout.size))
        y[:, layout.shared] = h = hosts[rng.integers(len(hosts), size=BEGIN)]
        scale = np.maximum(hosts.std(axis=0), 1e-300)
        for each, some, columns in zip(known, places, host_columns, strict=True):
            own = each.factor.own
            if not len(layout.shared):
                y[:, own] = some[rng.integers(len(some), size=BEGIN)]
            elif len(own):
                near = min(NEAREST, len(some))
                _, rows = cKDTree(some[:, columns] / scale).query(h / scale, near)
                chosen = rows.reshape(BEGIN, near)[np.arange(BEGIN), rng.integers(near, size=BEGIN)]
                y[:, own] = some[chosen][:, ~columns]
        sets.append(y)
    return sets[0], sets[1]


def every_so_often(samples: Array, n: int) -> Array:
    """Return about n of the samples, at equal distances."""
    return samples[:: max(len(samples) // n, 1)]
