"""The tables of a fit, made of plain arrays. Their columns print with four digits; files hold all of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from astropy import units as u
from astropy.table import Column, QTable

from streamkit.fit.judge.goodness import Fitted, Goodness
from streamkit.fit.judge.predictive import Predictive
from streamkit.runfile import DATA
from streamkit.stream import Array

# Percentiles in tables and pictures: the median with its central 68 % and 95 % intervals.
LEVELS = {"": 50.0, "lo68": 16.0, "hi68": 84.0, "lo95": 2.5, "hi95": 97.5}
DIGITS = ".4g"
SIGMA = "standard deviations of the likelihood: the error, an extra dispersion, the debris about a single star"


def intervals(values: Array) -> dict[str, Array]:
    """Return median and ends of intervals of values (n, ...) over the first axis, by the names of `LEVELS`."""
    return dict(zip(LEVELS, np.percentile(values, list(LEVELS.values()), axis=0), strict=True))


def printable(table: QTable, digits: str | None = DIGITS) -> QTable:
    """Give the columns of floats a short format; or, with None, that of files."""
    for column in table.itercols():
        if column.dtype.kind == "f":
            column.info.format = digits
    return table


def goodness_table(fit: Goodness | None) -> QTable:
    """Return one row per quantity and one for all data: chi^2, number of data, p-values and the worst datum."""
    fits = [] if fit is None else [*fit.quantities, *([fit.whole] if len(fit.quantities) > 1 else [])]
    table = _fitted("quantity", fits)
    if fit is not None and fit.unjudged:
        table.meta["not judged"] = "a likelihood of its own without residuals: " + ", ".join(fit.unjudged)
    return printable(table)


def stream_table(fit: Goodness | None, facts: Mapping[str, str]) -> QTable:
    """Return one row per stream of several: the columns of `goodness_table`, and what the sampler says of the stream.

    The facts of a sampler about a stream are called ``stream NAME``. A row of the host's data has the name `DATA`.
    """
    fits = [] if fit is None else fit.streams
    table = _fitted("stream", fits)
    said = [facts.get(f"stream {each.name}", facts.get("data of the host", "") if each.name == DATA else "")
            for each in fits]  # fmt: skip
    table["sampler"] = Column(said, dtype=str, description="calls and test of the stream's emulator")
    return printable(table)


def _fitted(called: str, fits: Sequence[Fitted]) -> QTable:
    table = QTable({called: Column([each.name for each in fits], dtype=str)})
    table["data"] = Column([len(each.data) for each in fits], dtype=int)
    table["chi2"] = Column([each.best for each in fits], dtype=float, description="at the best sample")
    table["p"] = Column([each.p_value for each in fits], dtype=float, description="posterior predictive, of chi2")
    table["worst"] = Column([each.data[each.worst] for each in fits], dtype=str, description="the farthest datum")
    worst = [each.residuals[each.worst] for each in fits]
    described = "data minus model, in standard deviations of the likelihood, at the best sample"
    table["residual"] = Column(worst, dtype=float, description=described)
    table["chance"] = Column(
        [each.worst_chance for each in fits], dtype=float, description="chance of a worst datum at least so far away"
    )
    return table


def predictions_table(seen: Predictive | None) -> QTable:
    """Return one row per datum: its error, and median and intervals of what the samples predict; none without any.

    Data have different units, so the numbers stand in plain columns: those of the run file's data.
    """
    if seen is None:
        return QTable({"datum": Column([], dtype=str)})
    levels = intervals(seen.mean)
    table = QTable({"datum": list(seen.names), "value": seen.data, "error": seen.errors, "median": levels.pop("")})
    for name, column in levels.items():
        table[name] = column
    table["deviation"] = Column(seen.deviations, description=f"datum minus median prediction, in {SIGMA}")
    table["noise"] = Column(seen.noise, description=f"the model's own noise over {SIGMA}")
    return printable(table)


def radii_in_kpc(radii: Any) -> Array:
    """Return radii (kpc, or a Quantity) as numbers (nr,); ValueError if there are none, or one is not positive."""
    r = np.atleast_1d(u.Quantity(radii, u.kpc).value).astype(float)
    if r.ndim != 1 or not r.size:
        raise ValueError(f"radii: found an array of shape {r.shape}, expected one radius or more, in kpc")
    if (wrong := r[~(np.isfinite(r) & (r > 0))]).size:
        raise ValueError(f"radii: found {wrong[0]:g} kpc, expected positive numbers")
    return r
