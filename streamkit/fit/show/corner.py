"""The corner plot: the marginal distributions of all pairs of parameters."""

from __future__ import annotations

import logging

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import ScalarFormatter

from streamkit.fit.samples.results import Results
from streamkit.fit.show.figures import parameters_of, remark
from streamkit.report import (
    BLUE,
    BOTH,
    COLUMN,
    SMALLEST,
    VERMILION,
    NotebookFigure,
    decimals,
    inner_ticks,
    with_unit,
)
from streamkit.stream import Array

FEW = 200  # samples below which a corner plot shows points without contours
FEW_PARAMETERS = 4  # largest number of parameters in a corner plot of one column of a journal
TITLED = 0.95  # smallest width in inches of a panel with a title
GAP = 0.11  # inches between the panels of a corner plot


def corner(results: Results, column: bool = False) -> Figure:
    """Draw the marginal distributions of all pairs of parameters, with 68 % and 95 % contours.

    Of many streams only the parameters that they share are drawn, by `parameters_of`. For a journal it is as wide as
    one ``column`` up to `FEW_PARAMETERS`, else as two; small panels have no titles.
    """
    from corner import corner as draw  # it loads pyplot, which is slow and only needed here

    shown, scale, names, units = parameters_of(results)
    samples, d = results.samples[:, shown] / scale, len(names)
    text = remark(results)
    panel = 2.6 if d == 1 else 2.0 if d < 7 else 1.7
    titles = [_title(name, column) for name, column in zip(names, samples.T, strict=True)]
    lines = 1 + max(map(_lines, names))
    part = 1.0  # of all texts and margins
    if column:
        part = 0.6
        sides = part * ((0.4 if d == 1 else 1.0 + 0.3 * lines) + 0.7)
        panel = ((COLUMN if d <= FEW_PARAMETERS else BOTH) - sides - GAP * (d - 1)) / d
        titles = titles if panel > TITLED else [""] * d
    letters = 14 * part if panel > TITLED else max(14 * part * panel / TITLED, SMALLEST)
    left, right = part * (0.4 if d == 1 else 1.0 + 0.3 * lines), part * 0.7
    bottom, top = part * (0.45 + 0.26 * lines), part * (0.25 + 0.22 * _lines(titles[0]) + (0.4 if text else 0))
    width, height = (panel * d + GAP * (d - 1) + sides for sides in (left + right, bottom + top))
    figure = NotebookFigure(figsize=(width, height))
    many = len(samples) >= FEW
    logging.getLogger("root").addFilter(_no_contour_warning)
    try:
        draw(
            samples,
            fig=figure,
            range=[_range(column) for column in samples.T],
            bins=30 if many else 12,
            color=BLUE,
            smooth=1.0 if many else None,
            levels=(0.68, 0.95),
            plot_contours=many,
            plot_density=many,
            plot_datapoints=not many,
            fill_contours=many,
            hist_kwargs={"linewidth": 1.4},
            data_kwargs={"alpha": 0.5, "ms": 2},
        )
    finally:
        logging.getLogger("root").removeFilter(_no_contour_warning)
    grid = np.array(figure.axes).reshape(d, d)
    for i, (name, unit, title) in enumerate(zip(names, units, titles, strict=True)):
        grid[i, i].set_title(title, fontsize=max(12 * part, SMALLEST), loc="left")
        low, middle, high = np.percentile(samples[:, i], [16, 50, 84])
        for value, style in ((low, ":"), (middle, "--"), (high, ":")):
            grid[i, i].axvline(value, color="black", lw=0.9, ls=style)
        values = inner_ticks(*_range(samples[:, i]), panel / part * (0.8 if column else 1.0))
        for axes in grid[i:, i]:
            axes.set_xticks(values)
        for axes in grid[i, :i]:
            axes.set_yticks(values)
        grid[-1, i].set_xlabel(with_unit(name, unit, "\n"), fontsize=letters)
        grid[-1, i].xaxis.set_label_coords(0.5, -0.33 * part / panel)
        if i:
            grid[i, 0].set_ylabel(with_unit(name, unit, "\n"), fontsize=letters)
            grid[i, 0].yaxis.set_label_coords(-0.85 * part / panel, 0.5)
    for axes in figure.axes:
        axes.tick_params(labelsize=max(11 * part, SMALLEST), labelrotation=0, direction="in", top=True, right=True)
        for axis in (axes.xaxis, axes.yaxis):
            if isinstance(formatter := axis.get_major_formatter(), ScalarFormatter):
                formatter.set_useOffset(False)
    figure.subplots_adjust(
        left=left / width, right=1 - right / width, bottom=bottom / height, top=1 - top / height,
        wspace=GAP / panel, hspace=GAP / panel,
    )  # fmt: skip
    if text:
        figure.text(
            1 - 0.2 / width,
            1 - 0.15 / height,
            text,
            color=VERMILION,
            fontsize=part * (14 if d < 4 else 20),
            ha="right",
            va="top",
        )
    return figure


def _no_contour_warning(record: logging.LogRecord) -> bool:
    """Silence corner's warning about sparse contours: the picture shows as much."""
    return "Too few points to create valid contours" not in record.getMessage()


def _lines(text: str) -> int:
    return text.count("\n") + 1


def _title(name: str, values: Array) -> str:
    """Return the median and 68 % interval of a parameter as a title, below its name if that is long."""
    between = " = " if name.startswith("$") and "\n" not in name else "\n"
    low, middle, high = np.percentile(values, [16, 50, 84])
    digits = decimals(min(high - middle, middle - low))
    return rf"{name}{between}${middle:.{digits}f}^{{+{high - middle:.{digits}f}}}_{{-{middle - low:.{digits}f}}}$"


def _range(values: Array) -> tuple[float, float]:
    low, high = np.percentile(values, [0.2, 99.8])
    margin = 0.08 * (high - low) or 1e-3 * max(abs(low), 1.0)
    return float(low - margin), float(high + margin)
