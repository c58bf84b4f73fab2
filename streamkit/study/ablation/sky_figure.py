"""The tracks of variants on the sky with the data, and their differences from the first track."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from streamkit.observe import panels_of
from streamkit.report import NotebookFigure, across, finish, folded
from streamkit.stream import Panel, PanelData
from streamkit.study.ablation.figures import CYCLE
from streamkit.study.ablation.measures import Portrait

LINES = ("-", "--", "-.", ":")
MARKERS = "osD^vP"
WIDE, WIDEST_NAME = 8.2, 90  # width in inches, and largest number of letters in a line of the legend


def has_panels(portrait: Portrait) -> bool:
    """Return whether an observable shows the stream on the sky, with data."""
    return bool(_panels(portrait))


def tracks_on_sky(portraits: Mapping[str, Portrait]) -> Figure:
    """Draw the fitted tracks of all streams with the data, column by column.

    The panel below each has the differences of the predictions from those of the first stream that has some, in units
    of the errors of the data.
    """
    shown = {title: portrait for title, portrait in portraits.items() if has_panels(portrait)}
    reference = next(iter(shown.values()))
    columns = _panels(reference)
    beside = across(["data", *shown], WIDE)
    figure = NotebookFigure(figsize=(WIDE, 1.95 * len(columns) + 1.2 + 0.2 * (len(shown) // beside)))
    figure.set_layout_engine("constrained", h_pad=0.02, hspace=0.0)
    every: Any = figure.subplots(2 * len(columns), 1, height_ratios=(2.0, 1.0) * len(columns), sharex=True)
    for row, (panel, data) in enumerate(columns):
        above, below = every[2 * row], every[2 * row + 1]
        order = np.argsort(data.x, kind="stable")
        above.errorbar(data.x, data.y, data.error, fmt="s", ms=3.5, color="#BBBBBB", mec="black", ecolor="black",
                       elinewidth=0.8, label="data", zorder=1)  # fmt: skip
        below.axhspan(-1, 1, color="#E6E6E6", lw=0)
        for i, (title, portrait) in enumerate(shown.items()):
            look: dict[str, Any] = {"color": CYCLE[i % len(CYCLE)], "lw": 1.4}
            panel_of_stream, _ = _panels(portrait)[row]
            for mark in panel_of_stream.marks:
                above.plot(mark.x, mark.y, ls=LINES[i % len(LINES)], label=title, **look)
            if portrait is not reference and portrait.prediction is not None and reference.prediction is not None:
                away = (portrait.prediction.mean - reference.prediction.mean)[data.rows] / data.error
                marker = {"marker": MARKERS[i % len(MARKERS)], "ms": 3.5}
                below.plot(data.x[order], away[order], **(look | {"lw": 0.8}), **marker)
        margin = 0.25 * max(float(np.ptp(data.y)), 1e-6)
        above.set_ylim((data.y - data.error).min() - margin, (data.y + data.error).max() + margin)
        above.set_ylabel(panel.y_label.replace(" [", "\n["), fontsize=10)
        below.set_ylabel(r"$\delta/\sigma$", fontsize=10)
        reach = max([1.5, *(float(np.nanmax(np.abs(line.get_ydata()), initial=0.0)) for line in below.lines)])
        below.set_ylim(-1.15 * reach, 1.15 * reach)
        for axes in (above, below):
            finish(axes)
            axes.locator_params(axis="y", nbins=4)
    x = np.concatenate([data.x for _, data in columns])
    rim = 0.04 * max(float(np.ptp(x)), 1.0)
    every[-1].set_xlim(x.min() - rim, x.max() + rim)
    every[-1].set_xlabel(columns[0][0].x_label, fontsize=11)
    figure.align_ylabels()
    handles, names = every[0].get_legend_handles_labels()
    names = [folded(name, WIDEST_NAME) for name in names]
    figure.legend(handles, names, loc="outside upper center", ncols=beside, frameon=False, fontsize=9)
    note = f"lower panels: prediction minus that of {next(iter(shown))}, in errors of the data"
    figure.supxlabel(folded(note, 100), fontsize=9)
    return figure


def _panels(portrait: Portrait) -> tuple[tuple[Panel, PanelData], ...]:
    """Return the panels that have data, each with its data; none where the observables have no value."""
    if portrait.prediction is None or portrait.prediction.why_not:
        return ()
    panels = panels_of(portrait.inputs.observables, portrait.stream, portrait.prediction)
    return tuple((panel, panel.data) for panel in panels if panel.data is not None)
