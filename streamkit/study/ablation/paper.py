"""The small table of an ablation, for a paper: the measures that a reader compares, one row per variant."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from io import StringIO
from typing import NamedTuple

import numpy as np
from astropy.table import Table

from streamkit.components import Observable
from streamkit.model import Host
from streamkit.report import LATEX_UNITS, decimals, latex_escaped
from streamkit.stream import ARMS, Array
from streamkit.study.ablation.runner import Ablation
from streamkit.study.ablation.tables import Row, over_seeds, rows_of
from streamkit.study.grid import MANY, by_column, rms
from streamkit.units import datum_unit

RADIUS = 50.0  # radius in kpc of the mass of a host that varies
CHANGED = 1e-6  # relative difference between masses above which it is no rounding
FEWEST_DIGITS = 2  # digits of a number without a scatter


class PaperColumn(NamedTuple):
    """A column: its head, its unit, and (rows,) means over the seeds and their scatter; NaN for none."""

    head: str
    unit: str
    mean: Array
    scatter: Array


def paper_columns(ablation: Ablation) -> list[PaperColumn]:
    """Return the columns in the order of `measures_table`'s rows, without columns that have no number.

    The columns are the length of each tail, the distance of its mean track from the reference's near the progenitor,
    the observables, the bound fraction, the mass of a host that varies, and the CPU time. For more than a dozen data
    there is the root mean square difference from the reference for each quantity, in standard errors of the data.
    """
    rows = rows_of(ablation)
    columns = [_measure(rows, f"length_{arm}", f"length {arm}", "deg") for arm in ARMS]
    columns += [_measure(rows, f"track_near_{arm}", f"track {arm}", "kpc") for arm in ARMS]
    firsts = [outcome.first for outcome in ablation.outcomes if outcome.first is not None]
    columns += _observables(rows, firsts[0].inputs.observables if firsts else {})
    columns += [_measure(rows, "bound", "fraction bound", ""), _mass(rows), _measure(rows, "cpu", "CPU time", "s")]
    return [column for column in columns if np.isfinite(column.mean).any()]


def small_csv(ablation: Ablation) -> str:
    """Return the small table as CSV: units in the heads, the scatter over the seeds in separate columns."""
    table = Table({"variant": [label for label, _, _ in rows_of(ablation)]})
    for head, unit, mean, scatter in paper_columns(ablation):
        of = f" [{unit}]" if unit else ""
        table[f"{head}{of}"] = [f"{value:.5g}" if np.isfinite(value) else "" for value in mean]
        if np.isfinite(scatter).any():
            table[f"sd of {head}{of}"] = [f"{value:.3g}" if np.isfinite(value) else "" for value in scatter]
    return _written(table, "ascii.csv")


def small_latex(ablation: Ablation) -> str:
    """Return the small table in LaTeX: means over the seeds with their scatter, to two digits of the scatter."""
    table = Table({"variant": [latex_escaped(label) for label, _, _ in rows_of(ablation)]})
    units = {}
    for head, unit, mean, scatter in paper_columns(ablation):
        name = latex_escaped(head)
        table[name] = [_cell(value, error) for value, error in zip(mean, scatter, strict=True)]
        units[name] = LATEX_UNITS.get(unit, unit)
    lines = {"preamble": "", "header_start": r"\hline", "header_end": r"\hline", "data_end": r"\hline"}
    return _written(table, "ascii.latex", latexdict={"tabletype": None, "units": units, **lines})


def _written(table: object, form: str, **options: object) -> str:
    out = StringIO()
    table.write(out, format=form, **options)  # type: ignore[attr-defined]
    return out.getvalue().lstrip()


def _cell(mean: float, scatter: float) -> str:
    if not np.isfinite(mean):
        return "--"
    if not (np.isfinite(scatter) and scatter > 0):
        return f"${mean:.{max(decimals(abs(mean)), FEWEST_DIGITS) if abs(mean) < 100 else 0}f}$"
    digits = decimals(scatter)
    return rf"${mean:.{digits}f} \pm {scatter:.{digits}f}$"


def _measure(rows: Sequence[Row], name: str, head: str, unit: str) -> PaperColumn:
    values = [[one.get(name, np.nan) for one in measures] for _, _, measures in rows]
    return PaperColumn(head, unit, *over_seeds(values))


def _observables(rows: Sequence[Row], observed: Mapping[str, Observable]) -> Iterator[PaperColumn]:
    """Return the observables; for many data the difference from the reference, for each quantity."""
    keys = dict.fromkeys(key for _, _, ms in rows for one in ms for key in one if key.startswith("observable_"))
    names = [key.removeprefix("observable_") for key in keys]
    kind = "".join(each.kind for each in observed.values()) if len(observed) == 1 else ""
    if len(names) <= MANY:
        for name in names:
            head = f"{kind} {name}".strip().replace("_", " ")
            yield _measure(rows, f"observable_{name}", head, _unit(name, observed))
        return
    for quantity, which in by_column(names).items():
        values = []
        for _, _, measures in rows:
            pulls = [np.array([one.get(f"pull_{names[i]}", np.nan) for i in which]) for one in measures]
            values.append([float(rms(pull)) for pull in pulls])
        yield PaperColumn(f"rms difference of {quantity.replace('_', ' ')}", "errors", *over_seeds(values))


def _unit(name: str, observed: Mapping[str, Observable]) -> str:
    """Return the unit of a datum that is a field, such as an apocentre; empty for any other."""
    fields = (type(each).model_fields.get(name.rpartition(".")[2]) for each in observed.values())
    return next((datum_unit(field) for field in fields if field is not None), "")


def _mass(rows: Sequence[Row]) -> PaperColumn:
    """Return M(<50 kpc) of the hosts, if there are several."""
    masses = []
    for _, outcome, _ in rows:
        first = None if outcome is None else outcome.first
        inside = np.nan
        if first is not None:
            inside = float(Host(first.inputs.potentials, {}).mass_inside(np.array([RADIUS]))[0])
        masses.append(inside)
    mass = np.array(masses)
    if not np.isfinite(mass).any() or np.nanmax(mass) - np.nanmin(mass) <= CHANGED * np.nanmax(mass):
        mass = np.full(len(rows), np.nan)
    return PaperColumn(f"M(<{RADIUS:g} kpc)", "1e11 Msun", mass / 1e11, np.full(len(rows), np.nan))
