"""The files of a calibration: tables and a picture."""

from __future__ import annotations

from functools import partial
from typing import Any

from streamkit.study.calibration.figure import calibration_figure
from streamkit.study.calibration.runner import DRAWS, Calibration
from streamkit.study.calibration.tables import coverage_table, describe_calibration, draws_table
from streamkit.study.grid import Products

TABLE, COVERAGE, PICTURE, RUN = "calibration.ecsv", "coverage.ecsv", "calibration.png", "calibration.toml"
PRODUCTS = (DRAWS, TABLE, COVERAGE, PICTURE, RUN)


def calibration_products(found: Calibration) -> Products:
    """Return the draws, the coverage of the masses, and the picture of the ranks."""
    tables = {TABLE: draws_table(found), COVERAGE: coverage_table(found)}
    pictures = {PICTURE: partial(calibration_figure, found)}
    text = describe_calibration(found)
    header: dict[str, Any] = {"draws": len(found.draws), "converged": sum(draw.converged for draw in found.draws)}
    if found.truth is not None:
        header["truth"] = found.truth.document
    return Products(found.spec, RUN, text, tables, pictures, header, found.stopped)
