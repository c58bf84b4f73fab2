"""The picture of the stars of catalogues, coloured by their probability to be members, with the model's track."""

from __future__ import annotations

import numpy as np
from astropy.table import QTable
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure

from streamkit.errors import OutOfDomain
from streamkit.fit.samples.members import HasMembers
from streamkit.fit.samples.results import Results
from streamkit.fit.show.figures import remark
from streamkit.observe import parts_of
from streamkit.report import VERMILION, NotebookFigure, finish
from streamkit.stream import Array
from streamkit.units import spelled

WIDE, HIGH = 9.0, 2.3  # inches of a row of panels
LIKELY = 0.5
ALONG = "phi1"
PLACES = ("stream", "ra", "dec", ALONG, "p_member", "p_member_sd", "p_cocoon")  # columns without a panel
# By column: its label, longitudes (K,), and the mean and the width of the stream there.
Track = dict[str, tuple[str, Array, Array, Array]]


def members(results: Results) -> Figure:
    """Draw each measured column against phi1: likely members in colour over all other stars, and the best sample."""
    table = results.members()
    panels = [(name, column) for name in dict.fromkeys(table["stream"]) for column in table.colnames
              if column not in PLACES and np.isfinite(table[column][table["stream"] == name]).any()]  # fmt: skip
    figure = NotebookFigure(figsize=(WIDE, HIGH * max(len(panels), 1) + 0.6), layout="constrained")
    rows = figure.subplots(max(len(panels), 1), 1, squeeze=False)[:, 0]
    tracks, drawn = tracks_of(results), None
    for axes, (name, column) in zip(rows, panels, strict=False):
        stars = table[table["stream"] == name]
        drawn = draw_stars(axes, stars, column)
        label, phi1, mean, width = tracks.get(name, {}).get(column, ("", *np.full((3, 1), np.nan)))
        for line, style in ((mean, "-"), (mean - width, "--"), (mean + width, "--")):
            axes.plot(phi1, line, style, color="black", lw=0.8)
        axes.set_ylabel(label or f"{column} [{spelled(stars[column].unit)}]")
        axes.set_xlabel(r"$\phi_1$ [deg]" + (f" of {name}" if len(set(table["stream"])) > 1 else ""))
        finish(axes)
    if drawn is not None:
        figure.colorbar(drawn, ax=list(rows), label="probability to be a member", fraction=0.03, pad=0.01)
    if text := remark(results):
        rows[0].set_title(text, color=VERMILION, fontsize=12)
    return figure


def draw_stars(axes: Axes, stars: QTable, column: str) -> PathCollection:
    """Draw the stars of one catalogue; return what has the colours."""
    stars = stars[np.argsort(stars["p_member"])]
    x, y, p = stars[ALONG].value, stars[column].value, np.asarray(stars["p_member"])
    likely = p > LIKELY
    axes.plot(x[~likely], y[~likely], ".", color="#999999", ms=3.0, mew=0, rasterized=True)
    return axes.scatter(x[likely], y[likely], c=p[likely], s=9, cmap="viridis_r", vmin=LIKELY, vmax=1, rasterized=True)


def tracks_of(results: Results) -> dict[str, Track]:
    """Return the track of the best sample by the stream's name; none where that stream is not made."""
    try:
        best = results.best_observation
    except OutOfDomain:  # another machine's rounding may lose a stream at the edge
        return {}
    found: dict[str, Track] = {}
    for name, inputs in results.spec.bind_all(results.best()).streams.items():
        parts = parts_of(best.predictions[name]) if name in best.predictions else {}
        for called, observable in inputs.observables.items():
            if isinstance(observable, HasMembers) and not parts[called].why_not:
                found[name] = {**observable.over_stars(parts[called]), **found.get(name, {})}
    return found
