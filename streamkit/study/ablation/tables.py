"""The tables of an ablation: one row per variant as an astropy table, the same for a terminal, and the mean tracks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from astropy import units as u
from astropy.table import Column, QTable, vstack

from streamkit.report import columns, paragraph
from streamkit.runfile import as_written
from streamkit.stream import ARMS, Array
from streamkit.study.ablation.measures import NEAR, observables
from streamkit.study.ablation.runner import Ablation, Outcome
from streamkit.study.grid import MANY, by_column, rms

REFERENCE = "reference"
LABEL = 43  # letters of the longest label in a printed table


class Measure(NamedTuple):
    """The display of a measure: whether each arm has one, its short head, its unit, and its meaning."""

    of_arms: bool
    head: str
    unit: str
    meaning: str


# The measures of each printed table, by their names without the arm.
PRINTED = (
    {
        "length": Measure(True, "len", "deg",
                          "angle from the progenitor to the end of the tail: 0.5 and 99.5 % of the winding"),
        "length_ratio": Measure(False, "ratio", "", "length of both tails over the reference's"),
        "track_near": Measure(True, "near", "kpc", "the same as track, from the progenitor to where the reference is "
                              f"first {NEAR:g} kpc away"),
        "track": Measure(True, "track", "kpc", "rms distance of the mean track from the reference's, across it, over "
                         "the common length; the noise of the finite number of particles is taken off"),
    },
    {
        "width_ratio": Measure(True, "width", "", "width in the plane of the orbit over the reference's, median along "
                               "the common length"),
        "thickness_ratio": Measure(True, "thick", "", "the same out of the plane"),
        "density_distance": Measure(True, "along", "deg", "Wasserstein distance of the angles along the tail from the "
                                    "reference's"),
        "bound": Measure(False, "bound", "", "fraction of the particles inside the tidal radius today"),
        "cpu": Measure(False, "CPU", "s", "CPU seconds of one stream with its observables"),
    },
    {
        "energy_offset": Measure(True, "dE", "km2/s2", "mean energy of the tail minus the progenitor's"),
        "energy_distance": Measure(False, "E", "km2/s2", "Wasserstein distance of the unbound particles' energies "
                                   "from the reference's"),
        "angular_momentum_offset": Measure(True, "dL", "kpc km/s", "mean angular momentum of the tail minus the "
                                           "progenitor's"),
        "angular_momentum_distance": Measure(False, "L", "kpc km/s", "Wasserstein distance of the angular momenta "
                                             "from the reference's"),
    },
)  # fmt: skip
MOVING = (
    "A body moves beside the host: energies and angular momenta are those of today, with the body where it is today. "
    "They are not conserved, and differences of dE, dL, E and L do not last."
)
PULL = Measure(False, "pull", "", "difference of the observable from the reference's in standard errors of the data")
MEASURES = {name: measure for table in PRINTED for name, measure in table.items()} | {
    "observable": Measure(False, "", "", "as the run file measures it"),
    "pull": PULL,
}


def measures_table(ablation: Ablation) -> QTable:
    """Return one row per variant, the reference first if it is a snapshot: means over the seeds, and their scatter.

    A variant without a stream has its reason and no numbers.
    """
    rows = rows_of(ablation)
    names = list(dict.fromkeys(name for _, _, measures in rows for one in measures for name in one))
    several = any(len(measures) > 1 for _, _, measures in rows)
    out = QTable()
    out["variant"] = [label for label, _, _ in rows]
    for path in ablation.outcomes[0].variant.values:
        out[path] = ["" if o is None else as_written(o.variant.values[path]).strip('"') for _, o, _ in rows]
    out["streams"] = [0 if o is None else len(measures) for _, o, measures in rows]
    for name in names:
        values = [[one.get(name, np.nan) for one in measures] for _, _, measures in rows]
        measure = MEASURES[_base(name)]
        mean, scatter = over_seeds(values)
        for column, numbers in ((name, mean), (f"{name}_sd", scatter))[: 1 + several]:
            out[column] = numbers * u.Unit(measure.unit) if measure.unit else numbers
        out[name].info.description = measure.meaning
    reasons = ["" if o is None else "; ".join(o.reasons) for _, o, _ in rows]
    out["reason"] = Column(reasons, description="why there is no stream, or no observable")
    return out


Row = tuple[str, Outcome | None, list[dict[str, float]]]


def rows_of(ablation: Ablation) -> list[Row]:
    """Return label, outcome and the measures of each seed; the reference, which has no outcome, first."""
    rows: list[Row] = []
    reference = ablation.reference
    if reference.title:
        rows.append((REFERENCE, None, [{**reference.measures(), **observables(reference)}]))
    return rows + [(o.variant.label, o, [o.measures[seed] for seed in sorted(o.measures)]) for o in ablation.outcomes]


def over_seeds(rows: Sequence[Sequence[float]]) -> tuple[Array, Array]:
    """Return each row's mean and standard deviation over the seeds with a value; NaN with none, or below two."""
    finite = [[value for value in row if np.isfinite(value)] for row in rows]
    mean = np.array([np.mean(row) if row else np.nan for row in finite])
    return mean, np.array([np.std(row, ddof=1) if len(row) > 1 else np.nan for row in finite])


def _base(name: str) -> str:
    """Return a measure's name without the arm, or the name of the observable."""
    for prefix in ("observable", "pull"):
        if name.startswith(f"{prefix}_"):
            return prefix
    return name.removesuffix("_leading").removesuffix("_trailing")


def tracks_table(ablation: Ablation) -> QTable:
    """Return the mean tracks of the reference and of every variant at its first seed, one row per arm and angle."""
    portraits = {REFERENCE: ablation.reference} if ablation.reference.title else {}
    portraits |= {o.variant.label: o.first for o in ablation.outcomes if o.first is not None}
    parts = []
    for label, portrait in portraits.items():
        for arm, track in portrait.tracks.items():
            part = QTable()
            part["variant"] = [label] * len(track.angle)
            part["arm"] = arm
            part["angle"] = track.angle * ARMS[arm] * u.deg
            for name in ("r", "height", "width", "thickness"):
                part[name] = np.where(track.count > 0, getattr(track, name), np.nan) * u.kpc
            part["density"] = track.density / u.deg
            part["count"] = track.count
            parts.append(part)
    return vstack(parts, metadata_conflicts="silent")


def describe_ablation(ablation: Ablation) -> str:
    """Show the table for a terminal, in four parts, with what each column means."""
    rows, legend = _numbered(rows_of(ablation))
    seeds = max((len(measures) for _, _, measures in rows), default=0)
    of = f"; means over {seeds} seeds, their scatter is in the table's columns _sd" if seeds > 1 else ""
    parts = [paragraph(f"{len(ablation.outcomes)} variants beside {ablation.beside}{of}; L leading, T trailing")]
    parts += [legend, *(_part(rows, measures) for measures in PRINTED)]
    parts += _observables(rows)
    if any(o.first is not None and o.first.moves for o in ablation.outcomes):
        parts.append(paragraph(MOVING))
    for label, outcome, _ in rows:
        if outcome is not None and outcome.reasons:
            parts.append(paragraph("; ".join(outcome.reasons), f"{label}: ", "  "))
    return "\n\n".join(part for part in parts if part)


def _numbered(rows: list[Row]) -> tuple[list[Row], str]:
    """Return the rows with numbers for labels, and a list of these, where the labels leave no room for the columns."""
    if max(len(label) for label, _, _ in rows) <= LABEL:
        return rows, ""
    outcomes = [outcome for _, outcome, _ in rows if outcome is not None]
    names = {id(outcome): str(i) for i, outcome in enumerate(outcomes, 1)}
    legend = columns([(names[id(outcome)], outcome.variant.label) for outcome in outcomes])
    return [(names.get(id(outcome), REFERENCE), outcome, measures) for _, outcome, measures in rows], legend


def _part(rows: Sequence[Row], measures: Mapping[str, Measure]) -> str:
    """Show one of the printed tables, and below it what its columns mean."""
    head, names, notes = ["variant"], [], []
    for base, measure in measures.items():
        unit = f" [{measure.unit}]".replace("km2/s2", "(km/s)^2") if measure.unit else ""
        notes.append(paragraph(f"{measure.meaning}{unit}", f"    {measure.head}: ", "      "))
        for arm in ARMS if measure.of_arms else ("",):
            names.append(f"{base}_{arm}" if arm else base)
            head.append(f"{measure.head} {arm[:1].upper()}".strip())
    body = [[label, *(_cell(of_seeds, name) for name in names)] for label, _, of_seeds in rows]
    return "\n".join([columns([head, *body]), *notes])


def _observables(rows: Sequence[Row]) -> list[str]:
    """Show the observables and their pulls, if there are any."""
    names = dict.fromkeys(n for _, _, ms in rows for one in ms for n in one if _base(n) == "observable")
    if not names:
        return []
    short = [name.removeprefix("observable_") for name in names]
    if len(short) > MANY:
        return [_columns(rows, short)]
    body = [["variant", *(head for name in short for head in (name, PULL.head))]]
    for label, _, measures in rows:
        pairs = ((_cell(measures, f"observable_{n}"), _cell(measures, f"pull_{n}", "+.1f")) for n in short)
        body.append([label, *(cell for pair in pairs for cell in pair)])
    return ["\n".join([columns(body), paragraph(PULL.meaning, "  pull: ", "    ")])]


def _columns(rows: Sequence[Row], names: Sequence[str]) -> str:
    """Return many observables by column: the rms difference from the reference, and the largest."""
    shown = [row for row in rows if row[2]]
    body = [["column", *(label for label, _, _ in shown)]]
    pulls = [over_seeds([[one.get(f"pull_{name}", np.nan) for one in ms] for name in names])[0] for _, _, ms in shown]
    for column, which in by_column(names).items():
        cells = []
        for pull in (each[which] for each in pulls):
            farthest = pull[np.argmax(np.nan_to_num(np.abs(pull)))]
            cells.append(f"{rms(pull):.2f} ({farthest:+.1f})" if np.isfinite(farthest) else "-")
        body.append([column, *cells])
    note = f"{PULL.meaning}: the root of the mean square of the data of each column, and the farthest of them"
    return "\n".join([columns(body), paragraph(note, "  ", "    ")])


def _cell(measures: Sequence[dict[str, float]], name: str, form: str = "") -> str:
    """Write the mean over the seeds."""
    (mean,), _ = over_seeds([[one.get(name, np.nan) for one in measures]])
    if not np.isfinite(mean):
        return "-"
    digits = 0 if abs(mean) >= 100 else 1 if abs(mean) >= 10 else 2
    return format(mean, form or f".{digits}f")
