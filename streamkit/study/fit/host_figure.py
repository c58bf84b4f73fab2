"""The picture of a host: its profile, and the radii of the objects that move in it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from streamkit.model import PROFILE, Moving
from streamkit.report import BLUE, VERMILION, panel_grid, ticks
from streamkit.study.fit.figures import bands, levels
from streamkit.units import GYR

if TYPE_CHECKING:
    from astropy.table import QTable

LOGARITHMIC = ("M", "rho")  # columns over several powers of ten


def draw_host(profile: QTable, objects: Mapping[str, Moving], note: str = "") -> Figure:
    """Draw the columns of `host_table` against radius, with their intervals if it has them, and the orbits' radii."""
    shown = [name for name in PROFILE if np.isfinite(profile[name].value).any()]
    figure, panels = panel_grid(len(shown) + bool(objects), 3.4, 2.9, across=3, share=False)
    r, has_bands = profile["r"].value, f"{shown[0]}_lo68" in profile.colnames
    for axes, name in zip(panels, shown, strict=False):
        if has_bands:
            bands(axes, r, levels(profile, name, 1.0))
        else:
            axes.plot(r, profile[name].value, color=BLUE, lw=1.8)
        axes.set_ylabel(PROFILE[name].label, fontsize=11)
        axes.set_xlabel("r [kpc]", fontsize=11)
        axes.set_xscale("log")
        ticks(axes)
        if name in LOGARITHMIC:
            axes.set_yscale("log")
        axes.set_xlim(r.min(), r.max() if len(r) > 1 else 1.1 * r.min())
    if objects:
        axes = panels[len(shown)]
        for i, (name, moving) in enumerate(objects.items()):
            axes.plot(moving.orbit.t / GYR, moving.orbit.r, color=f"C{i % 10}", lw=1.3, label=name)
        axes.set_xlabel("t [Gyr]", fontsize=11)
        axes.set_ylabel("radius of the orbit [kpc]", fontsize=11)
        ticks(axes)
        axes.set_ylim(0, 1.25 * axes.get_ylim()[1])
        axes.legend(frameon=False, fontsize=8, ncols=2, loc="upper left")
    if has_bands:
        panels[0].legend(frameon=False, fontsize=9)
    if note:
        figure.suptitle(note, color=VERMILION, fontsize=12)
    return figure
