"""The picture of one stream: on the sky with its data where an observable shows it there, else unwrapped."""

from __future__ import annotations

from collections.abc import Mapping

from matplotlib.figure import Figure

from streamkit.observe import panels_of
from streamkit.report.sky_figure import SMALLER, draw_sky, draw_sky_column
from streamkit.report.stream_axes import LEGEND, draw_mass, draw_plane, draw_unwrapped, loses_mass
from streamkit.report.style import COLUMN, VERMILION, NotebookFigure, angle_ticks, shrink_text
from streamkit.runfile import StreamInputs
from streamkit.stream import Array, Prediction, Stream

COLUMN_SIZE = (COLUMN, 5.9)  # inches


def draw_stream(
    particles: Stream,
    prediction: Prediction | None = None,
    inputs: StreamInputs | None = None,
    note: str = "",
    intervals: Mapping[str, Array] | None = None,
    column: bool = False,
) -> Figure:
    """Draw a stream in its orbital plane, and the observables' panels, or else r against the unwrapped angle.

    The intervals (2, m), by what a legend calls them, are those of the predicted numbers: bands of the panels. A
    picture for one ``column`` of a journal has the panels alone, or the two pictures below each other.
    """
    if inputs is not None and prediction is not None:
        panels = panels_of(inputs.observables, particles, prediction)
        if panels and column:
            return draw_sky_column(particles, panels, note, intervals)
        if panels:
            return draw_sky(particles, prediction, inputs, panels, note, intervals or {})
    loses = loses_mass(particles) and not column
    figure = NotebookFigure(figsize=COLUMN_SIZE if column else (12.5 + 4.0 * loses, 5.2), layout="constrained")
    if column:
        left, right, *rest = figure.subplots(2, 1, height_ratios=(1, 0.8))
    else:
        left, right, *rest = figure.subplots(1, 2 + loses, width_ratios=(1, 1.25, 0.8)[: 2 + loses])
    draw_plane(particles, left)
    left.legend(**LEGEND)
    draw_unwrapped(particles, prediction, inputs, right)
    for axes in rest:
        draw_mass(particles, axes)
    if note:
        figure.suptitle(note, color=VERMILION, fontsize=13)
    if column:
        angle_ticks(right, 5)
        shrink_text(figure, SMALLER)
    return figure
