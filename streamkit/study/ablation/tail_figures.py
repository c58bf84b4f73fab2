"""The paper's figures along the tails: unwrapped with the apocentre fits, stripping epochs, density and mean track.

They take portraits by title, as the functions of `streamkit.figures` do.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from streamkit.observe import ENOUGH
from streamkit.report import draw_unwrapped, finish, label_all, panel_grid
from streamkit.stream import ARMS, Array, Stream
from streamkit.study.ablation.panels import Portraits, some
from streamkit.units import GYR

CYCLE = ("#000000", "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
"""Okabe & Ito's colours, for lines."""


def unwrapped(portraits: Portraits) -> Figure:
    """Draw radius against the angle along each stream, with the fitted apocentres and the data."""
    figure, panels = panel_grid(len(portraits), 5.4, 3.3, across=2, share=True)
    limits = []
    for axes, (title, portrait) in zip(panels, portraits.items(), strict=False):
        draw_unwrapped(portrait.stream, portrait.prediction, portrait.setup, axes)
        limits.append((*axes.get_xlim(), axes.get_ylim()[1]))
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
        axes.plot(0, stream.orbit.r[-1], marker="*", ms=11, color="black", mec="white", ls="none", zorder=6)
        if free.any():
            low, high = np.percentile(angle[free], [0.2, 99.8])
            limits.append((high + 15, low - 15, float(np.percentile(stream.r[free], 99.8))))
        axes.set_title(title, fontsize=10)
        finish(axes)
    if portraits:
        look: dict[str, Any] = {"framealpha": 0.85, "edgecolor": "none", "markerscale": 5, "fontsize": 8}
        panels[0].legend(title="stripped", title_fontsize=8, **look)
    _share(figure, panels, limits)
    return figure


def _share(figure: Figure, panels: list[Axes], limits: list[tuple[float, float, float]]) -> None:
    """Give all panels, which share their axes, limits (left, right, top) that suit most of them, and their labels."""
    if limits:
        left, right, top = (float(np.median(column)) for column in zip(*limits, strict=True))
        panels[0].set(xlim=(left, right), ylim=(0, 1.05 * top))
        panels[0].xaxis.set_major_locator(MultipleLocator(90 if left - right < 720 else 180))
    label_all(figure, "angle along the stream [deg]  (leading > 0)", r"$r\ \,[{\rm kpc}]$")


def _apocentres(stream: Stream) -> Array:
    """Return the times of the progenitor's apocentres, without one at the very start of its track."""
    times = stream.orbit.apocentres()
    return np.asarray(times[times > 0.98 * stream.orbit.t[0]])


def _gyr(t: float, stream: Stream) -> str:
    return f"{np.clip(t, stream.orbit.t[0], 0.0) / GYR:.2g}"


def along(portraits: Portraits) -> Figure:
    """Draw what runs along the streams: density, and the distance of the mean track from the first one's."""
    figure = Figure(figsize=(11.0, 7.0), layout="constrained")
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
    reach = max(1.3 * float(np.percentile(np.abs(np.concatenate(offsets)), 93)), 1.0)
    ends = [portrait.ends for portrait in portraits.values()]
    low, high = np.median(ends, axis=0) if ends else (-180.0, 180.0)
    bottom.set(xlim=(high + 40, low - 40), ylim=(-reach, reach))
    bottom.xaxis.set_major_locator(MultipleLocator(90))
    top.set_ylabel("particles per degree / all unbound", fontsize=11)
    bottom.set_ylabel(rf"mean $r$ $-$ that of {next(iter(portraits), 'the first')} $[{{\rm kpc}}]$", fontsize=11)
    bottom.set_xlabel("angle along the stream [deg]  (leading > 0)", fontsize=11)
    for axes in (top, bottom):
        finish(axes)
    if portraits:
        figure.legend(fontsize=9, frameon=False, ncols=3, loc="outside lower center")
    return figure
