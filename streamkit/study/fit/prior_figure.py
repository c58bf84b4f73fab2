"""The picture of prior and posterior beside each other, a panel for every parameter."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from streamkit.report import BAND_68, BLUE, VERMILION, finish, inner_ticks, labels, panel_grid, scaled, with_unit
from streamkit.runfile import Prior
from streamkit.stream import Array
from streamkit.study.fit.figures import remark
from streamkit.study.fit.results import Results

WIDE, HIGH = 2.5, 1.9  # inches of a panel
ZOOM = 0.15  # share of the prior's range below which the picture shows only the surroundings of the posterior


def priors(results: Results) -> Figure:
    """Draw every posterior as a histogram, and the density of its prior as a dashed line in the same units.

    If the posterior fills a small part of the prior, the picture shows the surroundings of this part.
    """
    spec, samples = results.spec, results.samples
    figure, panels = panel_grid(samples.shape[1], WIDE, HIGH, share=False)
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
    axes.set_xticks(inner_ticks(x[0] / scale, x[-1] / scale, WIDE))
