"""The preflight: the progenitor's orbit as the source of a stream, and the cost of a fit."""

from __future__ import annotations

import time
from dataclasses import dataclass

from numba.core import event

from streamkit.components import HostData
from streamkit.model import Model
from streamkit.observe import remarks_of
from streamkit.runfile import Spec, StreamInputs
from streamkit.sample import first_call
from streamkit.stream import Prediction
from streamkit.study.preflight.data_warnings import data_warnings, sign_warnings
from streamkit.study.preflight.draws import Cost, PriorDraws, observe, search_cost, time_call, try_prior_draws
from streamkit.study.preflight.knot_warnings import knot_warnings
from streamkit.study.preflight.orbit import OrbitSummary, summarise_orbit
from streamkit.study.preflight.warnings import (
    conformance_warnings,
    dissolved_warnings,
    mass_warnings,
    moved_twice_warnings,
    prior_warnings,
    short_lookback,
    stream_warnings,
    sun_warnings,
    weight_warnings,
)


@dataclass(frozen=True)
class Look:
    """One stream at the prior's centre: its inputs, the summary of its progenitor's orbit, and the prediction.

    The prediction is None without a stream or an observable.
    """

    inputs: StreamInputs
    orbit: OrbitSummary
    prediction: Prediction | None


@dataclass(frozen=True)
class Preflight:
    """The results of the preflight of a run."""

    streams: dict[str, Look]  # each stream at the prior's centre, by name
    # data that are no stream, each with the prediction by the host at the prior's centre, by name.
    data: dict[str, tuple[HostData, Prediction]]
    reason: str  # the reason why there is no prediction at the prior's centre; empty if there is one
    cost: Cost  # of one posterior call, or of one stream where there is nothing to fit
    prior_draws: PriorDraws | None  # trial streams over the prior; None if there were none
    warnings: tuple[str, ...]  # one paragraph each


def run_preflight(spec: Spec, *, draws: int = 64, progress: bool = False) -> Preflight:
    """Check the run file's physics at the prior's centre, make streams at draws from the prior, and time one call.

    Raises ComponentError if a component fails, CallTimeout if one does not return within the sampler's limit.
    """
    centre = spec.centre()
    bound = spec.bind_all(centre)
    limit = spec.sampler.call_limit
    orbits = {name: first_call(limit, summarise_orbit, inputs) for name, inputs in bound.streams.items()}
    begin, compiled = time.process_time(), list[float]()
    with event.install_timer("numba:compile", compiled.append):
        trial, reason = observe(Model(spec), centre)
    predictions = trial.observation.predictions if trial is not None else {}
    first = time.process_time() - begin
    tried = try_prior_draws(spec, draws, progress) if draws and spec.names else None
    centre_name = "the prior's centre" if spec.names else "the given parameters"
    where, theta = centre_name, centre
    if reason and tried is not None and len(tried.good):
        where, theta = "a draw from the prior that has a stream", tried.good[0]
    call, unfit = time_call(spec, theta, first, compiled=bool(compiled))
    looks = {name: Look(inputs, orbits[name], predictions.get(name)) for name, inputs in bound.streams.items()}
    places = {name: f"data.{name}" for name in bound.data if f"data.{name}" in predictions}
    data = {name: (bound.data[name], predictions[place]) for name, place in places.items()}
    failures = [text for look in looks.values() for text in conformance_warnings(look.inputs)]
    warnings = list(dict.fromkeys(failures))  # two streams share the components of the host
    same: dict[str, list[str]] = {}
    for name, look in looks.items():
        for text in stream_warnings(spec, look.inputs, look.orbit):
            same.setdefault(text, []).append(name)
    warnings += [f"{', '.join(names)}: {text}" if len(looks) > 1 else text for text, names in same.items()]
    if trial is None:
        warnings.append(f"There is no prediction at {centre_name}: {reason}.")
    for name, why in trial.reasons.items() if trial is not None else ():
        before = f"{name}: " if len(looks) > 1 else ""
        if (orbit := orbits.get(name)) is None or len(orbit.apocentres) or name not in predictions:
            hint = short_lookback(orbit) if orbit is not None else ""
            warnings.append(f"{before}There is no prediction at {centre_name}: {why}.{hint}")
    for name, look in looks.items():
        if look.prediction is not None:
            before = f"{name}: " if len(looks) > 1 else ""
            warnings += [before + text for text in remarks_of(look.inputs.observables, look.prediction)]
    if trial is not None:
        for name, stream in trial.observation.streams.items():
            warnings += dissolved_warnings(spec, bound.streams[name], stream)
            warnings += weight_warnings(spec, bound.streams[name], stream)
    trials = [trial] if trial is not None else []
    warnings += data_warnings(spec, [*trials, *(tried.trials if tried is not None else ())])
    warnings += sign_warnings(spec, trials)
    warnings += mass_warnings(spec, bound)
    warnings += moved_twice_warnings(spec, bound)
    warnings += knot_warnings(spec, bound)
    warnings += prior_warnings(spec, bound, tried)
    warnings += [f"This run file cannot be fitted: {unfit}."] if unfit else spec.sampler.advice(len(spec.names))
    warnings += sun_warnings(bound.sun)
    return Preflight(
        looks,
        data,
        reason,
        Cost(first, call, where, *search_cost(spec, tried, call), compiled=bool(compiled)),
        tried,
        tuple(warnings),
    )
