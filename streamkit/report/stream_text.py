"""One stream as text for a terminal: parameters, counts, observables beside the data."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from streamkit.components import Measurement
from streamkit.observe import remarks_of
from streamkit.report.text import columns, number, paragraph, seconds
from streamkit.runfile import Spec, StreamInputs, as_written
from streamkit.stream import Prediction, Stream

MOST_ROWS, FARTHEST = 200, 20  # data above which a text shows only some of them, and how many


def warning_list(texts: Sequence[str]) -> str:
    """Return the warnings as a list; nothing without any."""
    return "\n".join(["warnings", *(paragraph(text, "  - ") for text in texts)]) if texts else ""


def describe_expansions(inputs: StreamInputs) -> str:
    """Say by what expansions potentials are made that are not compiled; nothing without any."""
    found = inputs.expansions()
    return f"expansions\n{columns(found.items())}" if found else ""


def describe_prediction(inputs: StreamInputs, prediction: Prediction) -> str:
    """Show the observables beside the data, and the difference in standard errors of the data."""
    if not inputs.observables:
        return "observables: the run file has none"
    return describe_measured("observables", list(inputs.observables.values()), prediction)


def describe_measured(called: str, measured: Sequence[Measurement], prediction: Prediction) -> str:
    """Show what is predicted of all ``measured`` beside their data; of very many those that are farthest from it."""
    kinds = ", ".join(each.kind for each in measured)
    if prediction.why_not:
        return f"{called} ({kinds}): no value, {prediction.why_not}"
    data, errors = np.concatenate([each.data() for each in measured], axis=1)
    rows, told = [("", "model", "own noise", "data", "model - data")], ""
    shown_ones = np.arange(len(data))
    if len(data) > MOST_ROWS:
        away = np.nan_to_num(np.abs(prediction.mean - data) / errors, nan=-1.0)
        shown_ones = np.sort(np.argsort(-away, kind="stable")[:FARTHEST])
        told = f", the {FARTHEST} of {len(data)} that are farthest from the data"
    for i in shown_ones.tolist():
        name, mean, variance = prediction.names[i], prediction.mean[i], prediction.variance[i]
        datum, error = data[i], errors[i]
        known = np.isfinite(datum)
        shown = (f"{mean:.2f}", f"{np.sqrt(variance):.2f}") if np.isfinite(mean) else ("-", "-")
        rows.append((
            name, *shown, f"{datum:g} +- {error:g}" if known else "-",
            f"{(mean - datum) / error:+.1f} sigma" if known else "-",
        ))  # fmt: skip
    return "\n".join([f"{called} ({kinds}){told}", columns(rows)])


def describe_stream(
    spec: Spec,
    inputs: StreamInputs,
    stream: Stream,
    prediction: Prediction | None,
    spent: float,
    changed: Collection[str],
) -> str:
    """Show one stream: its parameters, the counts per arm, the observables and the CPU time.

    Parameters
    ----------
    spec, inputs
        What the stream was made from; free parameters stand at the prior's centre.
    stream, prediction
        The stream, and what the observable says of it.
    spent
        CPU seconds, machine code loaded included.
    changed
        Fields set by hand.
    """
    units = dict(zip(spec.names, spec.units, strict=True))
    rows = []
    for path, value in fields(spec.document):
        if path in units:
            rows.append((path, number(inputs.values[path], units[path].replace(" ", "")), "prior's centre"))
        elif path in changed:
            rows.append((path, value, "set"))
    bound = int(stream.bound.sum())
    counts = [
        ("particles", str(len(stream))),
        ("leading arm", str(int((stream.arm == 1).sum()))),
        ("trailing arm", str(int((stream.arm == -1).sum()))),
        ("bound", f"{bound} ({bound / len(stream):.1%})"),
        ("CPU time", f"{seconds(spent)}, machine code loaded included"),
    ]
    named = "one stream" if len(spec.streams) == 1 else f"stream {inputs.name}"
    parts = [f"{spec.source}: {named} (seed {spec.seed})"]
    parts += [f"parameters\n{columns(rows)}"] if rows else []
    parts.append(f"stream\n{columns(counts)}")
    parts.append(describe_expansions(inputs))
    if not inputs.observables:
        parts.append("observables: the run file has none")
    elif prediction is not None:
        parts += [describe_prediction(inputs, prediction), warning_list(remarks_of(inputs.observables, prediction))]
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
