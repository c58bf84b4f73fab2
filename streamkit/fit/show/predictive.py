"""The picture of the posterior predictive: data beside predictions of the samples, in units of the data's scatter."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from streamkit.errors import ChainError
from streamkit.fit.judge.predictive import Predictive
from streamkit.fit.samples.results import Results
from streamkit.fit.show.figures import remark
from streamkit.report import (
    BAND_68,
    BAND_95,
    BLUE,
    COLUMN,
    SMALLER,
    SMALLEST,
    VERMILION,
    NotebookFigure,
    finish,
    number,
    shrink_text,
    text_inches,
)
from streamkit.stream import IntArray

# Inches: the height of a row, and the widths of the axes, of the names on their left and the numbers on their right.
ROW, WIDE, NAMES, NUMBERS = 0.2, 2.9, 1.75, 1.35  # the width of the names is the smallest one
LONGEST = 40  # most rows in a column
MOST, FARTHEST = 200, 80  # with more data than the first number, the picture shows as many as the second
SMALL_ROW = 0.15  # inches of a row in one column of a journal


def predictions(results: Results, column: bool = False) -> Figure:
    """Draw every datum minus the model and, for a Gaussian likelihood, minus new data: in units of its scatter.

    For one ``column`` of a journal the data themselves are left out. With many more data than `LONGEST` there are two
    columns. Of more than `MOST` data those that are farthest from the predictions are drawn. ChainError if the run
    stored no predictions.
    """
    if (seen := results.predictive) is None:
        raise ChainError("the run kept no predictions")
    note = remark(results)
    if (m := len(seen.names)) > MOST:
        seen, note = seen.farthest(FARTHEST), f"the {FARTHEST} of {m} data that are farthest away. {note}".rstrip()
    return draw_predictive(seen, note, column)


def draw_predictive(seen: Predictive, note: str = "", narrow: bool = False) -> Figure:
    """Draw any predictions in this way, with a caveat above."""
    m = len(seen.names)
    columns = -(-m // LONGEST)
    rows = -(-m // columns)
    shown = [name.replace("_", " ") for name in seen.names]
    left = text_inches(shown, SMALLEST) + 0.15 if narrow else max(NAMES, text_inches(shown, 8) + 0.25)
    wide, row = (COLUMN - left - 0.1, SMALL_ROW) if narrow else (WIDE, ROW)
    across = COLUMN if narrow else left + WIDE + NUMBERS
    top, foot = (1.05 if narrow else 0.95) if columns == 1 else 0.75, 0.55
    width, height = columns * across, top + rows * row + foot
    figure = NotebookFigure(figsize=(width, height))
    reach = 0.0
    every: list[Axes] = []
    for k in range(columns):
        chosen = np.arange(k * rows, min((k + 1) * rows, m))
        high = len(chosen) * row
        box = ((k * across + left) / width, 1 - (top + high) / height, wide / width, high / height)
        axes = figure.add_axes(box)
        reach = max(reach, _column(axes, seen, chosen, not narrow))
        every.append(axes)
    for axes in every:
        axes.set_xlim(-reach, reach)
        axes.set_xlabel(rf"(datum $-$ prediction) / {_unit(seen)}", fontsize=11)
    names = dict(zip(*reversed(every[0].get_legend_handles_labels()), strict=True))
    figure.legend(
        names.values(), names.keys(), loc="upper center", ncols=(2 if narrow else 3) * columns, frameon=False,
        fontsize=9, bbox_to_anchor=(0.5, 1 - (0.3 if note else 0.1) / height),
    )  # fmt: skip
    if note:
        figure.suptitle(note, color=VERMILION, fontsize=12, y=1 - 0.06 / height, va="top")
    if narrow:
        shrink_text(figure, SMALLER)
    return figure


def _unit(seen: Predictive) -> str:
    """Return the word for the unit of the deviations."""
    return "scatter" if np.any(seen.sigma > 1.001 * seen.errors) else "error"


def _column(axes: Axes, seen: Predictive, chosen: IntArray, numbers: bool) -> float:
    """Draw some of the data below each other, with their numbers beside; return the necessary end of the axis."""
    datum, error, sigma = seen.data[chosen], seen.errors[chosen], seen.sigma[chosen]
    model = (datum - seen.mean[:, chosen]) / sigma
    y = np.arange(len(chosen))
    axes.axvspan(-1, 1, color="#F6D5BF", lw=0, label=f"{_unit(seen)} of the datum")
    ends = [2.0]
    if seen.gaussian:
        noise = np.random.default_rng(0).standard_normal(model.shape) * np.sqrt(seen.total[:, chosen]) / sigma
        for name, levels, colour in (("95 %", (2.5, 97.5), BAND_95), ("68 %", (16, 84), BAND_68)):
            low, high = np.percentile(model + noise, levels, axis=0)
            axes.barh(y, high - low, left=low, height=0.72, color=colour, lw=0, label=f"new data, {name}", zorder=2)
            ends += [float(np.abs(low).max()), float(np.abs(high).max())]
    for name, levels, wide in (("95 %", (2.5, 97.5), 1.0), ("68 %", (16, 84), 2.6)):
        low, high = np.percentile(model, levels, axis=0)
        axes.hlines(y, low, high, color=BLUE, lw=wide, label=f"model, {name}", zorder=3)
        ends += [float(np.abs(low).max()), float(np.abs(high).max())]
    axes.plot(
        np.median(model, axis=0), y, ls="none", marker="o", ms=3.5, mfc="white", mec=BLUE, label="median", zorder=4
    )
    axes.axvline(0, color=VERMILION, lw=1.2, zorder=1)
    finish(axes)
    axes.yaxis.minorticks_off()
    axes.tick_params(axis="y", length=0, right=False)
    axes.set_yticks(y, [seen.names[k].replace("_", " ") for k in chosen], fontsize=8)
    axes.set_ylim(len(chosen) - 0.4, -0.6)
    axes.xaxis.set_major_locator(MaxNLocator(7, integer=True))
    for i, (value, plus) in enumerate(zip(datum.tolist(), error.tolist(), strict=True) if numbers else ()):
        axes.annotate(
            f"{number(value + 0.0)} ± {plus:.2g}".replace("-", "−"), (1, i), (6, 0),
            xycoords=axes.get_yaxis_transform(), textcoords="offset points", fontsize=8, va="center",
        )  # fmt: skip
    return 1.08 * max(ends)
