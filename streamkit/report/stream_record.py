"""One stream as plain values: programs read them, and `describe_stream` makes its text of them."""

from __future__ import annotations

from typing import Any

from streamkit.observe import remarks_of
from streamkit.report.plain import prediction_record
from streamkit.runfile import Spec, StreamInputs
from streamkit.stream import Prediction, Stream


def stream_record(
    spec: Spec, inputs: StreamInputs, stream: Stream, prediction: Prediction | None, spent: float
) -> dict[str, Any]:
    """Return the parameters of a stream with their units, the counts per arm, the observables and the CPU seconds."""
    units = zip(spec.names, spec.units, strict=True)
    remarks = remarks_of(inputs.observables, prediction) if inputs.observables and prediction is not None else ()
    return {
        "stream": inputs.name,
        "seed": spec.seed,
        "digest": spec.digest(),
        "parameters": {name: {"value": inputs.values[name], "unit": unit} for name, unit in units},
        "particles": len(stream),
        "leading": int((stream.arm == 1).sum()),
        "trailing": int((stream.arm == -1).sum()),
        "bound": int(stream.bound.sum()),
        "cpu_seconds": spent,
        "observables": prediction_record(list(inputs.observables.values()), prediction),
        "warnings": remarks,
    }
