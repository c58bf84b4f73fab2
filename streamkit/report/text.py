"""Plain text for a terminal: aligned columns and wrapped paragraphs within 100 columns."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence

WIDTH = 100


def columns(rows: Iterable[Sequence[str]], indent: int = 2, gap: int = 2) -> str:
    """Align rows of cells on the left; a last cell that does not fit is wrapped under its own start."""
    table = [list(row) for row in rows]
    if not table:
        return ""
    count = max(map(len, table))
    widths = [max((len(row[i]) for row in table if i < len(row) - 1), default=0) for i in range(count)]
    lines = []
    for row in table:
        cells = [f"{cell:<{width + gap}}" for cell, width in zip(row[:-1], widths, strict=False)]
        lines.append(paragraph(row[-1], " " * indent + "".join(cells)))
    return "\n".join(lines)


def paragraph(text: str, first: str = "", rest: str | None = None) -> str:
    """Wrap text after ``first``, continuing after ``rest`` (as many blanks as ``first`` is wide, if None)."""
    rest = " " * len(first) if rest is None else rest
    if len(rest) > WIDTH - 20:  # no room left beside the columns: do not squeeze the text into a strip
        rest = " " * 8
    filled = textwrap.fill(
        text, WIDTH, initial_indent=first, subsequent_indent=rest,
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
