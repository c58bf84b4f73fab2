"""The picture of a calibration: the ranks of the truths against the uniform distribution."""

from __future__ import annotations

from typing import Any

import numpy as np
from arviz_stats.ecdf_utils import ecdf_pit
from matplotlib.figure import Figure

from streamkit.report import BAND_95, BLUE, GREY, VERMILION, finish, label_all, labels, panel_grid
from streamkit.study.calibration.draw import MASS_RADII
from streamkit.study.calibration.runner import Calibration

SIMULATIONS = 2000  # sets of uniform ranks from which the band is computed


def calibration_figure(calibration: Calibration) -> Figure:
    """Draw the empirical distribution of the ranks less the uniform one, with its simultaneous 95 % band.

    Inside the band the intervals have their stated coverage. A hump to the left with a dip to the right is a posterior
    that is too narrow; the reverse is one that is too wide; a hump alone is a bias (Saeilynoja, Buerkner & Vehtari
    2022). A mass with the same ranks as a parameter, because the parameter is this mass, is left out.
    """
    names = [
        *labels(calibration.spec.names, calibration.spec.symbols),
        *(rf"$M({r:g}\,{{\rm kpc}})$" for r in MASS_RADII),
    ]
    ranks = calibration.every_rank
    shown = [i for i in range(len(names)) if not any(np.array_equal(ranks[:, i], ranks[:, j]) for j in range(i))]
    figure, panels = panel_grid(len(shown), 2.3, 1.9, share=True)
    rng = np.random.default_rng(0)
    for axes, i in zip(panels, shown, strict=True):
        column = ranks[:, i]
        band: Any = ecdf_pit  # has no types
        x, ecdf, low, high = (np.asarray(each, dtype=float) for each in band(column, 0.95, SIMULATIONS, rng=rng))
        axes.fill_between(x, low - x, high - x, color=BAND_95, lw=0, step="post")
        axes.axhline(0.0, color=GREY, lw=0.8)
        outside = bool(((ecdf < low) | (ecdf > high)).any())
        axes.step(x, ecdf - x, where="post", color=VERMILION if outside else BLUE, lw=1.3)
        axes.set_title(names[i], fontsize=11)
        axes.set_xlim(0.0, 1.0)
        finish(axes)
    label_all(
        figure, f"rank of the truth among the posterior samples, {len(calibration.draws)} draws", "ECDF - uniform"
    )
    return figure
