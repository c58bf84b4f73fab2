"""The samples of a run as files for other programs: netCDF for ArviZ, text for GetDist, and tables."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from astropy import units as u
from astropy.table import QTable

from streamkit.components import FINE
from streamkit.fit.samples.conversion import sample_columns
from streamkit.fit.samples.results import Results
from streamkit.fit.show.text import PRINTED_RADII, radii_in_reach
from streamkit.report import LATEX_UNITS, decimals, latex_escaped, save, save_table, through_memory
from streamkit.runfile import Prior

# Contents of a file, by its suffix.
EXPORTS = {
    ".nc": "netCDF for ArviZ",
    ".csv": "one row per sample",
    ".ecsv": "the same with units",
    ".tex": "a LaTeX table for a paper: parameters and masses, no samples",
    ".txt": "GetDist, with .paramnames and .ranges beside it",
}


def write_samples(results: Results, path: Path) -> list[Path]:
    """Write the samples after burn-in in the format that the suffix of a file names; return the files.

    Raises StreamkitError if the file cannot be written, or a package that is needed is not there.
    """
    if path.suffix == ".txt":
        return write_getdist(results, path)
    if path.suffix in (".csv", ".ecsv"):
        save_table(path, sample_table(results), f"ascii{path.suffix}")
        return [path]
    writers: dict[str, Callable[[Path], object]] = {
        ".nc": through_memory(lambda content: results.to_arviz().to_netcdf(content, engine="h5netcdf")),
        ".tex": lambda part: part.write_text(paper_table(results), encoding="utf-8"),
    }
    save(path, writers[path.suffix])
    return [path]


def sample_table(results: Results) -> Any:
    """Return an astropy QTable of the samples after burn-in: walker, step, the parameters with units, ln posterior."""
    columns: dict[str, Any] = sample_columns(results.spec, results.draws)
    for name, unit in zip(results.names, results.spec.units, strict=True):
        columns[name] = columns[name] * u.Unit(unit) if unit else columns[name]
    return QTable(columns, meta={"note": results.note(), "digest": results.spec.digest()})


def write_getdist(results: Results, path: Path) -> list[Path]:
    """Write the samples as GetDist reads them: ROOT.txt (weight, -ln posterior, parameters), .paramnames, .ranges.

    Labels are the symbols of the run file's fields. Ranges are the ends of bounded priors.
    """
    flat = results.samples
    ln_p = results.log_prob[results.discard :].ravel()
    table = np.column_stack([np.ones(len(flat)), -ln_p, flat])
    labels = [
        name if symbol == name else symbol.strip("$")
        for name, symbol in zip(results.names, results.spec.symbols, strict=True)
    ]
    lines = [f"{name}\t{label}" for name, label in zip(results.names, labels, strict=True)]
    ranges = [f"{name} {_end(p, 0)} {_end(p, 1)}" for name, p in zip(results.names, results.spec.priors, strict=True)]
    files = [path, path.with_suffix(".paramnames"), path.with_suffix(".ranges")]
    save(files[0], lambda part: np.savetxt(part, table, fmt="%.10g"))
    for file, text in zip(files[1:], (lines, ranges), strict=True):
        save(file, lambda part, text=text: part.write_text("\n".join(text) + "\n", encoding="utf-8"))  # type: ignore[misc]
    return files


def _end(prior: Prior, which: int) -> str:
    value = prior.support[which]
    return f"{value:.10g}" if np.isfinite(value) else "N"


LARGE, SMALL = 1e5, 1e-3  # larger and smaller medians are written with a power of ten


def paper_table(results: Results) -> str:
    """Return a LaTeX table: medians with the distances to the ends of the 68 % intervals.

    Radii of masses are within the range of the best stream and the data. The first line warns if the run is not
    reliable.
    """
    rows = []
    for row, symbol in zip(results.summary(), results.spec.symbols, strict=True):
        name = symbol if symbol.startswith("$") else rf"\texttt{{{latex_escaped(row['parameter'])}}}"
        unit = "" if row["unit"] in ("", "1") else row["unit"]
        rows.append((name, measured(row["median"], row["lo68"], row["hi68"]), LATEX_UNITS.get(unit, unit)))
    radii = radii_in_reach(results) or list(PRINTED_RADII)
    for row in results.mass_profile(radii):
        mass = [row[name].to_value("Msun") for name in ("M", "M_lo68", "M_hi68")]
        rows.append((rf"$M(<{row['r'].to_value('kpc'):g}\,{{\rm kpc}})$", measured(*mass), LATEX_UNITS["Msun"]))
    remark = [] if results.verdict == FINE else [f"% {' '.join(results.note().split())}"]
    lines = [*remark, r"\begin{tabular}{lll}", r"\hline", r"parameter & median and 68\,\% & unit \\", r"\hline"]
    lines += [" & ".join(row) + r" \\" for row in rows]
    return "\n".join([*lines, r"\hline", r"\end{tabular}", ""])


def measured(median: float, low: float, high: float) -> str:
    """Return a median and the ends of its interval as LaTeX, to two digits of the smaller error."""
    power = int(np.floor(np.log10(abs(median)))) if median and not SMALL < abs(median) < LARGE else 0
    value, plus, minus = (number / 10.0**power for number in (median, high - median, median - low))
    digits = decimals(min(plus, minus))
    shown = f"{value:.{digits}f}^{{+{plus:.{digits}f}}}_{{-{minus:.{digits}f}}}"
    factor = rf" \times 10^{{{power}}}" if power else ""
    return f"${shown}{factor}$"
