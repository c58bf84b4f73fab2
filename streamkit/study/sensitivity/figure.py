"""The picture of a sensitivity: a row for each observable, a column for each parameter (Gibbons+ 2014, figure 8)."""

from __future__ import annotations

import textwrap
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FormatStrFormatter, LogLocator, MaxNLocator, NullFormatter

from streamkit.report import BLUE, GREY, VERMILION, NotebookFigure, finish, labels, scaled, with_unit
from streamkit.runfile import LogUniform
from streamkit.stream import Data
from streamkit.study.grid import MANY, by_column, rms
from streamkit.study.sensitivity.curves import Curve
from streamkit.study.sensitivity.runner import Sensitivity

ACROSS = 6  # largest number of columns in a row; further parameters are drawn below
COLOURS = (BLUE, VERMILION, "black", "#009E73", "#CC79A7")
# Largest range of an axis, in units of the middle 80 % of all values: outliers must not shrink the other values.
REACH = 4.0


def sensitivity_figure(response: Sensitivity) -> Figure:
    """Draw every observable against every parameter; the datum and its error as a band.

    The dashed line is where a parameter is fixed while others are varied, the thin one the slope there. Crosses at the
    lower edge are points without a value. Of more than `MANY` data, the rms difference of every column from its data.
    """
    many = len(response.names) > MANY
    response = by_columns(response) if many else response
    curves, m = response.curves, len(response.names)
    across = min(len(curves), ACROSS)
    blocks = -(-len(curves) // across)
    figure = NotebookFigure(figsize=(2.35 * across + 0.8, (1.75 * m + 0.55) * blocks + 0.6), layout="constrained")
    panels: Any = figure.subplots(m * blocks, across, squeeze=False)
    limits = [_limits(response, i) for i in range(m)]
    names = response.spec.names
    symbols = dict(zip(names, labels(names, response.spec.symbols), strict=True))
    for k, curve in enumerate(curves):
        block, column = divmod(k, across)
        scale, unit = scaled(curve.unit, float(np.median(np.abs(curve.x))))
        symbol = symbols[curve.name]
        for i in range(m):
            axes = panels[m * block + i, column]
            _panel(axes, response, curve, i, scale)
            if not many:  # an rms has a kink where it is least
                _tangent(axes, curve, i, scale)
            axes.set_ylim(*limits[i])
            if column:
                axes.tick_params(labelleft=False)
            else:
                axes.set_ylabel(with_unit(response.names[i].replace("_", " "), response.units[i]), fontsize=11)
            if i < m - 1:
                axes.tick_params(which="both", labelbottom=False)
        between, size = (" ", 12) if symbol.startswith("$") else ("\n", 9)  # a name without a symbol needs room
        panels[m * block + m - 1, column].set_xlabel(with_unit(symbol, unit, between), fontsize=size)
        if curve.missing:
            panels[m * block, column].set_title(
                f"{curve.missing} of {len(curve.x)} without a value", fontsize=8, color=GREY
            )
    for axes in panels[m * (blocks - 1) :, len(curves) - across * (blocks - 1) :].flat:
        axes.set_visible(False)
    if response.reasons:
        lines = ["× no value, streams:"] + [f"{n}  {reason}" for reason, n in response.reasons.most_common(6)]
        wide = int(13 * figure.get_figwidth())
        text = "\n".join(textwrap.fill(line, wide, subsequent_indent="    ") for line in lines)
        figure.supxlabel(text, fontsize=8, color=GREY, x=0.02, ha="left")
    return figure


def by_columns(response: Sensitivity) -> Sensitivity:
    """Return the same with the rms of (model - datum) / error of every column in place of the observables.

    The noise of these is unknown, and their data are zero.
    """
    groups, data = by_column(response.names), response.data
    m = len(groups)

    def shown(curve: Curve) -> Curve:
        away = (curve.mean - data.values) / data.errors
        mean = np.stack([rms(away[:, which]) for which in groups.values()], axis=1)
        nothing = np.full_like(mean, np.nan)
        return replace(curve, mean=mean, scatter=nothing, noise=nothing)

    curves = tuple(map(shown, response.curves))
    nowhere = Data(np.full(m, np.nan), np.full(m, np.nan))
    wrapped = (textwrap.fill(name.replace("_", " "), 16) for name in groups)
    labels = tuple(f"{name}\n" r"rms $\Delta/\sigma$" for name in wrapped)
    return replace(response, names=labels, units=("",) * m, data=nowhere, curves=curves)


def _panel(axes: Axes, response: Sensitivity, curve: Curve, i: int, scale: float) -> None:
    """Draw one observable against one parameter."""
    datum, error = response.data.values[i], response.data.errors[i]
    colour = COLOURS[i % len(COLOURS)]
    if np.isfinite(datum):
        axes.axhspan(datum - error, datum + error, color="black", alpha=0.13, lw=0)
    x, mean = curve.x / scale, curve.mean[:, i]
    axes.axvline(curve.fixed / scale, color=GREY, lw=0.9, ls="--")
    spread = np.nan_to_num(curve.scatter[:, i])
    if spread.any():
        axes.fill_between(x, mean - spread, mean + spread, color=colour, alpha=0.3, lw=0)
    axes.plot(x, mean, color=colour, lw=1.5, marker="o", ms=2.8)
    missing = x[curve.streams == 0]
    low = np.full(len(missing), 0.05)
    axes.plot(missing, low, transform=axes.get_xaxis_transform(), ls="none", marker="x", ms=4, color=GREY)
    if isinstance(curve.prior, LogUniform):
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 3.0, 5.0)))
        axes.xaxis.set_major_formatter(FormatStrFormatter("%g"))
        axes.xaxis.set_minor_formatter(NullFormatter())
    else:
        margin = 0.04 * (x[-1] - x[0])
        axes.set_xlim(x[0] - margin, x[-1] + margin)
        axes.xaxis.set_major_locator(MaxNLocator(3))
    finish(axes)


def _tangent(axes: Axes, curve: Curve, i: int, scale: float) -> None:
    """Draw the slope at the fixed point, a third of a standard deviation of the prior to either side."""
    slope = curve.slope
    z = np.linspace(-1 / 3, 1 / 3, 21)
    x = curve.fixed * np.exp(z * slope.sd) if isinstance(curve.prior, LogUniform) else curve.fixed + z * slope.sd
    axes.plot(x / scale, slope.at[i] + z * slope.per_sd[i], color="black", lw=0.7)


def _limits(response: Sensitivity, i: int) -> tuple[float, float]:
    """Return the range of an observable's axes: of all values except outliers, and of the datum."""
    every = np.concatenate([curve.mean[:, i] for curve in response.curves])
    every = every[np.isfinite(every)]
    if not every.size:
        every = np.array([0.0, 1.0])
    low, middle, high = np.percentile(every, [10, 50, 90])
    reach = REACH * max(high - low, 1e-3 * abs(middle))
    inside = every[(every > low - reach) & (every < high + reach)]
    datum, error = response.data.values[i], response.data.errors[i]
    if np.isfinite(datum):
        inside = np.append(inside, [datum - 2 * error, datum + 2 * error])
    margin = 0.06 * float(np.ptp(inside)) or 1.0
    return float(inside.min() - margin), float(inside.max() + margin)
