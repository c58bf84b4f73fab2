"""The sampler `emulator`: its fields, and the posterior of a run as the emulator sees it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field

from streamkit import Array, BoolArray, ComponentError, Evaluations, Sampler, Samples, Target, Verdict
from streamkit.builtin.emulator.problem import Answers

if TYPE_CHECKING:  # emcee and SciPy are slow to load
    from streamkit.builtin.emulator.certificate import Certificate
    from streamkit.builtin.emulator.rounds import Progress

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

    max_calls: int = Field(default=8000, ge=1, description="Stop after so many calls with all particles in any case.")
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
        from streamkit.builtin.emulator.rounds import Rounds

        if target.undeclared:
            raise ComponentError(
                f"sampler emulator: {', '.join(target.undeclared)} has a likelihood of its own, or data that depend on "
                "a parameter, and does not declare `likelihood_details`. Take the sampler emcee."
            )
        full, small = OfTarget(target), OfTarget(target, small=True)
        rounds = Rounds(full, small, self.realisation == "one", self.starts, target.remark)
        for progress in rounds.run(self.max_calls):
            yield _samples(target, progress)

    def search_size(self) -> tuple[int, int]:
        """Return no points, and the particles of the streams of a start."""
        return 0, self.start_particles

    def quick_settings(self, d: int) -> dict[str, int | float]:
        """Take one start and few calls."""
        return {"starts": 1, "max_calls": min(self.max_calls, QUICK_CALLS)}

    def cites(self) -> dict[str, str]:
        """Return emcee, and its moves."""
        return {"ForemanMackey2013": "emcee, which samples the emulated posterior", "terBraak2006": "its moves"}


class OfTarget:
    """The posterior of a run, with all particles or with few: a `streamkit.builtin.emulator.problem.Problem`."""

    def __init__(self, target: Target, small: bool = False) -> None:
        self._target, self._small = target, small
        self.size, self.seed, self.undeclared = target.size, target.seed, target.undeclared
        self.coordinates: BoolArray = target.coordinates
        self.values, self.errors = target.data.values, target.data.errors
        self.add_noise = target.data.add_noise or small

    def from_unit(self, u: Array) -> Array:
        """Return the parameters (..., d) at fractions u (..., d) of their priors."""
        return self._target.from_unit(u)

    def ln_prior(self, points: Array) -> Array:
        """Return the ln prior density (n,) at points (n, d); -inf outside."""
        return self._target.ln_prior(points)

    def evaluate(self, points: Array) -> Answers:
        """Call the model at points (n, d)."""
        found = self._target.predictions(points, small=self._small)
        return Answers(found.mean, found.variance, found.details, found.ln_likelihood)

    def compare(self, points: Array, mean: Array, variance: Array, details: Array) -> Array:
        """Return ln likelihood (n,) for given predictions."""
        return self._target.compare(points, mean, variance, details)

    def time_left(self) -> float:
        """Return the seconds until the run's time limit."""
        return self._target.time_left()

    def expect(self, calls: float) -> None:
        """Say how many calls there may have been at the end."""
        self._target.expect(calls)


def _samples(target: Target, progress: Progress) -> Samples:
    """Return samples of the emulated posterior, with what the emulator predicts there."""
    y = progress.samples[:: max(len(progress.samples) // MOST, 1)]
    points = np.ascontiguousarray(progress.emulated.space.back(y))
    predicted, lnl = progress.emulated.emulator.predict(y), progress.emulated.ln_likelihood(y)
    evaluations = Evaluations(
        target.ln_prior(points) + lnl, lnl, predicted.mean, predicted.own, ("",) * len(y), predicted.details
    )
    facts = {"calls": f"{len(progress.known)} with all particles, {progress.cheap} with few"}
    verdicts = () if progress.certificate is None else tuple(_verdicts(progress.certificate))
    return Samples(
        points, np.zeros(len(y)), missing=progress.missing, verdicts=verdicts, facts=facts, evaluations=evaluations
    )


def _verdicts(certificate: Certificate) -> Sequence[Verdict]:
    """Return the verdict of a certificate."""
    value = f"{certificate.offset:+.1f} +- {certificate.spread:.1f}"
    noise = f"{certificate.noise_offset:+.1f} +- {certificate.noise_spread:.1f}"
    if certificate.faults:
        why = "; ".join(certificate.faults)
        sentence = f"Fresh calls do not confirm the emulator: {why}. Take more calls, or the sampler emcee."
        return (Verdict("true minus emulated ln L", "do not use", value, sentence, RULE),)
    sentence = f"{certificate.calls} fresh calls confirm the emulator: the noise of the particles makes {noise}."
    return (Verdict("true minus emulated ln L", "fine", value, sentence, RULE),)
