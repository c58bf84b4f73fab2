"""The files of a study over a grid: tables with their provenance, the resolved run file, pictures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from astropy.table import QTable
from matplotlib.figure import Figure

from streamkit.errors import StreamkitError
from streamkit.report import fit_to_journal, origin, save, save_pictures, save_table
from streamkit.runfile import Spec


@dataclass(frozen=True)
class Products:
    """The products of a study: its run file with its file name, text for a terminal, tables and pictures.

    Tables and pictures are given by file name; pictures are drawn when they are written. The header is added to the
    provenance of the tables. ``stopped`` is the reason of an early end; empty without one. Further files of text are
    ``texts``.
    """

    spec: Spec
    run: str
    text: str
    tables: Mapping[str, QTable]
    pictures: Mapping[str, Callable[[], Figure]]
    header: Mapping[str, Any] = field(default_factory=dict)
    stopped: str = ""
    texts: Mapping[str, str] = field(default_factory=dict)


def write_tables(products: Products, out: Path) -> None:
    """Write the tables with their header, and the resolved run file."""
    for name, table in products.tables.items():
        table.meta = {**origin(products.spec), **products.header}
        save_table(out / name, table)
    for name, content in products.texts.items():
        save(out / name, lambda part, content=content: part.write_text(content, encoding="utf-8"))  # type: ignore[misc]
    text = products.spec.toml()
    save(out / products.run, lambda part: part.write_text(text, encoding="utf-8"))


def draw_pictures(products: Products, out: Path, pdf: bool = False, column: bool = False) -> str:
    """Draw the pictures, as PDF too if ``pdf`` is set or an older PDF exists; for a journal if ``column`` is set.

    If one fails, the others are drawn: return the failures with their reasons, empty without any.
    No picture of an earlier study stays in its place. A file that cannot be written is a `StreamkitError`.
    """
    failed = []
    for name, draw in products.pictures.items():
        try:
            figure = draw()
            if column:
                fit_to_journal(figure)
            save_pictures(out / name, figure, pdf)
        except StreamkitError:
            raise
        except Exception as error:
            for old in (out / name, (out / name).with_suffix(".pdf")):
                old.unlink(missing_ok=True)
            failed.append(f"{name} ({type(error).__name__}: {error})")
    return ", ".join(failed)
