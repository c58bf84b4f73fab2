"""The files of a sensitivity study: tables and a picture."""

from __future__ import annotations

from functools import partial

from streamkit.study.grid import Products
from streamkit.study.sensitivity.curves import CENTRAL
from streamkit.study.sensitivity.figure import sensitivity_figure
from streamkit.study.sensitivity.runner import Sensitivity
from streamkit.study.sensitivity.tables import describe_sensitivity, points_table, slopes_table

TABLE, SLOPES, PICTURE, RUN = "sensitivity.ecsv", "slopes.ecsv", "sensitivity.png", "sensitivity.toml"
PRODUCTS = (TABLE, SLOPES, PICTURE, RUN)


def sensitivity_products(sensitivity: Sensitivity) -> Products:
    """Return the observables at every point and their slopes, the header with the fixed point, and the picture."""
    data = zip(sensitivity.data.values.tolist(), sensitivity.data.errors.tolist(), strict=True)
    header = {
        "seeds": sensitivity.seeds,
        "central": CENTRAL,
        "fixed": sensitivity.point,
        "data": dict(zip(sensitivity.names, map(list, data), strict=True)),
    }
    tables = {TABLE: points_table(sensitivity), SLOPES: slopes_table(sensitivity)}
    pictures = {PICTURE: partial(sensitivity_figure, sensitivity)}
    return Products(
        sensitivity.spec, RUN, describe_sensitivity(sensitivity), tables, pictures, header, sensitivity.stopped
    )
