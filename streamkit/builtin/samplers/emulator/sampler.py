"""The sampler `emulator`: its fields, and the posterior of a run as the emulator sees it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field

from streamkit import Array, EmulatedLikelihood, Evaluations, Sampler, Samples, Target, Verdict
from streamkit.builtin.samplers.emulator.of_target import LikelihoodOnly, OfTarget
from streamkit.builtin.samplers.emulator.problem import Problem

if TYPE_CHECKING:  # emcee and SciPy are slow to load
    from streamkit.builtin.samplers.emulator.emulator import Predictions
    from streamkit.builtin.samplers.emulator.rounds import Progress

MOST = 4000  # samples that are given
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
        """Make rounds of calls until they confirm the emulator; yield samples of the emulated posterior."""
        from streamkit.builtin.samplers.emulator.of_factors import sample_factors
        from streamkit.builtin.samplers.emulator.rounds import Rounds

        if len(target.factors) > 1:
            yield from sample_factors(target, self.max_calls, self.realisation == "one", self.starts)
            return
        full: Problem = OfTarget(target)
        small: Problem = OfTarget(target, small=True)
        if target.undeclared:
            full, small = LikelihoodOnly(full), LikelihoodOnly(small)
        rounds = Rounds(full, small, self.realisation == "one", self.starts, target.remark)
        for progress in rounds.run(self.max_calls):
            yield _samples(target, progress)

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
        """Return emcee, and its moves."""
        return {"ForemanMackey2013": "emcee, which samples the emulated posterior", "terBraak2006": "its moves"}


def _samples(target: Target, progress: Progress) -> Samples:
    """Return samples of the emulated posterior, with what the emulator predicts there."""
    y = progress.samples[:: max(len(progress.samples) // MOST, 1)]
    points = np.ascontiguousarray(progress.emulated.space.back(y))
    lnl = progress.emulated.ln_likelihood(y)
    predicted = _predictions(target, progress, y)
    evaluations = Evaluations(
        target.ln_prior(points) + lnl, lnl, predicted.mean, predicted.fit_variance, ("",) * len(y), predicted.details
    )
    facts = {}
    if target.undeclared:
        which = ", ".join(target.undeclared)
        facts["learned"] = (
            f"ln L as a whole in place of the predictions, which takes more calls: {which} has a likelihood of its own "
            "without `likelihood_details`, or data that depend on a parameter"
        )
    elif larger := progress.emulated.emulator.larger_noise:
        facts["noise of a call"] = (
            f"{larger[0]} of {np.isfinite(target.data.values).sum()} data scatter more than their observables "
            f"state, by a factor of {larger[1]:.1f} at most: measured by pairs of calls at one place"
        )
    verdicts = (_verdict(progress),)
    return Samples(
        points, np.zeros(len(y)), missing=progress.missing, verdicts=verdicts, facts=facts, evaluations=evaluations
    )


def _predictions(target: Target, progress: Progress, y: Array) -> Predictions:
    """Return the emulated predictions at samples y (n, d); NaN where too few calls have any."""
    from streamkit.builtin.samplers.emulator.learn import learn_predictions

    emulator = progress.emulated.emulator
    if not target.undeclared:
        return emulator.predict(y)
    problem, calls = OfTarget(target), progress.calls
    of_data = learn_predictions(problem, calls.y, problem.evaluate(calls.theta))  # calls that were made cost nothing
    if of_data is not None:
        return of_data.predict(y)
    nothing = np.full((len(y), len(target.data.values)), np.nan)
    return emulator.predict(y)._replace(mean=nothing, fit_variance=nothing)


def _verdict(progress: Progress) -> Verdict:
    """Return the verdict of the fresh calls; "do not use" too where none were made, or a mode may be missing."""
    from streamkit.builtin.samplers.emulator.certificate import MOVED

    subject, certificate = "fresh calls beside the emulator", progress.certificate
    if certificate is None:
        sentence = (
            f"No fresh calls have tested the emulator: {progress.missing}. Raise sampler.max_calls and --resume, or "
            "run again with more particles or without the data that the emulator cannot follow (the largest `noise` in "
            "predictions.ecsv), or take the sampler emcee."
        )
        return Verdict(subject, "do not use", "none", sentence, RULE)
    value = f"true - emulated ln L = {certificate.offset:+.1f} ± {certificate.spread:.1f}"
    if progress.missing:
        sentence = (
            f"Not certified: {progress.missing}. Raise sampler.max_calls and --resume, run again with another seed and "
            "more sampler.starts, or take the sampler emcee."
        )
        return Verdict(subject, "do not use", value, sentence, RULE)
    sentence = (
        f"{certificate.calls} fresh calls confirm the emulator. The noise of the particles alone makes "
        f"{certificate.noise_offset:+.1f} ± {certificate.noise_spread:.1f}. A mean or a width that is off by "
        f"{max(certificate.trend_by_chance, MOVED):.2f} standard deviations would show; the noise of all calls leaves "
        f"{progress.uncertain:.2f} at most."
    )
    return Verdict(subject, "fine", value, sentence, RULE)
