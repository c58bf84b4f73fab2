"""What `check`, `stream` and `run` print: the library's objects as text for a terminal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from streamkit.advice import coverage_warnings, stranded_warnings
from streamkit.listing import toml
from streamkit.phase import Array, Prediction, Stream
from streamkit.spec import Setup, Spec
from streamkit.text import columns, number, paragraph, seconds, span

if TYPE_CHECKING:
    from astropy.table import QTable

    from streamkit.course import Course
    from streamkit.preflight import Cost, Preflight
    from streamkit.results import Results
    from streamkit.survey import Survey

RADII = (50.0, 100.0, 150.0, 200.0)
"""Radii in kpc of the masses that a run prints: those of Gibbons+ 2014, table 3."""


def describe_spec(spec: Spec) -> str:
    """List the components with their suppliers, and the free parameters with priors and units."""
    parts = [f"{spec.source}: valid (digest {spec.digest()[:12]}, seed {spec.seed})"]
    used = columns((path, cls.kind, supplier) for path, cls, supplier in spec.components())
    parts.append(f"components\n{used}")
    if not spec.names:
        return "\n\n".join([*parts, "free parameters: none"])
    rows = [("parameter", "prior", "centre", "unit")]
    rows += [
        (name, prior.text(), f"{centre:.4g}", unit.replace(" ", "") or "-")
        for name, prior, centre, unit in zip(spec.names, spec.priors, spec.centre(), spec.units, strict=True)
    ]
    return "\n\n".join([*parts, f"free parameters ({len(spec.names)})\n{columns(rows)}"])


def describe_preflight(spec: Spec, found: Preflight) -> str:
    """Say what the preflight found: the orbit, the streams over the prior, the cost and the warnings."""
    setup = found.setup
    place = "the prior's centre" if spec.names else "the given parameters"
    parts = [f"at {place}\n" + columns(_course_rows(setup, found.course))]
    if setup.observable is not None and found.prediction is not None:
        parts.append(describe_prediction(setup, found.prediction))
    if found.survey is not None:
        parts.append(_survey(found.survey))
    parts.append(_cost(spec, found.cost))
    parts.append(_warnings(found.warnings) or "no warnings")
    return "\n\n".join(parts)


def _warnings(texts: Sequence[str]) -> str:
    return "\n".join(["warnings", *(paragraph(text, "  - ") for text in texts)]) if texts else ""


def _course_rows(setup: Setup, path: Course) -> list[tuple[str, str]]:
    tidal = span(*path.r_tidal, "kpc") if np.isfinite(path.r_tidal[0]) else "none somewhere on the orbit"
    periods = ""
    if np.isfinite(path.period):
        periods = f": {setup.lookback / path.period:.1f} radial periods, {path.completed} completed apocentre"
        periods += "s" * (path.completed != 1)
    return [
        ("pericentre", _radii(path.pericentres)),
        ("apocentre", _radii(path.apocentres)),
        ("radial period", number(path.period, "Gyr") if np.isfinite(path.period) else "none"),
        ("look-back time", number(setup.lookback, "Gyr") + periods),
        ("tidal radius", tidal),
        ("particles", f"{setup.stripping.particles}, progenitor's gravity {_switch(setup)}"),
    ]


def _radii(radii: Array) -> str:
    return span(float(radii.min()), float(radii.max()), "kpc") if len(radii) else "none"


def _switch(setup: Setup) -> str:
    return "on" if setup.stripping.progenitor_gravity else "off"


def _survey(trial: Survey) -> str:
    head = f"streams over the prior: {len(trial.good)} of {trial.draws} draws have one that can be measured"
    rows = [(str(n), f"have none: {reason}") for reason, n in trial.reasons.most_common()]
    return "\n".join([head, columns(rows)] if rows else [head])


def _cost(spec: Spec, cost: Cost) -> str:
    first = f"the first of a process {seconds(cost.first)}"
    rows = [("one call", f"{seconds(cost.call)} at {cost.where}; {first}")]
    if spec.names:
        walkers, steps = spec.sampler.walkers, spec.sampler.steps
        total = walkers * steps
        calls = f"{walkers} walkers x at most {steps} steps = {total} calls"
        rows.append(("the run", f"{calls}: {seconds(total * cost.call)}, shared by the workers"))
    return "\n".join(["cost in CPU time", columns(rows)])


def describe_prediction(setup: Setup, prediction: Prediction) -> str:
    """Show the observables beside the data, and the difference in standard errors of the data."""
    if setup.observable is None:
        return "observables: the run file has none"
    if prediction.why_not:
        return f"observables ({setup.observable.kind}): no value, {prediction.why_not}"
    data, errors = setup.observable.data()
    rows = [("", "model", "own noise", "data", "model - data")]
    for name, mean, variance, datum, error in zip(
        prediction.names, prediction.mean, prediction.variance, data, errors, strict=True
    ):
        known = np.isfinite(datum)
        rows.append((
            name, f"{mean:.2f}", f"{np.sqrt(variance):.2f}", f"{datum:g} +- {error:g}" if known else "-",
            f"{(mean - datum) / error:+.1f} sigma" if known else "-",
        ))  # fmt: skip
    return "\n".join([f"observables ({setup.observable.kind})", columns(rows)])


def describe_stream(
    spec: Spec,
    setup: Setup,
    stream: Stream,
    prediction: Prediction | None,
    spent: float,
    changed: Collection[str],
) -> str:
    """Show one stream: its parameters, the counts per arm, the observables and the CPU time.

    Parameters
    ----------
    spec, setup
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
            rows.append((path, number(setup.values[path], units[path].replace(" ", "")), "prior's centre"))
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
    parts = [f"{spec.source}: one stream (seed {spec.seed})"]
    parts += [f"parameters\n{columns(rows)}"] if rows else []
    parts.append(f"stream\n{columns(counts)}")
    if setup.observable is None:
        parts.append("observables: the run file has none")
    elif prediction is not None:
        parts += [describe_prediction(setup, prediction), _warnings(coverage_warnings(prediction))]
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
        return number(float(digits), unit) if isinstance(value, str) else toml(value)
    except ValueError:
        return toml(value)


def describe_results(results: Results) -> str:
    """Show a run: whether it can be trusted, the parameters, the masses, what became of its calls."""
    steps, walkers, _ = results.chain.shape
    summary, profile = results.summary(), results.mass_profile(RADII)
    rows = [("parameter", "median", "68 %", "95 %", "unit", "tau", "eff. samples")]
    rows += [
        (
            row["parameter"], f"{row['median']:.4g}", _interval(row, 68), _interval(row, 95),
            row["unit"] or "-", f"{row['autocorrelation_time']:.0f}", f"{row['effective_samples']:.0f}",
        )
        for row in summary
    ]  # fmt: skip
    masses = [("r", "M(<r)", "68 %", "95 %", "in 1e11 Msun")]
    masses += [
        (f"{r:g} kpc", f"{m[0]:.2f}", f"{m[1]:.2f} to {m[2]:.2f}", f"{m[3]:.2f} to {m[4]:.2f}", "")
        for r, m in zip(RADII, _masses(profile), strict=True)
    ]
    calls = [
        ("acceptance", f"{results.acceptance:.3f}", ""),
        ("calls", str(results.calls), f"and {results.search_calls} in the search for a start"),
    ]
    calls += [("rejected", str(n), reason) for reason, n in Counter(results.reasons).most_common()]
    calls += [("stranded", str(len(results.stranded)), f"of {walkers} walkers")]
    head = f"{steps} steps of {walkers} walkers, {results.discard} of them left out as burn-in"
    parts = [f"{head}\n{paragraph(results.note())}", f"parameters\n{columns(rows)}"]
    parts += [f"mass of the host\n{columns(masses)}", f"sampler\n{columns(calls)}"]
    if warnings := stranded_warnings(results.stranded.tolist(), walkers):
        parts.append(_warnings(warnings))
    if results.directory is not None:
        names = sorted(path.name for path in results.directory.iterdir() if not path.name.startswith("."))
        parts.append(paragraph(", ".join(names), f"products in {results.directory}: ", "  "))
    return "\n\n".join(parts)


def _interval(row: Any, percent: int) -> str:
    return f"{row[f'lo{percent}']:.4g} to {row[f'hi{percent}']:.4g}"


def _masses(profile: QTable) -> Array:
    """(nr, 5) Median and the ends of the 68 % and 95 % intervals, in 1e11 Msun."""
    names = ("M", "M_lo68", "M_hi68", "M_lo95", "M_hi95")
    return np.stack([profile[name].to_value("Msun") for name in names], axis=1) / 1e11
