"""A table of a run for a paper: parameters and masses with their errors, in LaTeX."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from streamkit.report import LATEX_UNITS, decimals, latex_escaped
from streamkit.study.fit.text import PRINTED_RADII, radii_in_reach

if TYPE_CHECKING:
    from streamkit.study.fit.results import Results

LARGE, SMALL = 1e5, 1e-3  # medians beyond these are written with a power of ten


def paper_table(results: Results) -> str:
    """Return a LaTeX table: medians with the distances to the ends of the 68 % intervals.

    Radii of masses are those that the best stream and the data reach. A run that may not be quoted says so on top.
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
    remark = [] if results.converged else [f"% {results.note()}"]
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

