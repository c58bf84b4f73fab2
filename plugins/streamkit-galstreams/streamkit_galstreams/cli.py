"""The command `streamkit galstreams`. Nothing heavy is imported before its use."""

from __future__ import annotations

import click


@click.command()
@click.version_option(package_name="streamkit-galstreams", message="streamkit-galstreams %(version)s")
@click.argument("name", required=False)
@click.option("--all", "every", is_flag=True, help="List streams without distances or proper motions too.")
def galstreams(name: str | None, every: bool) -> None:
    """List the streams of galstreams, and what was measured of each.

    With NAME, list the tracks of one stream, and what was found in their rows. 'streamkit init --stream NAME' writes
    a run file.
    """
    from streamkit_galstreams import listing

    click.echo(listing.stream_text(name) if name else listing.streams_text(every))
