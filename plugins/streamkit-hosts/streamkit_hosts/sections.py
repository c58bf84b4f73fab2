"""Write the tables of an imported host, and the sections of a run file that name them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from streamkit import Array, StreamkitError
from streamkit.report import save_table
from streamkit_hosts.agama import Host
from streamkit_hosts.expansion import tabulated
from streamkit_hosts.table import PRECISION, check_rows

UNITS = {
    "t": "Gyr", "R": "kpc", "z": "kpc", "phi": "km2 / s2", "dphi_dR": "km2 / (kpc s2)", "dphi_dz": "km2 / (kpc s2)",
}  # fmt: skip


@dataclass(frozen=True)
class Written:
    """A table that was written: its file, and what to say of it."""

    file: Path
    section: str  # as a run file has it, such as potential.halo
    kind: str
    times: Array
    size: str
    fields: dict[str, Any]
    warnings: tuple[str, ...]


def written(
    hosts: Sequence[Host], between: tuple[float, float], output: Path, *, precision: float = PRECISION, force: bool
) -> list[Written]:
    """Write a table for each part of a host; with several parts the files have a name for each.

    Raises StreamkitError if a file is there already, unless it may be replaced.
    """
    names = _names(hosts)
    files = [output.with_name(f"{output.stem}_{name}{output.suffix}") if name else output for name in names]
    check_free(files, force)
    made = []
    for host, name, file in zip(hosts, names, files, strict=True):
        section = f"potential.{name}" if name else "potential"
        if host.expansion is not None:
            table = tabulated(host.expansion, between, precision)
            save_table(file, table.table)
            changes = ", ".join(f"{change:.2%} without {what}" for what, change in table.changes.items())
            size = (
                f"{len(table.times)} time(s), {len(table.harmonics)} harmonic(s), {len(table.radii)} radii from "
                f"{table.radii[0]:.3g} to {table.radii[-1]:.3g} kpc"
            ) + (f"; the force changes by {changes}" if changes else "")
            said = tuple(table.warnings())
        else:
            save_table(file, _table(host.columns, len(host.times)))
            reach = [float(np.max(host.columns[axis])) for axis in ("R", "z")]
            size = f"{len(host.times)} time(s), R up to {reach[0]:.3g} and z up to {reach[1]:.3g} kpc"
            said = ()
        made.append(Written(file, section, host.kind, host.times, size, host.fields, said))
    return made


def described(part: Written) -> str:
    """Return what a table holds, and its section."""
    lines = section_lines(part.section, part.kind, part.file, part.times, tolerance="1e-3", fields=part.fields)
    return "\n".join([f"{part.file}: {part.size}", "", *lines]) + "\n"


def section_lines(
    section: str, kind: str, file: Path, times: Array, *, tolerance: str, fields: Mapping[str, Any] | None = None
) -> list[str]:
    """Return the lines of a run file that name a table, which is known from the first of its times on."""
    lines = [f"[{section}]", f'kind = "{kind}"', f'table = "{file}"']
    for name, value in (fields or {}).items():
        lines.append(f"{name} = {list(value) if isinstance(value, tuple) else value}")
    lines.append(f"tolerance = {tolerance}")
    if len(times) > 1:
        lines.append(f"# known from {times[0]:.4g} Gyr: progenitor.lookback may be up to {-times[0]:.4g}")
    return lines


def check_free(files: Sequence[Path], force: bool) -> None:
    """Raise StreamkitError if a file is there already, unless it may be replaced."""
    if there := [file for file in files if file.exists() and not force]:
        raise StreamkitError(f"{there[0]} exists: give another --output, or --force to replace it")


def _names(hosts: Sequence[Host]) -> list[str]:
    """Return a name for each part: none for the only one."""
    if len(hosts) == 1:
        return [""]
    words = ["halo" if host.kind == "multipole" else "disc" for host in hosts]
    counts = [words[: k + 1].count(word) for k, word in enumerate(words)]
    return [word if count == 1 else f"{word}{count}" for word, count in zip(words, counts, strict=True)]


def _table(columns: dict[str, Array], times: int) -> Any:
    from astropy.table import Table  # slow to import

    rows = len(columns["R"])
    check_rows(rows, f"{times} times with {rows // times} rows each", "take fewer times by --every")
    return Table(columns, units={name: unit for name, unit in UNITS.items() if name in columns})
