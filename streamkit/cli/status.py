"""The command ``streamkit status``."""

from __future__ import annotations

import json
from pathlib import Path

import click

from streamkit.cli.options import JSON, TRUST
from streamkit.study import fit


@click.command()
@click.argument("directory", metavar="DIR", type=click.Path(path_type=Path))
@TRUST
@JSON
def status(directory: Path, trust: bool, as_json: bool) -> None:
    """Say how far a run has come.

    Whether it is running, its steps, when it was last alive, when it may end, the least number of effective samples,
    the largest R-hat, whether to believe it, and the command that goes on with it.
    """
    state = fit.read_status(directory, trust)
    click.echo(json.dumps(state, indent=2) if as_json else fit.describe_status(directory, state))
