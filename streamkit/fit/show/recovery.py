"""The recovery of a known host: mass profile and rotation curve of a fit compared with the true ones.

Gibbons+ 2014, figures 10 and 11.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from astropy import units as u
from astropy.table import QTable
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from streamkit.errors import SpecError
from streamkit.fields import Files
from streamkit.fit.directory.claim import RECOVERY
from streamkit.fit.samples.results import Results
from streamkit.fit.show.figures import bands, data_radii, levels, remark
from streamkit.model import Host
from streamkit.report import VERMILION, NotebookFigure, columns, finish, paragraph
from streamkit.runfile import Spec, read_toml, resolve
from streamkit.stream import Array

RADII = np.arange(10.0, 121.0, 5.0)  # radii in kpc of the table, as in the recovery test of Gibbons+ 2014
DRAWN = np.linspace(RADII[0], RADII[-1], 56)  # radii in kpc of the picture
PRINTED = 10.0  # spacing in kpc of the rows that are printed
QUANTITIES = ("M", "v_c")


def true_host(path: str | Path, fit: Spec) -> Host:
    """Return the host of a run file, whose fields must be numbers. It is validated as the host of the fit would be.

    Only its ``[potential]`` and its ``plugins`` count; it may hold nothing else, or be a whole run file.

    Raises SpecError if the file cannot be read, has no potential, or one that is not valid, or has a prior. Raises
    PluginError if one of its plugins is broken.
    """
    path = Path(path)
    given = read_toml(path)
    if "potential" not in given:
        content = f"found {', '.join(given)}" if given else "it is empty"
        raise SpecError(f"{path}: the section [potential] is missing, which holds the true host; {content}")
    plugins = given.get("plugins", [])
    theirs = fit.with_files_at({name: str(fit.folder / name) for name in fit.files})
    document = {**theirs, "potential": given["potential"], "plugins": plugins}
    if isinstance(plugins, list):  # anything else is an error below; the fit's plugin files have its other components
        names = {Path(str(file)).name for file in plugins}
        others = (fit.folder / file for file in fit.document.get("plugins", []))
        document["plugins"] = [*plugins, *(str(file) for file in others if file.name not in names)]
    parts = resolve(document, str(path), None, Files(path.parent.absolute()))[3]
    sections = parts.potentials
    free = [f"{section.path}.{name}" for section in sections.values() for name in section.priors]
    if free:
        raise SpecError(f"{path}: the true host needs numbers, found a prior at {', '.join(free)}")
    return Host(parts.host({}))


def recovery_table(results: Results, host: Host, radii: Array = RADII) -> QTable:
    """Return the recovered profile beside the true one at radii (nr,) in kpc.

    For M (mass inside r) and v_c (circular velocity in the plane): median and intervals as in the mass profile;
    ``_true``; ``_sigma``, the half of the 68 % interval on the side of the truth; ``_deviation``, recovered minus true
    in sigma (within -1 and 1 the truth is inside the 68 % interval); ``_relative``, recovered over true minus 1;
    ``_error``, half the 68 % interval over the true value.
    """
    table = results.mass_profile(radii)
    r = table["r"].to_value(u.kpc)
    table.meta["truth"] = {
        name: {"kind": part.kind, **part.model_dump(exclude_none=True)} for name, part in host.potentials.items()
    }
    for name, true in (("M", host.mass_inside(r) * u.Msun), ("v_c", host.circular_velocity(r) * u.km / u.s)):
        median, low, high = table[name], table[f"{name}_lo68"], table[f"{name}_hi68"]
        table[f"{name}_true"] = true
        table[f"{name}_sigma"] = np.where(true > median, high - median, median - low)
        with np.errstate(divide="ignore", invalid="ignore"):  # a chain that never moved has no width
            deviation = (median - true) / table[f"{name}_sigma"]
        table[f"{name}_deviation"] = deviation.to_value(u.one)
        table[f"{name}_relative"] = (median / true - 1).to_value(u.one)
        table[f"{name}_error"] = (0.5 * (high - low) / true).to_value(u.one)
    return table


def largest(table: QTable, name: str) -> tuple[float, float]:
    """Return the largest deviation in sigma, of either sign, and its radius in kpc."""
    k = int(np.argmax(np.abs(table[f"{name}_deviation"])))
    return float(table[f"{name}_deviation"][k]), float(table["r"][k].to_value("kpc"))


def describe_recovery(directory: Path) -> str:
    """Return the recovery in a run's directory, which a report has written, as text for a terminal."""
    table = QTable.read(directory / RECOVERY[0])
    r = table["r"].to_value("kpc")
    head = ("r", "true", "M(<r)", "68 %", "M - true", "error", "", "true", "v_c", "68 %", "v_c - true", "error")
    rows: list[Sequence[str]] = [head]
    for k in np.flatnonzero(np.isclose(r % PRINTED, 0)):
        mass, speed = _recovery_cells(table[k], "M", "Msun", 1e11, 2), _recovery_cells(table[k], "v_c", "km/s", 1, 0)
        rows.append((f"{r[k]:g} kpc", *mass, "", *speed))
    said = [
        f"largest deviation of {label}: {deviation:+.2f} sigma at {radius:g} kpc"
        for label, (deviation, radius) in (("M", largest(table, "M")), ("v_c", largest(table, "v_c")))
    ]
    text = (
        "M in 1e11 Msun, v_c in km/s. Sigma is the half of the 68 % interval on the side of the truth; error is half "
        "the interval over the true value."
    )
    title = f"recovered over true, {r[0]:g} to {r[-1]:g} kpc"
    return "\n".join([title, columns(rows), *(f"  {line}" for line in said), paragraph(text, "  ", "  ")])


def _recovery_cells(row: Any, name: str, unit: str, scale: float, digits: int) -> list[str]:
    """Write one quantity at one radius: true, recovered, interval, deviation, relative error."""
    true, median, low, high = (
        f"{row[name + suffix].to_value(unit) / scale:.{digits}f}" for suffix in ("_true", "", "_lo68", "_hi68")
    )
    deviation = f"{row[f'{name}_deviation']:+.1f} sigma"
    return [true, median, f"{low} to {high}", deviation, f"{100 * row[f'{name}_error']:.1f} %"]


def recovery_figure(results: Results, host: Host) -> Figure:
    """Draw M(r) and v_c(r) with their 68 % and 95 % bands over the true ones, the relative difference below."""
    table = recovery_table(results, host, DRAWN)
    figure = NotebookFigure(figsize=(10.4, 5.6), layout="constrained")
    panels: Any = figure.subplots(2, 2, sharex=True, height_ratios=(2.4, 1))
    labels = (r"$M(<r)\ \,[10^{11}\,M_\odot]$", r"$v_{\rm c}(r)\ \,[{\rm km\,s}^{-1}]$")
    for name, label, factor, (above, below) in zip(QUANTITIES, labels, (1e-11, 1.0), panels.T, strict=True):
        r = table["r"].value
        bands(above, r, levels(table, name, factor))
        above.plot(r, table[f"{name}_true"].value * factor, color=VERMILION, lw=1.8, ls=(0, (5, 2)), label="true")
        above.set_ylabel(label, fontsize=13)
        above.set_ylim(bottom=0 if name == "M" else 0.4 * table["v_c_lo95"].value.min())
        data_radii(above, results)
        above.legend(frameon=False, fontsize=10, loc="upper left" if name == "M" else "lower left")
        _difference(below, table, name)
        below.set_xlabel(r"$r\ \,[{\rm kpc}]$", fontsize=13)
        below.set_xlim(r[0], r[-1])
        for axes in (above, below):
            finish(axes)
    panels[1, 0].set_ylabel("difference  [%]", fontsize=12)
    if text := remark(results):
        figure.suptitle(text, color=VERMILION, fontsize=12)
    return figure


def _difference(axes: Axes, table: QTable, name: str) -> None:
    """Draw the relative difference with its bands, in per cent."""
    r, true = table["r"].value, table[f"{name}_true"].value
    bands(axes, r, {level: 100 * (value / true - 1) for level, value in levels(table, name, 1.0).items()})
    axes.axhline(0, color=VERMILION, lw=1.8, ls=(0, (5, 2)))
