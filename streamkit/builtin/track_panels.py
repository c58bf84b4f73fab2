"""The pictures of a track: debris, the fitted line on a fine grid, data and residuals, a panel for every column."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from streamkit import Array, Mark, Panel, PanelData, Prediction, Stream
from streamkit.builtin.track_columns import COLUMNS, DEPTH, column_of, within
from streamkit.builtin.track_lines import ENOUGH

if TYPE_CHECKING:
    from streamkit.builtin.track import Track

FINE = 181  # longitudes that a line is drawn through
BEYOND = 0.15  # how far lines go on beyond the data, over their range
UNITS = {"mas/yr": r"mas yr$^{-1}$", "km/s": r"km s$^{-1}$"}


def column_panels(track: Track, stream: Stream, prediction: Prediction) -> tuple[Panel, ...]:
    """Return a panel for every column of a track, with what the prediction says of its data."""
    longitude, columns = track.of_particles(stream)
    grid, curves = _curves(track, stream)
    found, start = [], 0
    for name, (phi1, value, error) in track.given.items():
        part = slice(start, start := start + len(phi1))
        pull = np.full(len(phi1), np.nan)
        if not prediction.why_not:
            spread = np.sqrt(track.scatter2(name, error, prediction.details["spread"][part]))
            pull = (value - prediction.mean[part]) / spread
        x = longitude if track.unwrapped else within(longitude, float(phi1.mean()))
        y = np.full(len(longitude), np.nan) if name == DEPTH else columns[name]
        marks = (Mark("fit", grid, curves[name], "fitted track"),) if name in curves else ()
        data = PanelData(np.arange(part.start, part.stop), phi1, value, error, pull)
        found.append(Panel(_x_label(track), _y_label(track, name), x, y, marks, data))
    return tuple(found)


def _curves(track: Track, stream: Stream) -> tuple[Array, dict[str, Array]]:
    """Return longitudes (k,) over those of all data and beyond, and the line of each field there; NaN off the debris.

    No lines without enough debris.
    """
    phi1 = np.concatenate([part for part, _, _ in track.given.values()])
    beyond = BEYOND * max(float(np.ptp(phi1)), 5.0)
    grid = np.unique(np.concatenate([np.linspace(phi1.min() - beyond, phi1.max() + beyond, FINE), phi1]))
    if not track.shows(stream):
        return grid, {}
    lines, of = track.lines(stream, grid)
    there = lines.ln_count > np.log(ENOUGH)
    every = np.arange(len(grid))
    return grid, {
        name: np.where(there, track.part_of(name, lines, of.index(column_of(name)), every)[0], np.nan)
        for name in track.given
    }


def _x_label(track: Track) -> str:
    frame = f" in {track.frame}" if isinstance(track.frame, str) else ""
    return rf"$\phi_1${', unwrapped,' if track.unwrapped else ''}{frame} [deg]"


def _y_label(track: Track, name: str) -> str:
    column = COLUMNS[column_of(name)]
    label = "spread of distance" if name == DEPTH else column.label
    if name == "radial_velocity" and track.velocity_frame == "gsr":
        label = r"$v_{\rm GSR}$"
    return f"{label} [{UNITS.get(column.unit, column.unit)}]"
