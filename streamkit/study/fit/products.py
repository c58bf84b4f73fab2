"""The products of a run: tables and pictures, written again from its chain whenever wanted."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from streamkit.errors import ChainError, OutOfDomain
from streamkit.report import draw_stream, save_picture, save_table
from streamkit.sample import CHAIN
from streamkit.study.fit.directory import MANIFEST, RECOVERY, RUN_FILE
from streamkit.study.fit.figures import corner, mass_profile, radii, remark, rotation_curve, traces
from streamkit.study.fit.recovery import DRAWN, RADII, recovery_figure, recovery_table, true_host
from streamkit.study.fit.results import Results
from streamkit.study.fit.tables import printable

if TYPE_CHECKING:
    from astropy.table import QTable
    from matplotlib.figure import Figure


PROFILE_RADII = np.arange(5.0, 201.0, 5.0)
"""Radii in kpc of the table of masses: 5 to 200, with 50, 100, 150 and 200 among them."""


def best_stream(results: Results) -> Figure:
    """Draw the stream at the best sample."""
    best = results.best()
    try:
        stream, prediction = results.best_stream
    except OutOfDomain as error:  # another machine's rounding may lose a stream at the edge
        raise ChainError(f"the stream of the best sample could not be made again: {error.reason}") from None
    return draw_stream(stream, prediction, results.spec.bind(best), note=remark(results) if results.quick else "")


TABLES: dict[str, Callable[[Results], QTable]] = {
    "summary.ecsv": Results.summary,
    "mass_profile.ecsv": lambda results: results.mass_profile(PROFILE_RADII),
    "diagnostics.ecsv": Results.diagnostics,
}
FIGURES: dict[str, Callable[[Results], Figure]] = {
    "corner.png": corner,
    "mass_profile.png": mass_profile,
    "rotation_curve.png": rotation_curve,
    "best_stream.png": best_stream,
    "traces.png": traces,
}
PRODUCTS = (RUN_FILE, MANIFEST, CHAIN, *TABLES, *FIGURES)
"""Every file that a run writes into its output directory."""


def write_products(run: Results | str | Path, truth: str | Path | None = None) -> Results:
    """Write every table and picture of a run into its directory, and return its results.

    A picture that fails is left out, with a warning in the log; `Results.failed` and the diagnostics hold the reason.

    Parameters
    ----------
    run
        The run, or its directory.
    truth
        A TOML file whose ``[potential]`` is the true host of a mock: the recovery is written too.

    Raises ChainError if there is no readable run. Raises SpecError if the truth is not valid. Nothing has then been
    written.
    """
    results = run if isinstance(run, Results) else Results(run)
    where = results.directory
    if where is None:
        raise ChainError("these results are in memory only: a report needs a directory")
    tables, figures = dict(TABLES), dict(FIGURES)
    wanted = [PROFILE_RADII, radii(results)]
    if truth is not None:
        host = true_host(truth, results.spec)
        tables[RECOVERY[0]] = lambda results: recovery_table(results, host)
        figures[RECOVERY[1]] = lambda results: recovery_figure(results, host)
        wanted += [RADII, DRAWN]
    results.profiles(np.concatenate(wanted))  # in one go
    results.failed = {}
    for name, draw in figures.items():
        try:
            save_picture(where / name, draw(results))
        except Exception as error:
            (where / name).unlink(missing_ok=True)  # an older one would belong to other samples
            results.failed[name] = f"{type(error).__name__}: {error}"
    for name, make in tables.items():
        table = make(results)
        if results.failed:
            table.meta["pictures that failed"] = dict(results.failed)
        save_table(where / name, printable(table, None))
    if results.failed:
        reasons = "; ".join(f"{name} ({reason})" for name, reason in results.failed.items())
        logging.getLogger("streamkit").warning("Some pictures could not be drawn, all else was: %s", reasons)
    return results
