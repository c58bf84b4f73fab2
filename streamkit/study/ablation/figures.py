"""Figures that compare streams, after Gibbons+ 2014: in phase space, and along the tails.

Every function takes portraits by title and returns a figure. A portrait is a stream with its inputs and the prediction
of its observables. The portraits are the variants of an ablation, or a fit and an N-body snapshot. The first one is the
reference of the others.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.lines import Line2D

from streamkit.components import Stripping
from streamkit.model import standard_normals
from streamkit.observe import ENOUGH
from streamkit.report import (
    ACROSS,
    ARM_STYLE,
    NotebookFigure,
    across,
    angle_ticks,
    draw_unwrapped,
    finish,
    folded,
    label_all,
    panel_grid,
    radial_limits,
    typical_reach,
)
from streamkit.stream import ARMS, Array, BoolArray, IntArray, Stream, orbital_plane
from streamkit.study.ablation.measures import Portrait
from streamkit.units import GYR

Portraits = Mapping[str, Portrait]
SHOWN = 6500  # largest number of particles in a panel, chosen at random, as in Gibbons+ 2014, figure 6
# Okabe & Ito's colours, for lines.
CYCLE = ("#000000", "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
STAR: dict[str, Any] = {"marker": "*", "ms": 11, "color": "black", "mec": "white", "ls": "none", "label": "progenitor"}
CROSS: dict[str, Any] = {
    "marker": "+", "ms": 9, "mew": 1.4, "color": "black", "ls": "none", "label": "Galactic centre, at rest"
}  # fmt: skip
TITLE = 24  # letters in a line of the title of a small panel
ALONG = "angle along the stream [deg]  (leading > 0)"


def some(stream: Stream, chosen: BoolArray) -> IntArray:
    """Return the chosen particles to draw: at random by their weights, at most `SHOWN` of all unbound ones."""
    free = ~stream.bound
    index = np.flatnonzero(chosen)
    share = stream.weight / stream.weight[free].max(initial=0.0)
    share *= min(SHOWN / max(float(share[free].sum()), 1.0), 1.0)
    return np.asarray(index[np.random.default_rng(0).random(len(index)) < share[index]])


def _legend(place: Figure | Axes, panels: Iterable[Axes], **look: Any) -> Legend:
    """Make the legend of all panels, each label once; the dots of particles are enlarged."""
    named = {label: handle for axes in panels for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    legend = place.legend(named.values(), named.keys(), **{"fontsize": 9, "frameon": False, **look})
    for handle in legend.legend_handles:
        if isinstance(handle, PathCollection):
            handle.set_sizes([30.0])
            handle.set_alpha(1.0)
    return legend


def bow_tie(portraits: Portraits) -> Figure:
    """Draw energy against angular momentum, minus the progenitor's, coloured by the phase along the stream.

    Each cell has the median winding of its particles (Gibbons+ 2014, figure 3). The line encloses 95 % of the first
    stream. Streams whose host has no potential energy are left out.
    """
    shown: dict[str, tuple[Array, Array, Array]] = {}
    for title, portrait in portraits.items():
        (energy, momentum), free = portrait.integrals, ~portrait.stream.bound
        if energy is not None and free.any():
            shown[title] = momentum[free] / 1e3, energy[free] / 1e4, np.degrees(portrait.stream.winding[free])
    figure, panels = panel_grid(len(shown), 3.1, 3.1, share=True)
    if not shown:
        return figure
    x, y, turn = (
        typical_reach(float(np.percentile(np.abs(values), percent)) for values in column)
        for column, percent in zip(zip(*shown.values(), strict=True), (99.5, 99.5, 97), strict=True)
    )
    extent = (-x, x, -y, y)
    outline = _outline(*next(iter(shown.values()))[:2], extent)
    for axes, (title, (momentum, energy, angle)) in zip(panels, shown.items(), strict=False):
        image = axes.hexbin(
            momentum, energy, C=angle, reduce_C_function=np.median, gridsize=70, extent=extent, cmap="turbo",
            vmin=-turn, vmax=turn, lw=0.1,
        )  # fmt: skip
        axes.contour(*outline, colors="black", linewidths=0.9)
        axes.plot(0, 0, **STAR)
        axes.set(xlim=extent[:2], ylim=extent[2:])
        axes.set_title(folded(title, TITLE), fontsize=9)
        finish(axes)
    panels[0].add_line(Line2D([], [], color="black", lw=0.9, label=f"95 % of {next(iter(shown))}"))
    label_all(
        figure, r"$L - L_{\rm p}\ \,[10^3\,{\rm kpc\,km\,s}^{-1}]$", r"$E - E_{\rm p}\ \,[10^4\,({\rm km\,s}^{-1})^2]$"
    )
    figure.colorbar(image, ax=panels, label=ALONG, pad=0.01, shrink=0.9)
    _legend(figure, panels[:1], ncols=2, loc="outside upper left")
    return figure


def _outline(x: Array, y: Array, extent: tuple[float, float, float, float]) -> tuple[Array, Array, Array, list[float]]:
    """Return the arguments of the contour around the densest 95 % of the points: x, y, density and level."""
    from scipy.ndimage import gaussian_filter

    count, x_edges, y_edges = np.histogram2d(x, y, 80, (extent[:2], extent[2:]))
    smooth = gaussian_filter(count, 1.2)
    ordered = np.sort(smooth.ravel())[::-1]
    level = float(ordered[np.searchsorted(np.cumsum(ordered), 0.95 * ordered.sum())])
    return 0.5 * (x_edges[1:] + x_edges[:-1]), 0.5 * (y_edges[1:] + y_edges[:-1]), smooth.T, [level]


def phase_space(portraits: Portraits) -> Figure:
    """Draw configuration space above velocity space, both in the progenitor's orbital plane, coloured by arm."""
    n = max(len(portraits), 1)
    beside, blocks = min(n, ACROSS), -(-n // ACROSS)
    figure = NotebookFigure(figsize=(3.1 * beside + 0.6, 6.6 * blocks + 0.3), layout="constrained")
    panels: Any = figure.subplots(2 * blocks, beside, squeeze=False)
    for axes in panels.flat:
        axes.set_visible(False)
    for row, (what, axis, unit) in enumerate((("q", ("x'", "y'"), "kpc"), ("v", ("v_x'", "v_y'"), r"km\,s^{-1}"))):
        reach = typical_reach(_reach(portrait.stream, what) for portrait in portraits.values())
        for i, (title, portrait) in enumerate(portraits.items()):
            axes, stream = panels[2 * (i // ACROSS) + row, i % ACROSS], portrait.stream
            basis = orbital_plane(stream.orbit)
            x, y = basis @ getattr(stream, what)
            for arm in (1, -1):
                chosen = some(stream, stream.arm == arm)
                name, colour = ARM_STYLE[arm]
                axes.scatter(x[chosen], y[chosen], s=1.2, color=colour, alpha=0.55, lw=0, rasterized=True, label=name)
            axes.plot(*(basis @ getattr(stream.orbit, what)[:, -1]), **STAR)
            axes.plot(0, 0, **CROSS)
            axes.set(visible=True, aspect="equal", xlim=(-reach, reach), ylim=(-reach, reach))
            axes.set_xlabel(rf"${axis[0]}\ \,[{{\rm {unit}}}]$", fontsize=11)
            if i % ACROSS == 0:
                axes.set_ylabel(rf"${axis[1]}\ \,[{{\rm {unit}}}]$", fontsize=11)
            if row == 0:
                axes.set_title(folded(title, TITLE), fontsize=10)
            finish(axes)
    if portraits:
        _legend(figure, panels[0, :1], ncols=4 if beside > 1 else 2, loc="outside upper left", handletextpad=0.1)
    return figure


def _reach(stream: Stream, what: str) -> float:
    """Return the range of a picture in positions ("q") or velocities ("v")."""
    if stream.bound.all():
        return 1.0
    planar = orbital_plane(stream.orbit) @ getattr(stream, what)[:, ~stream.bound]
    return 1.05 * float(np.percentile(np.abs(planar), 99.7))


def crossings(portraits: Portraits) -> Figure:
    """Draw the trailing debris' velocities at the last crossing of r_t, and its velocities at release.

    In the frame that moves with the progenitor (Gibbons+ 2014, figure 4): radial, along the motion, out of the plane.
    The black line is the distribution that the scheme draws from: mLCS's Gaussian. A snapshot and a live progenitor
    have no such line, because no scheme has released their debris. A snapshot without crossings has no row.
    """
    trailing = {t: p.stream.dv_strip[:, p.stream.arm < 0] for t, p in portraits.items()}
    shown = {t: v for t, v in trailing.items() if v.size and np.isfinite(v).all()}
    n = max(len(shown), 1)
    figure = NotebookFigure(figsize=(9.6, 1.9 * n + 0.7), layout="constrained")
    panels: Any = figure.subplots(n, 3, squeeze=False, sharex=True)
    reach = max((float(np.percentile(np.abs(v), 99)) for v in shown.values()), default=1.0)
    bins = np.linspace(-reach, reach, 51)
    released: dict[str, Any] = {"color": "black", "lw": 1.2, "label": "as released"}
    for row, (title, velocity) in zip(panels, shown.items(), strict=False):
        portrait = portraits[title]
        chosen = portrait.stream.arm < 0
        density: dict[str, Any] = {"weights": portrait.stream.weight[chosen], "density": True}
        for axes, crossing in zip(row, velocity, strict=True):
            axes.hist(crossing, bins, color=ARM_STYLE[-1][1], alpha=0.55, label="at the last crossing", **density)
            axes.axvline(0, color="black", lw=0.6, ls=":")
            finish(axes)
            axes.tick_params(which="both", left=False, right=False, labelleft=False)
        for axes, start in zip(row, _released(portrait)[:, chosen], strict=False):
            if np.std(start) > 0.02 * reach:
                axes.hist(start, bins, histtype="step", **density, **released)
            else:  # no dispersion: a line
                axes.axvline(float(np.mean(start)), **released)
        row[0].set_ylabel(title.replace(", ", ",\n"), fontsize=9)
    for axes, component in zip(panels[-1], ("r", "t", r"{\rm oop}"), strict=True):
        axes.set_xlabel(rf"$\Delta v_{component}\ \,[{{\rm km\,s}}^{{-1}}]$", fontsize=12)
    panels[0, 0].set_xlim(-reach, reach)
    if shown:
        _legend(figure, panels[:, 0], ncols=2, loc="outside upper center")
    return figure


def _released(portrait: Portrait) -> Array:
    """(3, n) Velocities at release relative to the progenitor, in its frame; (0, n) where none were drawn."""
    inputs, stream = portrait.inputs, portrait.stream
    if portrait.title or not isinstance(inputs.stripping, Stripping):
        return np.empty((0, len(stream)))
    there = stream.orbit.at(stream.t_release)
    normals = standard_normals(inputs.stripping, inputs.seed)
    release = inputs.stripping.release(there, stream.tail, inputs.mass * there.mass_left, normals)
    return np.asarray(np.einsum("fcn,cn->fn", np.stack(there.frame), release.v - there.v))


def unwrapped(portraits: Portraits) -> Figure:
    """Draw radius against the angle along each stream, with the fitted apocentres and the data."""
    figure, panels = panel_grid(len(portraits), 5.4, 3.3, across=2, share=True)
    limits = []
    for axes, (title, portrait) in zip(panels, portraits.items(), strict=False):
        draw_unwrapped(portrait.stream, portrait.prediction, portrait.inputs, axes)
        limits.append((*axes.get_xlim(), *axes.get_ylim()))
        axes.set_title(title, fontsize=10)
        axes.set(xlabel="", ylabel="")
    for axes in panels[1:]:
        if legend := axes.get_legend():
            legend.remove()
    _share(figure, panels, limits)
    return figure


def epochs(portraits: Portraits) -> Figure:
    """Draw the tidal tails coloured by the stripping epoch: from one apocentre of the progenitor to the next."""
    figure, panels = panel_grid(len(portraits), 5.4, 3.3, across=2, share=True)
    limits = []
    oldest = max((len(_apocentres(portrait.stream)) for portrait in portraits.values()), default=0)
    for axes, (title, portrait) in zip(panels, portraits.items(), strict=False):
        stream = portrait.stream
        edges = [-np.inf, *_apocentres(stream), np.inf]
        free = ~stream.bound
        angle = np.degrees(stream.winding)
        for i, (begin, end) in enumerate(pairwise(edges)):
            chosen = some(stream, free & (stream.t_strip >= begin) & (stream.t_strip < end))
            colour = colormaps["plasma"](0.85 * (1 - (len(edges) - 2 - i) / max(oldest, 1)))
            span = f"{_gyr(begin, stream)} to {_gyr(end, stream)} Gyr"
            dots: dict[str, Any] = {"s": 1.5, "color": colour, "alpha": 0.6, "lw": 0, "rasterized": True}
            axes.scatter(angle[chosen], stream.r[chosen], label=span, **dots)
        axes.plot(0, stream.orbit.r[-1], zorder=6, **STAR)
        if free.any():
            low, high = np.percentile(angle[free], [0.2, 99.8])
            limits.append((high + 15, low - 15, *radial_limits(*np.percentile(stream.r[free], [0.2, 99.8]).tolist())))
        axes.set_title(title, fontsize=10)
        finish(axes)
    if portraits:
        look: dict[str, Any] = {"frameon": True, "framealpha": 0.85, "edgecolor": "none", "fontsize": 8}
        _legend(panels[0], panels[:1], title="stripped", title_fontsize=8, **look)
    _share(figure, panels, limits)
    return figure


def _share(figure: Figure, panels: Sequence[Axes], limits: list[tuple[float, float, float, float]]) -> None:
    """Set the limits (left, right, bottom, top) of all panels, which share their axes, to medians; label the axes."""
    if limits:
        left, right, bottom, top = (float(np.median(column)) for column in zip(*limits, strict=True))
        panels[0].set(xlim=(left, right), ylim=(bottom, top))
        angle_ticks(panels[0])
    label_all(figure, ALONG, r"$r\ \,[{\rm kpc}]$")


def _apocentres(stream: Stream) -> Array:
    """Return the times of the progenitor's apocentres, without one at the very start of its track."""
    times = stream.orbit.apocentres()
    return np.asarray(times[times > 0.98 * stream.orbit.t[0]])


def _gyr(t: float, stream: Stream) -> str:
    return f"{np.clip(t, stream.orbit.t[0], 0.0) / GYR:.2g}"


def along(portraits: Portraits) -> Figure:
    """Draw the profiles along the streams: density, and the distance of the mean track from the first one's."""
    beside = min(across(portraits, 11.0), 3)
    figure = NotebookFigure(figsize=(11.0, 7.0 + 0.2 * (len(portraits) // beside)), layout="constrained")
    top, bottom = figure.subplots(2, 1, sharex=True)
    first = next(iter(portraits.values()), None)
    offsets = [np.zeros(1)]
    for i, (title, portrait) in enumerate(portraits.items()):
        style: dict[str, Any] = {"color": CYCLE[i % len(CYCLE)], "ls": ("-", "--", ":")[i // len(CYCLE) % 3], "lw": 1.3}
        for name, arm in ARMS.items():
            track = portrait.tracks[name]
            good = track.count >= ENOUGH
            density = np.where(good, track.density, np.nan)
            top.semilogy(arm * track.angle, density, label=title if arm == 1 else None, **style)
            if first is not None and portrait is not first:
                other = first.tracks[name]
                k = min(len(track.angle), len(other.angle))
                both = good[:k] & (other.count[:k] >= ENOUGH)
                away = np.where(both, track.r[:k] - other.r[:k], np.nan)
                offsets.append(away[both])
                bottom.plot(arm * track.angle[:k], away, **style)
    bottom.axhline(0, color="black", lw=0.8)
    reach = 1.3 * float(np.percentile(np.abs(np.concatenate(offsets)), 93)) or 1.0
    ends = [portrait.ends for portrait in portraits.values()]
    low, high = np.median(ends, axis=0) if ends else (-180.0, 180.0)
    rim = 0.1 * (high - low) or 10.0
    bottom.set(xlim=(high + rim, low - rim), ylim=(-reach, reach))
    angle_ticks(bottom, 14)
    top.set_ylabel("particles per degree / all unbound", fontsize=11)
    of = folded(f"that of {next(iter(portraits), 'the first')}", 38)
    bottom.set_ylabel(rf"mean $r$ $[{{\rm kpc}}]$ $-${chr(10)}{of}", fontsize=11 if of.count(chr(10)) < 2 else 9)
    bottom.set_xlabel(ALONG, fontsize=11)
    for axes in (top, bottom):
        finish(axes)
    if portraits:
        _legend(figure, [top], ncols=beside, loc="outside lower center")
    return figure
