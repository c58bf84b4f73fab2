"""The command ``streamkit cite``."""

from __future__ import annotations

from pathlib import Path

import click

import streamkit as sk
from streamkit import report


@click.command()
@click.argument("path", metavar="RUN.toml|DIR", type=click.Path(path_type=Path))
def cite(path: Path) -> None:
    """Print what to cite, as BibTeX.

    It is exactly what the run file, or the run in DIR, uses: the components, the sampler, the packages that do the
    work. The sources of your data are yours to add.
    """
    click.echo(report.cited(sk.load(path / "run.toml" if path.is_dir() else path)), nl=False)
