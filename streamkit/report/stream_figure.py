"""The pictures of one stream: on the sky with its data where an observable shows it, else unwrapped; and its track."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from streamkit.observe import panels_of
from streamkit.report.sky_figure import SMALLER, draw_sky, draw_sky_column
from streamkit.report.stream_axes import LEGEND, draw_mass, draw_particles, draw_plane, draw_unwrapped, loses_mass
from streamkit.report.style import BAND_68, COLUMN, VERMILION, NotebookFigure, angle_ticks, finish, shrink_text
from streamkit.runfile import StreamInputs
from streamkit.stream import Array, Frame, Prediction, SkyTrack, Stream

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

    The intervals (2, m) of the predicted numbers, by their names in the legend, are drawn as bands. A picture for one
    ``column`` of a journal has only the panels, or the two pictures below each other.
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


TALL, WIDE = 1.6, 6.6  # inches: a panel, and the figure
LABELS = {
    "phi2": r"$\phi_2$ [deg]", "distance": "distance [kpc]", "pm_phi1_cosphi2": r"$\mu_{\phi_1} \cos \phi_2$"
    "\n" r"[mas yr$^{-1}$]", "pm_phi2": r"$\mu_{\phi_2}$ [mas yr$^{-1}$]", "radial_velocity": r"$v_r$ [km s$^{-1}$]",
}  # fmt: skip


def draw_track(track: SkyTrack, stream: Stream | None = None, frame: Frame = None) -> Figure:
    """Draw the mean of every column against phi1, and the spread of the debris as a band.

    Parameters
    ----------
    track
        The result of ``stream.track(frame)``.
    stream, frame
        If given, the particles are drawn too.
    """
    figure = NotebookFigure(figsize=(WIDE, TALL * len(track.names) + 0.4), layout="constrained")
    panels = figure.subplots(len(track.names), 1, sharex=True)
    low, high = float(track.phi1.min()), float(track.phi1.max())
    margin = 0.03 * max(high - low, 1.0)
    for axes, name, spread in zip(panels, track.names, track.spread, strict=True):
        mean = track[name]
        if stream is not None:
            seen = stream.seen(frame)
            lon = seen.lon - 360.0 * np.round((seen.lon - (low + high) / 2) / 360.0)
            columns = seen.lat, seen.distance, seen.pm_lon_coslat, seen.pm_lat, seen.radial_velocity
            draw_particles(stream, lon, columns[track.names.index(name)], axes)
        axes.fill_between(track.phi1, mean - spread, mean + spread, color=BAND_68, lw=0, label="spread of the debris")
        axes.plot(track.phi1, mean, color="black", lw=1.3, label="mean")
        if (there := np.isfinite(mean)).any():
            bottom, top = float((mean - 2 * spread)[there].min()), float((mean + 2 * spread)[there].max())
            rim = 0.06 * max(top - bottom, 1e-6)
            axes.set_ylim(bottom - rim, top + rim)
        axes.set_ylabel(LABELS[name], fontsize=9.5)
        finish(axes)
        axes.tick_params(labelsize=9)
    panels[0].legend(frameon=False, fontsize=9, ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    panels[-1].set_xlim(low - margin, high + margin)
    angle_ticks(panels[-1])
    panels[-1].set_xlabel(r"$\phi_1$ [deg]", fontsize=11)
    figure.align_ylabels()
    return figure
