"""A preflight as plain values, for programs: the content of `describe_spec` and `describe_preflight`."""

from __future__ import annotations

from typing import Any

from streamkit.report import prediction_record
from streamkit.runfile import Spec
from streamkit.study.preflight.preflight import Look, Preflight


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
        else {"draws": tried.draws, "with_stream": len(tried.good), "without": dict(tried.reasons)},
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
