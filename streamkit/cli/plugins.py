"""The command ``streamkit plugins``."""

from __future__ import annotations

import click

from streamkit import components, report
from streamkit.cli.completion import kinds_of, roles
from streamkit.cli.options import JSON


@click.command()
@click.argument("kind", required=False, shell_complete=roles)
@click.argument("name", required=False, shell_complete=kinds_of("kind"))
@JSON
def plugins(kind: str | None, name: str | None, as_json: bool) -> None:
    """List the installed components and the packages that supply them.

    KIND (potential, stripping, integrator, observable, data or sampler) lists the components of one kind. KIND and
    NAME describe one component in full: its parameters with units, defaults and bounds.
    """
    registry = components.load_registry()
    if as_json:
        click.echo(report.as_json(report.component_records(registry, kind, name)))
    else:
        click.echo(report.listing(registry, kind, name))
