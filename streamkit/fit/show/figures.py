"""Pictures of a run: one function each, on figures of their own, with no global state."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from operator import itemgetter
from typing import Any

import numpy as np
from astropy.table import QTable
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from streamkit.components import DO_NOT
from streamkit.errors import OutOfDomain
from streamkit.fit.judge.chain import listed
from streamkit.fit.samples.results import Results
from streamkit.fit.samples.tables import LEVELS
from streamkit.fit.show.literature import draw_literature
from streamkit.observe import radii_of
from streamkit.report import (
    BAND_68,
    BAND_95,
    BLUE,
    VERMILION,
    NotebookFigure,
    across,
    finish,
    inner_ticks,
    labels,
    panel_grid,
    scaled,
    ticks,
    with_unit,
)
from streamkit.runfile import Prior
from streamkit.stream import Array, IntArray

MANY_PARAMETERS = 12  # largest number of parameters of several streams in a picture
FEW_RADII = 4  # largest number of radii of the data that are marked by a line each
POINTS = 5.0  # of a letter of a name, on average and amply, at 8 points
WIDE = 6.0  # inches: pictures of profiles
NAMED, MANY_RANGES = 12, 0.3  # most ranges of radii with a name each; the height of more, as a fraction of the axes


def reach(results: Results) -> tuple[float, float]:
    """Return the range of radii in kpc where the data say something; 10 to 130 without any.

    It begins at the pericentre of the best stream, which its debris has passed. It ends at the outermost datum, however
    far the orbit goes; at the outermost debris of a stream whose data have no radii.
    """
    data = _data_radii(results)
    inner, outer = ([radius for each in data.values() for radius in each.values()] for _ in range(2))
    try:
        streams = results.best_observation.streams
    except OutOfDomain:  # another machine's rounding may lose a stream at the edge
        streams = {}
    for name, stream in streams.items():
        debris = stream.r if stream.bound.all() else stream.r[~stream.bound]
        first, last = np.percentile(debris, [0.5, 99.5])
        inner += [stream.orbit.r.min(), first]
        outer += [] if name in data else [last]
    return (float(min(inner)), float(max(outer))) if outer else (10.0, 130.0)


def radii(results: Results, literature: QTable | None = None) -> Array:
    """(nr,) Radii in kpc of the pictures of a profile: beyond the `reach` and published values."""
    low, high = reach(results)
    first, last = 0.5 * low, 1.5 * high
    if literature is not None and len(literature):
        z = np.nan_to_num(np.asarray(literature["z"], dtype=float))
        place = np.hypot(np.asarray(literature["radius"], dtype=float), z)
        first, last = min(first, 0.8 * float(place.min())), max(last, 1.1 * float(place.max()))
    return np.geomspace(first, last, 79)  # dense where a rotation curve bends: a line through them looks smooth


def remark(results: Results) -> str:
    """Return the caveat printed above every picture; empty where no check says "do not use"."""
    if results.quick:
        return "QUICK LOOK, not for science"
    if results.draws.lacks:
        return "not converged"
    against = [each.subject for each in results.verdicts if each.level == DO_NOT]
    return f"do not use: {listed(against)}" if against else ""


def mass_profile(results: Results, literature: QTable | None = None, wide: float = WIDE) -> Figure:
    """Draw the mass inside each radius with its 68 % and 95 % bands, the radii of the data and published values."""
    return _profile(results, literature, "M", 1e-11, r"$M(<r)\ \,[10^{11}\,M_\odot]$", wide)


def rotation_curve(results: Results, literature: QTable | None = None, wide: float = WIDE) -> Figure:
    """Draw the circular velocity with its 68 % and 95 % bands, the radii of the data and published values."""
    return _profile(results, literature, "v_c", 1.0, r"$v_{\rm c}(r)\ \,[{\rm km\,s}^{-1}]$", wide)


def _profile(results: Results, literature: QTable | None, name: str, factor: float, label: str, wide: float) -> Figure:
    """Draw one column of a profile, ``wide`` inches wide."""
    rows = None if literature is None else literature[[quantity == name for quantity in literature["quantity"]]]
    profile = results.mass_profile(radii(results, rows))
    r = profile["r"].value
    figure, axes = profile_axes(results, r, label, wide)
    bands(axes, r, levels(profile, name, factor))
    if rows is not None:
        draw_literature(axes, rows, name, factor)
    data_radii(axes, results)
    legend_above(figure, axes)
    return figure


def legend_above(figure: Figure, axes: Axes) -> None:
    """Put the legend above the axes of a profile, where it covers no curve, and increase the figure's height for it."""
    handles, entries = axes.get_legend_handles_labels()
    wide, high = figure.get_size_inches()
    size = 7.0 if wide < WIDE else 10.0
    columns = min(across(entries, 0.95 * wide, size), len(entries), 4)
    figure.set_size_inches(wide, high + -(-len(entries) // columns) * 1.7 * size / 72)
    figure.legend(handles, entries, loc="outside upper left", frameon=False, ncols=columns, fontsize=size)


def profile_axes(results: Results, r: Array, label: str, wide: float) -> tuple[Figure, Axes]:
    """Return a figure ``wide`` inches wide, and its axes over radii (nr,) in kpc.

    The range beyond the `reach` of stream and data is shaded.
    """
    figure = NotebookFigure(figsize=(wide, 0.75 * wide), layout="constrained")
    axes, narrow = figure.subplots(), wide < WIDE
    axes.set_xlim(r[0], r[-1])
    low, high = reach(results)
    shade: Any = {"color": "#EDEDED", "lw": 0, "zorder": 0.5}
    axes.axvspan(min(r[0], low), low, **shade)
    axes.axvspan(high, max(r[-1], high), **shade, label="extrapolated")
    axes.set_xlabel(r"$r\ \,[{\rm kpc}]$", fontsize=9 if narrow else 13)
    axes.set_ylabel(label, fontsize=9 if narrow else 13)
    if text := remark(results):
        axes.set_title(text, color=VERMILION, fontsize=8 if narrow else 12)
    ticks(axes)
    if narrow:
        axes.tick_params(labelsize=8)
    return figure, axes


def traces(results: Results) -> Figure:
    """Draw the traces of the parameters and of ln p, by `Draws.draw_trace`."""
    shown, scale, labels_of, units = parameters_of(results)
    d = len(shown)
    figure, panels = panel_grid(d + 1, 4.3, 1.75, across=3, share=True, share_y=False)
    between = ["\n" if len(name) > (25 if "$" in name else 8) else " " for name in labels_of]
    names = [with_unit(*each) for each in zip(labels_of, units, between, strict=True)]
    names.append(results.draws.last_trace)
    for i, (axes, name) in enumerate(zip(panels, names, strict=True)):
        parameter = int(shown[i]) if i < d else None
        results.draws.draw_trace(axes, parameter, 1.0 if parameter is None else scale[i])
        axes.set_ylabel(name, fontsize=12)
        ticks(axes)
    x_label, legend = results.draws.trace
    figure.supxlabel(x_label, fontsize=12)
    text = remark(results)
    figure.suptitle(f"{text} ({legend})" if text else legend, fontsize=11, color=VERMILION if text else "black")
    return figure


def levels(profile: QTable, name: str, factor: float) -> dict[str, Array]:
    """Return median and intervals (nr,) of one quantity of a profile, times the factor, by the names of `LEVELS`."""
    return {level: profile[f"{name}_{level}".rstrip("_")].value * factor for level in LEVELS}


def bands(axes: Axes, r: Array, values: Mapping[str, Array]) -> None:
    """Draw a median with its 68 % and 95 % bands at radii (nr,) as `levels` returns them."""
    axes.fill_between(r, values["lo95"], values["hi95"], color=BAND_95, lw=0, label="95 %")
    axes.fill_between(r, values["lo68"], values["hi68"], color=BAND_68, lw=0, label="68 %")
    axes.plot(r, values[""], color=BLUE, lw=1.8, label="median")


def data_radii(axes: Axes, results: Results) -> None:
    """Mark the radii of the data: a few by dashed lines with names, many by the range of each stream or table.

    A name stands at the bottom or at the top, away from the median that has been drawn.
    """
    sources = _data_radii(results)
    if sum(map(len, sources.values())) > FEW_RADII:
        _draw_ranges(axes, sources)
        return
    shown, before = np.ptp(axes.get_xlim()), -np.inf
    marks = {
        label if len(sources) == 1 else f"{name}: {label}": radius
        for name, of_source in sources.items()
        for label, radius in of_source.items()
    }
    for text, radius in sorted(marks.items(), key=itemgetter(1)):
        axes.axvline(radius, color="black", lw=0.9, ls="--")
        side, before = -1 if radius - before > 0.04 * shown else 1, radius  # left of the line if there is room
        height = height_of_median(axes, radius)
        low = height < 0.5
        axes.annotate(
            folded(axes, text, max(height, 1 - height)), (radius, 0.98 if low else 0.02), (3 * side, 0),
            xycoords=axes.get_xaxis_transform(), rotation=90, textcoords="offset points", fontsize=8,
            ha="right" if side < 0 else "left", va="top" if low else "bottom", annotation_clip=True,
        )  # fmt: skip


def folded(axes: Axes, text: str, room: float) -> str:
    """Return a name in lines that fit into a fraction of the axes' height, if its words are short enough."""
    figure = axes.get_figure(root=True)
    points = axes.get_window_extent().height * 72 / (figure.dpi if figure is not None else 72)
    return textwrap.fill(text, max(int(0.9 * room * points / POINTS), 1), break_long_words=False)


def height_of_median(axes: Axes, radius: float) -> float:
    """Return where the line called median passes a radius, as a fraction of the axes' height; 1 without one."""
    line = next((each for each in axes.lines if str(each.get_label()).startswith("median")), None)
    if line is None:
        return 1.0
    (low, high), values = axes.get_ylim(), np.asarray(line.get_ydata(), dtype=float)
    return float((np.interp(radius, np.asarray(line.get_xdata(), dtype=float), values) - low) / (high - low))


def _draw_ranges(axes: Axes, sources: Mapping[str, Mapping[str, float]]) -> None:
    """Draw the range of radii of each source as a line, where no median is; a few with their names."""
    place, figure = axes.get_xaxis_transform(), axes.get_figure(root=True)
    size = 8 if figure is not None and figure.get_figwidth() >= WIDE else 6
    ranges = sorted((min(of_source.values()), max(of_source.values()), name) for name, of_source in sources.items())
    few = len(ranges) <= NAMED
    heights = 0.03 + (0.045 if few else MANY_RANGES / len(ranges)) * np.arange(len(ranges))
    if np.mean([height_of_median(axes, first) for first, _, _ in ranges]) < 0.5:
        heights = 1 - heights
    for height, (first, last, name) in zip(heights.tolist(), ranges, strict=True):
        axes.plot([first, last], [height, height], color="black", lw=1.2 if few else 0.7, marker="|",
                  ms=6 if few else 2, transform=place)  # fmt: skip
        if not few:
            continue
        axes.annotate(
            name.replace("_", " "), (last, height), (6, 0), xycoords=place, textcoords="offset points", fontsize=size,
            va="center",
        )  # fmt: skip


def _data_radii(results: Results) -> dict[str, dict[str, float]]:
    """Return the radii in kpc of the data by stream or table of host data, and by name; only of data with radii."""
    bound = results.spec.bind_all(results.best())
    sources = {name or "stream": radii_of(inputs.observables) for name, inputs in bound.streams.items()}
    sources |= {name or "host": data.radii() for name, data in bound.data.items()}
    return {name: of_source for name, of_source in sources.items() if of_source}


def parameters_of(results: Results) -> tuple[IntArray, Array, list[str], list[str]]:
    """Return the parameters that pictures show, for each the power of ten it is divided by, its name and its unit.

    Of more than `MANY_PARAMETERS` of several streams these are the ones that the streams share.
    """
    every, shared = np.arange(len(results.names)), results.spec.factors[0].shared
    shown = (shared if len(shared) else every[:MANY_PARAMETERS]) if are_too_many(results) else every
    typical = np.median(np.abs(results.samples), axis=0)
    scales_and_units = [scaled(results.spec.units[k], float(typical[k])) for k in shown.tolist()]
    scales, units = zip(*scales_and_units, strict=True)
    names, symbols = ([each[k] for k in shown.tolist()] for each in (results.names, results.spec.symbols))
    return shown, np.array(scales), labels(names, symbols), list(units)


def are_too_many(results: Results) -> bool:
    """Return whether pictures of parameters show only those that several streams share."""
    return len(results.spec.streams) > 1 and len(results.names) > MANY_PARAMETERS


PANEL = (2.5, 1.9)  # inches of a panel with a prior
ZOOM = 0.15  # fraction of the prior's range below which the picture shows only the surroundings of the posterior


def priors(results: Results) -> Figure:
    """Draw posteriors as histograms, and the density of each prior as a dashed line in the same units.

    If the posterior fills a small part of the prior, the picture shows the surroundings of this part.
    """
    shown, scales, names, units = parameters_of(results)
    figure, panels = panel_grid(len(shown), *PANEL, share=False)
    for axes, k, scale, name, unit in zip(panels, shown.tolist(), scales.tolist(), names, units, strict=False):
        _panel(axes, results.spec.priors[k], results.samples[:, k], scale)
        axes.set_xlabel(with_unit(name.replace("\n", ""), unit), fontsize=11)
    figure.legend(
        *panels[0].get_legend_handles_labels(), loc="outside lower right", ncols=2, frameon=False, fontsize=10
    )
    figure.supylabel("probability density", fontsize=11)
    if text := remark(results):
        figure.suptitle(text, color=VERMILION, fontsize=12)
    return figure


def _panel(axes: Axes, prior: Prior, values: Array, scale: float) -> None:
    ends = prior.ppf(np.array([0.002, 0.998]))
    low, high = np.percentile(values, [0.1, 99.9])
    if high - low < ZOOM * np.ptp(ends):
        middle, half = 0.5 * (low + high), max(1.2 * (high - low), 1e-6 * float(np.ptp(ends)))
        ends = np.array([middle - half, middle + half])
    ends = np.array([min(ends[0], low), max(ends[1], high)])
    margin = 0.03 * np.ptp(ends)
    x = np.linspace(ends[0] - margin, ends[1] + margin, 400)
    density = np.exp([prior.lnpdf(value) for value in x.tolist()])
    bins = np.histogram_bin_edges(values, 30, (low, high) if high > low else None).tolist()
    axes.hist(values / scale, np.array(bins) / scale, density=True, color=BAND_68, label="posterior")  # type: ignore[arg-type]
    axes.hist(values / scale, np.array(bins) / scale, density=True, histtype="step", color=BLUE, lw=1.2)  # type: ignore[arg-type]
    axes.plot(x / scale, density * scale, color=VERMILION, lw=1.3, ls="--", label="prior")
    axes.set(xlim=(x[0] / scale, x[-1] / scale), ylim=(0, None))
    finish(axes)
    axes.set_yticks([])
    axes.minorticks_off()
    axes.set_xticks(inner_ticks(x[0] / scale, x[-1] / scale, PANEL[0]))
