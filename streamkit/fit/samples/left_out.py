"""The host without the data of each stream in turn, as a table."""

from __future__ import annotations

import numpy as np
from astropy import units as u
from astropy.table import Column, QTable

from streamkit.errors import ComponentError
from streamkit.fit.judge.chain import at_least_one
from streamkit.fit.judge.goodness import Sampled
from streamkit.fit.judge.left_out import FEWEST, LeftOut, leave_out, normal_scores
from streamkit.fit.samples.tables import printable
from streamkit.model import Host
from streamkit.observe import compare_with_data
from streamkit.stream import Array

MOST = 2000  # samples whose likelihoods are compared
RADII = (20.0, 50.0)  # kpc, of the masses
NONE = "none"  # the row of the fit to all data


def left_out_table(sampled: Sampled | None) -> QTable:
    """Return a row for the fit to all data and one without each stream; none where streams share no parameters.

    `streamkit.Results.left_out` describes the columns.
    """
    points, found = (np.empty((0, 0)), []) if sampled is None else _left_out(sampled)
    rows = [None, *found] if found else []
    table = QTable({"without": Column([NONE if each is None else each.stream for each in rows], dtype=str)})
    if sampled is None or not found:
        return table
    masses = np.array([Host(sampled.spec.host(theta)).mass_inside(np.array(RADII)) for theta in points])
    equal = np.full(len(points), 1 / len(points))
    weights = [equal if each is None else each.weights for each in rows]
    used = [each if each is None or not each.problem else None for each in rows]
    known = [each is None or (not each.problem and each.independent >= FEWEST) for each in rows]
    for radius, mass in zip(RADII, masses.T, strict=True):
        for name, level in (("", 50.0), ("_lo68", 16.0), ("_hi68", 84.0)):
            values = [_percentile(mass, w, level) if k else np.nan for w, k in zip(weights, known, strict=True)]
            table[f"M{radius:g}{name}"] = values * u.Msun
    for k, column in enumerate(sampled.spec.factors[0].shared.tolist()):
        table[sampled.spec.names[column]] = [np.nan if each is None else float(each.mean[k]) for each in used]
    chances = [np.nan if each is None else each.p_value for each in used]
    table["p"] = Column(chances, dtype=float, description="of a shift as large, if the stream agrees with the others")
    table["chance"] = Column([at_least_one(p, len(found)) if p >= 0 else np.nan for p in chances], dtype=float,
                             description="p, the number of streams allowed for")  # fmt: skip
    densities = [np.nan if each is None else each.ln_density for each in used]
    text = "ln of the density of the stream's data, given those of all others"
    table["ln_density"] = Column(densities, dtype=float, description=text)
    table["problem"] = Column(["" if each is None else each.problem for each in rows], dtype=str)
    return printable(table)


def _left_out(sampled: Sampled) -> tuple[Array, list[LeftOut]]:
    """(n, d) Some samples of a run, and the shared parameters without the data of each factor."""
    spec = sampled.spec
    if len(spec.streams) < 2 or not len(spec.factors[0].shared):
        return np.empty((0, 0)), []
    rows, terms = [], []
    for i, measured in sampled.each(MOST):
        sums = dict.fromkeys((each.name for each in spec.factors), 0.0)
        try:
            for one in measured:
                sums[one.stream] += compare_with_data(one.measurement, one.prediction, one.data)
        except ComponentError:  # emulated predictions may have no likelihood
            continue
        rows.append(i)
        terms.append(sums)
    size = len(spec.factors[0].shared)
    if len(rows) < 10 * (1 + size + size * (size + 1) // 2):  # too few for a quadratic
        return np.empty((0, 0)), []
    points = sampled.samples[rows]
    ln_l = {name: np.array([sums[name] for sums in terms]) for name in terms[0]}
    return points, leave_out(normal_scores(points, spec.priors), ln_l, spec.factors)


def _percentile(values: Array, weights: Array, level: float) -> float:
    """Return a percentile of values (n,) with weights (n,) whose sum is 1."""
    order = np.argsort(values)
    below = np.cumsum(weights[order]) - 0.5 * weights[order]
    return float(np.interp(level / 100, below, values[order]))
