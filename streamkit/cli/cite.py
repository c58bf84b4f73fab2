"""The command ``streamkit cite``."""

from __future__ import annotations

from pathlib import Path

import click

import streamkit as sk
from streamkit import fit, report
from streamkit.cli.options import TRUST


@click.command()
@click.argument("path", metavar="RUN.toml|DIR", type=click.Path(path_type=Path))
@TRUST
def cite(path: Path, trust: bool) -> None:
    """Print what to cite, as BibTeX.

    The list holds what the run file, or the run in DIR, uses: components, sampler and packages, and published values
    that are shown beside the run. Add the sources of your data.
    """
    spec = fit.load_spec(path, trust=trust) if path.is_dir() else sk.load(path)
    click.echo(report.cited(spec, fit.published_with(path)), nl=False)
