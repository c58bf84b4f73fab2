"""The picture of one stream: on the sky with its data where an observable shows it there, else unwrapped."""

from __future__ import annotations

from collections.abc import Mapping

from matplotlib.figure import Figure

from streamkit.observe import panels_of
from streamkit.report.sky_figure import draw_sky
from streamkit.report.stream_axes import LEGEND, draw_mass, draw_plane, draw_unwrapped, loses_mass
from streamkit.report.style import VERMILION, NotebookFigure
from streamkit.runfile import StreamInputs
from streamkit.stream import Array, Prediction, Stream


def draw_stream(
    particles: Stream,
    prediction: Prediction | None = None,
    inputs: StreamInputs | None = None,
    note: str = "",
    intervals: Mapping[str, Array] | None = None,
) -> Figure:
    """Draw a stream in its orbital plane, and the observables' panels, or else r against the unwrapped angle.

    The intervals (2, m), by what a legend calls them, are those of the predicted numbers: bands of the panels.
    """
    if inputs is not None and prediction is not None:
        panels = panels_of(inputs.observables, particles, prediction)
        if panels:
            return draw_sky(particles, prediction, inputs, panels, note, intervals or {})
    loses = loses_mass(particles)
    figure = NotebookFigure(figsize=(12.5 + 4.0 * loses, 5.2), layout="constrained")
    left, right, *rest = figure.subplots(1, 2 + loses, width_ratios=(1, 1.25, 0.8)[: 2 + loses])
    draw_plane(particles, left)
    left.legend(**LEGEND)
    draw_unwrapped(particles, prediction, inputs, right)
    for axes in rest:
        draw_mass(particles, axes)
    if note:
        figure.suptitle(note, color=VERMILION, fontsize=13)
    return figure
