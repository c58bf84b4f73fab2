"""Pictures of a run: one function each, on figures of their own, with no global state."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from operator import itemgetter
from typing import Any

import numpy as np
from astropy.table import QTable
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import ScalarFormatter

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
    BOTH,
    COLUMN,
    SMALLEST,
    VERMILION,
    NotebookFigure,
    across,
    decimals,
    finish,
    inner_ticks,
    labels,
    panel_grid,
    scaled,
    ticks,
    with_unit,
)
from streamkit.runfile import Prior
from streamkit.stream import Array

FEW = 200  # samples below which a corner plot shows points without contours
FEW_RADII = 4  # largest number of radii of the data that are marked by a line each
WIDE = 6.0  # inches: pictures of profiles
FEW_PARAMETERS = 4  # largest number of parameters in a corner plot of one column of a journal
TITLED = 0.95  # smallest width in inches of a panel with a title
GAP = 0.11  # inches between the panels of a corner plot


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
    return np.linspace(first, last, 79)


def remark(results: Results) -> str:
    """Return the caveat printed above every picture; empty where no check says "do not use"."""
    if results.quick:
        return "QUICK LOOK, not for science"
    if results.draws.lacks:
        return "not converged"
    against = [each.subject for each in results.verdicts if each.level == DO_NOT]
    return f"do not use: {listed(against)}" if against else ""


def corner(results: Results, column: bool = False) -> Figure:
    """Draw the marginal distributions of all pairs of parameters, with 68 % and 95 % contours.

    For a journal it is as wide as one ``column`` up to `FEW_PARAMETERS`, else as two; small panels have no titles.
    """
    from corner import corner as draw  # it loads pyplot, which is slow and only needed here

    scale, names, units = _labels(results)
    samples, d = results.samples / scale, len(names)
    text = remark(results)
    panel = 2.6 if d == 1 else 2.0 if d < 7 else 1.7
    titles = [_title(name, column) for name, column in zip(names, samples.T, strict=True)]
    lines = 1 + max(map(_lines, names))
    part = 1.0  # of all texts and margins
    if column:
        part = 0.6
        sides = part * ((0.4 if d == 1 else 1.0 + 0.3 * lines) + 0.7)
        panel = ((COLUMN if d <= FEW_PARAMETERS else BOTH) - sides - GAP * (d - 1)) / d
        titles = titles if panel > TITLED else [""] * d
    letters = 14 * part if panel > TITLED else max(14 * part * panel / TITLED, SMALLEST)
    left, right = part * (0.4 if d == 1 else 1.0 + 0.3 * lines), part * 0.7
    bottom, top = part * (0.45 + 0.26 * lines), part * (0.25 + 0.22 * _lines(titles[0]) + (0.4 if text else 0))
    width, height = (panel * d + GAP * (d - 1) + sides for sides in (left + right, bottom + top))
    figure = NotebookFigure(figsize=(width, height))
    many = len(samples) >= FEW
    logging.getLogger("root").addFilter(_no_contour_warning)
    try:
        draw(
            samples,
            fig=figure,
            range=[_range(column) for column in samples.T],
            bins=30 if many else 12,
            color=BLUE,
            smooth=1.0 if many else None,
            levels=(0.68, 0.95),
            plot_contours=many,
            plot_density=many,
            plot_datapoints=not many,
            fill_contours=many,
            hist_kwargs={"linewidth": 1.4},
            data_kwargs={"alpha": 0.5, "ms": 2},
        )
    finally:
        logging.getLogger("root").removeFilter(_no_contour_warning)
    grid = np.array(figure.axes).reshape(d, d)
    for i, (name, unit, title) in enumerate(zip(names, units, titles, strict=True)):
        grid[i, i].set_title(title, fontsize=max(12 * part, SMALLEST), loc="left")
        low, middle, high = np.percentile(samples[:, i], [16, 50, 84])
        for value, style in ((low, ":"), (middle, "--"), (high, ":")):
            grid[i, i].axvline(value, color="black", lw=0.9, ls=style)
        values = inner_ticks(*_range(samples[:, i]), panel / part * (0.8 if column else 1.0))
        for axes in grid[i:, i]:
            axes.set_xticks(values)
        for axes in grid[i, :i]:
            axes.set_yticks(values)
        grid[-1, i].set_xlabel(with_unit(name, unit, "\n"), fontsize=letters)
        grid[-1, i].xaxis.set_label_coords(0.5, -0.33 * part / panel)
        if i:
            grid[i, 0].set_ylabel(with_unit(name, unit, "\n"), fontsize=letters)
            grid[i, 0].yaxis.set_label_coords(-0.85 * part / panel, 0.5)
    for axes in figure.axes:
        axes.tick_params(labelsize=max(11 * part, SMALLEST), labelrotation=0, direction="in", top=True, right=True)
        for axis in (axes.xaxis, axes.yaxis):
            if isinstance(formatter := axis.get_major_formatter(), ScalarFormatter):
                formatter.set_useOffset(False)
    figure.subplots_adjust(
        left=left / width, right=1 - right / width, bottom=bottom / height, top=1 - top / height,
        wspace=GAP / panel, hspace=GAP / panel,
    )  # fmt: skip
    if text:
        figure.text(
            1 - 0.2 / width,
            1 - 0.15 / height,
            text,
            color=VERMILION,
            fontsize=part * (14 if d < 4 else 20),
            ha="right",
            va="top",
        )
    return figure


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
    """Return a figure ``wide`` inches wide, and its axes over radii (nr,) in kpc, with the radii of the data.

    The range beyond the `reach` of stream and data is shaded.
    """
    figure = NotebookFigure(figsize=(wide, 0.75 * wide), layout="constrained")
    axes, narrow = figure.subplots(), wide < WIDE
    axes.set_xlim(r[0], r[-1])
    low, high = reach(results)
    shade: Any = {"color": "#EDEDED", "lw": 0, "zorder": 0.5}
    axes.axvspan(min(r[0], low), low, **shade)
    axes.axvspan(high, max(r[-1], high), **shade, label="extrapolated")
    data_radii(axes, results)
    axes.set_xlabel(r"$r\ \,[{\rm kpc}]$", fontsize=9 if narrow else 13)
    axes.set_ylabel(label, fontsize=9 if narrow else 13)
    if text := remark(results):
        axes.set_title(text, color=VERMILION, fontsize=8 if narrow else 12)
    ticks(axes)
    if narrow:
        axes.tick_params(labelsize=8)
    return figure, axes


def traces(results: Results) -> Figure:
    """Draw the traces of every parameter and of ln p, by `Draws.draw_trace`."""
    d = len(results.names)
    scale, labels_of, units = _labels(results)
    figure, panels = panel_grid(d + 1, 4.3, 1.75, across=3, share=True, share_y=False)
    between = ["\n" if len(name) > (25 if "$" in name else 8) else " " for name in labels_of]
    names = [with_unit(*each) for each in zip(labels_of, units, between, strict=True)]
    names.append(results.draws.last_trace)
    for i, (axes, name) in enumerate(zip(panels, names, strict=True)):
        parameter = i if i < d else None
        results.draws.draw_trace(axes, parameter, 1.0 if parameter is None else scale[i])
        axes.set_ylabel(name, fontsize=12)
        ticks(axes)
    x_label, legend = results.draws.trace
    figure.supxlabel(x_label, fontsize=12)
    text = remark(results)
    figure.suptitle(f"{text} ({legend})" if text else legend, fontsize=11, color=VERMILION if text else "black")
    return figure


def _no_contour_warning(record: logging.LogRecord) -> bool:
    """Silence corner's warning about sparse contours: the picture shows as much."""
    return "Too few points to create valid contours" not in record.getMessage()


def levels(profile: QTable, name: str, factor: float) -> dict[str, Array]:
    """Return median and intervals (nr,) of one quantity of a profile, times the factor, by the names of `LEVELS`."""
    return {level: profile[f"{name}_{level}".rstrip("_")].value * factor for level in LEVELS}


def bands(axes: Axes, r: Array, values: Mapping[str, Array]) -> None:
    """Draw a median with its 68 % and 95 % bands at radii (nr,) as `levels` returns them."""
    axes.fill_between(r, values["lo95"], values["hi95"], color=BAND_95, lw=0, label="95 %")
    axes.fill_between(r, values["lo68"], values["hi68"], color=BAND_68, lw=0, label="68 %")
    axes.plot(r, values[""], color=BLUE, lw=1.8, label="median")


def data_radii(axes: Axes, results: Results) -> None:
    """Mark the radii of the data: a few by dashed lines with names, many by the range of each stream or table."""
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
        axes.annotate(
            text, (radius, 0.02), (3 * side, 0), xycoords=axes.get_xaxis_transform(), textcoords="offset points",
            rotation=90, fontsize=8, ha="right" if side < 0 else "left", va="bottom", annotation_clip=True,
        )  # fmt: skip


def _draw_ranges(axes: Axes, sources: Mapping[str, Mapping[str, float]]) -> None:
    """Draw the range of radii of each source as a line along the bottom, with its name beside it."""
    place, figure = axes.get_xaxis_transform(), axes.get_figure(root=True)
    size = 8 if figure is not None and figure.get_figwidth() >= WIDE else 6
    ranges = sorted((min(of_source.values()), max(of_source.values()), name) for name, of_source in sources.items())
    for row, (first, last, name) in enumerate(ranges):
        height = 0.03 + 0.045 * row
        axes.plot([first, last], [height, height], color="black", lw=1.2, marker="|", ms=6, transform=place)
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


def _labels(results: Results) -> tuple[Array, list[str], list[str]]:
    """(d,) Powers of ten that large parameters are divided by, the name of each in a picture, and its unit."""
    typical = np.median(np.abs(results.samples), axis=0)
    scales_and_units = [scaled(*each) for each in zip(results.spec.units, typical.tolist(), strict=True)]
    scales, units = zip(*scales_and_units, strict=True)
    return np.array(scales), labels(results.names, results.spec.symbols), list(units)


def _lines(text: str) -> int:
    return text.count("\n") + 1


def _title(name: str, values: Array) -> str:
    """Return the median and 68 % interval of a parameter as a title, below its name if that is long."""
    between = " = " if name.startswith("$") and "\n" not in name else "\n"
    low, middle, high = np.percentile(values, [16, 50, 84])
    digits = decimals(min(high - middle, middle - low))
    return rf"{name}{between}${middle:.{digits}f}^{{+{high - middle:.{digits}f}}}_{{-{middle - low:.{digits}f}}}$"


def _range(values: Array) -> tuple[float, float]:
    low, high = np.percentile(values, [0.2, 99.8])
    margin = 0.08 * (high - low) or 1e-3 * max(abs(low), 1.0)
    return float(low - margin), float(high + margin)


PANEL = (2.5, 1.9)  # inches of a panel with a prior
ZOOM = 0.15  # fraction of the prior's range below which the picture shows only the surroundings of the posterior


def priors(results: Results) -> Figure:
    """Draw every posterior as a histogram, and the density of its prior as a dashed line in the same units.

    If the posterior fills a small part of the prior, the picture shows the surroundings of this part.
    """
    spec, samples = results.spec, results.samples
    figure, panels = panel_grid(samples.shape[1], *PANEL, share=False)
    names = labels(results.names, spec.symbols)
    for axes, prior, name, unit, values in zip(panels, spec.priors, names, spec.units, samples.T, strict=False):
        scale, shown = scaled(unit, float(np.median(np.abs(values))))
        _panel(axes, prior, values, scale)
        axes.set_xlabel(with_unit(name.replace("\n", ""), shown), fontsize=11)
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
