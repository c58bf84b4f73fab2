"""The command ``streamkit schema``."""

from __future__ import annotations

import json

import click

from streamkit import components, runfile


@click.command()
def schema() -> None:
    """Print the JSON Schema of the run file.

    It includes the installed plugins. Editors use it to complete and check run files.
    """
    click.echo(json.dumps(runfile.json_schema(components.load_registry()), indent=2))
