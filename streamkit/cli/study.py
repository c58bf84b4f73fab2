"""What the commands over a grid share: run the study in its directory, write it, print it, leave with its status."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import click

from streamkit import report
from streamkit.cli.options import INTERRUPTED, INVALID
from streamkit.study import grid


def conduct(
    out: Path,
    count: int,
    study: Callable[[Callable[[], object]], grid.Products],
    *,
    quiet: bool,
    as_json: bool = False,
    pdf: bool = False,
    unit: str = "stream",
) -> None:
    """Run a study, which calls its argument after each of so many streams, and show what it found."""
    with report.locked(out):
        with report.Progress(out.name, count, unit, shown=not quiet) as bar:
            products = study(bar.update)
        grid.write_tables(products, out)
        if as_json:
            tables = {name: report.table_record(table) for name, table in products.tables.items()}
            click.echo(report.as_json({"directory": str(out), "stopped": products.stopped, "tables": tables}))
        elif not quiet:
            click.echo(f"{products.text}\n")
        failed = grid.draw_pictures(products, out, pdf)
    if not (quiet or as_json):
        click.echo(f"tables and picture{'s' * (len(products.pictures) > 1)}: {out}")
    if failed:
        click.echo(f"streamkit: not drawn: {failed}; everything else is written", err=True)
    if products.stopped:
        click.echo(f"streamkit: {products.stopped}; the tables hold what was finished", err=True)
        click.get_current_context().exit(INTERRUPTED if products.stopped == grid.INTERRUPTED else INVALID)
