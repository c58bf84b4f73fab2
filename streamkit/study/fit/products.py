"""The products of a run: tables and pictures, written again from its chain whenever wanted."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from streamkit.errors import ChainError, OutOfDomain
from streamkit.report import draw_stream, replace_whole
from streamkit.study.fit.directory import RECOVERY
from streamkit.study.fit.figures import corner, mass_profile, radii, remark, rotation_curve, traces
from streamkit.study.fit.recovery import recovery_figure, recovery_table, true_host
from streamkit.study.fit.results import Results

if TYPE_CHECKING:
    from astropy.table import QTable
    from matplotlib.figure import Figure


PROFILE_RADII = np.arange(5.0, 201.0, 5.0)
"""Radii in kpc of the table of masses: 5 to 200, with 50, 100, 150 and 200 among them."""


def write_products(run: Results | str | Path, truth: str | Path | None = None) -> Results:
    """Write every table and picture of a run into its directory, and return its results.

    Parameters
    ----------
    run
        The run, or its directory.
    truth
        A TOML file whose ``[potential]`` is the true host of a mock: the recovery is written too.

    Raises
    ------
    ChainError
        If there is no readable run.
    SpecError
        If the truth is not valid. Nothing has then been written.
    """
    results = run if isinstance(run, Results) else Results(run)
    where = results.directory
    if where is None:
        raise ChainError("these results are in memory only: a report needs a directory")
    if truth is not None:
        host = true_host(truth, results.spec)
        _table(where / RECOVERY[0], recovery_table(results, host))
        _picture(where / RECOVERY[1], recovery_figure(results, host))
    _table(where / "summary.ecsv", results.summary())
    _table(where / "mass_profile.ecsv", results.mass_profile(PROFILE_RADII))
    _table(where / "diagnostics.ecsv", results.diagnostics())
    profile = results.mass_profile(radii(results))
    _picture(where / "corner.png", corner(results))
    _picture(where / "mass_profile.png", mass_profile(results, profile))
    _picture(where / "rotation_curve.png", rotation_curve(results, profile))
    _picture(where / "traces.png", traces(results))
    try:
        stream, prediction = results.best_stream
    except OutOfDomain as error:  # another machine's rounding may lose a stream at the edge
        (where / "best_stream.png").unlink(missing_ok=True)
        _table(where / "diagnostics.ecsv", _without_stream(results, error.reason))
        return results
    setup = results.spec.bind(results.best())
    _picture(
        where / "best_stream.png",
        draw_stream(stream, prediction, setup, note=remark(results) if results.quick else ""),
    )
    return results


def _without_stream(results: Results, reason: str) -> QTable:
    table = results.diagnostics()
    table.meta["best stream"] = f"could not be made again: {reason}"
    return table


def _table(path: Path, table: QTable) -> None:
    replace_whole(path, lambda part: table.write(part, format="ascii.ecsv", overwrite=True))


def _picture(path: Path, figure: Figure) -> None:
    replace_whole(path, lambda part: figure.savefig(part, dpi=200))
