"""Whether to believe a run: every check with its rule, its source, and a plain sentence.

Each rule has one of three outcomes: fine, look here, do not use. The thresholds stand here and nowhere else.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from streamkit.sample import Weighted
from streamkit.stream import Array
from streamkit.study.fit.diagnostics import (
    EDGE,
    Predictive,
    chance,
    contraction,
    drift,
    predictive,
    prior_fractions,
    rank_scores,
)

if TYPE_CHECKING:
    from streamkit.study.fit.results import Results

FINE, LOOK, DO_NOT = LEVELS = ("fine", "look here", "do not use")  # the verdicts, from good to bad

# Autocorrelation times: 50 as the documentation of emcee asks for; with fewer than 10 their estimate means nothing.
LENGTH = (50.0, 10.0)
# Vehtari+ 2021 ask for 1.01 of 4 long independent chains; walkers are many and each is short, so that 1.02 is the
# default of the run file. Above 1.1 chains have not mixed (Gelman & Rubin 1992; Gelman+ 2013, sec. 11.5).
R_HAT = (1.02, 1.1)
# Effective samples: 400 (Vehtari+ 2021, sec. 4); with 100 the median is known to 0.13 of the standard deviation.
SAMPLES = (400.0, 100.0)
DRIFT = (0.01, 1e-4)  # chance that a stationary chain drifts as much as this one (Geweke 1992), over all parameters
RANKS = 0.01  # chance that mean ranks of walkers of one distribution differ as much, over all walkers and parameters
# Share of the largest weight: with one in a hundred a percentile is coarse, with one in ten it is that sample.
HEAVIEST = (0.01, 0.1)
# Share of walkers: 2.5 % of the samples hold one end of a 95 % interval, 16 % that of a 68 % interval.
STUCK = (0.025, 0.16)
# Random walks lose little from 0.15 to 0.5 (Roberts & Rosenthal 2001, sec. 3; emcee's authors advise 0.2 to 0.5). One
# in a hundred is the sign of a rough likelihood. High acceptance is no fault here: short steps show in the length.
ACCEPTANCE = (0.15, 0.01)
P_VALUE = (0.05, 0.001)  # posterior predictive p-value of chi^2 (Gelman, Meng & Stern 1996)
# Share of all proposals that one reason may refuse, before it may cut the posterior where nobody meant it to.
REASON = 0.1
NOISE = (1 / 3, 1.0)  # the model's noise over the data's error: added in quadrature, a third makes the error 5 % larger
AT_EDGE = 0.1  # share of the posterior in the outermost 2 % of a prior, where the prior itself has 2 %
# Spread of the posterior over that of the prior above which the data say nothing of a parameter. It is said, and no
# fault: a parameter that was measured elsewhere has its measurement as its prior.
UNINFORMED = 0.9


@dataclass(frozen=True)
class Verdict:
    """The outcome of one check.

    Attributes
    ----------
    subject
        What was looked at.
    level
        "fine", "look here" or "do not use".
    value
        What was found, in a few characters.
    sentence
        What it means, and what to do.
    rule
        The thresholds, and where they come from.
    """

    subject: str
    level: str
    value: str
    sentence: str
    rule: str


def level_above(value: float, limits: tuple[float, float]) -> str:
    """Return "fine" up to the first limit, "do not use" above the second; NaN cannot be trusted."""
    return FINE if value <= limits[0] else LOOK if value <= limits[1] else DO_NOT


def level_below(value: float, limits: tuple[float, float]) -> str:
    """Return "fine" from the first limit on, "do not use" below the second; NaN cannot be trusted."""
    return FINE if value >= limits[0] else LOOK if value >= limits[1] else DO_NOT


def verdicts(results: Results) -> list[Verdict]:
    """Return the outcome of every check that the run allows."""
    kept, tau, names = results.kept, results.tau, results.names
    found = [quick_verdict()] if results.quick else []
    found += (
        weighted_verdicts(results.weighted, results.spec.sampler.kind)
        if results.weighted is not None
        else [
            length_verdict(results.convergence.span, results.convergence.is_stable),
            r_hat_verdict(names, results.r_hat),
            samples_verdict(names, results.ess),
            drift_verdict(names, drift(kept, tau)),
            ranks_verdict(rank_scores(kept, tau)),
            stuck_verdict(len(results.stuck), kept.shape[1]),
            acceptance_verdict(results.acceptance),
        ]
    )
    if (seen := predictive(results)) is not None:
        found += [predictive_verdict(seen)] if seen.gaussian else []
        found.append(noise_verdict(seen))
    found.append(reasons_verdict(results.reasons, results.calls))
    fractions = [prior_fractions(p, x) for p, x in zip(results.spec.priors, results.samples.T, strict=True)]
    found.append(prior_verdict(names, fractions))
    return found


def overall(found: Sequence[Verdict]) -> tuple[str, str]:
    """Return the worst level, and what it means for the run as a whole."""
    worst = max((v.level for v in found), key=LEVELS.index, default=FINE)
    which = _listed([v.subject for v in found if v.level == worst])
    said = {
        FINE: "All checks are passed: the medians and intervals below can be quoted.",
        LOOK: f"The intervals can be used once you have looked at: {which}.",
        DO_NOT: f"Do not quote numbers of this run. What stands against it: {which}.",
    }
    return worst, said[worst]


def quick_verdict() -> Verdict:
    """Judge a coarse look: it is never for science."""
    said = "A quick look has few particles, few walkers and little time. Run again without --quick."
    return Verdict("kind of run", DO_NOT, "quick look", said, "a run made with --quick is not for science")


def weighted_verdicts(weighted: Weighted, kind: str) -> list[Verdict]:
    """Judge samples that have weights: what stands for R-hat, which compares chains, is the sampler's own rule."""
    level = LOOK if weighted.missing else FINE
    said = {
        FINE: f"The rule of {kind} is met. There is no R-hat, which compares chains: that no region was missed "
        "rests on this rule. Run it again with another seed where much depends on it.",
        LOOK: f"Not ended by its own rule: {weighted.missing}. Continue with --resume.",
    }
    error = weighted.ln_evidence_error
    value = f"ln Z = {weighted.ln_evidence:.2f} ± {error:.2f}" if np.isfinite(weighted.ln_evidence) else kind
    rule = f"fine when {kind} has ended by its own rule, which the run file sets"
    least, largest = weighted.ess, float(weighted.weights.max())
    samples = level_below(least, SAMPLES)
    known = f"Every median is known to {1.2533 / np.sqrt(max(least, 1.0)):.2f} of its standard deviation"

    ended = {
        FINE: f"{known} or better.",
        LOOK: f"{known} only, the 95 % limits worse. Ask for more effective samples.",
        DO_NOT: "There are too few independent samples for an interval.",
    }
    weight = level_above(largest, HEAVIEST)
    heavy = {
        FINE: "No single sample carries much of the posterior.",
        LOOK: "One sample carries a visible part of the posterior: ask for more effective samples.",
        DO_NOT: "One sample carries much of the posterior: the maximum has hardly been found.",
    }
    return [
        Verdict("rule of the sampler", level, value, said[level], rule),
        Verdict(
            "effective samples",
            samples,
            _number(least, ".0f"),
            ended[samples],
            "from the weights (Kish 1965): fine from 400 on (Vehtari+ 2021, sec. 4), do not use below 100",
        ),
        Verdict("largest weight", weight, _number(100 * largest, ".2g", " %"), heavy[weight],
                "fine up to 1 % of all weights, do not use above 10 %"),
    ]  # fmt: skip


def length_verdict(span: float, stable: bool) -> Verdict:
    """Judge the chain's length in autocorrelation times."""
    level = level_below(span, LENGTH)
    level = LOOK if level == FINE and not stable else level
    said = {
        FINE: "The chain is long enough: it has forgotten where it began many times over.",
        LOOK: "The chain is short, or its autocorrelation time still changes. Continue with --resume and more --steps.",
        DO_NOT: "The chain is too short for any interval. Continue with --resume and more --steps.",
    }
    value = f"{span:.0f} tau" if np.isfinite(span) else "unknown"
    rule = "fine from 50 autocorrelation times tau on, with a stable tau (emcee's documentation); do not use below 10"
    return Verdict("length of the chain", level, value, said[level], rule)


def r_hat_verdict(names: Sequence[str], r_hat: Array) -> Verdict:
    """Judge the largest rank-normalised split R-hat."""
    largest = float(np.max(r_hat))
    level = level_above(largest, R_HAT)
    which = _listed([name for name, value in zip(names, r_hat, strict=True) if not value <= R_HAT[0]])
    said = {
        FINE: "The walkers agree with each other on every parameter.",
        LOOK: f"The walkers do not quite agree on {which}: the intervals may move. Let the chain run on.",
        DO_NOT: f"The walkers disagree on {which}: they have not found one common distribution.",
    }
    rule = "fine up to 1.02, do not use above 1.1 (Gelman & Rubin 1992; Vehtari+ 2021 ask 1.01 of 4 long chains)"
    return Verdict("R-hat", level, _number(largest, ".3f"), said[level], rule)


def samples_verdict(names: Sequence[str], ess: Array) -> Verdict:
    """Judge the smallest effective number of samples."""
    least = float(np.min(ess))
    level = level_below(least, SAMPLES)
    worst = names[int(np.argmin(np.nan_to_num(ess)))]
    error = 1.2533 / np.sqrt(max(least, 1.0))
    said = {
        FINE: f"The median of every parameter is known to {error:.2f} of its standard deviation or better.",
        LOOK: f"The median of {worst} is known to {error:.2f} of its standard deviation only, the 95 % limits worse.",
        DO_NOT: f"There are too few independent samples of {worst} for an interval.",
    }
    rule = "fine from 400 on (Vehtari+ 2021, sec. 4), do not use below 100"
    return Verdict("effective samples", level, _number(least, ".0f"), said[level], rule)


def drift_verdict(names: Sequence[str], scores: Array) -> Verdict:
    """Judge whether the traces still drift."""
    p = chance(scores)
    level = level_below(p, DRIFT)
    worst = names[int(np.argmax(np.abs(np.nan_to_num(scores))))]
    largest = float(np.max(np.abs(scores)))
    said = {
        FINE: "The traces are level: the last third of the chain has the means of the first.",
        LOOK: f"The trace of {worst} seems to drift. Look at the traces: is the burn-in long enough?",
        DO_NOT: f"The trace of {worst} drifts: the walkers are still on their way. Let the chain run on.",
    }
    rule = "last against first third (Geweke 1992), over all parameters: fine if chance makes 1 in 100, not below 1e-4"
    return Verdict("traces", level, _number(largest, ".1f", " sigma"), said[level], rule)


def ranks_verdict(scores: Array) -> Verdict:
    """Judge whether all walkers roam over the same distribution."""
    p = chance(scores)
    level = FINE if p >= RANKS else LOOK
    which = int(np.argmax(np.abs(np.nan_to_num(scores)).max(axis=1)))
    said = {
        FINE: "Every walker has been everywhere: the ranks of each are even.",
        LOOK: f"Not all walkers have been everywhere, walker {which} least of all: look at the rank plots.",
    }
    value = _number(float(np.max(np.abs(scores))), ".1f", " sigma")
    rule = "mean rank of each walker (Vehtari+ 2021, sec. 4): fine if chance makes 1 in 100 over walkers and parameters"
    return Verdict("rank plots", level, value, said[level], rule)


def stuck_verdict(stuck: int, walkers: int) -> Verdict:
    """Judge the walkers that are stuck on a false maximum."""
    share = stuck / walkers
    level = FINE if not stuck else LOOK if share <= STUCK[1] else DO_NOT
    tail = "95 % intervals are" if share > STUCK[0] else "outermost tails are"
    said = {
        FINE: "No walker is stuck.",
        LOOK: f"The {tail} too wide by the stuck walkers. Continue with --resume; if they stay, take more particles.",
        DO_NOT: "So many walkers are stuck that even the 68 % intervals are theirs. Take more particles, or noise = "
        "'add', and start again.",
    }
    rule = "fine without any; do not use if they are more than 16 %, the tail outside a 68 % interval"
    return Verdict("stuck walkers", level, f"{stuck} of {walkers}", said[level], rule)


def acceptance_verdict(acceptance: float) -> Verdict:
    """Judge the fraction of accepted proposals."""
    level = level_below(acceptance, ACCEPTANCE)
    said = {
        FINE: "Enough proposals are accepted.",
        LOOK: "Few proposals are accepted: the chain is slow, which its length shows too. A likelihood that is rough "
        "because streams have few particles does this.",
        DO_NOT: "Hardly any proposal is accepted: the likelihood is too rough, or the moves do not fit. Take more "
        "particles, or noise = 'add'.",
    }
    rule = "fine from 0.15 on (Roberts & Rosenthal 2001), do not use below 0.01"
    return Verdict("acceptance", level, f"{acceptance:.2f}", said[level], rule)


def predictive_verdict(seen: Predictive) -> Verdict:
    """Judge whether the model can make the data."""
    p = seen.p_value
    level = level_below(p, P_VALUE)
    far = int(np.argmax(np.abs(seen.deviations)))
    worst = f"{seen.names[far]}, {seen.deviations[far]:+.1f} sigma from its datum,"
    said = {
        FINE: "The model makes streams like the data.",
        LOOK: f"The model strains to make the data: {worst} is the farthest.",
        DO_NOT: f"The model does not make the data: {worst} is the farthest. Its intervals mean nothing then.",
    }
    rule = "posterior predictive p of chi^2 (Gelman, Meng & Stern 1996): fine from 0.05 on, do not use below 0.001"
    return Verdict("posterior predictive", level, f"p = {p:.2g}", said[level], rule)


def noise_verdict(seen: Predictive) -> Verdict:
    """Judge the noise of the model, from its finite number of particles, beside the errors of the data."""
    worst = int(np.argmax(seen.noise))
    noise, name = float(seen.noise[worst]), seen.names[worst]
    if seen.add_noise:
        level = FINE if noise <= NOISE[1] else LOOK
        said = {
            FINE: "The model's own noise is part of the likelihood, and smaller than the errors of the data.",
            LOOK: f"The model's own noise is larger than the error of {name}. It is part of the likelihood and widens "
            "the intervals: more particles would narrow them.",
        }
        rule = "standard deviation over the datum's error, added in the likelihood here: fine up to 1"
    else:
        level = level_above(noise, NOISE)
        more = "It is left out of the likelihood, so that intervals are too narrow: take more particles, or noise = "
        said = {
            FINE: "The model's own noise is small beside the errors of the data.",
            LOOK: f"The model's own noise counts beside the error of {name}. {more}'add'.",
            DO_NOT: f"The model's own noise is larger than the error of {name}. {more}'add'.",
        }
        rule = "standard deviation over the datum's error: fine up to 1/3, 5 % in quadrature; do not use above 1"
    return Verdict("own noise", level, f"{noise:.2f}", said[level], rule)


def reasons_verdict(reasons: Mapping[str, int], calls: int) -> Verdict:
    """Judge the proposals that were refused for another reason than the prior."""
    own = {reason: n / calls for reason, n in reasons.items() if calls and reason != "outside the prior"}
    worst = max(own, key=own.__getitem__, default="")
    share = own.get(worst, 0.0)
    level = FINE if share <= REASON else LOOK
    said = {
        FINE: "Few proposals are without a stream or an observable.",
        LOOK: f"Many proposals are refused because: {worst}. Does this cut the posterior where you did not mean it to?",
    }
    rule = "fine if no reason besides the prior's ends refuses more than 10 %"
    return Verdict("refused proposals", level, f"{100 * share:.0f} %", said[level], rule)


def prior_verdict(names: Sequence[str], fractions: Sequence[Array]) -> Verdict:
    """Judge what the prior alone decides, from the (n,) samples of every parameter as fractions of its prior."""
    ends = [max((u < EDGE).mean(), (u > 1 - EDGE).mean()) for u in fractions]
    at_edge = [name for name, share in zip(names, ends, strict=True) if share > AT_EDGE]
    silent = [name for name, u in zip(names, fractions, strict=True) if contraction(u) > UNINFORMED]
    level = LOOK if at_edge else FINE
    said = [f"The posterior of {_listed(at_edge)} leans on the prior's end: other ends would move it."] * bool(at_edge)
    said += [f"The data add nothing to the prior of {_listed(silent)}."] * bool(silent)
    value = f"{len(at_edge)} at an end, {len(silent)} uninformed"
    rule = "fine if at most 10 % of the samples are in the outermost 2 % of a prior; uninformed: spread above 0.9 of it"
    text = " ".join(said) or "Every posterior is narrower than its prior, and none leans on an end of it."
    return Verdict("prior against posterior", level, value, text, rule)


def _number(value: float, form: str, unit: str = "") -> str:
    return f"{value:{form}}{unit}" if np.isfinite(value) else "unknown"


def _listed(names: Sequence[str], most: int = 4) -> str:
    """Return "a, b and c", and how many more there are."""
    if len(names) > most + 1:
        return f"{', '.join(names[:most])} and {len(names) - most} more"
    return " and ".join([", ".join(names[:-1]), names[-1]]) if len(names) > 1 else "".join(names)
