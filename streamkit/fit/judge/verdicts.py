"""The checks of a run, each with its rule, the source of the rule, and a plain sentence.

The outcome of a check is "fine", "look here" or "do not use". The thresholds are in this file and in `chain`.
A new check of any posterior is a function here, and a line in `verdicts`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from streamkit.components import DO_NOT, FINE, LEVELS, LOOK, Check, Verdict
from streamkit.fit.judge.chain import listed
from streamkit.fit.judge.goodness import Fitted, Goodness
from streamkit.fit.judge.predictive import EDGE, Predictive, contraction, prior_fractions
from streamkit.runfile import ONLY, Normal, Prior
from streamkit.stream import Array

# Posterior predictive p-value of chi^2 (Gelman, Meng & Stern 1996). The p-value is conservative, as the parameters were
# fitted to the same data: a small one means that the model or the errors are wrong (Bayarri & Berger 2000).
GOODNESS = Check(
    "goodness of fit",
    (0.05, 0.001),
    "posterior predictive p of chi^2 (Gelman, Meng & Stern 1996), the least of all data together and of each quantity "
    "times their number: fine from 0.05 on, do not use below 0.001",
)
# A single wrong datum among many may have no influence: the verdict is "look here". A wrong model shows in chi^2 too.
WORST = Check(
    "worst datum",
    (0.05, -np.inf),
    "normal score of the farthest datum (Dunn & Smyth 1996): fine if chance makes one so far in 1 of 20 data sets",
)
# The model's noise over the data's error: added in quadrature, a third makes the error 5 % larger.
NOISE = Check(
    "own noise",
    (1 / 3, 1.0),
    "standard deviation over the datum's scatter: fine up to 1/3, 5 % in quadrature; do not use above 1",
    larger_is_worse=True,
)
NOISE_ADDED = Check(
    "own noise",
    (1.0, np.inf),
    "standard deviation over the datum's scatter, added in the likelihood here: fine up to 1",
    larger_is_worse=True,
)
# Largest fraction of all proposals that one reason may refuse: beyond, it may cut the posterior unintentionally.
REASONS = Check(
    "refused proposals",
    (0.1, np.inf),
    "fine if no reason besides the prior's ends refuses more than 10 %",
    larger_is_worse=True,
)
# A Gaussian prior is a measurement, one datum more: the farthest of them is judged like the worst datum.
MEASURED = Check(
    "measured priors",
    (2.0, np.inf),
    "distance of the posterior's median from the mean of a Gaussian prior, in its standard deviations: fine up to 2",
    larger_is_worse=True,
)
# Share of a live progenitor's mass that is bound today.
BOUND = Check("bound mass", (0.01, -np.inf), "share of the mass that is bound to the progenitor today: fine from 1 %")
# Samples at the edge of the hosts for which the likelihood of a stream is known. A Gaussian that is cut where 1 % of it
# is left has lost nothing that matters.
DOMAIN = Check(
    "edge of the data's domain",
    (0.01, 0.1),
    "share of the samples at the edge of the hosts that the data know of: fine up to 1 %, do not use above 10 %",
    larger_is_worse=True,
)
AT_EDGE = 0.1  # fraction of the posterior in the outermost 2 % of a prior, where the prior itself has 2 %
# Ratio of the widths of posterior and prior above which the data do not constrain a parameter. The page says so, and it
# is no fault: the prior of a parameter may be an earlier measurement.
UNINFORMED = 0.9


class Judged(Protocol):
    """What is judged of a run: `streamkit.Results` has all of it."""

    quick: bool
    names: tuple[str, ...]
    samples: Array  # (n, d)
    reasons: dict[str, int]
    calls: int

    @property
    def own_verdicts(self) -> list[Verdict]:
        """The outcomes of the checks that belong to the sampler."""

    @property
    def fit(self) -> Goodness | None:
        """The goodness of fit."""

    @property
    def unmeasured(self) -> str:
        """The reason why the stream at the best sample has no predictions."""

    @property
    def emulated(self) -> bool:
        """Whether the predictions of the samples are those of an emulator, and not of calls."""

    @property
    def uncertified(self) -> bool:
        """Whether an emulator's predictions have not passed its own test."""

    @property
    def noisy(self) -> Predictive | None:
        """The predictions, where their noise is judged."""

    @property
    def priors(self) -> Sequence[Prior]:
        """(d,) The priors of the free parameters."""

    @property
    def bound_shares(self) -> Mapping[str, float]:
        """The share of its mass that is bound today, of each live progenitor of the best sample by its stream."""


def verdicts(run: Judged) -> list[Verdict]:
    """Return the outcome of every check that the run allows."""
    outcomes = [quick_verdict()] if run.quick else []
    outcomes += run.own_verdicts
    if run.fit is not None:
        unsure = disagreement_verdict(run.fit, run.uncertified) if run.emulated else None
        outcomes += [goodness_verdict(run.fit), worst_verdict(run.fit.whole)] if unsure is None else [unsure]
        outcomes += [domain_verdict(run.fit.at_edge)] if any(run.fit.at_edge.values()) else []
    elif run.unmeasured:
        outcomes.append(unmeasured_verdict(run.unmeasured))
    if run.noisy is not None:
        outcomes.append(noise_verdict(run.noisy))
    outcomes.append(reasons_verdict(run.reasons, run.calls))
    fractions = [prior_fractions(p, x) for p, x in zip(run.priors, run.samples.T, strict=True)]
    outcomes.append(prior_verdict(run.names, fractions, [prior.support for prior in run.priors]))
    if any(isinstance(prior, Normal) for prior in run.priors):
        outcomes.append(measured_verdict(run.names, run.priors, run.samples))
    if run.bound_shares:
        outcomes.append(bound_verdict(run.bound_shares))
    return outcomes


def overall(outcomes: Sequence[Verdict]) -> tuple[str, str]:
    """Return the worst level, and what it means for the run as a whole."""
    worst = max((v.level for v in outcomes), key=LEVELS.index, default=FINE)
    which = listed([v.subject for v in outcomes if v.level == worst])
    said = {
        FINE: "All checks are passed: the medians and intervals below can be quoted.",
        LOOK: f"The intervals can be used once you have looked at: {which}.",
        DO_NOT: f"Do not quote numbers of this run. Failed checks: {which}.",
    }
    return worst, said[worst]


def quick_verdict() -> Verdict:
    """Judge a coarse look: it is never for science."""
    said = "A quick look has few particles, few walkers and little time. Run again without --quick."
    return Verdict("kind of run", DO_NOT, "quick look", said, "a run made with --quick is not for science")


def goodness_verdict(fit: Goodness) -> Verdict:
    """Judge whether the model fits the data: all of them, and those of each quantity."""
    (least, p), poorest = fit.least, fit.poorest
    n, several = len(least.data), least is fit.whole and len(fit.quantities) > 1
    name = f"{least.name}, least of all {poorest.name}" if several else least.name
    datum, away = poorest.data[poorest.worst], poorest.residuals[poorest.worst]
    far = f"{datum}, {away:+.1f} sigma from the best sample,"
    sentences = {
        FINE: "The model fits the data.",
        LOOK: f"The model fits {name} poorly: {far} is the farthest datum.",
        DO_NOT: f"The model does not fit {name}, so its intervals have no meaning: either the model is wrong, or the "
        f"errors of the data are too small. The farthest datum is {far.rstrip(',')}.",
    }
    return GOODNESS.judge(p, f"chi^2 = {least.best:.4g} of {n} {'data' if n > 1 else 'datum'}, p = {p:.2g}", sentences)


def disagreement_verdict(fit: Goodness, uncertified: bool) -> Verdict | None:
    """Judge emulated predictions that may not be the model's; None where they can judge the goodness of fit.

    The chi^2 of the best sample comes from a call, the p-values from emulated predictions. If the emulator is right and
    the call is far from the data, the samples are far from the data too.
    """
    whole = fit.whole
    contradicted = whole.p_of_best < GOODNESS.limits[1] <= whole.p_value
    if not (uncertified or contradicted):
        return None
    value = f"chi^2 = {whole.best:.4g} of {len(whole.data)} data by a call"
    why = "is not certified" if uncertified else f"disagrees with that call (its p = {whole.p_value:.2g})"
    said = f"The emulator {why}: the goodness of fit is unknown. Continue with more calls."
    return Verdict("goodness of fit", LOOK, value, said, "not stated unless emulated predictions are those of calls")


def unmeasured_verdict(why: str) -> Verdict:
    """Judge a best sample whose stream cannot be measured."""
    said = (
        "The goodness of fit is unknown: the stream at the best sample cannot be measured. The posterior is at the "
        "edge of the parameters with measurable streams. Look at the picture of the stream, and at the reasons of "
        "refused calls."
    )
    return Verdict("goodness of fit", LOOK, why, said, "the stream at the best sample must have predictions")


def worst_verdict(whole: Fitted) -> Verdict:
    """Judge the datum that is farthest from its prediction."""
    name, away = whole.data[whole.worst], whole.residuals[whole.worst]
    sentences = {
        FINE: f"No datum is too far from the model. The farthest datum is {name}.",
        LOOK: f"{name} is too far from the model for a random error. Check this datum and its error. Does the mass "
        "change without it? Outliers and an extra dispersion may be parameters of the fit.",
    }
    return WORST.judge(whole.worst_chance, f"{away:+.1f} sigma", sentences)


def noise_verdict(seen: Predictive) -> Verdict:
    """Judge the noise of the model, from its finite number of particles, beside the errors of the data."""
    worst = int(np.argmax(seen.noise))
    noise, name = float(seen.noise[worst]), seen.names[worst]
    if seen.add_noise:
        sentences = {
            FINE: "The model's own noise is part of the likelihood, and smaller than the errors of the data.",
            LOOK: f"The model's own noise is larger than the error of {name}. It is part of the likelihood and widens "
            "the intervals: more particles would narrow them.",
        }
        return NOISE_ADDED.judge(noise, f"{noise:.2f}", sentences)
    more = "It is left out of the likelihood, so that intervals are too narrow: take more particles, or noise = 'add'."
    sentences = {
        FINE: "The model's own noise is small beside the errors of the data.",
        LOOK: f"The model's own noise is not small beside the error of {name}. {more}",
        DO_NOT: f"The model's own noise is larger than the error of {name}. {more}",
    }
    return NOISE.judge(noise, f"{noise:.2f}", sentences)


def reasons_verdict(reasons: Mapping[str, int], calls: int) -> Verdict:
    """Judge the proposals that were refused for another reason than the prior."""
    shares = {reason: n / calls for reason, n in reasons.items() if calls and reason != "outside the prior"}
    worst = max(shares, key=shares.__getitem__, default="")
    share = shares.get(worst, 0.0)
    sentences = {
        FINE: "Few proposals have no stream or no observable.",
        LOOK: f"Many proposals are refused for one reason: {worst}. Does this cut the posterior unintentionally?",
    }
    return REASONS.judge(share, f"{100 * share:.0f} %", sentences)


def prior_verdict(
    names: Sequence[str], fractions: Sequence[Array], supports: Sequence[tuple[float, float]]
) -> Verdict:
    """Judge the influence of the priors, from the (n,) samples of every parameter as fractions of its prior.

    ``supports`` are the ends of the priors. A normal prior has none: `measured_verdict` judges samples in its wings.
    """
    ends = [
        max((u < EDGE).mean() * np.isfinite(low), (u > 1 - EDGE).mean() * np.isfinite(high))
        for u, (low, high) in zip(fractions, supports, strict=True)
    ]
    at_edge = [name for name, share in zip(names, ends, strict=True) if share > AT_EDGE]
    silent = [name for name, u in zip(names, fractions, strict=True) if contraction(u) > UNINFORMED]
    level = LOOK if at_edge else FINE
    said = [f"The posterior of {listed(at_edge)} reaches the prior's end: other ends would change it."] * bool(at_edge)
    said += [f"The data do not constrain {listed(silent)}: the posterior is the prior."] * bool(silent)
    value = f"{len(at_edge)} at an end, {len(silent)} uninformed"
    rule = "fine if at most 10 % of the samples are in the outermost 2 % of a prior; uninformed: spread above 0.9 of it"
    text = " ".join(said) or "Every posterior is narrower than its prior, and none reaches an end of it."
    return Verdict("prior against posterior", level, value, text, rule)


def measured_verdict(names: Sequence[str], priors: Sequence[Prior], samples: Array) -> Verdict:
    """Judge the distance of the samples (n, d) from the Gaussian priors."""
    away = {
        name: float((np.median(x) - prior.mean) / prior.sd)
        for name, prior, x in zip(names, priors, samples.T, strict=True)
        if isinstance(prior, Normal)
    }
    name = max(away, key=lambda each: abs(away[each]))
    sentences = {
        FINE: f"Every measured parameter is near its measurement. The farthest is {name}.",
        LOOK: f"The data move {name} away from its measurement. The model, the data or the measurement is wrong.",
    }
    return MEASURED.judge(abs(away[name]), f"{away[name]:+.1f} sigma", sentences)


def bound_verdict(shares: Mapping[str, float]) -> Verdict:
    """Judge whether the live progenitors of the best sample still exist."""
    name = min(shares, key=shares.__getitem__)
    whose = "The progenitor" if name == ONLY else f"The progenitor of {name}"
    sentences = {
        FINE: "Every live progenitor still has a bound part today.",
        LOOK: f"{whose} has dissolved before today. Is there a progenitor at its position on the sky? The last "
        "debris leaves at random, and depends on the number of particles.",
    }
    return BOUND.judge(shares[name], f"{100 * shares[name]:.2g} % of the mass", sentences)


def domain_verdict(shares: Mapping[str, float]) -> Verdict:
    """Judge whether the samples reach the edge of the hosts that data of the host know of."""
    name = max(shares, key=shares.__getitem__)
    cut = f"The posterior reaches the edge of the hosts that {name} knows of, and is cut there."
    sentences = {
        FINE: f"Few samples are at the edge of the hosts that {name} knows of.",
        LOOK: f"{cut} Masses may be off, and errors too small: fit with the stream itself in place of {name}.",
        DO_NOT: f"{cut} Fit with the stream itself in place of {name}.",
    }
    return DOMAIN.judge(shares[name], f"{100 * shares[name]:.0f} % of the samples", sentences)
