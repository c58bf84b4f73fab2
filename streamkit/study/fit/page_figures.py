"""Pictures for the page of a run that no other product shows: ranks, prediction and data, posterior and prior."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from streamkit.report import BAND_68, BAND_95, BLUE, GREY, VERMILION, finish, labels, panel_grid
from streamkit.stream import Array
from streamkit.study.fit.evidence import Predictive, ranks
from streamkit.study.fit.results import Results


def rank_plots(results: Results) -> Figure:
    """Draw for every parameter how far each walker's ranks are from even (Vehtari+ 2021, sec. 4; Saeilynoja+ 2022).

    One line a walker: the share of its ranks below a value, minus that value. The band holds 95 % of what as many
    independent samples as the walker has would show at each value.
    """
    kept = results.kept
    found = np.sort(ranks(kept), axis=0)
    steps, walkers, d = kept.shape
    figure, panels = panel_grid(d, 2.6, 1.9, share=True)
    u, below = np.linspace(0, 1, 101), (np.arange(steps) + 0.5) / steps
    for axes, own, n, name in zip(panels, np.moveaxis(found, 2, 0), steps / results.tau, _names(results), strict=False):
        if np.isfinite(n):
            spread = 1.96 * np.sqrt(u * (1 - u) / n)
            axes.fill_between(u, -spread, spread, color=BAND_95, lw=0)
        for walker in own.T:
            lines = np.interp(u, walker, below, left=0, right=1) - u
            axes.plot(u, lines, color=GREY, lw=0.6, alpha=min(1.0, max(0.3, 10 / walkers)))
        axes.axhline(0, color=BLUE, lw=1.2)
        axes.set_title(name, fontsize=11)
        axes.set_xlim(0, 1)
        finish(axes)
    figure.supxlabel("rank of the sample, over the number of samples", fontsize=11)
    figure.supylabel("walker's share below, minus the rank", fontsize=11)
    return figure


def predicted_data(seen: Predictive, most: int = 12) -> Figure:
    """Draw each datum with its error over the distribution that the posterior predicts; the farthest of many data."""
    chosen = np.sort(np.argsort(-np.abs(seen.deviations))[:most])
    figure, panels = panel_grid(len(chosen), 3.0, 2.1, share=False)
    rng = np.random.default_rng(0)
    for axes, k in zip(panels, chosen, strict=False):
        mean, datum, error = seen.mean[:, k], seen.data[k], seen.errors[k]
        replicated = mean + np.sqrt(seen.total[:, k]) * rng.standard_normal(len(mean))
        axes.axvspan(datum - error, datum + error, color="#F6D5BF", lw=0)
        axes.axvline(datum, color=VERMILION, lw=1.8, label="datum")
        bins = np.histogram_bin_edges(np.concatenate([replicated, mean]), 40).tolist()
        axes.hist(replicated, bins, density=True, color=BAND_68, label="new data")
        axes.hist(mean, bins, density=True, histtype="step", color=BLUE, lw=1.4, label="model")
        axes.set_title(f"{seen.names[k]}: {seen.deviations[k]:+.1f} sigma", fontsize=11)
        axes.set_yticks([])
        finish(axes)
    panels[0].legend(frameon=False, fontsize=9)
    return figure


def priors_and_posteriors(results: Results, fractions: list[Array]) -> Figure:
    """Draw every posterior, as a histogram of fractions of its prior: flat at 1 where the data say nothing."""
    figure, panels = panel_grid(len(fractions), 2.6, 1.7, share=True)
    edges = np.linspace(0, 1, 26)
    for axes, u, name in zip(panels, fractions, _names(results), strict=False):
        axes.hist(u, edges.tolist(), density=True, color=BAND_68)
        axes.axhline(1, color=VERMILION, lw=1.2, ls="--")
        axes.set_title(name, fontsize=11)
        axes.set_xlim(0, 1)
        finish(axes)
    panels[0].set_yscale("symlog", linthresh=2)
    figure.supxlabel("fraction of the prior below", fontsize=11)
    figure.supylabel("posterior over prior", fontsize=11)
    return figure


def _names(results: Results) -> list[str]:
    return [name.replace("\n", "") for name in labels(results.names, results.spec.symbols)]
