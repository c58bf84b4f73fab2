"""Pictures of one stream: in its orbital plane, and unwrapped with the fitted apocentres and the data."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from streamkit.observe import marks_of, panels_of
from streamkit.report.style import ARM_STYLE, VERMILION, NotebookFigure, angle_ticks, finish
from streamkit.spec import Setup
from streamkit.stream import Mark, Panel, Prediction, Stream, orbital_plane
from streamkit.units import GYR

BEYOND = 180.0
"""How far the picture goes on beyond the apocentres, degrees."""
SHOWN = 8000
"""Most particles drawn."""
PROGENITOR: dict[str, Any] = {
    "marker": "*", "ms": 13, "color": "black", "mec": "white", "ls": "none", "zorder": 6, "label": "progenitor",
}  # fmt: skip
PEAK: dict[str, Any] = {"marker": "o", "ms": 10, "mfc": "white", "mec": "black", "mew": 1.3, "ls": "none"}
"""Larger than a datum, which may lie upon it."""
LEGEND: dict[str, Any] = {"frameon": True, "framealpha": 0.85, "edgecolor": "none", "fontsize": 9}


def draw_stream(
    particles: Stream, prediction: Prediction | None = None, setup: Setup | None = None, note: str = ""
) -> Figure:
    """Draw a stream in its orbital plane, and the observable's panels, or else r against the unwrapped angle."""
    if setup is not None and prediction is not None and (panels := panels_of(setup.observables, particles, prediction)):
        return draw_sky(particles, panels, note)
    figure = NotebookFigure(figsize=(12.5, 5.2), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1, 1.25))
    draw_plane(particles, left)
    draw_unwrapped(particles, prediction, setup, right)
    if note:
        figure.suptitle(note, color=VERMILION, fontsize=13)
    return figure


def draw_sky(particles: Stream, panels: Sequence[Panel], note: str = "") -> Figure:
    """Draw a stream in its orbital plane, and what an observable shows of it on the sky, a panel below the other."""
    rows = (len(panels) + 1) // 2
    figure = NotebookFigure(figsize=(14.0, max(2.3 * rows, 5.2)), layout="constrained")
    grid = figure.add_gridspec(rows, 3, width_ratios=(1.1, 1, 1))
    draw_plane(particles, figure.add_subplot(grid[:, 0]))
    for i, panel in enumerate(panels):
        draw_panel(particles, panel, figure.add_subplot(grid[i % rows, 1 + i // rows]))
    if note:
        figure.suptitle(note, color=VERMILION, fontsize=13)
    return figure


def draw_panel(particles: Stream, panel: Panel, axes: Axes) -> None:
    """Draw particles on the sky with the data over them, over the range of the data and a fifth beyond."""
    data = [mark for mark in panel.marks if mark.look == "datum"]
    x = np.concatenate([mark.x for mark in data]) if data else panel.x
    margin = 0.2 * max(float(np.ptp(x)), 5.0)
    low, high = float(x.min()) - margin, float(x.max()) + margin
    inside = (panel.x > low) & (panel.x < high) & ~particles.bound & np.isfinite(panel.y)
    if inside.any():
        _points(particles, panel.x, panel.y, axes)
    for mark in panel.marks:
        _mark(axes, mark, 3.5)
    ends = [edge for mark in data for edge in (float(mark.y.min()) - mark.y_error, float(mark.y.max()) + mark.y_error)]
    ends += [float(y) for mark in panel.marks for y in (mark.y.min(), mark.y.max())]
    ends += np.percentile(panel.y[inside], [2, 98]).tolist() if inside.any() else []
    bottom, top = min(ends, default=0.0), max(ends, default=1.0)
    rim = 0.08 * max(top - bottom, 1e-6)
    axes.set(xlim=(low, high), ylim=(bottom - rim, top + rim))
    axes.set_xlabel(panel.x_label, fontsize=11)
    axes.set_ylabel(panel.y_label, fontsize=11)
    finish(axes)


def draw_plane(particles: Stream, axes: Axes) -> None:
    """Draw the particles in the progenitor's orbital plane: x towards it, y ahead along its motion."""
    basis = orbital_plane(particles.orbit)
    x, y = basis @ particles.q
    _points(particles, x, y, axes)
    for name, colour in ARM_STYLE.values():  # the points themselves would be too small for a legend
        axes.plot([], [], marker="o", ms=4, color=colour, ls="none", label=name)
    t_past = particles.orbit.t > -1.5 * GYR
    ox, oy = basis @ particles.orbit.q[:, t_past]
    axes.plot(ox, oy, color="black", lw=0.9, label="orbit, last 1.5 Gyr")
    axes.plot(*(basis @ particles.orbit.q[:, -1]), **PROGENITOR)
    axes.plot(0, 0, marker="+", ms=11, mew=1.6, color="black", ls="none", label="Galactic centre")
    reach = 1.08 * max(np.percentile(np.abs(np.concatenate([x, y])), 99.5), np.abs([ox, oy]).max())
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
    axes.set_xlabel(r"$x'\ \,[{\rm kpc}]$  (towards the progenitor)", fontsize=12)
    axes.set_ylabel(r"$y'\ \,[{\rm kpc}]$  (along its motion)", fontsize=12)
    finish(axes)
    axes.legend(**LEGEND)


def draw_unwrapped(particles: Stream, prediction: Prediction | None, setup: Setup | None, axes: Axes) -> None:
    """Draw radius against the angle along the stream, and what the observable shows of its measurement and data."""
    angle = np.degrees(particles.winding)
    _points(particles, angle, particles.r, axes)
    axes.plot(0, particles.orbit.r[-1], **PROGENITOR)
    marks = () if prediction is None or setup is None else marks_of(setup.observables, prediction)
    for mark in marks:
        _mark(axes, mark)
    peaks = [float(x) for mark in marks if mark.look == "peak" for x in mark.x]
    low, high = np.percentile(angle, [0.5, 99.5]) + np.array([-15.0, 15.0])
    if peaks:
        low, high = max(low, min(0.0, *peaks) - BEYOND), min(high, max(0.0, *peaks) + BEYOND)
    inside = (angle > low) & (angle < high)
    tops = [np.max(mark.y) + mark.y_error for mark in marks if mark.look == "datum"]
    tops.append(np.percentile(particles.r[inside], 99.8))
    axes.set(xlim=(high, low), ylim=(0, 1.12 * max(tops)))
    angle_ticks(axes)
    axes.set_xlabel("angle along the stream [deg]  (leading > 0)", fontsize=12)
    axes.set_ylabel(r"$r\ \,[{\rm kpc}]$", fontsize=12)
    finish(axes)
    named = dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))  # each name once
    axes.legend(named.values(), named.keys(), **LEGEND)


def _mark(axes: Axes, mark: Mark, size: float = 5.0) -> None:
    """Draw what an observable wants to show."""
    if mark.look == "datum":
        axes.errorbar(
            mark.x, mark.y, xerr=mark.x_error or None, yerr=mark.y_error or None, label=mark.label, fmt="s", ms=size,
            color="#CC79A7", mec="black", ecolor="black", capsize=3, zorder=7,
        )  # fmt: skip
    elif mark.look == "peak":
        axes.plot(mark.x, mark.y, label=mark.label, zorder=6, **PEAK)
    else:
        width, style = (2.2, "-") if mark.look == "fit" else (1.0, ":")
        axes.plot(mark.x, mark.y, label=mark.label, color="black", lw=width, ls=style)


def _points(particles: Stream, x: Any, y: Any, axes: Axes) -> None:
    every = max(int((~particles.bound).sum()) // SHOWN, 1)
    size = 1.0 if len(particles) > 3000 else 3.0
    for arm, (_, colour) in ARM_STYLE.items():
        chosen = np.flatnonzero(particles.arm == arm)
        chosen = chosen[:: max(every, len(chosen) // SHOWN)]
        axes.scatter(x[chosen], y[chosen], s=size, color=colour, alpha=0.6, lw=0, rasterized=True)
