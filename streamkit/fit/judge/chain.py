"""Checks of a chain and their statistics: its length, R-hat, samples, drift, ranks, stuck walkers, acceptance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import norm, rankdata

from streamkit.components import DO_NOT, FINE, LOOK, Check, Verdict
from streamkit.stream import Array

# 50 autocorrelation times as emcee's documentation asks for; with fewer than 10 their estimate means nothing.
LENGTH = Check(
    "length of the chain",
    (50.0, 10.0),
    "fine from 50 autocorrelation times tau on, with a stable tau (emcee's documentation); do not use below 10",
)
# Vehtari+ 2021 ask for 1.01 of 4 long independent chains; walkers are many and each is short, so that 1.02 is the
# default of the run file. Above 1.1 chains have not mixed (Gelman & Rubin 1992; Gelman+ 2013, sec. 11.5).
R_HAT = Check(
    "R-hat",
    (1.02, 1.1),
    "fine up to 1.02, do not use above 1.1 (Gelman & Rubin 1992; Vehtari+ 2021 ask 1.01 of 4 long chains)",
    larger_is_worse=True,
)
# With 100 effective samples the median is known to 0.13 of the standard deviation.
SAMPLES = Check("effective samples", (400.0, 100.0), "fine from 400 on (Vehtari+ 2021, sec. 4), do not use below 100")
# The probability that a stationary chain drifts as much as this one, over all parameters.
DRIFT = Check(
    "traces",
    (0.01, 1e-4),
    "last against first third (Geweke 1992), over all parameters: fine if chance makes 1 in 100, not below 1e-4",
)
# The probability that mean ranks of walkers of one distribution differ as much. The verdict is "look here" at worst:
# R-hat measures the difference.
RANKS = Check(
    "rank plots",
    (0.01, -np.inf),
    "mean rank of each walker (Vehtari+ 2021, sec. 4): fine if chance makes 1 in 100 over walkers and parameters",
)
# Fractions of walkers: one end of a 95 % interval has 2.5 % of the samples beyond it, one of a 68 % interval 16 %.
STUCK = Check(
    "stuck walkers",
    (0.0, 0.16),
    "fine without any; do not use if they are more than 16 %, the tail outside a 68 % interval",
    larger_is_worse=True,
)
TAIL_95 = 0.025
# The efficiency of random walks changes little from 0.15 to 0.5 (Roberts & Rosenthal 2001, sec. 3; emcee's authors
# advise 0.2 to 0.5). An acceptance of 0.01 indicates a rough likelihood. A high acceptance is not judged: short steps
# show in the length of the chain.
ACCEPTANCE = Check("acceptance", (0.15, 0.01), "fine from 0.15 on (Roberts & Rosenthal 2001), do not use below 0.01")


def length_verdict(span: float, stable: bool) -> Verdict:
    """Judge the chain's length in autocorrelation times."""
    short = {
        LOOK: "The chain is short, or its autocorrelation time still changes. Continue with --resume and more --steps.",
        DO_NOT: "The chain is too short for any interval. Continue with --resume and more --steps.",
    }
    fine = "The chain is long enough: its samples do not depend on the start."
    shown = f"{span:.0f} tau" if np.isfinite(span) else "unknown"
    verdict = LENGTH.judge(span, shown, short | {FINE: fine})
    return verdict if stable or verdict.level != FINE else replace(verdict, level=LOOK, sentence=short[LOOK])


def r_hat_verdict(names: Sequence[str], r_hat: Array) -> Verdict:
    """Judge the largest rank-normalised split R-hat."""
    largest = float(np.max(r_hat))
    which = listed([name for name, value in zip(names, r_hat, strict=True) if not value <= R_HAT.limits[0]])
    sentences = {
        FINE: "The walkers agree with each other on every parameter.",
        LOOK: f"The walkers do not fully agree on {which}: the intervals may change. Continue with --resume.",
        DO_NOT: f"The walkers disagree on {which}: they have not reached a common distribution.",
    }
    return R_HAT.judge(largest, number(largest, ".3f"), sentences)


def samples_verdict(names: Sequence[str], ess: Array) -> Verdict:
    """Judge the smallest effective number of samples."""
    least = float(np.min(ess))
    worst = names[int(np.argmin(np.nan_to_num(ess)))]
    error = 1.2533 / np.sqrt(max(least, 1.0))  # of a median, in standard deviations of a Gaussian
    sentences = {
        FINE: f"The median of every parameter is known to {error:.2f} of its standard deviation or better.",
        LOOK: f"The median of {worst} is only known to {error:.2f} of its standard deviation, the 95 % limits to less.",
        DO_NOT: f"There are too few independent samples of {worst} for an interval."
        if np.isfinite(least)
        else "The walkers disagree, or moved too little: there is no estimate of the independent samples yet.",
    }
    return SAMPLES.judge(least, number(least, ".0f"), sentences)


def drift_verdict(names: Sequence[str], scores: Array) -> Verdict:
    """Judge whether the traces still drift."""
    worst = names[int(np.argmax(np.abs(np.nan_to_num(scores))))]
    sentences = {
        FINE: "The traces do not drift: the last third of the chain has the means of the first.",
        LOOK: f"The trace of {worst} seems to drift. Look at the traces: is the burn-in long enough?",
        DO_NOT: f"The trace of {worst} drifts: the chain has not converged. Continue with --resume.",
    }
    return DRIFT.judge(chance(scores), number(float(np.max(np.abs(scores))), ".1f", " sigma"), sentences)


def ranks_verdict(scores: Array) -> Verdict:
    """Judge whether all walkers sample the same distribution, from the scores (walkers, d) of their mean ranks."""
    which = int(np.argmax(np.abs(np.nan_to_num(scores)).max(axis=1)))
    differ = f"The walkers have different distributions, walker {which} most of all: look at the rank plots."
    sentences = {FINE: "Every walker has sampled the whole posterior: the ranks of each walker are even.", LOOK: differ}
    p = chance(scores)
    shown = number(float(np.max(np.abs(scores))), ".1f", " sigma")
    return RANKS.judge(p if np.isfinite(p) else 0.0, shown, sentences)


def stuck_verdict(stuck: int, walkers: int) -> Verdict:
    """Judge the walkers that are stuck on a false maximum."""
    tail = "95 % intervals are" if stuck / walkers > TAIL_95 else "outermost tails are"
    sentences = {
        FINE: "No walker is stuck.",
        LOOK: f"The {tail} too wide by the stuck walkers. Continue with --resume; if they stay, take more particles.",
        DO_NOT: "So many walkers are stuck that they change even the 68 % intervals. Take more particles, or noise = "
        "'add', and start again.",
    }
    return STUCK.judge(stuck / walkers, f"{stuck} of {walkers}", sentences)


def acceptance_verdict(acceptance: float) -> Verdict:
    """Judge the fraction of accepted proposals."""
    sentences = {
        FINE: "Enough proposals are accepted.",
        LOOK: "Few proposals are accepted: the chain is slow, which its length shows too. A likelihood that is rough "
        "because streams have few particles does this.",
        DO_NOT: "Hardly any proposal is accepted: the likelihood is too rough, or the moves do not fit. Take more "
        "particles, or noise = 'add'.",
    }
    return ACCEPTANCE.judge(acceptance, f"{acceptance:.2f}", sentences)


def number(value: float, form: str, unit: str = "") -> str:
    """Return a number in a format, with its unit; "unknown" for NaN and infinity."""
    return f"{value:{form}}{unit}" if np.isfinite(value) else "unknown"


def listed(names: Sequence[str], most: int = 4) -> str:
    """Return "a, b and c", and how many more there are."""
    if len(names) > most + 1:
        return f"{', '.join(names[:most])} and {len(names) - most} more"
    return " and ".join([", ".join(names[:-1]), names[-1]]) if len(names) > 1 else "".join(names)


def drift(kept: Array, tau: Array) -> Array:
    """(d,) Difference of the means of the last and the first third of a chain, in its standard errors (Geweke 1992).

    ``kept`` (steps, walkers, d) are the samples after burn-in, ``tau`` (d,) their autocorrelation times in steps. NaN
    for fewer than 6 steps.
    """
    steps, walkers, d = kept.shape
    third = steps // 3
    if third < 2:
        return np.full(d, np.nan)
    first, last = kept[:third], kept[-third:]
    variance = (first.var(axis=(0, 1)) + last.var(axis=(0, 1))) * tau / (third * walkers)
    with np.errstate(all="ignore"):  # a parameter that never moved
        return np.asarray((last.mean(axis=(0, 1)) - first.mean(axis=(0, 1))) / np.sqrt(variance))


def ranks(kept: Array) -> Array:
    """(steps, walkers, d) Rank of every sample among all of its parameter, between 0 and 1 (Vehtari+ 2021, sec. 4)."""
    flat = kept.reshape(-1, kept.shape[2])
    return np.asarray((rankdata(flat, axis=0) - 0.5) / len(flat)).reshape(kept.shape)


def rank_scores(kept: Array, tau: Array) -> Array:
    """(walkers, d) How far each walker's mean rank is from 1/2, in standard errors of its independent samples."""
    steps = len(kept)
    with np.errstate(all="ignore"):
        return np.asarray((ranks(kept).mean(axis=0) - 0.5) / np.sqrt(tau / (12 * steps)))


def chance(scores: Array) -> float:
    """Return the probability that the largest of n independent normal scores is as large; NaN without any."""
    finite = np.abs(scores[np.isfinite(scores)])
    if not finite.size:
        return np.nan
    return at_least_one(2 * float(norm.sf(finite.max())), finite.size)


def at_least_one(p: float, n: int) -> float:
    """Return the probability that at least one of n independent events of probability p happens."""
    return float(-np.expm1(n * np.log1p(-p))) if p < 1 else 1.0
