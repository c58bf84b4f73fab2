"""The picture of the flattening of the potential against radius, for hosts that are not spheres."""

from __future__ import annotations

import numpy as np
from astropy.table import QTable
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from streamkit.errors import StreamkitError
from streamkit.fit.samples.results import Results
from streamkit.fit.samples.tables import LEVELS
from streamkit.fit.show.figures import WIDE, bands, data_radii, legend_above, profile_axes, radii
from streamkit.fit.show.literature import POTENTIAL, beside_literature, draw_literature, flattenings
from streamkit.model import Host
from streamkit.report import VERMILION
from streamkit.runfile import Spec
from streamkit.stream import Array

# Latitudes in degrees seen from the centre, and the line styles of their medians; the first one has the intervals.
DIRECTIONS = {45.0: "-", 15.0: "--", 75.0: ":"}
ROUND = 1e-6
OUTWARDS = 1.04  # factor of the radius at which a value of the run is drawn beside a published one


def is_sphere(spec: Spec) -> bool:
    """Return whether the host is round at two points of the prior: a prior of q may have its centre at 1.

    A host whose flattening cannot be computed there counts as round.
    """
    places = [np.array([float(prior.ppf(np.array([u]))[0]) for prior in spec.priors]) for u in (0.31, 0.74)]
    try:
        hosts = [Host(spec.host(theta)) for theta in places]
        q = np.array([host.flattening(*_along(45.0, np.array([5.0, 20.0, 60.0]))) for host in hosts])
    except StreamkitError:  # a fit counts such parameters; there is no picture for them
        return True
    return not (np.abs(q[np.isfinite(q)] - 1) > ROUND).any()


def flattening(results: Results, literature: QTable | None = None, wide: float = WIDE) -> Figure:
    """Draw the flattening q of the potential (`Host.flattening`), 45 deg above the plane with 68 % and 95 % bands.

    Lines are medians at a low and a high latitude. Published values are drawn at their distance from the centre, with
    the values of the run at the same positions.
    """
    rows = None if literature is None else literature[[name == POTENTIAL for name in literature["quantity"]]]
    r = radii(results, rows)[::2]
    figure, axes = profile_axes(results, r, r"flattening of the potential, $q_\Phi$", wide)
    for angle, style in DIRECTIONS.items():
        q = np.nanpercentile(flattenings(results, *_along(angle, r)), list(LEVELS.values()), axis=0)
        if angle == next(iter(DIRECTIONS)):
            bands(axes, r, dict(zip(LEVELS, q, strict=True)))
            axes.lines[-1].set_label(f"median, latitude {angle:g} deg")
        else:
            axes.plot(r, q[0], color="black", lw=1.1, ls=style, label=f"median, latitude {angle:g} deg")
    axes.axhline(1, color="black", lw=0.6)
    if rows is not None and len(rows):
        _draw_published(axes, beside_literature(results, rows))
    data_radii(axes, results)
    legend_above(figure, axes)
    return figure


def _along(angle: float, r: Array) -> tuple[Array, Array]:
    """Return cylindrical radii and heights (nr,) at radii (nr,) in a direction in degrees above the plane."""
    up = np.radians(angle)
    return r * np.cos(up), r * np.sin(up)


def _draw_published(axes: Axes, rows: QTable) -> None:
    """Draw published flattenings, and a little farther out the run's own at the same places, once for each."""
    draw_literature(axes, rows, POTENTIAL)
    _, first = np.unique(np.stack([rows["radius"], rows["z"]]), axis=1, return_index=True)
    once = rows[np.sort(first)]
    axes.errorbar(
        OUTWARDS * np.hypot(once["radius"], once["z"]), once["ours"],
        yerr=np.array([once["ours_minus"], once["ours_plus"]]),
        fmt="o", ms=6, color=VERMILION, capsize=3, lw=1.4, zorder=6, label="this run, at the places of these",
    )  # fmt: skip
