"""The common part of the commands that run a study: options, directory, files, text and exit status."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import Any

import click

from streamkit import report
from streamkit.cli.options import COLUMN, FORCE, JSON, PDF, QUIET, RUN_FILE, WORKERS, directory
from streamkit.study import grid


@dataclass(frozen=True)
class StudyOptions:
    """The values of the options that every study has: its directory, its processes, and the form of its output."""

    out: Path
    workers: int
    force: bool
    pdf: bool
    column: bool
    as_json: bool
    quiet: bool


def study_options(suffix: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Add the run file and the options that every study has; the command gets them as one argument ``options``.

    The directory is by default the run file's name and the suffix.
    """

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        @wraps(command)
        def with_options(run_file: Path, output: Path | None, **values: Any) -> None:
            shared = {name: values.pop(name) for name in ("workers", "force", "pdf", "column", "as_json", "quiet")}
            out = output if output is not None else Path(f"{run_file.stem}{suffix}")
            command(run_file=run_file, options=StudyOptions(out, **shared), **values)

        # The last is the first in help.
        for option in (QUIET, JSON, COLUMN, PDF, FORCE, directory(suffix), WORKERS, RUN_FILE):
            with_options = option(with_options)
        return with_options

    return decorate


def conduct(
    options: StudyOptions, count: int, study: Callable[[Callable[[], object]], grid.Products], unit: str = "stream"
) -> None:
    """Run a study, write its files, print its tables, and end the process with the exit status.

    The study makes ``count`` streams, or other units, and calls its argument after each.
    """
    out, silent = options.out, options.quiet or options.as_json
    with report.locked(out):
        with report.Progress(out.name, count, unit, shown=not options.quiet) as bar:
            products = study(bar.update)
        grid.write_tables(products, out)
        if options.as_json:
            tables = {name: report.table_record(table) for name, table in products.tables.items()}
            click.echo(report.as_json({"directory": str(out), "stopped": products.stopped, "tables": tables}))
        elif not silent:
            click.echo(f"{products.text}\n")
        failed = grid.draw_pictures(products, out, options.pdf, options.column)
    if not silent:
        click.echo(f"tables{' and picture' * bool(products.pictures)}{'s' * (len(products.pictures) > 1)}: {out}")
    if failed:
        click.echo(f"streamkit: not drawn: {failed}; everything else is written", err=True)
    if products.stopped:
        context = click.get_current_context()
        again = "; --resume goes on" if "resume" in context.params else ""
        click.echo(f"streamkit: {products.stopped}; the tables hold the finished part{again}", err=True)
        context.exit(grid.exit_status(products.stopped))
