"""The search for the walkers' start, by sequential Monte Carlo (Del Moral, Doucet & Jasra 2006).

The search draws from the prior and keeps the draws with a stream. Then it switches the likelihood on in steps of
inverse temperature. Each step is followed by resampling and by differential-evolution moves (ter Braak 2006), in the
unit cube of the priors' cumulative probabilities, where the prior is flat. The model is a cheap one with few particles,
whose noise is added to that of the data. The full model evaluates the last population.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from time import monotonic

import numpy as np
from scipy.stats import qmc

from streamkit.components import PriorDensity
from streamkit.errors import StreamkitError
from streamkit.sample.evaluation import Evaluation
from streamkit.stream import Array, IntArray

BATCH = 1024  # prior draws at a time: a power of two, which Sobol sequences need
PARTS = 16  # parts of a batch, after each of which the search checks the number of streams and the time
HURRIED = 128  # prior draws at a time where there is a time limit
MAX_BATCHES = 8
LAST_BATCH = 32  # where so few draws have a stream that no search can begin: several small domains, as of files
GIVE_UP = 2  # batches without a single stream after which the search ends
# Seconds after the time limit, or the length of the limit, within which the first few streams must be found.
GRACE = 10.0
ENOUGH = 4  # draws with streams, in units of the population, after which no more are needed
SWEEPS = 5  # largest number of moves per particle and temperature
ROUNDS = 6  # largest number of rounds in which missing walkers are replaced
SPREAD = 12.0  # a walker may start at ln p this much below the best, plus half the number of parameters
# Sweeps of a search through all temperatures, for estimates: fewer for weak data, more for strong ones.
SWEEPS_IN_ALL = 20


def expected_calls(walkers: int, parameters: int, good: float) -> tuple[int, int]:
    """Estimate the calls of a search, cheap and full, if the fraction ``good`` of the prior gives streams."""
    wanted = population_of(walkers, parameters)
    return draws_for(wanted, good) + (SWEEPS_IN_ALL * wanted if good > 0 else 0), 2 * walkers


def draws_for(wanted: int, good: float) -> int:
    """Estimate the draws of the prior for a population, if the fraction ``good`` of them gives streams."""
    part = BATCH // PARTS
    return GIVE_UP * BATCH if good <= 0 else min(part * -int(-ENOUGH * wanted / good // part), MAX_BATCHES * BATCH)


def population_of(walkers: int, parameters: int) -> int:
    """Return the number of particles of the sequential Monte Carlo."""
    return max(2 * walkers, 4 * parameters, 16)


Evaluate = Callable[[Array, str], list[Evaluation]]


@dataclass
class Search:
    """The search for a starting ensemble."""

    priors: Sequence[PriorDensity]  # d priors
    evaluate: Evaluate  # ``evaluate(points (n, d), "cheap" or "full")``
    walkers: int  # number of starting points
    rng: np.random.Generator  # the only source of random numbers
    # Value of `time.monotonic` after which the cheap search ends with its present population; infinity for none. After
    # the same time again, a search with too few streams fails.
    deadline: float = np.inf
    # Called with a line about the progress after every batch of evaluations.
    report: Callable[[str], None] = lambda _: None
    full_cost: float = 1.0  # approximate cost of a "full" evaluation in units of a "cheap" one
    calls: int = 0
    # Work done, and an estimate of the work left, in cheap evaluations.
    work: float = 0.0
    work_left: float = 0.0
    inverse_temperature: float = 0.0
    begun: float = field(default_factory=monotonic)
    reasons: Counter[str] = field(default_factory=Counter)

    def run(self) -> tuple[Array, list[Evaluation]]:
        """Return ``walkers`` distinct points (walkers, d) with their full evaluations, all finite.

        A StreamkitError with the counted reasons if streams that can be fitted are too rare.
        """
        self.begun = monotonic()
        u, lnl = self._draw()
        u, lnl = self._temper(u, lnl)
        u = self._make_distinct(u, lnl)
        return self._choose(u)

    @property
    def population(self) -> int:
        """Particles of the sequential Monte Carlo."""
        return population_of(self.walkers, len(self.priors))

    def _theta(self, u: Array) -> Array:
        """(n, d) Parameters at unit-cube points (n, d)."""
        columns = [prior.ppf(column) for prior, column in zip(self.priors, u.T, strict=True)]
        return np.ascontiguousarray(np.stack(columns, axis=1))

    def _ln_likelihood(self, u: Array) -> Array:
        """(n,) ln likelihood of the cheap model at unit-cube points."""
        results = self.evaluate(self._theta(u), "cheap")
        self.calls += len(results)
        self.work += len(results)
        self.reasons.update(result.reason for result in results if result.reason)
        return np.array([result.ln_likelihood for result in results])

    def _draw(self) -> tuple[Array, Array]:
        """Draw from the prior until enough draws give a stream with observables; return these draws."""
        d = len(self.priors)
        sobol = qmc.Sobol(d, scramble=True, seed=self.rng)
        u, lnl = np.empty((0, d)), np.empty(0)
        drawn = 0
        parts = HURRIED if np.isfinite(self.deadline) else PARTS
        for batch in range(LAST_BATCH):
            if (batch == GIVE_UP and not len(lnl)) or (batch >= MAX_BATCHES and len(lnl) >= d + 2):
                break
            # clip to (0, 1): ppf may be infinite at the ends
            points = np.clip(sobol.random(BATCH), 1e-9, 1 - 1e-9)
            for part in np.array_split(points, parts):
                values = self._ln_likelihood(part)
                drawn += len(part)
                good = np.isfinite(values)
                u, lnl = np.concatenate([u, part[good]]), np.concatenate([lnl, values[good]])
                self._expect(draws_for(self.population, len(lnl) / drawn) - drawn, SWEEPS_IN_ALL)
                self.report(f"{len(lnl)} of {drawn} draws of the prior have a stream")
                now = monotonic()
                if len(lnl) >= (1 if now > self.deadline else ENOUGH) * self.population:
                    return u, lnl
                if self._out_of_time():
                    if len(lnl) >= d + 2:
                        return u, lnl
                    raise StreamkitError(self._nowhere(drawn, len(lnl), f" in {now - self.begun:.0f} s"))
            if len(lnl) >= self.population:
                return u, lnl
        if len(lnl) < d + 2:
            raise StreamkitError(self._nowhere(drawn, len(lnl)))
        return u, lnl

    def _out_of_time(self) -> bool:
        """Return whether a search without success must end: the time limit is long over."""
        return monotonic() > self.deadline + max(self.deadline - self.begun, GRACE)

    def _expect(self, cheap: float, sweeps: float) -> None:
        """Set the work that is left: cheap evaluations and sweeps before the full evaluations."""
        self.work_left = max(cheap, 0) + sweeps * self.population + 2 * self.walkers * self.full_cost

    def _nowhere(self, drawn: int, good: int, within: str = "") -> str:
        counted = "; ".join(f"{reason}: {n} of {drawn}" for reason, n in self.reasons.most_common())
        return (
            f"found no place to start{within}: of {drawn} draws of the prior only {good} give a stream with "
            f"observables ({counted}). Check the priors, and the seconds of a call, with `streamkit check`."
        )

    def _temper(self, u: Array, lnl: Array) -> tuple[Array, Array]:
        """Switch the likelihood on, keeping half of the population effective at every step."""
        reached: list[float] = []
        sweeps = 0
        while self.inverse_temperature < 1:
            target = min(0.5 * self.population, 0.9 * len(u))
            step = _largest_step(lnl, target, 1 - self.inverse_temperature)
            self.inverse_temperature += step
            reached.append(self.inverse_temperature)
            keep = _systematic(_weights(lnl, step), self.population, self.rng)
            u, lnl = u[keep], lnl[keep]
            moved = 0
            for _ in range(SWEEPS):
                if monotonic() > self.deadline:
                    return u, lnl
                self._expect(0, _sweeps_left(reached, sweeps))
                u, lnl, accepted = self._sweep(u, lnl)
                sweeps += 1
                moved += accepted
                if moved > len(u):
                    break
        return u, lnl

    def _sweep(self, u: Array, lnl: Array) -> tuple[Array, Array, int]:
        """Move every particle once along the difference of two of the other half of the population."""
        u, lnl = u.copy(), lnl.copy()
        n, d = u.shape
        halves = np.array_split(self.rng.permutation(n), 2)
        accepted = 0
        for mine, others in (halves, halves[::-1]):
            first = self.rng.integers(len(others), size=len(mine))
            second = (first + self.rng.integers(1, len(others), size=len(mine))) % len(others)
            # from the best length for a Gaussian down to a fifth: far from Gaussian, short steps are taken
            gamma = 2.38 / np.sqrt(2 * d) * np.exp(self.rng.uniform(np.log(0.2), 0.0, len(mine)))
            jitter = 0.02 * u.std(axis=0) * self.rng.standard_normal((len(mine), d))
            proposal = u[mine] + gamma[:, None] * (u[others[first]] - u[others[second]]) + jitter
            proposal = _reflected(proposal)
            values = self._ln_likelihood(proposal)
            with np.errstate(invalid="ignore"):  # -inf against -inf: refused
                ratio = self.inverse_temperature * (values - lnl[mine])
            taken = np.log(self.rng.random(len(mine))) < ratio
            u[mine[taken]], lnl[mine[taken]] = proposal[taken], values[taken]
            accepted += int(taken.sum())
        self.report(
            f"inverse temperature {self.inverse_temperature:.3g}, best ln L {lnl.max():.1f}, "
            f"{100 * accepted / n:.0f} % accepted"
        )
        return u, lnl, accepted

    def _make_distinct(self, u: Array, lnl: Array) -> Array:
        """Separate the copies from resampling by further moves; return the distinct points (n, d)."""
        for _ in range(5 * SWEEPS):
            distinct = np.unique(u, axis=0)
            late = monotonic() > self.deadline and len(distinct) >= 3
            if late or len(distinct) >= min(1.25 * self.walkers, len(u)):
                return distinct
            self._expect(0, 0)
            u, lnl, _ = self._sweep(u, lnl)
        return np.unique(u, axis=0)

    def _choose(self, u: Array) -> tuple[Array, list[Evaluation]]:
        """Evaluate with the full model; keep ``walkers`` points near the best, filling up around them.

        If too few are near the best, the best of all are returned.
        """
        floor = SPREAD + 0.5 * len(self.priors)
        u = self.rng.permutation(u, axis=0)
        u_good, points = np.empty((0, u.shape[1])), np.empty((0, u.shape[1]))
        results: list[Evaluation] = []
        for _ in range(ROUNDS):
            theta = self._theta(u)
            evaluations = self.evaluate(theta, "full")
            self.calls += len(evaluations)
            self.work += len(evaluations) * self.full_cost
            self.reasons.update(result.reason for result in evaluations if result.reason)
            good = [i for i, result in enumerate(evaluations) if np.isfinite(result.lnp)]
            u_good, points = np.concatenate([u_good, u[good]]), np.concatenate([points, theta[good]])
            results.extend(evaluations[i] for i in good)
            lnp = np.array([result.lnp for result in results])
            chosen = np.flatnonzero(lnp > lnp.max(initial=-np.inf) - floor)
            self.work_left = self.walkers * self.full_cost if len(chosen) < self.walkers else 0.0
            self.report(f"{min(len(chosen), self.walkers)} of {self.walkers} walkers placed")
            if len(chosen) < self.walkers <= len(results) and monotonic() > self.deadline:
                chosen = np.sort(np.argsort(-lnp)[: self.walkers])
            if len(chosen) >= self.walkers:
                return points[chosen[: self.walkers]], [results[i] for i in chosen[: self.walkers]]
            if len(results) < 3 or (self._out_of_time() and len(results) < self.walkers):
                break
            best = np.argsort(-lnp)[: max(self.walkers, 3)]
            u = self._around(u_good[best], self.walkers)
        if len(results) >= self.walkers:
            chosen = np.argsort(-lnp)[: self.walkers]
            return points[chosen], [results[i] for i in chosen]
        counted = "; ".join(f"{reason}: {n}" for reason, n in self.reasons.most_common())
        raise StreamkitError(
            f"found only {len(results)} places for {self.walkers} walkers with the full number of particles "
            f"({self.calls} calls, rejected: {counted}). "
            "Fewer walkers, more particles or narrower priors may help."
        )

    def _around(self, u: Array, n: int) -> Array:
        """(n, d) New points inside the cube, short differential steps away from good points."""
        base, first, second = (u[self.rng.integers(len(u), size=n)] for _ in range(3))
        jitter = 0.02 * u.std(axis=0) * self.rng.standard_normal(base.shape)
        return _reflected(base + 0.3 * (first - second) + jitter)


def _sweeps_left(reached: Sequence[float], sweeps: int) -> float:
    """Estimate the sweeps to come from the inverse temperatures so far: each is about the same factor larger."""
    if len(reached) < 2:
        return max(SWEEPS_IN_ALL - sweeps, 0)
    growth = np.log(reached[-1] / reached[0]) / (len(reached) - 1)
    return float(-np.log(reached[-1]) / growth * max(sweeps, 1) / len(reached))


def _reflected(u: Array) -> Array:
    """(n, d) Points thrown back from the faces of the unit cube.

    For correlated steps such a proposal is not quite symmetric: good enough for a start, not for the sampler.
    """
    folded = np.abs(u) % 2.0
    return np.asarray(np.clip(np.where(folded > 1, 2 - folded, folded), 1e-9, 1 - 1e-9))


def _weights(lnl: Array, step: float) -> Array:
    """(n,) Normalised weights exp(step * ln L)."""
    w = np.exp(step * (lnl - lnl.max()))
    return np.asarray(w / w.sum())


def _largest_step(lnl: Array, target: float, rest: float) -> float:
    """Return the largest step in inverse temperature, up to ``rest``, that leaves ``target`` effective."""

    def effective(step: float) -> float:
        return float(1 / np.sum(_weights(lnl, step) ** 2))

    if effective(rest) >= target:
        return rest
    low, high = 0.0, rest
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if effective(middle) >= target else (low, middle)
    return max(low, 1e-6 * rest)


def _systematic(weights: Array, n: int, rng: np.random.Generator) -> IntArray:
    """(n,) Indices by systematic resampling: each is taken n * weight times, to one."""
    edges = np.cumsum(weights)
    edges[-1] = 1.0
    return np.searchsorted(edges, (np.arange(n) + rng.random()) / n)
