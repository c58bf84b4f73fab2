"""The picture of a stream on the sky: a column of panels with data, track and residuals over one axis of longitude."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from streamkit.observe import marks_of
from streamkit.report.stream_axes import (
    DATUM,
    LEGEND,
    draw_mark,
    draw_mass,
    draw_particles,
    draw_plane,
    draw_unwrapped,
    loses_mass,
)
from streamkit.report.style import (
    BAND_68,
    BAND_95,
    COLUMN,
    VERMILION,
    NotebookFigure,
    angle_ticks,
    finish,
    shrink_text,
)
from streamkit.runfile import StreamInputs
from streamkit.stream import Array, Panel, PanelData, Prediction, Stream

# Widths in inches: panels, numbers on their left, gap, pictures on their right, and the edge.
WIDE, LEFT, GAP, SIDE, RIGHT = 5.8, 0.95, 0.85, 3.0, 0.15
# The same for one column of a journal, which has only the panels, with the names below; and the factor of all sizes.
COLUMN_LEFT, COLUMN_RIGHT, COLUMN_NAMES, SMALLER = 0.72, 0.08, 0.4, 0.75
TALL, BELOW, BETWEEN = 1.2, 0.55, 0.1  # heights in inches: a panel, its residuals, and the gap to the next pair
FOOT, NAMES = 0.5, 2.4  # inches for the name of a horizontal axis, and for the legend
NAME = 0.5  # inches from a panel to the name of its vertical axis
MASS, AXIS = 1.7, 0.6  # inches: height of the picture of the bound mass, and width of its second axis
THIN = 1.3  # width of a line: the debris of a cold stream stays visible beside it
BANDS = (BAND_95, BAND_68)


def draw_sky(
    particles: Stream,
    prediction: Prediction,
    inputs: StreamInputs,
    panels: Sequence[Panel],
    note: str = "",
    intervals: Mapping[str, Array] | None = None,
) -> Figure:
    """Draw what observables show of a stream on the sky, each panel above its residuals, and its orbital plane beside.

    The intervals (2, m), by what a legend calls them and the widest first, are those of the predicted numbers.
    """
    unwrapped = bool(marks_of(inputs.observables, prediction))
    head = 0.45 if note else 0.12
    loses = loses_mass(particles)
    beside = SIDE + FOOT + (SIDE + FOOT if unwrapped else 0.0) + (MASS + FOOT if loses else 0.0) + NAMES
    pairs, feet = len(panels), FOOT * len(_groups(panels))
    tall = max(TALL, (beside - feet) / pairs - BELOW - BETWEEN)
    height = head + pairs * (tall + BELOW + BETWEEN) + feet
    width = LEFT + WIDE + GAP + SIDE + RIGHT
    figure = NotebookFigure(figsize=(width, height))
    (first, *_) = _draw_panels(figure, particles, panels, intervals or {}, head, (LEFT, WIDE, tall))

    def place(left: float, top: float, wide: float, high: float) -> Axes:
        return figure.add_axes((left / width, 1 - (top + high) / height, wide / width, high / height))

    left = LEFT + WIDE + GAP
    plane = place(left, head, SIDE, SIDE)
    draw_plane(particles, plane)
    down = head + SIDE + FOOT
    if unwrapped:
        angles = place(left, down, SIDE, SIDE)
        draw_unwrapped(particles, prediction, inputs, angles)
        angle_ticks(angles, 6)
        angles.xaxis.label.set_fontsize(9.5)
        down += SIDE + FOOT
    if loses:
        draw_mass(particles, place(left, down, SIDE - AXIS, MASS), small=True)
        down += MASS + FOOT
    named = {
        text: mark for axes in (first, plane) for mark, text in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    anchor = (left / width, 1 - (down + 0.1) / height)
    figure.legend(named.values(), named.keys(), loc="upper left", bbox_to_anchor=anchor, borderaxespad=0, **LEGEND)
    if note:
        figure.suptitle(note, color=VERMILION, fontsize=13, y=1 - 0.08 / height, va="top")
    return figure


def draw_sky_column(
    particles: Stream,
    panels: Sequence[Panel],
    note: str = "",
    intervals: Mapping[str, Array] | None = None,
) -> Figure:
    """Draw the panels of `draw_sky` alone, for one column of a journal."""
    head = 0.3 if note else 0.06
    tall, below, foot = (SMALLER * inches for inches in (TALL, BELOW, FOOT))
    height = head + len(panels) * (tall + below + BETWEEN) + foot * len(_groups(panels)) + COLUMN_NAMES
    figure = NotebookFigure(figsize=(COLUMN, height))
    size = (COLUMN_LEFT, COLUMN - COLUMN_LEFT - COLUMN_RIGHT, tall)
    named: dict[str, Artist] = {}
    for axes in _draw_panels(figure, particles, panels, intervals or {}, head, size, SMALLER):
        named |= dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    figure.legend(
        named.values(), named.keys(), loc="lower center", ncols=min(len(named), 3), frameon=False, fontsize=9,
        bbox_to_anchor=(0.5, 0.0), borderaxespad=0.2, columnspacing=1.0, handletextpad=0.4,
    )  # fmt: skip
    if note:
        figure.suptitle(note, color=VERMILION, fontsize=13, y=1 - 0.04 / height, va="top")
    shrink_text(figure, SMALLER)
    return figure


def _groups(panels: Sequence[Panel]) -> list[list[Panel]]:
    """Return the panels that follow each other over one axis."""
    return [list(group) for _, group in groupby(panels, key=lambda panel: panel.x_label)]


def _draw_panels(
    figure: Figure,
    particles: Stream,
    panels: Sequence[Panel],
    intervals: Mapping[str, Array],
    top: float,
    size: tuple[float, float, float],
    part: float = 1.0,
) -> list[Axes]:
    """Draw the panels below each other, each above its residuals; return the axes of the panels.

    In inches ``top`` is the distance from the upper edge, and ``size`` the left edge, width and height of a panel.
    ``part`` is the factor of the sizes of residuals and margins.
    """
    width, height = figure.get_size_inches()
    left, wide, tall = size
    drawn = []
    for group in _groups(panels):
        reach = _reach(group)
        axes: Axes | None = None
        for panel in group:
            pair = []
            for high in (tall, part * BELOW):
                box = (left / width, 1 - (top + high) / height, wide / width, high / height)
                axes = figure.add_axes(box, sharex=axes)
                pair.append(axes)
                top += high
            upper, lower = pair
            draw_panel(particles, panel, upper, reach, intervals)
            draw_residuals(panel.data, lower)
            upper.tick_params(labelbottom=False)
            lower.tick_params(labelbottom=panel is group[-1])
            for each, label, points in ((upper, panel.y_label, 11), (lower, r"$\Delta/\sigma$", 10)):
                each.set_ylabel(label.replace(" [", "\n["), fontsize=points)
                each.yaxis.set_label_coords(-NAME * part / wide, 0.5)
            drawn.append(upper)
            top += BETWEEN
        lower.set_xlim(*reach)
        angle_ticks(lower, 8 if part == 1 else 5)
        lower.set_xlabel(group[0].x_label, fontsize=12)
        top += part * FOOT
    return drawn


def draw_panel(
    particles: Stream, panel: Panel, axes: Axes, reach: tuple[float, float], intervals: Mapping[str, Array]
) -> None:
    """Draw particles on the sky with the model's line, its intervals and the data, over a range of longitudes."""
    inside = (panel.x > reach[0]) & (panel.x < reach[1]) & ~particles.bound & np.isfinite(panel.y)
    if inside.any():
        draw_particles(particles, panel.x, panel.y, axes)
    line = next((mark for mark in panel.marks if mark.look == "fit"), None)
    data = panel.data
    if line is not None and data is not None:
        for (name, levels), colour in zip(intervals.items(), BANDS, strict=False):
            axes.fill_between(line.x, *_band(data, levels, line.x, line.y), color=colour, lw=0, label=name, alpha=0.85)
    for mark in panel.marks:
        draw_mark(axes, mark, THIN)
    ends = [mark.y[(mark.x > reach[0]) & (mark.x < reach[1])] for mark in panel.marks]
    if data is not None:
        axes.errorbar(data.x, data.y, data.error, label="data", capsize=2, elinewidth=1, **(DATUM | {"ms": 3.5}))
        ends += [data.y - data.error, data.y + data.error]
    if inside.any():
        ends.append(np.percentile(panel.y[inside], [2, 98]))
    every = np.concatenate([np.ravel(part) for part in ends]) if ends else np.empty(0)
    every = every[np.isfinite(every)]
    bottom, top = (float(every.min()), float(every.max())) if every.size else (0.0, 1.0)
    rim = 0.08 * max(top - bottom, 1e-6)
    axes.set(xlim=reach, ylim=(bottom - rim, top + rim))
    finish(axes)
    axes.set_yticks(_inside(bottom - rim, top + rim))


def draw_residuals(data: PanelData | None, axes: Axes) -> None:
    """Draw data minus model in standard deviations of the likelihood; grey where it is less than one."""
    axes.axhspan(-1, 1, color="#E6E6E6", lw=0)
    axes.axhline(0, color="black", lw=0.8)
    largest = 2.0
    if data is not None and (measured := np.isfinite(data.pull)).any():
        look = {"marker": "s", "ms": 3.5, "color": DATUM["color"], "mec": "black", "ls": "none", "zorder": 7}
        axes.plot(data.x[measured], data.pull[measured], **look)
        largest = max(largest, float(np.abs(data.pull[measured]).max()))
    axes.set_ylim(-1.4 * largest, 1.4 * largest)
    finish(axes)
    step = max(n * 10**k for k in range(9) for n in (1, 2, 3, 4, 5, 6, 8, 15) if n * 10**k <= largest)
    axes.set_yticks([-step, 0, step])
    axes.tick_params(axis="y", labelsize=9)


def _reach(panels: Sequence[Panel]) -> tuple[float, float]:
    """Return the range of longitudes that panels show: that of their data, and a tenth beyond."""
    parts = [panel.x if panel.data is None else panel.data.x for panel in panels]
    x = np.concatenate(parts)
    margin = 0.1 * max(float(np.ptp(x)), 5.0)
    return float(x.min()) - margin, float(x.max()) + margin


def _inside(low: float, high: float) -> Array:
    """(n,) Round numbers off the ends of an axis, where those of the next panel are."""
    values = np.asarray(MaxNLocator(6, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high))
    margin = 0.08 * (high - low)
    return values[(values > low + margin) & (values < high - margin)]


def _band(data: PanelData, levels: Array, x: Array, line: Array) -> tuple[Array, Array]:
    """Return the interval (2, m) of the numbers about a line (k,) at x (k,): even steps from a datum to the next.

    NaN beyond the data.
    """
    at, which = np.unique(data.x, return_index=True)
    here = np.interp(at, x, np.where(np.isfinite(line), line, 0.0))
    low, high = (line + np.interp(x, at, end[data.rows][which] - here, left=np.nan, right=np.nan) for end in levels)
    return low, high
