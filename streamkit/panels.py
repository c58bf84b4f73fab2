"""What the pictures of several streams share: portraits by title, panels in rows, and how many particles are drawn."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from streamkit.comparison import Portrait
from streamkit.phase import BoolArray, IntArray, Stream

Portraits = Mapping[str, Portrait]
ACROSS = 4
"""Most panels beside each other."""
SHOWN = 6500
"""Most particles drawn per panel: the same random number of each stream, as in Gibbons+ 2014, figure 6."""


def grid(n: int, width: float, height: float, *, across: int = ACROSS, share: bool) -> tuple[Figure, list[Axes]]:
    """Return a figure and n panels, in rows of at most ``across``."""
    columns = max(min(n, across), 1)
    rows = max(-(-n // columns), 1)
    figure = Figure(figsize=(width * columns + 0.9, height * rows + 0.5), layout="constrained")
    panels: Any = figure.subplots(rows, columns, squeeze=False, sharex=share, sharey=share)
    every = list(panels.flat)
    for axes in every[n:]:
        axes.set_visible(False)
    for axes in every[max(n - columns, 0) : n]:
        axes.tick_params(labelbottom=True)
    return figure, every[: max(n, 1)]


def typical(reaches: Iterable[float]) -> float:
    """Return how far the axes must reach for most streams: one outlier must not shrink all the others."""
    known = list(reaches)
    return 1.15 * float(np.median(known)) if known else 1.0


def labels(figure: Figure, x: str, y: str) -> None:
    """Label all panels at once."""
    figure.supxlabel(x, fontsize=11)
    figure.supylabel(y, fontsize=11)


def some(stream: Stream, chosen: BoolArray) -> IntArray:
    """Return the chosen particles to draw: at random by their weights, at most `SHOWN` of all unbound ones."""
    free = ~stream.bound
    index = np.flatnonzero(chosen)
    share = stream.weight / stream.weight[free].max(initial=0.0)
    share *= min(SHOWN / max(float(share[free].sum()), 1.0), 1.0)
    return np.asarray(index[np.random.default_rng(0).random(len(index)) < share[index]])
