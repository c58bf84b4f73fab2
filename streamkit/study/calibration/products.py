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


def calibration_products(calibration: Calibration) -> Products:
    """Return the draws, the coverage of the masses, and the picture of the ranks."""
    tables = {TABLE: draws_table(calibration), COVERAGE: coverage_table(calibration)}
    pictures = {PICTURE: partial(calibration_figure, calibration)}
    text = describe_calibration(calibration)
    header: dict[str, Any] = {
        "draws": len(calibration.draws),
        "converged": sum(draw.converged for draw in calibration.draws),
    }
    if calibration.truth is not None:
        header["truth"] = calibration.truth.document
    return Products(calibration.spec, RUN, text, tables, pictures, header, calibration.stopped)
