"""One stream as plain values, for programs: what `describe_stream` says."""

from __future__ import annotations

from typing import Any

from streamkit.observe import remarks_of
from streamkit.report.plain import prediction_record
from streamkit.spec import Setup, Spec
from streamkit.stream import Prediction, Stream


def stream_record(
    spec: Spec, setup: Setup, stream: Stream, prediction: Prediction | None, spent: float
) -> dict[str, Any]:
    """Return the parameters of a stream with their units, the counts per arm, the observables and the CPU seconds."""
    units = zip(spec.names, spec.units, strict=True)
    remarks = remarks_of(setup.observables, prediction) if setup.observables and prediction is not None else ()
    return {
        "stream": setup.name,
        "seed": spec.seed,
        "digest": spec.digest(),
        "parameters": {name: {"value": setup.values[name], "unit": unit} for name, unit in units},
        "particles": len(stream),
        "leading": (stream.arm == 1).sum(),
        "trailing": (stream.arm == -1).sum(),
        "bound": stream.bound.sum(),
        "cpu_seconds": spent,
        "observables": prediction_record(list(setup.observables.values()), prediction),
        "warnings": remarks,
    }
