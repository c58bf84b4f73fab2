"""The picture of the stars of catalogues, coloured by their probability to be members."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from streamkit.fit.samples.results import Results
from streamkit.fit.show.figures import remark
from streamkit.report import VERMILION, NotebookFigure

WIDE, HIGH = 9.0, 2.3  # inches of a row of panels
LIKELY = 0.5
ALONG = "phi1"
PLACES = ("stream", "ra", "dec", ALONG, "p_member", "p_member_sd", "p_cocoon")  # columns without a panel


def members(results: Results) -> Figure:
    """Draw each measured column against phi1: likely members in colour over all other stars."""
    table = results.members()
    panels = [(name, column) for name in dict.fromkeys(table["stream"]) for column in table.colnames
              if column not in PLACES and np.isfinite(table[column][table["stream"] == name]).any()]  # fmt: skip
    figure = NotebookFigure(figsize=(WIDE, HIGH * max(len(panels), 1) + 0.6), layout="constrained")
    rows = figure.subplots(max(len(panels), 1), 1, squeeze=False)[:, 0]
    drawn = None
    for axes, (name, column) in zip(rows, panels, strict=False):
        stars = table[table["stream"] == name]
        stars = stars[np.argsort(stars["p_member"])]
        x, y = stars[ALONG].value, stars[column].value
        p = np.asarray(stars["p_member"])
        likely = p > LIKELY
        axes.plot(x[~likely], y[~likely], ".", color="#999999", ms=3.0, mew=0, rasterized=True)
        drawn = axes.scatter(
            x[likely], y[likely], c=p[likely], s=9, cmap="viridis_r", vmin=0.0, vmax=1.0, rasterized=True
        )
        axes.set_ylabel(f"{column} [{stars[column].unit}]")
        axes.set_xlabel(r"$\phi_1$ [deg]" + (f" of {name}" if len(set(table["stream"])) > 1 else ""))
    if drawn is not None:
        figure.colorbar(drawn, ax=list(rows), label="probability to be a member", fraction=0.03, pad=0.01)
    if text := remark(results):
        rows[0].set_title(text, color=VERMILION, fontsize=12)
    return figure
