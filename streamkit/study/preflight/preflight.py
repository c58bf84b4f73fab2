"""Look before the run: does the progenitor move as a tidal stream needs it to, and what will a fit cost."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from streamkit.errors import SpecError
from streamkit.model import Model
from streamkit.sample import Posterior
from streamkit.spec import Setup, Spec
from streamkit.stream import Array, Prediction
from streamkit.study.preflight.draws import PriorDraws, predict, try_prior_draws
from streamkit.study.preflight.orbit import OrbitSummary, summarise_orbit
from streamkit.study.preflight.warnings import (
    orbit_warnings,
    prior_warnings,
    sampler_warnings,
    short_lookback,
    sun_warnings,
)

SLOW = 5.0
"""A first call of so many CPU seconds is not repeated: loading the machine code is a small part of it."""


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
    setup, orbit
        The components and the summary of the progenitor's orbit at the prior's centre.
    prediction
        What the observable says there; None without a stream or an observable.
    reason
        Why there is no prediction there; empty if there is one.
    cost
        Of one posterior call, or of one stream where there is nothing to fit.
    prior_draws
        Trial streams over the prior; None if there were none.
    warnings
        One paragraph each.
    """

    setup: Setup
    orbit: OrbitSummary
    prediction: Prediction | None
    reason: str
    cost: Cost
    prior_draws: PriorDraws | None
    warnings: tuple[str, ...]


def run_preflight(spec: Spec, *, draws: int = 64) -> Preflight:
    """Look at the run file's physics at the prior's centre, try up to so many draws from the prior and time one call.

    A `ComponentError` says that a component fails.
    """
    centre = spec.centre()
    setup = spec.bind(centre)
    orbit = summarise_orbit(setup)
    begin = time.process_time()
    prediction, reason = predict(Model(spec), centre)
    first = time.process_time() - begin
    tried = try_prior_draws(spec, draws) if draws and spec.names else None
    asked = "the prior's centre" if spec.names else "the given parameters"
    where, theta = asked, centre
    if reason and tried is not None and len(tried.good):
        where, theta = "a draw from the prior that has a stream", tried.good[0]
    call, unfit = time_call(spec, theta, first)
    warnings = orbit_warnings(spec, setup, orbit)
    if reason and (len(orbit.apocentres) or prediction is None):
        warnings.append(f"There is no prediction at {asked}: {reason}.{short_lookback(orbit)}")
    if setup.observable is not None and prediction is not None:
        warnings += setup.observable.remarks(prediction)
    warnings += prior_warnings(tried)
    warnings += [f"This run file cannot be fitted: {unfit}."] if unfit else sampler_warnings(spec)
    warnings += sun_warnings(setup.sun)
    return Preflight(setup, orbit, prediction, reason, Cost(first, call, where), tried, tuple(warnings))


def time_call(spec: Spec, theta: Array, first: float) -> tuple[float, str]:
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
