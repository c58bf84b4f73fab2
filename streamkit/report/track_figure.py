"""The picture of a stream's track on the sky."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from streamkit.report.stream_axes import draw_particles
from streamkit.report.style import BAND_68, NotebookFigure, angle_ticks, finish
from streamkit.stream import Frame, SkyTrack, Stream

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
        With these the particles are drawn too.
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
