"""Rank plots of a chain, for the page of a run."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from streamkit.report import BAND_95, BLUE, GREY, finish, panel_grid
from streamkit.stream import Array
from streamkit.study.fit.chain_statistics import ranks


def rank_plots(kept: Array, tau: Array, labels: Sequence[str]) -> Figure:
    """Draw for every parameter how far each walker's ranks are from even (Vehtari+ 2021, sec. 4; Saeilynoja+ 2022).

    One line a walker: the share of its ranks below a value, minus that value. The band holds 95 % of what as many
    independent samples as the walker has would show at each value.

    ``kept`` are samples (steps, walkers, d), ``tau`` autocorrelation times (d,) in steps.
    """
    by_rank = np.sort(ranks(kept), axis=0)
    steps, walkers, d = kept.shape
    figure, panels = panel_grid(d, 2.6, 1.9, share=True)
    u, below = np.linspace(0, 1, 101), (np.arange(steps) + 0.5) / steps
    for axes, walkers_ranks, n, name in zip(panels, np.moveaxis(by_rank, 2, 0), steps / tau, labels, strict=False):
        if np.isfinite(n):
            spread = 1.96 * np.sqrt(u * (1 - u) / n)
            axes.fill_between(u, -spread, spread, color=BAND_95, lw=0)
        for walker in walkers_ranks.T:
            lines = np.interp(u, walker, below, left=0, right=1) - u
            axes.plot(u, lines, color=GREY, lw=0.6, alpha=min(1.0, max(0.3, 10 / walkers)))
        axes.axhline(0, color=BLUE, lw=1.2)
        axes.set_title(name.replace("\n", ""), fontsize=11)
        axes.set_xlim(0, 1)
        finish(axes)
    figure.supxlabel("rank of the sample, over the number of samples", fontsize=11)
    figure.supylabel("walker's share below, minus the rank", fontsize=11)
    return figure
