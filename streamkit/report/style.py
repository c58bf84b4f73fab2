"""The style of all pictures: colours, symbols, ticks, panels."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable, Sequence
from io import BytesIO
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.textpath import TextPath
from matplotlib.ticker import MaxNLocator, MultipleLocator

from streamkit.stream import Array


class NotebookFigure(Figure):
    """A figure that shows itself as the last line of a notebook's cell, without pyplot."""

    def _repr_png_(self) -> bytes:
        buffer = BytesIO()
        self.savefig(buffer, format="png", dpi=100)
        return buffer.getvalue()


# Width in inches of one column of a journal and of two, and points of the smallest text in them.
COLUMN, BOTH, SMALLEST = 3.4, 7.1, 6.5
LETTER = 0.62  # mean width of a letter over the size of the font
ACROSS = 4  # most panels beside each other


def panel_grid(
    n: int, width: float, height: float, *, across: int = ACROSS, share: bool, share_y: bool = True
) -> tuple[Figure, list[Axes]]:
    """Return a figure and n panels, in rows of at most ``across``; they may share both axes, or the horizontal one."""
    columns = max(min(n, across), 1)
    rows = max(-(-n // columns), 1)
    figure = NotebookFigure(figsize=(width * columns + 0.9, height * rows + 0.5), layout="constrained")
    panels: Any = figure.subplots(rows, columns, squeeze=False, sharex=share, sharey=share and share_y)
    every = list(panels.flat)
    for axes in every[n:]:
        axes.set_visible(False)
    for axes in every[max(n - columns, 0) : n]:
        axes.tick_params(labelbottom=True)
    return figure, every[: max(n, 1)]


def typical_reach(reaches: Iterable[float]) -> float:
    """Return how far the axes must reach for most streams: one outlier must not shrink all the others."""
    lengths = list(reaches)
    return 1.15 * float(np.median(lengths)) if lengths else 1.0


def shrink_text(figure: Figure, factor: float) -> None:
    """Multiply the size of every text of a figure; no text gets smaller than a journal prints."""

    def shrunk(text: Text) -> float:
        return max(factor * float(text.get_fontsize()), SMALLEST)

    for axes in figure.axes:
        for text in (axes.xaxis.label, axes.yaxis.label, axes.title, *axes.texts):
            text.set_fontsize(shrunk(text))
        for axis in (axes.xaxis, axes.yaxis):
            if numbers := axis.get_ticklabels():
                axis.set_tick_params(labelsize=shrunk(numbers[0]))
    legends = [*figure.legends, *(legend for axes in figure.axes if (legend := axes.get_legend()) is not None)]
    for text in (*figure.texts, *(each for legend in legends for each in legend.get_texts())):
        text.set_fontsize(shrunk(text))


def fit_to_journal(figure: Figure) -> None:
    """Make a figure as wide as a column of a journal, or as two where one column would be half its width or less."""
    width, height = figure.get_size_inches()
    factor = min((COLUMN if width < 2 * COLUMN else BOTH) / width, 1.0)
    figure.set_size_inches(factor * width, factor * height)
    shrink_text(figure, factor)


def label_all(figure: Figure, x: str, y: str) -> None:
    """Label all panels at once."""
    figure.supxlabel(x, fontsize=11)
    figure.supylabel(y, fontsize=11)


# Okabe & Ito's colours, which colour-blind readers can distinguish.
BLUE, VERMILION, GREY = "#0072B2", "#D55E00", "#666666"
# Tints of the blue for intervals: opaque, so that legend and band have the same colour.
BAND_68, BAND_95 = "#82B9D9", "#D1E6F1"


def ticks(axes: Axes) -> None:
    """Give the axes minor ticks, inwards, on every side, and few numbers."""
    finish(axes)
    axes.yaxis.set_major_locator(MaxNLocator(5))


def labels(names: Sequence[str], symbols: Sequence[str]) -> list[str]:
    """Return different labels for all parameters: their symbols, or the shortest unambiguous ends of their paths.

    ``names`` are the paths (``potential.halo.m200``); a symbol that equals its path is not used.
    """
    texts = []
    for name, symbol in zip(names, symbols, strict=True):
        parts = name.split(".")
        if symbol == name:
            tails = [".".join(parts[-n:]) for n in range(1, len(parts) + 1)]
            tail = next(t for t in tails if sum(f".{other}".endswith(f".{t}") for other in names) == 1)
            # in lines of some fourteen letters, broken after dots and underscores
            words = re.sub("([._])", r"\1 ", tail)
            texts.append(textwrap.fill(words, 14, break_long_words=False).replace(" ", ""))
        else:
            texts.append(symbol)
    return texts


def folded(text: str, letters: int) -> str:
    """Break a text between words into lines of at most so many letters."""
    return "\n".join(textwrap.wrap(text, letters, break_long_words=False, break_on_hyphens=False)) or text


def across(names: Iterable[str], inches: float, points: float = 9.0) -> int:
    """Return the number of columns that a legend of these names may have in a width.

    With matplotlib's defaults, a sign and its distance from the name are 2.8 sizes of the font wide, and columns are 2
    apart; letters are drawn a little wider than they are.
    """
    em = points / 72
    widths = [TextPath((0, 0), line, points).get_extents().width / 72 for name in names for line in name.splitlines()]
    return max(int((inches + 2 * em) / (max(widths, default=0.0) + 5.2 * em)), 1)


def text_inches(names: Iterable[str], points: float) -> float:
    """Return the width of the longest of some names."""
    return LETTER * points / 72 * max((len(name) for name in names), default=0)


def inner_ticks(low: float, high: float, inches: float) -> Array:
    """(n,) Round numbers well inside an axis of that length, so few that their labels of 11 points keep apart."""
    margin, inside = 0.1 * (high - low), np.empty(0)
    for n in (6, 5, 4, 3, 2, 1):
        values = np.asarray(MaxNLocator(n, steps=[1, 2, 2.5, 4, 5, 10]).tick_values(low, high))
        values = values[(values > low + margin) & (values < high - margin)]
        if not values.size:
            break
        inside = values
        room = inches * (values[1] - values[0]) / (high - low) if len(values) > 1 else inches
        if room > 0.095 * max(len(f"{value:g}".replace(".", "")) for value in values) + 0.1:
            break
    return inside


def scaled(unit: str, typical: float) -> tuple[float, str]:
    """Return the power of ten that very large or small values are divided by, and the unit to show."""
    shown, scale = latex(unit), 1.0
    if typical >= 1e5 or 0 < typical < 1e-3:
        power = int(np.floor(np.log10(typical)))
        scale = 10.0**power
        shown = rf"$10^{{{power}}}$ {shown}".strip()
    return scale, shown


def latex(unit: str) -> str:
    """Return a unit as pictures write it."""
    if not unit:
        return ""
    from astropy import units as u

    return str(u.Unit(unit).to_string("latex_inline"))


def with_unit(symbol: str, unit: str, between: str = " ") -> str:
    """Return a label: the symbol and its unit in brackets."""
    return f"{symbol}{between}[{unit}]" if unit else symbol


# Name and colour of each arm.
ARM_STYLE = {1: ("leading", BLUE), -1: ("trailing", VERMILION), 0: ("bound", GREY)}


def finish(axes: Axes) -> None:
    """Give the axes minor ticks, inwards, on every side."""
    axes.minorticks_on()
    axes.tick_params(which="both", direction="in", top=True, right=True, labelsize=10)


# Steps in degrees between the ticks of an axis of angles; beyond, whole turns: 2, 4, 8 ...
ANGLES = (1, 2, 5, 10, 15, 30, 45, 60, 90, 180, 360)


def angle_ticks(axes: Axes, most: int = 8) -> None:
    """Number the horizontal axis, in degrees between the limits it has now, in at most so many even steps."""
    low, high = sorted(axes.get_xlim())
    least = (high - low) / most
    turns = 360 * 2 ** int(np.ceil(np.log2(max(least / 360, 1.0))))
    axes.xaxis.set_major_locator(MultipleLocator(next((step for step in ANGLES if step >= least), turns)))
