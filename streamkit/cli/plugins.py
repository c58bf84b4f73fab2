"""The command ``streamkit plugins``."""

from __future__ import annotations

import click

from streamkit import components, report


@click.command()
@click.argument("kind", required=False)
@click.argument("name", required=False)
def plugins(kind: str | None, name: str | None) -> None:
    """List the installed components and who supplies them.

    With KIND (potential, stripping, integrator or observable), those of one kind; with NAME as well, one
    component in full: its parameters with units, defaults and bounds.
    """
    click.echo(report.listing(components.load_registry(), kind, name))
