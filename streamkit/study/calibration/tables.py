"""The products of a calibration: tables of every draw and of the coverage, and the picture of the ranks."""

from __future__ import annotations

from collections import Counter
from functools import partial
from typing import Any

import numpy as np
from arviz_stats.ecdf_utils import ecdf_pit
from astropy import units as u
from astropy.table import Column, QTable
from matplotlib.figure import Figure

from streamkit.report import BAND_95, BLUE, GREY, VERMILION, columns, finish, label_all, labels, panel_grid, paragraph
from streamkit.study.calibration.compared import quantities
from streamkit.study.calibration.runner import DRAWS, Calibration
from streamkit.study.grid import Products

MISSED = "whether a truth lies outside the intervals that hold all true values in 95 % of draws"
PROBABILITIES = (0.5, 0.68, 0.95)  # probabilities of the intervals in the table of coverage


def draws_table(calibration: Calibration) -> QTable:
    """Return one row per draw: truth and rank of all that is compared, and how far its fit had converged."""
    out, draws = QTable(), calibration.draws
    out["draw"] = [draw.index for draw in draws]
    units = dict(zip(calibration.spec.names, calibration.spec.units, strict=True))
    units |= {name: unit for name, (unit, _) in quantities(calibration.radii).items()}
    for name, true, ranks in zip(calibration.names, calibration.truths.T, calibration.ranks.T, strict=True):
        out[name] = true * u.Unit(units[name])
        out[f"{name}_rank"] = Column(ranks, description="share of the posterior samples below the truth")
    if calibration.method:
        out["samples"] = [int(draw.ess) for draw in draws]
        return out
    out["r_hat"] = [draw.r_hat for draw in draws]
    out["effective_samples"] = [draw.ess for draw in draws]
    out["calls"] = [draw.calls for draw in draws]
    out["converged"] = Column([draw.converged for draw in draws], description="whether the sampler's rule was met")
    return out


def coverage_table(calibration: Calibration) -> QTable:
    """Return one row per interval: how often it holds the true value of all that is compared, with its error."""
    out, n = QTable(), len(calibration.draws)
    out["probability"] = PROBABILITIES
    shares = np.array([calibration.coverage(p) for p in PROBABILITIES])
    for i, name in enumerate(calibration.names):
        out[name] = shares[:, i]
    out["error"] = np.sqrt(np.multiply(PROBABILITIES, 1 - np.array(PROBABILITIES)) / n)
    out["error"].description = "of a share of so many draws, if the intervals are right"
    return out


def checks_table(calibration: Calibration) -> QTable:
    """Return one row per check of a page that was not fine: in how many draws that miss the truth, and in others."""
    rows = Counter(each for draw in calibration.draws for each in draw.said)
    missed = Counter(each for draw, one in zip(calibration.draws, calibration.missed, strict=True) if one
                     for each in draw.said)  # fmt: skip
    out, every = QTable(), sorted(rows)
    out["check"], out["level"] = np.array(every, dtype=str).reshape(-1, 2).T
    out["missed"] = Column([missed[each] for each in every], dtype=int, description=MISSED)
    out["held"] = Column([rows[each] - missed[each] for each in every], dtype=int, description="of the others")
    return out


def describe_calibration(calibration: Calibration) -> str:
    """Show the coverage for a terminal, and how many fits had converged."""
    n, converged = len(calibration.draws), sum(draw.converged for draw in calibration.draws)
    rows = [("interval", *(f"{p:.0%}" for p in PROBABILITIES), "mean rank")]
    errors = [f"{p:.0%} +- {np.sqrt(p * (1 - p) / n):.0%}" for p in PROBABILITIES]
    rows.append(("expected", *errors, f"0.50 +- {np.sqrt(1 / 12 / n):.2f}"))
    shares = np.array([calibration.coverage(p) for p in PROBABILITIES]).T
    for name, share, rank in zip(calibration.names, shares, calibration.ranks.mean(axis=0), strict=True):
        rows.append((name, *(f"{each:.0%}" for each in share), f"{rank:.2f}"))
    shown = f"share of {n} draws whose truth lies in the central interval\n{columns(rows)}{_checks(calibration)}"
    left_out = set(calibration.spec.names) - set(calibration.names)
    told = f" Not compared, as the truth has none of the same kind: {', '.join(sorted(left_out))}." if left_out else ""
    if beyond := calibration.beyond_priors:
        some = ", ".join(f"{name} in {count} of {n} draws" for name, count in beyond.items())
        told += f" The truth is outside the fit's prior, where no interval can hold it: {some}."
    return f"{shown}\n\n{paragraph(_reliability(calibration, converged) + told)}"


def _checks(calibration: Calibration) -> str:
    """Say what the pages of the fits said where the truth was missed, and where it was not; empty for other methods."""
    if calibration.method:
        return ""
    table, many = checks_table(calibration), int(calibration.missed.sum())
    others = len(calibration.draws) - many
    if not len(table):
        return "\n\nevery check of every fit is fine"
    head = ("check of the page", "says", f"in {many} that miss the truth", f"in {others} others")
    rows = [head, *(tuple(map(str, row)) for row in table.iterrows())]
    return f"\n\ndraws by {MISSED}\n{columns(rows)}"


def _reliability(calibration: Calibration, converged: int) -> str:
    """Say how many fits had converged, and how many samples a rank has."""
    n, kind = len(calibration.draws), calibration.spec.sampler.kind
    samples, calls = (np.median([getattr(draw, name) for draw in calibration.draws]) for name in ("ess", "calls"))
    if calibration.method:
        return f"The samples are of another method: {calibration.method}. In the median {samples:.0f} of a draw."
    if converged == n:
        note = f"All {n} fits have converged by the rule of {kind}."
    else:
        note = (
            f"{converged} of {n} fits have converged by the rule of {kind}. The intervals of the others are not "
            "settled: run them for longer."
        )
    return f"{note} In the median {samples:.0f} effective samples of {calls:.0f} streams."


TABLE, COVERAGE, CHECKS, PICTURE = "calibration.ecsv", "coverage.ecsv", "checks.ecsv", "calibration.png"
RUN = "calibration.toml"
PRODUCTS = (DRAWS, TABLE, COVERAGE, CHECKS, PICTURE, RUN)


def calibration_products(calibration: Calibration) -> Products:
    """Return the draws, the coverage of the masses, and the picture of the ranks; one rank has none."""
    tables = {TABLE: draws_table(calibration), COVERAGE: coverage_table(calibration)}
    if not calibration.method:
        tables[CHECKS] = checks_table(calibration)
    pictures = {PICTURE: partial(calibration_figure, calibration)} if len(calibration.draws) > 1 else {}
    text = describe_calibration(calibration)
    header: dict[str, Any] = {"draws": len(calibration.draws)}
    if calibration.method:
        header["method"] = calibration.method
    else:
        header["converged"] = sum(draw.converged for draw in calibration.draws)
    if calibration.truth is not None:
        header["truth"] = calibration.truth.document
    return Products(calibration.spec, RUN, text, tables, pictures, header, calibration.stopped)


SIMULATIONS = 2000  # sets of uniform ranks from which the band is computed


def calibration_figure(calibration: Calibration) -> Figure:
    """Draw the empirical distribution of the ranks less the uniform one, with its simultaneous 95 % band.

    Inside the band the intervals have their stated coverage. A hump on the left with a dip on the right means a
    posterior that is too narrow. The reverse means one that is too wide. A hump alone means a bias (Saeilynoja,
    Buerkner & Vehtari 2022). A mass that is itself a parameter, and has the same ranks, is left out.
    """
    every = [
        *labels(calibration.spec.names, calibration.spec.symbols),
        *(label for _, label in quantities(calibration.radii).values()),
    ]
    names = [every[i] for i in calibration.compared]
    ranks = calibration.ranks
    shown = [i for i in range(len(names)) if not any(np.array_equal(ranks[:, i], ranks[:, j]) for j in range(i))]
    figure, panels = panel_grid(len(shown), 2.3, 1.9, share=True)
    rng = np.random.default_rng(0)
    for axes, i in zip(panels, shown, strict=True):
        column = ranks[:, i]
        band: Any = ecdf_pit  # has no types
        x, ecdf, low, high = (np.asarray(each, dtype=float) for each in band(column, 0.95, SIMULATIONS, rng=rng))
        axes.fill_between(x, low - x, high - x, color=BAND_95, lw=0, step="post")
        axes.axhline(0.0, color=GREY, lw=0.8)
        outside = bool(((ecdf < low) | (ecdf > high)).any())
        axes.step(x, ecdf - x, where="post", color=VERMILION if outside else BLUE, lw=1.3)
        axes.set_title(names[i], fontsize=11)
        axes.set_xlim(0.0, 1.0)
        finish(axes)
    label_all(
        figure, f"rank of the truth among the posterior samples, {len(calibration.draws)} draws", "ECDF - uniform"
    )
    return figure
