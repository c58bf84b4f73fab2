"""Look before the run: does the progenitor move as a tidal stream needs it to, and what will a fit cost."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from streamkit import advice
from streamkit.course import Course, course
from streamkit.errors import OutOfDomain, SpecError
from streamkit.model import Model
from streamkit.phase import Array, Prediction
from streamkit.posterior import Posterior
from streamkit.spec import Setup, Spec

TRIAL_PARTICLES = 1000
"""Particles of the trial streams over the prior: enough to say whether there is a stream."""
BUDGET = 15.0
"""CPU seconds after which no further trial stream is started."""
SLOW = 5.0
"""A first call of so many CPU seconds is not repeated: loading the machine code is a small part of it."""


@dataclass(frozen=True)
class Survey:
    """Trial streams of `TRIAL_PARTICLES` particles at draws from the prior.

    Attributes
    ----------
    draws
        Number of draws.
    good
        (good, d) The draws with a stream that the observable can measure.
    seconds
        (good,) CPU seconds of each of them.
    reasons
        Why the others have none, and how many.
    """

    draws: int
    good: Array
    seconds: Array
    reasons: Counter[str]


@dataclass(frozen=True)
class Cost:
    """CPU seconds of the first call of a process and of a later one, measured at ``where``."""

    first: float
    call: float
    where: str


@dataclass(frozen=True)
class Preflight:
    """What is known of a run before it starts.

    Attributes
    ----------
    setup, course
        The components and the progenitor's orbit at the prior's centre.
    prediction
        What the observable says there; None without a stream or an observable.
    reason
        Why there is no prediction there; empty if there is one.
    cost
        Of one posterior call, or of one stream where there is nothing to fit.
    survey
        Trial streams over the prior; None if there were none.
    warnings
        One paragraph each.
    """

    setup: Setup
    course: Course
    prediction: Prediction | None
    reason: str
    cost: Cost
    survey: Survey | None
    warnings: tuple[str, ...]


def preflight(spec: Spec, *, draws: int = 64) -> Preflight:
    """Look at the run file's physics at the prior's centre, try points of the prior and time one call.

    Parameters
    ----------
    spec
        The run file.
    draws
        Trial streams over the prior at most; 0 for none.

    Raises
    ------
    ComponentError
        If a component fails.
    """
    centre = spec.centre()
    setup = spec.bind(centre)
    path = course(setup)
    begin = time.process_time()
    prediction, reason = predict(Model(spec), centre)
    first = time.process_time() - begin
    trial = survey(spec, draws) if draws and spec.names else None
    asked = "the prior's centre" if spec.names else "the given parameters"
    where, theta = asked, centre
    if reason and trial is not None and len(trial.good):
        where, theta = "a draw from the prior that has a stream", trial.good[0]
    call, unfit = measure(spec, theta, first)
    warnings = advice.orbit_warnings(spec, setup, path)
    if reason and len(path.apocentres):
        warnings.append(f"There is no prediction at {asked}: {reason}.")
    warnings += advice.coverage_warnings(prediction)
    warnings += advice.survey_warnings(trial)
    warnings += [f"This run file cannot be fitted: {unfit}."] if unfit else advice.sampler_warnings(spec)
    warnings += advice.sun_warnings(spec.parts.sun.build(setup.values))
    return Preflight(setup, path, prediction, reason, Cost(first, call, where), trial, tuple(warnings))


def predict(model: Model, theta: Array) -> tuple[Prediction | None, str]:
    """Return what the observable says of the stream at theta (d,), and the reason if it says nothing."""
    try:
        _, prediction = model.observe(model.spec.bind(theta))
    except OutOfDomain as error:
        return None, error.reason
    return prediction, "" if prediction is None else prediction.why_not


def measure(spec: Spec, theta: Array, first: float) -> tuple[float, str]:
    """Return the CPU seconds of a call at theta (d,): the median of a few, or ``first`` if that was `SLOW`.

    The call is one of the posterior, or of the stream alone where nothing can be fitted; the second value is
    then the reason why.
    """
    unfit = ""
    call: Callable[[Array], object]
    try:
        call = Posterior(spec)
    except SpecError as error:
        unfit, model = str(error), Model(spec)

        def call(theta: Array) -> object:
            return predict(model, theta)

    if first > SLOW:
        return first, unfit
    call(theta)  # draws the random numbers of a new process
    seconds: list[float] = []
    while len(seconds) < 3 and sum(seconds) < 3.0:
        begin = time.process_time()
        call(theta)
        seconds.append(time.process_time() - begin)
    return float(np.median(seconds)), unfit


def survey(spec: Spec, draws: int) -> Survey:
    """Try streams with few particles at random points of the prior, drawn from the run's seed."""
    few = min(TRIAL_PARTICLES, spec.bind(spec.centre()).stripping.particles)
    model = Model(spec.with_values({"stripping.particles": few}))
    rng = np.random.default_rng(spec.seed)
    points = np.stack([prior.sample(rng, draws) for prior in spec.priors], axis=1)
    reasons: Counter[str] = Counter()
    good: list[Array] = []
    seconds: list[float] = []
    done, start = 0, time.process_time()
    for theta in points:
        begin = time.process_time()
        if begin - start > BUDGET:
            break
        done += 1
        _, reason = predict(model, theta)
        if reason:
            reasons[reason] += 1
        else:
            good.append(theta)
            seconds.append(time.process_time() - begin)
    return Survey(done, np.array(good).reshape(-1, len(spec.names)), np.array(seconds), reasons)
