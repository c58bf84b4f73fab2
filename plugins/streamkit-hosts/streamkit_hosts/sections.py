"""Write the tables of an imported host, and the sections of a run file that name them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from streamkit import Array
from streamkit.report import check_target, save_table
from streamkit_hosts.agama import Host
from streamkit_hosts.expansion import tabulated
from streamkit_hosts.table import PRECISION, check_rows

UNITS = {
    "t": "Gyr", "R": "kpc", "z": "kpc", "phi": "km2/s2", "dphi_dR": "km2 / (kpc s2)", "dphi_dz": "km2 / (kpc s2)",
}  # fmt: skip
PATH = {"t": "Gyr", **dict.fromkeys("xyz", "kpc"), **dict.fromkeys(("vx", "vy", "vz"), "km/s")}
WORDS = {"multipole": "halo", "cylspline": "disc", "uniform_acceleration": "acceleration"}


@dataclass(frozen=True)
class Written:
    """A part that was written: its file, if it is a table, and what to say of it."""

    file: Path | None
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
    moved = [file_of_path(file) for file, host in zip(files, hosts, strict=True) if len(host.centre.get("t", ())) > 1]
    check_free([*(file for file, host in zip(files, hosts, strict=True) if _is_table(host)), *moved], force)
    made = []
    for host, name, file in zip(hosts, names, files, strict=True):
        section, fields = f"potential.{name}" if name else "potential", dict(host.fields)
        if len(host.centre.get("t", ())) > 1:
            fields["centre"] = str(file_of_path(file))
            save_table(file_of_path(file), path_table(host.centre))
        elif host.centre:
            fields["centre"] = host.centre
        placed: Path | None = file
        if host.expansion is not None:
            table = tabulated(host.expansion, between, precision)
            save_table(file, table.table)
            changes = ", ".join(f"{change:.2%} without {what}" for what, change in table.changes.items())
            size = (
                f"{len(table.times)} time(s), {len(table.harmonics)} harmonic(s), {len(table.radii)} radii from "
                f"{table.radii[0]:.3g} to {table.radii[-1]:.3g} kpc"
            ) + (f"; the force changes by {changes}" if changes else "")
            said = tuple(table.warnings())
        elif not host.columns:
            size, said, placed = "a uniform acceleration", (), None
        else:
            save_table(file, _table(host.columns, len(host.times)))
            reach = [float(np.max(host.columns[axis])) for axis in ("R", "z")]
            size = f"{len(host.times)} time(s), R up to {reach[0]:.3g} and z up to {reach[1]:.3g} kpc"
            said = ()
        times = host.times
        if len(path := host.centre.get("t", ())) > 1:  # what is known is known of both
            times = np.array([max(path[0], times[0] if len(times) > 1 else path[0]), 0.0])
        made.append(Written(placed, section, host.kind, times, size, fields, said))
    return made


def described(part: Written) -> str:
    """Return what a table holds, and its section."""
    lines = section_lines(part.section, part.kind, part.file, part.times, tolerance="1e-3", fields=part.fields)
    return "\n".join([f"{part.file or part.section}: {part.size}", "", *lines]) + "\n"


def section_lines(
    section: str, kind: str, file: Path | None, times: Array, *, tolerance: str, fields: Mapping[str, Any] | None = None
) -> list[str]:
    """Return the lines of a run file that name a table, if any, which is known from the first of its times on."""
    lines = [f"[{section}]", f'kind = "{kind}"', *([f'table = "{file}"'] if file else [])]
    lines += [f"{name} = {_inline(value)}" for name, value in (fields or {}).items()]
    lines += [f"tolerance = {tolerance}"] if file else []
    if len(times) > 1:
        known = _rounded_down(-times[0])
        lines.append(f"# known from {-known:g} Gyr: progenitor.lookback may be up to {known:g}")
    return lines


def _rounded_down(number: float) -> float:
    """Return a positive number with four digits that is not larger."""
    last = 10.0 ** (3 - math.floor(math.log10(number)))
    return math.floor(number * last) / last


def check_free(files: Sequence[Path], force: bool) -> None:
    """Raise StreamkitError for a file that is no ECSV table by its suffix, has no directory or may not be replaced."""
    for file in files:
        check_target(file, (".ecsv",), "--output", force)


def _names(hosts: Sequence[Host]) -> list[str]:
    """Return a name for each part: none for the only one."""
    if len(hosts) == 1:
        return [""]
    words = [WORDS[host.kind] for host in hosts]
    counts = [words[: k + 1].count(word) for k, word in enumerate(words)]
    return [word if count == 1 else f"{word}{count}" for word, count in zip(words, counts, strict=True)]


def _table(columns: dict[str, Array], times: int) -> Any:
    from astropy.table import Table  # slow to import

    rows = len(columns["R"])
    check_rows(rows, f"{times} times with {rows // times} rows each", "take fewer times by --every")
    return Table(columns, units={name: unit for name, unit in UNITS.items() if name in columns})


def _is_table(host: Host) -> bool:
    return host.expansion is not None or bool(host.columns)


def file_of_path(file: Path) -> Path:
    """Return the file of the centre of the part in this file."""
    return file.with_name(f"{file.stem}_centre{file.suffix}")


def path_table(centre: Mapping[str, Sequence[float]]) -> Any:
    """Return the columns of a path as a table with units."""
    from astropy.table import Table  # slow to import

    return Table({name: np.array(column) for name, column in centre.items()}, units={n: PATH[n] for n in centre})


def _inline(value: Any) -> str:
    """Return a value as TOML."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{name} = {_inline(inner)}" for name, inner in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_inline, value)) + "]"
    return f'"{value}"' if isinstance(value, str) else str(value)
