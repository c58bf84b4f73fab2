"""The files of a sensitivity study: tables and a picture."""

from __future__ import annotations

from pathlib import Path

from streamkit.report import origin, save, save_picture, save_table
from streamkit.study.sensitivity.curves import CENTRAL
from streamkit.study.sensitivity.figure import sensitivity_figure
from streamkit.study.sensitivity.runner import Sensitivity
from streamkit.study.sensitivity.tables import points_table, slopes_table

TABLE, SLOPES, PICTURE, RUN = "sensitivity.ecsv", "slopes.ecsv", "sensitivity.png", "sensitivity.toml"
PRODUCTS = (TABLE, SLOPES, PICTURE, RUN)


def write_products(found: Sensitivity, out: Path) -> None:
    """Write the observables at every point, their slopes, the picture and the resolved run file."""
    data = zip(found.data.values.tolist(), found.data.errors.tolist(), strict=True)
    header = {
        **origin(found.spec),
        "seeds": found.seeds,
        "central": CENTRAL,
        "fixed": found.point,
        "data": dict(zip(found.names, map(list, data), strict=True)),
    }
    for name, table in ((TABLE, points_table(found)), (SLOPES, slopes_table(found))):
        table.meta = header
        save_table(out / name, table)
    text = found.spec.toml()
    save(out / RUN, lambda part: part.write_text(text))
    save_picture(out / PICTURE, sensitivity_figure(found))
