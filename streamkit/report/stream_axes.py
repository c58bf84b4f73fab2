"""Axes with one stream: in its orbital plane, and unwrapped with the fitted apocentres and the data."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from streamkit.observe import marks_of
from streamkit.report.style import ARM_STYLE, VERMILION, angle_ticks, finish
from streamkit.runfile import StreamInputs
from streamkit.stream import Mark, Prediction, Stream, orbital_plane
from streamkit.units import GYR

BEYOND = 180.0  # margin of the picture beyond the apocentres, degrees
ASIDE = 10.0  # margin about a datum or an apocentre beyond the debris, degrees
# The axis of radii begins at zero where the innermost radius of the debris is below this fraction of the outermost.
FROM_ZERO = 1 / 3
SHOWN = 8000  # most particles drawn
PROGENITOR: dict[str, Any] = {
    "marker": "*", "ms": 13, "color": "black", "mec": "white", "ls": "none", "zorder": 6, "label": "progenitor",
}  # fmt: skip
# Larger than a datum, which may be drawn over it.
PEAK: dict[str, Any] = {"marker": "o", "ms": 10, "mfc": "white", "mec": "black", "mew": 1.3, "ls": "none"}
DATUM: dict[str, Any] = {"fmt": "s", "ms": 5, "color": "#CC79A7", "mec": "black", "ecolor": "black", "zorder": 7}
LEGEND: dict[str, Any] = {"frameon": True, "framealpha": 0.85, "edgecolor": "none", "fontsize": 9}


def draw_plane(particles: Stream, axes: Axes) -> None:
    """Draw the particles in the progenitor's orbital plane: x towards it, y ahead along its motion."""
    basis = orbital_plane(particles.orbit)
    x, y = basis @ particles.q
    draw_particles(particles, x, y, axes)
    for arm, (name, colour) in ARM_STYLE.items():
        if not (particles.arm == arm).any():
            continue
        # the points themselves would be too small for a legend
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


def loses_mass(particles: Stream) -> bool:
    """Return whether the progenitor loses mass, so that there is something to draw."""
    return bool((particles.orbit.mass_left != particles.orbit.mass_left[0]).any())


def draw_mass(particles: Stream, axes: Axes, small: bool = False) -> None:
    """Draw the remaining mass of the progenitor, and its tidal radius, against time."""
    orbit = particles.orbit
    t = orbit.t / GYR
    axes.plot(t, orbit.mass_left, color="black", lw=1.3)
    axes.set(xlim=(t[0], 0.0), ylim=(0.0, 1.05))
    axes.set_xlabel(r"$t\ \,[{\rm Gyr}]$", fontsize=12)
    axes.set_ylabel("bound mass" if small else "bound mass / mass at the look-back time", fontsize=11)
    finish(axes)
    right = axes.twinx()
    right.plot(t, orbit.r_tidal, color=VERMILION, lw=0.9)
    right.set_ylim(0.0, 1.1 * float(np.nanmax(orbit.r_tidal)))
    right.set_ylabel(r"$r_{\rm t}\ \,[{\rm kpc}]$", fontsize=12, color=VERMILION)


def draw_unwrapped(particles: Stream, prediction: Prediction | None, inputs: StreamInputs | None, axes: Axes) -> None:
    """Draw radius against the angle along the stream, and what the observable shows of its measurement and data."""
    angle = np.degrees(particles.winding)
    draw_particles(particles, angle, particles.r, axes)
    axes.plot(0, particles.orbit.r[-1], **PROGENITOR)
    marks = () if prediction is None or inputs is None else marks_of(inputs.observables, prediction)
    for mark in marks:
        draw_mark(axes, mark)
    peaks = [float(x) for mark in marks if mark.look == "peak" for x in mark.x]
    low, high = np.percentile(angle, [0.5, 99.5]) + np.array([-15.0, 15.0])
    if peaks:
        low, high = max(low, min(0.0, *peaks) - BEYOND), min(high, max(0.0, *peaks) + BEYOND)
    marked = [float(x) for mark in marks if mark.look in ("peak", "datum") for x in mark.x]
    low, high = min([low, *(x - ASIDE for x in marked)]), max([high, *(x + ASIDE for x in marked)])
    inside = (angle > low) & (angle < high)
    tops = [np.max(mark.y) + mark.y_error for mark in marks if mark.look == "datum"]
    tops.append(np.percentile(particles.r[inside], 99.8))
    axes.set(xlim=(high, low), ylim=radial_limits(float(np.percentile(particles.r[inside], 0.2)), max(tops)))
    angle_ticks(axes)
    axes.set_xlabel("angle along the stream [deg]  (leading > 0)", fontsize=12)
    axes.set_ylabel(r"$r\ \,[{\rm kpc}]$", fontsize=12)
    finish(axes)
    named = dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))  # each name once
    axes.legend(named.values(), named.keys(), **LEGEND)


def radial_limits(inner: float, outer: float) -> tuple[float, float]:
    """Return the ends of an axis of radii for debris between these: from zero, unless it is far from the centre."""
    spare = 0.12 * (outer - inner)
    return (0.0 if inner < FROM_ZERO * outer else inner - spare), outer + spare


def draw_mark(axes: Axes, mark: Mark, wide: float = 2.2) -> None:
    """Draw a mark of an observable."""
    if mark.look == "datum":
        axes.errorbar(
            mark.x, mark.y, xerr=mark.x_error or None, yerr=mark.y_error or None, label=mark.label, capsize=3,
            **DATUM,
        )  # fmt: skip
    elif mark.look == "peak":
        axes.plot(mark.x, mark.y, label=mark.label, zorder=6, **PEAK)
    else:
        width, style = (wide, "-") if mark.look == "fit" else (1.0, ":")
        axes.plot(mark.x, mark.y, label=mark.label, color="black", lw=width, ls=style)


def draw_particles(particles: Stream, x: Any, y: Any, axes: Axes) -> None:
    """Draw some of the particles as dots in the colours of their arms, not so many that they hide each other."""
    every = max(int((~particles.bound).sum()) // SHOWN, 1)
    size = 1.0 if len(particles) > 3000 else 3.0
    for arm, (_, colour) in ARM_STYLE.items():
        chosen = np.flatnonzero(particles.arm == arm)
        chosen = chosen[:: max(every, len(chosen) // SHOWN)]
        axes.scatter(x[chosen], y[chosen], s=size, color=colour, alpha=0.6, lw=0, rasterized=True)
