"""One stream as text for a terminal and as plain values: parameters, counts, observables beside the data."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from streamkit.components import LiveStripping, Measurement
from streamkit.observe import remarks_of, scatter_of
from streamkit.report.plain import prediction_record
from streamkit.report.text import columns, number, paragraph, seconds
from streamkit.runfile import Spec, StreamInputs, as_written
from streamkit.stream import Prediction, Stream

WIDER = "sigma: the error with the extra dispersion and, for single stars, the spread of the debris"
MOST_ROWS, FARTHEST = 200, 20  # with more data than the first number, a text shows as many as the second


def warning_list(texts: Sequence[str]) -> str:
    """Return the warnings as a list; nothing without any."""
    return "\n".join(["warnings", *(paragraph(text, "  - ") for text in texts)]) if texts else ""


def describe_expansions(inputs: StreamInputs) -> str:
    """List the expansions of potentials that are not compiled; an empty text without any."""
    expansions = inputs.expansions()
    return f"expansions\n{columns(expansions.items())}" if expansions else ""


def describe_live(scheme: LiveStripping) -> str:
    """Return a sentence with the time of the mass and the radius, and with the number of passages."""
    begins = "a live progenitor: its mass and radius are those at"
    if scheme.passages is None:
        return f"{begins} the look-back time, whatever number of pericentre passages that holds"
    return (
        f"{begins} the apocentre before {scheme.passages} pericentre passages; no other number of passages is tried: "
        "each is a fit of its own"
    )


def describe_measured(called: str, measured: Sequence[Measurement], prediction: Prediction) -> str:
    """Show what is predicted of all ``measured`` beside their data; of very many those that are farthest from it."""
    kinds = ", ".join(each.kind for each in measured)
    if prediction.why_not:
        return f"{called} ({kinds}): no value, {prediction.why_not}"
    data, errors = np.concatenate([each.data() for each in measured], axis=1)
    scatter = scatter_of(measured, prediction)
    rows, note = [("", "model", "own noise", "data", "data - model")], ""
    selected = np.arange(len(data))
    if len(data) > MOST_ROWS:
        away = np.nan_to_num(np.abs(prediction.mean - data) / scatter, nan=-1.0)
        selected = np.sort(np.argsort(-away, kind="stable")[:FARTHEST])
        note = f", the {FARTHEST} of {len(data)} that are farthest from the data"
    for i in selected.tolist():
        name, mean, variance = prediction.names[i], prediction.mean[i], prediction.variance[i]
        datum, error = data[i], errors[i]
        has_datum = np.isfinite(datum)
        noise = float(np.sqrt(variance))
        digits = decimals(min(noise or np.inf, error if has_datum else np.inf))
        shown = (f"{mean:.{digits}f}", f"{noise:.2g}") if np.isfinite(mean) else ("-", "-")
        rows.append((
            name, *shown, f"{datum:.{decimals(error)}f} +- {error:.{decimals(error)}f}" if has_datum else "-",
            f"{(datum - mean) / scatter[i]:+.1f} sigma" if has_datum else "-",
        ))  # fmt: skip
    lines = [f"{called} ({kinds}){note}", columns(rows)]
    if np.any(scatter[selected] > 1.001 * errors[selected]):
        lines.append(paragraph(WIDER, "  "))
    return "\n".join(lines)


def decimals(error: float) -> int:
    """Return the decimal places that show an error with two digits; none for one of 10 or more."""
    return 2 if not np.isfinite(error) or error <= 0 else int(np.clip(1 - np.floor(np.log10(error)), 0, 8))


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


def describe_stream(
    spec: Spec,
    inputs: StreamInputs,
    record: Mapping[str, Any],
    prediction: Prediction | None,
    changed: Collection[str],
) -> str:
    """Return one stream as text, from its `stream_record`: parameters, counts per arm, observables, CPU time.

    ``changed`` are the fields that were set on the command line.
    """
    free = record["parameters"]
    rows = []
    for path, value in fields(spec.document):
        if path in free:
            rows.append((path, number(free[path]["value"], free[path]["unit"]), "prior's centre"))
        elif path in changed:
            rows.append((path, value, "set"))
    counts = [
        ("particles", str(record["particles"])),
        ("leading arm", str(record["leading"])),
        ("trailing arm", str(record["trailing"])),
        ("bound", f"{record['bound']} ({record['bound'] / record['particles']:.1%})"),
        ("CPU time", f"{seconds(record['cpu_seconds'])}, machine code loaded included"),
    ]
    title = "one stream" if len(spec.streams) == 1 else f"stream {inputs.name}"
    parts = [f"{spec.source}: {title} (seed {spec.seed})"]
    parts += [f"parameters\n{columns(rows)}"] if rows else []
    parts += [f"stream\n{columns(counts)}", describe_expansions(inputs)]
    if not inputs.observables:
        parts.append("observables: the run file has none")
    elif prediction is not None:
        parts.append(describe_measured("observables", list(inputs.observables.values()), prediction))
        parts.append(warning_list(record["warnings"]))
    return "\n\n".join(part for part in parts if part)


def fields(document: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield the path of every field of a resolved run file, and its value as text."""
    for name, value in document.items():
        path = f"{prefix}{name}"
        yield path, _tidy(value)
        if isinstance(value, Mapping):
            yield from fields(value, f"{path}.")


def _tidy(value: object) -> str:
    """Write a quantity of a resolved run file with four digits, anything else as the run file does."""
    digits, _, unit = str(value).partition(" ")
    try:
        return number(float(digits), unit) if isinstance(value, str) else as_written(value)
    except ValueError:
        return as_written(value)
