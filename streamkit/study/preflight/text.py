"""A preflight as text for a terminal, and as plain values for programs."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np

from streamkit import report
from streamkit.components import LiveStripping, Stripping
from streamkit.report import prediction_record
from streamkit.runfile import ONLY, Spec, StreamInputs
from streamkit.stream import Array
from streamkit.study.preflight.draws import Cost, PriorDraws
from streamkit.study.preflight.many import are_many, component_rows, stream_table, without_names
from streamkit.study.preflight.orbit import OrbitSummary
from streamkit.study.preflight.preflight import Look, Preflight


def describe_spec(spec: Spec) -> str:
    """List the components with their suppliers, and the free parameters with priors and units."""
    parts = [f"{spec.source}: valid (digest {spec.digest()[:12]}, seed {spec.seed})"]
    parts.append(f"components\n{report.columns(component_rows(spec))}")
    if not spec.names:
        return "\n\n".join([*parts, "free parameters: none"])
    rows = [("parameter", "prior", "centre", "unit")]
    rows += [
        (name, prior.text(), f"{centre:.4g}", unit or "-")
        for name, prior, centre, unit in zip(spec.names, spec.priors, spec.centre(), spec.units, strict=True)
        if not (are_many(spec) and name.startswith("stream."))
    ]
    parts.append(f"free parameters ({len(spec.names)})\n{report.columns(rows)}")
    if are_many(spec):
        own = len(spec.names) + 1 - len(rows)
        parts.append(report.paragraph(f"{own} more belong to one stream each: --stream NAME shows those of a stream"))
    return "\n\n".join([*parts, *_factors(spec)])


def _factors(spec: Spec) -> list[str]:
    """Return the numbers of parameters that each of several streams has alone, and that all streams share."""
    if len(spec.factors) == 1 or are_many(spec):
        return []
    rows = [(each.name, f"{len(each.own)} parameters of its own") for each in spec.factors]
    return [f"each depends on the host ({len(spec.factors[0].shared)} parameters), and\n{report.columns(rows)}"]


def describe_preflight(spec: Spec, preflight: Preflight) -> str:
    """Return the text of a preflight: the orbit, the streams over the prior, the cost and the warnings."""
    place = "the prior's centre" if spec.names else "the given parameters"
    parts = [_host_centre(spec, preflight)]
    if are_many(spec):
        first = next(iter(preflight.streams.values()))
        parts += [stream_table(spec, preflight, place), report.describe_expansions(first.inputs)]
    for name, look in preflight.streams.items() if not are_many(spec) else ():
        head = f"at {place}" if name == ONLY else f"stream {name}, at {place}"
        parts.append(f"{head}\n" + report.columns(_orbit_rows(look.inputs, look.orbit)))
        if name == next(iter(preflight.streams)) and (expansions := report.describe_expansions(look.inputs)):
            parts.append(expansions)
        if look.inputs.observables and look.prediction is not None:
            observables = list(look.inputs.observables.values())
            parts.append(report.describe_measured("observables", observables, look.prediction))
    for name, (data, prediction) in preflight.data.items():
        parts.append(report.describe_measured(f"data {name}", [data], prediction))
    if preflight.prior_draws is not None:
        parts.append(_prior_draws(preflight.prior_draws, preflight.streams))
    parts.append(_cost(spec, preflight.cost))
    parts.append(report.warning_list(preflight.warnings) or "no warnings")
    return "\n\n".join(filter(None, parts))


def _host_centre(spec: Spec, preflight: Preflight) -> str:
    """Say that all is measured from the centre of a galaxy that moves; an empty text for a host at the origin."""
    if (centre := spec.sections.host_centre) is None:
        return ""
    away, ago = centre.farthest(max((look.inputs.lookback for look in preflight.streams.values()), default=0.0))
    return report.paragraph(
        f"the host's centre is on the path of its heaviest galaxy, up to {away:.3g} kpc from the origin of the "
        f"coordinates, {ago:.3g} Gyr ago: orbits, radii and the results for streams are measured from it"
    )


def _orbit_rows(inputs: StreamInputs, orbit: OrbitSummary) -> list[tuple[str, str]]:
    tidal = report.span(*orbit.r_tidal, "kpc") if np.isfinite(orbit.r_tidal[0]) else "none somewhere on the orbit"
    periods = ""
    if np.isfinite(orbit.period):
        periods = f": {inputs.lookback / orbit.period:.1f} radial periods, {orbit.completed} completed apocentre"
        periods += "s" * (orbit.completed != 1)
    return [
        ("pericentre", _radii(orbit.pericentres)),
        ("apocentre", _radii(orbit.apocentres)),
        ("radial period", report.number(orbit.period, "Gyr") if np.isfinite(orbit.period) else "none"),
        ("look-back time", report.number(inputs.lookback, "Gyr") + periods),
        ("tidal radius", tidal),
        *((f"body {name}", f"{report.span(*r, 'kpc')} from the Galactic centre") for name, r in orbit.bodies.items()),
        ("particles", f"{inputs.stripping.particles}, {_gravity(inputs)}"),
    ]


def _radii(radii: Array) -> str:
    return report.span(float(radii.min()), float(radii.max()), "kpc") if len(radii) else "none"


def _gravity(inputs: StreamInputs) -> str:
    scheme = inputs.stripping
    if isinstance(scheme, LiveStripping):
        return f"in {report.describe_live(scheme)}; leapfrog in place of [integrator]"
    return f"progenitor's gravity {'on' if isinstance(scheme, Stripping) and scheme.progenitor_gravity else 'off'}"


def _prior_draws(tried: PriorDraws, streams: Collection[str]) -> str:
    several, reasons = len(streams) > 1, without_names(tried.reasons, streams)
    what = "every stream, and they can be measured" if several else "one that can be measured"
    head = f"streams over the prior: {len(tried.good)} of {tried.draws} draws have {what}"
    rows = [(str(n), f"have none: {reason}") for reason, n in reasons.most_common()]
    return "\n".join([head, report.columns(rows)] if rows else [head])


def _cost(spec: Spec, cost: Cost) -> str:
    which = "this first one, with compilation," if cost.compiled else "the first of a process"
    first = f"{which} {report.seconds(cost.first)}"
    rows = [("one call", f"{report.seconds(cost.call)} at {cost.where}; {first}")]
    if spec.names:
        total, calls = spec.sampler.calls(len(spec.names))
        if cost.search_calls:
            few = f"about {cost.search_calls} calls, most with {spec.sampler.search_size()[1]} particles"
            rows.append(("the search for a start", f"{few}: {report.seconds(cost.search)}"))
        rows.append(("the run", f"{calls}: {report.seconds(total * cost.call + cost.search)}, shared by the workers"))
        if not spec.sampler.emulates:
            rows.append(("with --sampler emulator", "some hundred to some thousand calls in place of the run's"))
    return "\n".join(["cost in CPU time", report.columns(rows)])


def preflight_record(spec: Spec, preflight: Preflight) -> dict[str, Any]:
    """Return the components, the free parameters, every stream at the prior's centre, the cost and the warnings.

    Lengths are in kpc, times in Gyr, costs in CPU seconds.
    """
    tried = preflight.prior_draws
    rows = zip(spec.names, spec.priors, spec.centre(), spec.units, strict=True)
    return {
        "run_file": spec.source,
        "digest": spec.digest(),
        "seed": spec.seed,
        "components": [{"path": path, "kind": cls.kind, "supplier": by} for path, cls, by in spec.components()],
        "parameters": {name: {"prior": p.text(), "centre": centre, "unit": unit} for name, p, centre, unit in rows},
        "streams": {name: _stream(look) for name, look in preflight.streams.items()},
        "data": {name: prediction_record([datum], made) for name, (datum, made) in preflight.data.items()},
        "reason": preflight.reason,
        "prior_draws": None
        if tried is None
        else {
            "draws": tried.draws,
            "with_stream": len(tried.good),
            "without": dict(tried.reasons),
            "measured": {name: tried.measured(name) for name in preflight.streams},
        },
        "cost": {
            "first_call": preflight.cost.first,
            "call": preflight.cost.call,
            "where": preflight.cost.where,
            "search_calls": preflight.cost.search_calls,
            "search": preflight.cost.search,
            "most_calls": spec.sampler.calls(len(spec.names))[0] if spec.names else 0,
        },
        "warnings": preflight.warnings,
    }


def _stream(look: Look) -> dict[str, Any]:
    orbit = look.orbit
    return {
        "pericentres": orbit.pericentres,
        "apocentres": orbit.apocentres,
        "radial_period": orbit.period,
        "completed_apocentres": orbit.completed,
        "lookback": look.inputs.lookback,
        "tidal_radius": orbit.r_tidal,
        "bodies": orbit.bodies,
        "particles": look.inputs.stripping.particles,
        "observables": prediction_record(list(look.inputs.observables.values()), look.prediction),
    }
