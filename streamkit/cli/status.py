"""The command ``streamkit status``."""

from __future__ import annotations

import json
from pathlib import Path

import click

from streamkit import fit
from streamkit.cli.options import JSON, TRUST


@click.command()
@click.argument("directory", metavar="DIR", type=click.Path(path_type=Path))
@TRUST
@JSON
def status(directory: Path, trust: bool, as_json: bool) -> None:
    """Show the progress of a run.

    Printed are whether the run is active, its steps, the time when it was last active, the expected end, the smallest
    number of effective samples, the largest R-hat, the verdict on convergence, and the command that resumes the run.
    """
    state = fit.read_status(directory, trust)
    click.echo(json.dumps(state, indent=2) if as_json else fit.describe_status(directory, state))
