"""The rule of convergence of a chain, and its terms: autocorrelation time, effective samples, R-hat, burn-in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from streamkit.stream import Array, IntArray

CHECK = 100  # steps between two looks at the autocorrelation time
STABLE = 0.05  # the autocorrelation time must have changed by less than this fraction since the last look
LOW = 5.0  # a stuck walker's mean ln p is below the others' mean by more than so many standard deviations of the means
NARROW = 0.5  # and its samples scatter by less than this fraction of the median walker's scatter


def autocorrelation_times(chain: Array) -> Array:
    """(d,) Integrated autocorrelation times in steps of a chain (steps, walkers, d) (Goodman & Weare 2010).

    NaN where it cannot be estimated: fewer than 8 steps, or walkers that never moved.
    """
    steps, _, d = chain.shape
    if steps < 8:
        return np.full(d, np.nan)
    from emcee.autocorr import integrated_time  # slow to load

    with np.errstate(all="ignore"):
        tau = np.asarray(integrated_time(chain, tol=0, quiet=True), dtype=float)
    return np.where(np.isfinite(tau) & (tau > 0), tau, np.nan)


def burn_in(chain: Array) -> int:
    """Return the steps to discard: three times the longest autocorrelation time, at most half the chain."""
    tau = autocorrelation_times(chain)
    half = len(chain) // 2
    return half if np.isnan(tau).any() else min(int(np.ceil(3 * tau.max())), half)


def effective_samples(chain: Array, tau: Array) -> Array:
    """(d,) Number of independent samples that a chain (steps, walkers, d) is worth, at tau (d,)."""
    steps, walkers, _ = chain.shape
    return np.asarray(steps * walkers / tau)


def rank_r_hat(chain: Array) -> Array:
    """(d,) Rank-normalised split R-hat (Vehtari+ 2021) of a chain (steps, walkers, d), each walker a chain.

    NaN where there is none: fewer than 4 steps, fewer than 2 walkers, or a parameter that never moved.
    """
    steps, walkers, d = chain.shape
    r_hat = np.full(d, np.nan)
    moved = np.ptp(chain.reshape(-1, d), axis=0) > 0 if chain.size else np.zeros(d, dtype=bool)
    if steps >= 4 and walkers >= 2 and moved.any():
        from arviz_stats.base.array import array_stats  # a second or more to load

        with np.errstate(all="ignore"):  # infinite for walkers that rest at different places
            r_hat[moved] = array_stats.rhat(  # type: ignore[no-untyped-call]
                chain[..., moved], chain_axis=1, draw_axis=0, method="rank"
            )
    return r_hat


def stuck_walkers(chain: Array, log_prob: Array) -> IntArray:
    """Return the numbers of the walkers that are stuck on a false maximum, or do not move at all.

    Over the last half of the chain, such a walker's mean ln p lies far below the ensemble's, by the robust standard
    deviation (from the median absolute deviation) of the walkers' means; and it roams less than half as far as
    the median walker, by the largest of its standard deviations in units of the ensemble's. One that is only on
    an excursion into a tail moves, and one that rests near the maximum is not low.

    Parameters
    ----------
    chain, log_prob
        (steps, walkers, d) and (steps, walkers); of fewer than 16 steps the result is empty.
    """
    steps = len(chain)
    if steps < 16:
        return np.empty(0, dtype=np.int64)
    late, lnp = chain[steps // 2 :], log_prob[steps // 2 :].mean(axis=0)
    deviation = np.median(lnp) - lnp
    low = deviation > LOW * 1.4826 * np.median(np.abs(deviation))
    whole = late.std(axis=(0, 1))
    roams = np.max(late.std(axis=0) / np.where(whole > 0, whole, 1.0), axis=1)
    return np.flatnonzero(low & (roams < NARROW * np.median(roams)))


@dataclass(frozen=True, eq=False)
class Convergence:
    """The one rule of convergence, for the sampler and all that reports on its chain: a function of the chain alone.

    True if the chain without the steps of learning spans more than ``tau_factor`` of its longest autocorrelation times,
    if this time is stable, and if after burn-in R-hat of every parameter is below ``largest_r_hat``.

    Parameters
    ----------
    chain
        (steps, walkers, d) all samples.
    learning
        Steps at the beginning in which the moves still learn.
    tau_factor, largest_r_hat
        As the run file's ``[sampler]`` has them; with an infinite ``largest_r_hat`` none is computed.
    """

    chain: Array = field(repr=False)
    learning: int
    tau_factor: float
    largest_r_hat: float

    @property
    def learned(self) -> int:
        """Steps left out as those of learning: at most half of a chain that is too short for the rule."""
        steps = len(self.chain)
        return self.learning if steps > self.learning + CHECK else min(self.learning, steps // 2)

    @cached_property
    def discard(self) -> int:
        """Steps of learning and of burn-in."""
        return self.learned + burn_in(self.chain[self.learned :])

    @cached_property
    def tau(self) -> Array:
        """(d,) Autocorrelation times in steps, after learning; NaN where there is no estimate."""
        return autocorrelation_times(self.chain[self.learned :])

    @cached_property
    def r_hat(self) -> Array:
        """(d,) Rank-normalised split R-hat after burn-in."""
        return rank_r_hat(self.chain[self.discard :])

    @property
    def span(self) -> float:
        """Length of the chain after learning in its longest autocorrelation times; NaN without an estimate."""
        return float((len(self.chain) - self.learned) / np.max(self.tau))

    @property
    def is_stable(self) -> bool:
        """Whether the longest autocorrelation time is nearly what it was `CHECK` steps before."""
        if len(self.chain) <= self.learning + CHECK:
            return False
        tau, before = (float(np.max(t)) for t in (self.tau, autocorrelation_times(self.chain[self.learned : -CHECK])))
        return abs(tau - before) < STABLE * tau

    def __bool__(self) -> bool:
        if not (self.span > self.tau_factor and self.is_stable):
            return False
        return bool(np.isinf(self.largest_r_hat) or (self.r_hat < self.largest_r_hat).all())

    @property
    def expected_steps(self) -> float:
        """Steps after which the rule may be met, a multiple of `CHECK`; NaN without an estimate.

        R-hat - 1 falls approximately as the inverse of the length.
        """
        steps, longest = len(self.chain), float(np.max(self.tau))
        if self:
            return float(steps)
        wanted = self.learned + self.tau_factor * longest
        if wanted < steps and np.isfinite(self.largest_r_hat):
            ratio = (float(np.max(self.r_hat)) - 1) / (self.largest_r_hat - 1)
            wanted = self.learned + (steps - self.learned) * ratio
        return float(CHECK * np.ceil(max(wanted, steps + 1) / CHECK))

    def missing(self, names: Sequence[str]) -> str:
        """Say what a chain of parameters of these names lacks; empty if it has converged."""
        if self:
            return ""
        steps = f"{len(self.chain) - self.learned} steps{' after learning' if self.learned else ''}"
        if not np.isfinite(self.span):
            return f"{steps} are too few, or walkers move too little, to estimate the autocorrelation time"
        lacks = []
        if not self.span > self.tau_factor:
            lacks.append(f"{steps} are {self.span:.0f} autocorrelation times, and {self.tau_factor:g} are wanted")
        elif not self.is_stable:
            lacks.append("the autocorrelation time is not stable yet")
        values = zip(names, self.r_hat, strict=True)
        if apart := [f"{name} ({value:.3g})" for name, value in values if not value < self.largest_r_hat]:
            lacks.append(f"R-hat is not below {self.largest_r_hat:g} for {', '.join(apart)}")
        return "; ".join(lacks)
