"""What a sampler yields: weighted `Samples`, or an `Ensemble` after each step of a chain."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from streamkit.components.verdict import Verdict
from streamkit.stream import Array, BoolArray


@dataclass(frozen=True, eq=False)
class Evaluations:
    """The posterior at n points, with the predictions.

    Attributes
    ----------
    ln_probability, ln_likelihood
        (n,) ln prior + ln likelihood, and the second term alone; -inf where there is no stream or outside the prior.
    mean, variance
        (n, m) the prediction of each datum, and the variance of the prediction; NaN where there is none.
    reasons
        n texts: the reason why a point has no likelihood; empty where it has one.
    details
        (n, k) the details of the predictions that the likelihoods read, for a sampler that emulates predictions.
    """

    ln_probability: Array
    ln_likelihood: Array
    mean: Array
    variance: Array
    reasons: tuple[str, ...]
    details: Array = field(default_factory=lambda: np.empty((0, 0)))


@dataclass(frozen=True, eq=False)
class Samples:
    """Weighted samples of the posterior, at one stage of the sampling.

    Attributes
    ----------
    points
        (n, d) parameters. Each point was evaluated with `Target.evaluate`, or ``evaluations`` are given.
    ln_weights
        (n,) natural logs of the weights in the posterior, up to a constant.
    ln_evidence, ln_evidence_error
        The natural log of the integral of prior times likelihood, and its standard error; NaN if unknown.
    missing
        What the sampler's rule of stopping still requires, as the end of a sentence; empty when the rule is met.
    verdicts
        The results of the sampler's checks, shown on the page of the run beside streamkit's.
    facts
        Short texts by name, shown on the page and in the terminal.
    evaluations
        The posterior and the predictions at the n points, for samples of an emulator; None where each point was
        evaluated.
    """

    points: Array
    ln_weights: Array
    ln_evidence: float = np.nan
    ln_evidence_error: float = np.nan
    missing: str = ""
    verdicts: tuple[Verdict, ...] = ()
    facts: Mapping[str, str] = field(default_factory=dict)
    evaluations: Evaluations | None = None


@dataclass(frozen=True, eq=False)
class Ensemble:
    """The walkers of a chain after a step: a sample of each walker, and all data that the next step depends on.

    Attributes
    ----------
    points, ln_probability
        (walkers, d) parameters, each evaluated with `Target.evaluate`, and (walkers,) ln prior + ln likelihood.
    accepted
        (walkers,) whether the step moved each walker.
    random_state
        The state of the generator after the step: `numpy.random.RandomState.get_state`, or the
        ``bit_generator.state`` of a `numpy.random.Generator`.
    memory
        Arrays by name that the next step depends on, beside the points. Only those of the last step are stored.
    number
        Number of steps, this one included.
    facts
        Short texts by name, shown on the page and in the terminal. Only those of the last step are stored.
    """

    points: Array
    ln_probability: Array
    accepted: BoolArray
    random_state: Any
    memory: Mapping[str, Array] = field(default_factory=dict)
    number: int = 0
    facts: Mapping[str, str] = field(default_factory=dict)

    def generator(self) -> np.random.Generator:
        """Return the generator that draws the next step: ``random_state`` of that step is its ``bit_generator.state``.

        After the start it is a new one, seeded by the start's random state, which follows from the seed of the run.
        """
        if not isinstance(self.random_state, Mapping):
            return np.random.default_rng(self.random_state[1])
        bits = getattr(np.random, self.random_state["bit_generator"])()
        bits.state = dict(self.random_state)
        return np.random.Generator(bits)
