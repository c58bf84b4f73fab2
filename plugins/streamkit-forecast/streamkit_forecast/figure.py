"""The picture of a forecast: the bounds of one quantity by data, and what one more datum of each stream would give."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from streamkit.report import BLUE, GREY, VERMILION, NotebookFigure, ticks, with_unit
from streamkit_forecast.one_more import Gain
from streamkit_forecast.quantities import Quantity
from streamkit_forecast.runner import PRIORS, TOGETHER, Forecast

COLOURS = {"phi2": "black", "distance": BLUE, "pm_phi1_cosphi2": "#009E73", "pm_phi2": "#CC79A7",
           "radial_velocity": VERMILION}  # fmt: skip
ACROSS = 3  # panels in a row


def forecast_figure(found: Forecast, target: Quantity) -> Figure:
    """Draw the standard deviation of one quantity by each set of data, and with one more datum along each stream."""
    which = found.quantities.index(target)
    streams = list(dict.fromkeys(gain.source for gain in found.gains))
    bars = len(found.bounds)
    across = max(min(len(streams), ACROSS), 1)
    below = -(-len(streams) // across)
    heights = [0.28 * bars + 0.9, *[2.6] * below]
    figure = NotebookFigure(figsize=(max(3.4 * across, 6.0), sum(heights) + 0.3), layout="constrained")
    grid = figure.add_gridspec(1 + below, across, height_ratios=heights)
    _bars(figure.add_subplot(grid[0, :]), found, which, target)
    now = target.sd(found.covariance())
    first: Any = None
    for i, stream in enumerate(streams):
        axes = figure.add_subplot(grid[1 + i // across, i % across], sharey=first)
        first = first or axes
        gains = [gain for gain in found.gains if gain.source == stream]
        _panel(axes, gains, which, now, len(streams) == 1)
        axes.set_title(stream if len(streams) > 1 else "one more datum", fontsize=10)
        if i % across:
            axes.tick_params(labelleft=False)
        else:
            axes.set_ylabel("sd with it / sd now", fontsize=11)
        axes.set_xlabel(r"$\phi_1$ [deg]", fontsize=11)
        if i == 0:
            handles, names = axes.get_legend_handles_labels()
            figure.legend(handles, names, loc="outside lower center", ncols=3, frameon=False, fontsize=9)
    if first is not None:
        least = min(float(gain.sd[:, which].min()) for gain in found.gains) / now
        first.set_ylim(1 - 1.08 * (1 - least), 1 + 0.05 * (1 - least))
    return figure


def _bars(axes: Axes, found: Forecast, which: int, target: Quantity) -> None:
    """Draw a bar for each set of data, the first one on top, with the error of the bound."""
    scale, unit = (1e11, r"10^{11}\,M_\odot") if target.unit == "Msun" else (1.0, target.unit)
    y = np.arange(len(found.bounds))[::-1]
    sd = np.array([bound.sd[which] for bound in found.bounds]) / scale
    error = np.nan_to_num([bound.error[which] / scale for bound in found.bounds])
    colours = [GREY if b.data == PRIORS else VERMILION if b.data.startswith(TOGETHER) else BLUE for b in found.bounds]
    axes.barh(y, sd, color=colours, height=0.65, xerr=error, error_kw={"lw": 1})
    axes.set_yticks(y, [bound.data for bound in found.bounds], fontsize=9)
    axes.set_xlim(0, 1.15 * (sd + error).max())
    for place, value, end in zip(y, sd, sd + error, strict=True):
        axes.annotate(f"{value:.3g}", (end, place), (5, 0), textcoords="offset points", va="center", fontsize=8)
    unit = f"${unit}$" if unit.startswith("10") else unit
    value = target.value / scale
    axes.set_xlabel(with_unit(f"standard deviation of {target.name} = {value:.3g}", unit), fontsize=11)
    axes.tick_params(axis="y", which="both", length=0)


def _panel(axes: Axes, gains: list[Gain], which: int, now: float, errors: bool) -> None:
    for gain in gains:
        label = gain.column.replace("_", " ") + (f", {gain.error:.2g} {gain.unit}" if errors else "")
        axes.plot(gain.phi1, gain.sd[:, which] / now, color=COLOURS[gain.column], lw=1.5, label=label)
    axes.axhline(1.0, color=GREY, lw=0.8, ls="--")
    ticks(axes)
