"""The command `streamkit expand`. Nothing heavy is imported before its use."""

from __future__ import annotations

from pathlib import Path

import click

from streamkit.cli import QUIET
from streamkit_hosts.options import FORCE, OUTPUT


@click.command()
@click.version_option(package_name="streamkit-hosts", message="streamkit-hosts %(version)s")
@click.argument("snapshots", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--type", "types", multiple=True, type=click.IntRange(0), metavar="N",
              help="Particles of PartTypeN only; may be given again. Default: all.")  # fmt: skip
@click.option("--l-max", default=4, show_default=True, type=click.IntRange(0, 12), metavar="L",
              help="Largest degree of the spherical harmonics.")  # fmt: skip
@click.option("--radii", default=25, show_default=True, type=click.IntRange(10, 500), metavar="N",
              help="Number of radii.")  # fmt: skip
@click.option("--centre", type=click.Choice(["densest", "origin"]), default="densest", show_default=True,
              help="Where the host is in each snapshot.")  # fmt: skip
@OUTPUT
@FORCE
@QUIET
def expand(
    snapshots: tuple[Path, ...], types: tuple[int, ...], l_max: int, radii: int, centre: str, output: Path,
    force: bool, quiet: bool,
) -> None:  # fmt: skip
    """Make the particles of a simulation the host of streams.

    SNAPSHOTS are in the Gadget layout (HDF5), one or a series; the last in time is today. FILE is the table of a
    `multipole` potential, in time if there are several; the path of its centre, if it moves, is a table beside it. The
    lines to put into a run file are printed.
    """
    from streamkit.report import save_table
    from streamkit_hosts import series
    from streamkit_hosts.sections import check_free, file_of_path, path_table, section_lines

    beside = file_of_path(output)
    check_free([output, beside], force)
    made = series.expand(
        snapshots, types=types, l_max=l_max, radii=radii, centred=centre == "densest",
        tell=None if quiet else click.echo,
    )  # fmt: skip
    save_table(output, made.table)
    if made.path:
        save_table(beside, path_table(made.path))
    for sentence in made.warnings():
        click.echo(f"warning: {sentence}", err=True)
    if quiet:
        return
    click.echo(
        f"radii {made.radii[0]:.3g} to {made.radii[-1]:.3g} kpc, l up to {made.l_max}; median change of the force: "
        f"{made.noise:.2%} by noise, {made.truncation:.2%} without the highest degrees"
    )
    fields = {"centre": str(beside)} if made.path else {}
    lines = section_lines("potential", "multipole", output, made.times, tolerance="3e-3", fields=fields)
    click.echo("\n" + "\n".join(lines))
