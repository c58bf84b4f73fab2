"""Look before the run: does the progenitor move as a tidal stream needs it to, and what will a fit cost."""

from __future__ import annotations

import time
from dataclasses import dataclass

from streamkit.model import Model
from streamkit.spec import Setup, Spec
from streamkit.stream import Prediction
from streamkit.study.preflight.cost import Cost, search_cost, time_call
from streamkit.study.preflight.doubts import component_doubts
from streamkit.study.preflight.draws import PriorDraws, predict, try_prior_draws
from streamkit.study.preflight.orbit import OrbitSummary, summarise_orbit
from streamkit.study.preflight.warnings import (
    orbit_warnings,
    prior_warnings,
    sampler_warnings,
    short_lookback,
    sun_warnings,
)


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
    warnings = component_doubts(setup) + orbit_warnings(spec, setup, orbit)
    if reason and (len(orbit.apocentres) or prediction is None):
        warnings.append(f"There is no prediction at {asked}: {reason}.{short_lookback(orbit)}")
    if setup.observable is not None and prediction is not None:
        warnings += setup.observable.remarks(prediction)
    warnings += prior_warnings(tried)
    warnings += [f"This run file cannot be fitted: {unfit}."] if unfit else sampler_warnings(spec)
    warnings += sun_warnings(setup.sun)
    return Preflight(
        setup,
        orbit,
        prediction,
        reason,
        Cost(first, call, where, *search_cost(spec, tried, call)),
        tried,
        tuple(warnings),
    )
