"""The sampler `emulator`: its fields, and the posterior of a run as the emulator sees it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field

from streamkit import Array, EmulatedLikelihood, Evaluations, Sampler, Samples, Target, Verdict
from streamkit.builtin.samplers.emulator.learn.of_target import LikelihoodOnly, OfTarget
from streamkit.builtin.samplers.emulator.learn.problem import Problem

if TYPE_CHECKING:  # SciPy is slow to load
    from streamkit.builtin.samplers.emulator.certificate import Certificate
    from streamkit.builtin.samplers.emulator.judge.recall import Recall
    from streamkit.builtin.samplers.emulator.known import Known
    from streamkit.builtin.samplers.emulator.learn.emulator import Emulator
    from streamkit.builtin.samplers.emulator.learn.space import Space
    from streamkit.builtin.samplers.emulator.rounds import Progress
    from streamkit.builtin.samplers.emulator.walk.density import Factor

LEAST, MOST = 500, 4000  # samples that are given, about as many as are independent
QUICK_CALLS = 400
RULE = "fresh calls at samples of the emulated posterior, compared with what the noise of the particles makes of them"


class PredictionEmulator(Sampler):
    """Learns the predictions from some thousand calls, and samples the data's own likelihood of them.

    A certificate says whether fresh calls confirm the emulator.
    """

    kind = "emulator"
    reference = "Vernon, Goldstein & Bower 2010, Bayesian Analysis 5, 619: waves of emulators"
    emulates = True
    stopping = ("max_calls",)

    max_calls: int = Field(
        default=8000,
        ge=1,
        description="Stop after so many calls with all particles in any case; of several streams, so many of each.",
    )
    starts: int = Field(
        default=2, ge=1, description="Independent starts from the prior: a mode that one misses is found by another."
    )
    start_particles: int = Field(
        default=1000, ge=2, description="Particles of the streams of a start, the run's own number at most."
    )
    realisation: Literal["limit", "one"] = Field(
        default="limit",
        description="Whether data are compared with the prediction of infinitely many particles, or with that of one "
        "call, whose noise is then part of the error ('one').",
    )

    def sample(self, target: Target) -> Iterator[Samples]:
        """Make rounds of calls until they confirm the emulators; yield samples of the emulated posterior."""
        from streamkit.builtin.samplers.emulator.learn.space import Space
        from streamkit.builtin.samplers.emulator.rounds import Rounds

        factors, space = _factors(target), Space(OfTarget(target))
        one = self.realisation == "one"
        rounds = Rounds(factors, one, self.starts, target.remark, target.call_factors, target.at_once)
        for progress in rounds.run(self.max_calls):
            yield _samples(target, space, progress)

    def emulated(self, target: Target) -> EmulatedLikelihood:
        """Return the likelihood of predictions learned from the calls at ``target.earlier``."""
        from streamkit.builtin.samplers.emulator.learned import learned

        return learned(target, self.realisation == "one")

    def calls(self, d: int) -> tuple[int, str]:
        """Return the most calls with all particles."""
        return self.max_calls, f"at most {self.max_calls} calls, a few hundred for an easy posterior"

    def search_size(self) -> tuple[int, int]:
        """Return no points, and the particles of the streams of a start."""
        return 0, self.start_particles

    def quick_settings(self, d: int) -> dict[str, int | float]:
        """Take one start and few calls."""
        return {"starts": 1, "max_calls": min(self.max_calls, QUICK_CALLS)}

    def cites(self) -> dict[str, str]:
        """Return differential evolution, one of the moves on the emulated posterior."""
        return {"terBraak2006": "the moves on the emulated posterior"}


def _factors(target: Target) -> list[Factor]:
    """Return the streams of a run of several, and the data of the host; one factor otherwise."""
    from streamkit.builtin.samplers.emulator.walk.density import Factor, one_factor

    if len(target.factors) > 1:
        return [Factor(each.name, *_problems(each.target), each.shared, each.own, each.target.earlier)
                for each in target.factors]  # fmt: skip
    return [replace(one_factor(*_problems(target)), earlier=target.earlier)]


def _problems(target: Target) -> tuple[Problem, Problem]:
    """Return a factor with all particles and with few; they are one where these are the same."""
    full: Problem = OfTarget(target)
    small: Problem = full if target.small_is_full else OfTarget(target, small=True)
    if not target.undeclared:
        return full, small
    whole = LikelihoodOnly(full)
    return whole, whole if small is full else LikelihoodOnly(small)


def _samples(target: Target, space: Space, progress: Progress) -> Samples:
    """Return samples of the emulated posterior, with what the emulators predict there."""
    populations = progress.populations
    independent = int(max(min(populations.independent, MOST), LEAST))
    chosen = np.linspace(0, len(populations.samples) - 1, min(independent, len(populations.samples))).astype(int)
    z = populations.samples[chosen]
    points = np.ascontiguousarray(space.points(z))
    lnl = populations.terms.ln_likelihood[chosen].sum(axis=1)
    targets = [each.target for each in target.factors] if len(progress.known) > 1 else [target]
    parts = [_predictions(each, known, z[:, known.factor.columns])
             for each, known in zip(targets, progress.known, strict=True)]  # fmt: skip
    mean, variance, details = (np.concatenate(arrays, axis=1) for arrays in zip(*parts, strict=True))
    evaluations = Evaluations(target.ln_prior(points) + lnl, lnl, mean, variance, ("",) * len(z), details)
    facts = _facts_of_one(target, progress) if len(targets) == 1 else _facts_of_factors(progress)
    return Samples(
        points, np.zeros(len(z)), *_evidence(target, progress), missing=progress.missing,
        verdicts=(_verdict(progress),), facts=facts, evaluations=evaluations,
    )  # fmt: skip


def _evidence(target: Target, progress: Progress) -> tuple[float, float]:
    """Return ln evidence and its error, that of the noise of calls included; NaN before the sampler's end."""
    from streamkit.builtin.samplers.emulator.walk.evidence import ln_evidence, noise_of_calls

    if progress.missing:
        return np.nan, np.nan
    populations, joint = progress.populations, progress.joint
    value, error = ln_evidence(joint, populations, [target.seed, 13])
    return value, float(np.hypot(error, noise_of_calls(joint, populations.samples, [target.seed, 14])))


def _predictions(target: Target, known: Known, z: Array) -> tuple[Array, Array, Array]:
    """Return the emulated predictions of a factor at samples z (n, p), their variances and details.

    NaN where ln L is learned as a whole and too few calls have predictions.
    """
    from streamkit.builtin.samplers.emulator.learn.from_calls import learn_predictions

    emulator: Emulator | None = known.emulated.emulator
    if target.undeclared:  # calls that were made give the predictions too, and cost nothing
        problem = OfTarget(target)
        emulator = learn_predictions(problem, known.calls.y, problem.evaluate(known.calls.theta))
    if emulator is None:
        nothing = np.full((len(z), len(target.data.values)), np.nan)
        return nothing, nothing, np.empty((len(z), 0))
    predicted = emulator.predict(known.calls.space.learned(z))
    return predicted.mean, predicted.fit_variance, predicted.details


def _facts_of_one(target: Target, progress: Progress) -> dict[str, str]:
    """Return what is to be known of the emulator of a single stream."""
    if target.undeclared:
        which = ", ".join(target.undeclared)
        return {"learned": (
            f"ln L as a whole in place of the predictions, which takes more calls: {which} has a likelihood of its own "
            "without `likelihood_details`, or data that depend on a parameter"
        )}  # fmt: skip
    larger = progress.known[0].emulated.emulator.larger_noise
    if not larger:
        return {}
    return {"noise of a call": (
        f"{larger[0]} of {np.isfinite(target.data.values).sum()} data scatter more than their observables "
        f"state, by a factor of {larger[1]:.1f} at most: measured by pairs of calls at one place"
    )}  # fmt: skip


def _facts_of_factors(progress: Progress) -> dict[str, str]:
    """Return a line for each factor: its calls, its emulator's error, its certificate, and its tension."""
    from streamkit.builtin.samplers.emulator.changes import every_so_often

    samples, facts = every_so_often(progress.populations.samples, 1000), {}
    for each in progress.known:
        tension = each.alone - float(np.max(each.emulated.ln_likelihood(samples[:, each.factor.columns])))
        certificate = each.certificate
        tested = "not tested" if certificate is None else "refused" if certificate.faults else "confirmed"
        fresh = f" by {_tested_by([certificate])}" if certificate is not None else ""
        name = f"stream {each.factor.name}" if len(each.factor.own) else "data of the host"
        facts[name] = (
            f"{len(each.calls)} calls, error of the emulator {each.own_error:.2f} in ln L, {tested}{fresh}, "
            f"best ln L {max(tension, 0.0):.1f} below that of this factor alone"
        )
    return facts


def _verdict(progress: Progress) -> Verdict:
    """Return the verdict of the fresh calls; "do not use" too where none were made, or a mode may be missing."""
    from streamkit.builtin.samplers.emulator.walk.agreement import OF_OWN

    several = len(progress.known) > 1
    subject = "fresh calls beside the emulators" if several else "fresh calls beside the emulator"
    tested = [each.certificate for each in progress.known if each.certificate is not None]
    more = "Raise sampler.max_calls and --resume, run again with more sampler.starts or more particles"
    if not tested or progress.recall is None:
        sentence = (
            f"No fresh calls have tested {subject[23:]}: {progress.missing}. {more} or without the data that the "
            "emulator cannot follow (the largest `noise` in predictions.ecsv), or take the sampler emcee."
        )
        return Verdict(subject, "do not use", "none", sentence, RULE)
    first, both, found = tested[0], progress.populations, progress.recall
    value = f"true - emulated ln L = {first.offset:+.1f} ± {first.spread:.1f}"
    if several:
        value = f"their trends move the posterior by {progress.trend.measured:.2f} sd"
    if progress.missing:
        sentence = f"Not certified: {progress.missing}. {more}, or take the sampler emcee."
        return Verdict(subject, "do not use", value, sentence, RULE)
    noise = f"{first.noise_offset:+.1f} ± {first.noise_spread:.1f}"
    confirmed = f"the emulators of {len(tested)} factors, each and together" if several else "the emulator"
    own = f" (of a stream's own parameters {OF_OWN:g} of both at least)" if several else ""
    sentence = (
        f"{_tested_by(tested)} confirm {confirmed}. "
        + ("" if several else f"The noise of the particles alone makes {noise}. ")
        + f"A mean or a width that is off by {progress.trend.would_show:.2f} standard deviations would show; the noise "
        f"of all calls moves none by more than {progress.uncertain:.2f}, nine times in ten. Two populations agree, "
        f"R-hat {both.r_hat:.3f}, with {both.independent:.0f} independent samples of walks of "
        f"{both.sweeps / both.time:.0f} autocorrelation times{own}, each width known to "
        f"{100 * both.width_error:.0f} %. {_recalled(found)} {_seen(progress)}{_smallest(progress)}"
    )
    return Verdict(subject, "fine", value, sentence, RULE)


def _tested_by(tests: Sequence[Certificate]) -> str:
    held = sum(each.held_out for each in tests)
    fresh = sum(each.calls for each in tests) - held
    if not held:
        return f"{fresh} fresh calls"
    of_earlier = f"{held} calls held out of the earlier ones"
    return f"{fresh} fresh calls and {of_earlier}" if fresh else of_earlier


def _recalled(found: Recall) -> str:
    if not found.calls:
        return "The own error of the emulator alone allows no other place."
    return (
        f"{found.calls} calls where only the emulator's own error allows the data find {100 * found.found:.1f} % of "
        "the posterior there."
    )


def _seen(progress: Progress) -> str:
    """Say how many starts of a single stream lead to all of the posterior; an empty text for a run of several."""
    return "".join(
        f"{each.seen} of {len(each.starts)} start{'s lead' if len(each.starts) > 1 else ' leads'} to all of the "
        "posterior. "
        for each in progress.known
        if each.seen is not None and any(start.draws for start in each.starts)
    )


def _smallest(progress: Progress) -> str:
    """Say how small a separate mode may be that the draws of the starts would have met."""
    draws = min(sum(start.draws for start in each.starts) for each in progress.known)
    if not draws:
        return "The starts were those of an earlier run."
    return (
        f"{draws} draws of the prior began the starts: a separate mode, narrower than what they show, is met with a "
        f"probability of 95 % if its basin has {300 / draws:.1g} % of the prior."
    )
