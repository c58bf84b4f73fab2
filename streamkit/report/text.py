"""Plain text: aligned columns and wrapped paragraphs, as wide as the terminal.

Elsewhere, in a pipe or a file, paragraphs have 100 columns at most, and each row of a table is one line, for `grep`.
"""

from __future__ import annotations

import io
import shutil
import textwrap
from collections.abc import Iterable, Sequence

from rich.console import Console
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

# Columns of a text that does not go to a terminal, and of a paragraph at most: longer lines are hard to read.
WIDTH = 100
MOST_OF_A_WORD = 40  # letters of a word, such as a path, that are not broken
UNLIMITED = 10_000  # columns of a table that does not go to a terminal
NARROW = 60  # columns below which no text is squeezed


def text_width() -> int:
    """Return the columns of the terminal that standard output is, or `WIDTH`."""
    return max(shutil.get_terminal_size((WIDTH, 0)).columns, NARROW)


def columns(rows: Iterable[Sequence[str]], indent: int = 2, gap: int = 2) -> str:
    """Align rows of cells on the left; what does not fit a terminal in the last column is wrapped there."""
    terminal = shutil.get_terminal_size((0, 0)).columns  # 0 in a pipe, unless COLUMNS is set
    cells, width = [list(row) for row in rows], text_width() if terminal else UNLIMITED
    count = max(map(len, cells), default=0)
    widths = [max((len(row[i]) for row in cells if i < len(row)), default=0) + gap for i in range(count)]
    table = Table.grid(padding=(0, gap, 0, 0), pad_edge=False)
    fits = indent + sum(widths[:-1]) + min(widths[-1] - gap if widths else 0, 20) <= width
    if not fits:
        room = width - indent - gap * count
        widths = [each + gap for each in _squeezed(cells, [each - gap for each in widths], room)]
        width = max(width, indent + sum(widths))
    for i in range(count):
        table.add_column(no_wrap=fits and i < count - 1, overflow="fold", width=None if fits else widths[i] - gap)
    for row in cells:
        table.add_row(*map(Text, row))
    console = Console(file=io.StringIO(), width=width, color_system=None)
    with console.capture() as captured:
        console.print(Padding(table, (0, 0, 0, indent)))
    return "\n".join(line.rstrip() for line in captured.get().splitlines())


def _squeezed(cells: Sequence[Sequence[str]], widths: Sequence[int], room: int) -> list[int]:
    """Return the widths of columns in a room: the widest become narrower first, and none narrower than its words."""
    least = [
        min(max((len(word) for row in cells if i < len(row) for word in row[i].split()), default=0), MOST_OF_A_WORD)
        for i in range(len(widths))
    ]
    fitted = list(widths)
    while sum(fitted) > room:
        spare = [each - low for each, low in zip(fitted, least, strict=True)]
        if max(spare) <= 0:  # the text is wider than the terminal before a word is broken
            break
        fitted[spare.index(max(spare))] -= 1
    return fitted


def paragraph(text: str, first: str = "", rest: str | None = None) -> str:
    """Wrap text after ``first``, continuing after ``rest`` (as many blanks as ``first`` is wide, if None)."""
    rest, width = " " * len(first) if rest is None else rest, min(text_width(), WIDTH)
    if len(rest) > width - 20:  # no room left beside the columns: do not squeeze the text into a strip
        rest = " " * 8
    filled = textwrap.fill(
        text, width, initial_indent=first, subsequent_indent=rest,
        break_long_words=False, break_on_hyphens=False,
    )  # fmt: skip
    return filled or first.rstrip()


def number(value: float, unit: str = "") -> str:
    """Write four significant digits and the unit."""
    return f"{value:.4g} {unit}".rstrip()


def span(low: float, high: float, unit: str = "") -> str:
    """Write a range, or one number where both ends print alike."""
    a, b = f"{low:.3g}", f"{high:.3g}"
    return f"{a if a == b else f'{a} to {b}'} {unit}".rstrip()


def seconds(value: float) -> str:
    """Write a duration in the unit a person would use."""
    for size, unit in ((86400.0, "days"), (3600.0, "h"), (60.0, "min")):
        if value >= 2 * size:
            return f"{value / size:.3g} {unit}"
    return f"{value:.3g} s"
