"""One picture of a track: debris, the fitted line on a fine grid, data and residuals, for one column."""

from __future__ import annotations

import numpy as np

from streamkit import Array, Mark, Panel, PanelData
from streamkit.builtin.observables.track.columns import COLUMNS, DEPTH, column_of

FINE = 181  # longitudes of a drawn line
BEYOND = 0.15  # length of lines beyond the data, in units of the range of the data
Line = tuple[Array, Array] | None  # of the fitted track, if there is one
UNITS = {"mas/yr": r"mas yr$^{-1}$", "km/s": r"km s$^{-1}$"}


def fine_grid(phi1: Array) -> Array:
    """(k,) Longitudes for a smooth line: those of all data (m,), an even grid over their range, and a little beyond."""
    beyond = BEYOND * max(float(np.ptp(phi1)), 5.0)
    return np.unique(np.concatenate([np.linspace(phi1.min() - beyond, phi1.max() + beyond, FINE), phi1]))


def column_panel(
    x_label: str, y_label: str, particles: tuple[Array, Array], data: PanelData, line: Line
) -> Panel:
    """Return the panel of one column.

    ``particles`` and ``line`` are longitudes and values: (n,) of all particles, and (k,) of the fitted track, which is
    None without enough debris.
    """
    marks = () if line is None else (Mark("fit", *line, "fitted track"),)
    return Panel(x_label, y_label, *particles, marks, data)


def longitude_label(frame: object, unwrapped: bool) -> str:
    """Return the label of the longitudes, with the frame if it has a name."""
    named = f" in {frame}" if isinstance(frame, str) else ""
    return rf"$\phi_1${', unwrapped,' if unwrapped else ''}{named} [deg]"


def column_label(name: str, gsr: bool) -> str:
    """Return the label of a column; velocities may be those in the Galactic standard of rest (``gsr``)."""
    column = COLUMNS[column_of(name)]
    label = "spread of distance" if name == DEPTH else column.label
    if name == "radial_velocity" and gsr:
        label = r"$v_{\rm GSR}$"
    return f"{label} [{UNITS.get(column.unit, column.unit)}]"
