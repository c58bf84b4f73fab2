"""The command `streamkit expand`. Nothing heavy is imported before its use."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from streamkit.cli import QUIET
from streamkit_hosts.options import FORCE, OUTPUT

RESPONSE: dict[str, Any] = {"amplitude": {"uniform": [-1, 3]}}  # a prior that holds a rigid host, and the table's


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
@click.option("--response", is_flag=True, help="Only how it deforms: the degrees from 1 on, for a host of the kind "
              "response beside a rigid halo.")  # fmt: skip
@OUTPUT
@FORCE
@QUIET
def expand(
    snapshots: tuple[Path, ...], types: tuple[int, ...], l_max: int, radii: int, centre: str, response: bool,
    output: Path, force: bool, quiet: bool,
) -> None:  # fmt: skip
    """Make the particles of a simulation the host of streams.

    SNAPSHOTS are in the Gadget layout (HDF5), one or a series; the last in time is today. FILE is the table of a
    `multipole` potential, in time if there are several; the path of its centre, if it moves, is a table beside it. The
    lines to put into a run file are printed.

    With --response the table has the halo's dipole, quadrupole and so on about its moving centre, without its mean.
    Beside a rigid halo and the body that deforms it (`[body.NAME]`, which moves the host), a fit finds its amplitude.
    """
    from streamkit.report import save_table
    from streamkit_hosts import series
    from streamkit_hosts.sections import check_free, file_of_path, path_table, section_lines

    if response and l_max < 1:
        raise click.UsageError("--response needs --l-max 1 or more: it has no mean potential")
    beside = file_of_path(output)
    check_free([output] if response else [output, beside], force)
    made = series.expand(
        snapshots, types=types, l_max=l_max, radii=radii, centred=centre == "densest", response=response,
        tell=None if quiet else click.echo,
    )  # fmt: skip
    save_table(output, made.table)
    if made.path and not response:
        save_table(beside, path_table(made.path))
    for sentence in made.warnings():
        click.echo(f"warning: {sentence}", err=True)
    if quiet:
        return
    of = "response today" if response else "force"
    click.echo(
        f"radii {made.radii[0]:.3g} to {made.radii[-1]:.3g} kpc, l up to {made.l_max}; median change of the {of}: "
        f"{made.noise:.2%} by noise, {made.truncation:.2%} without the highest degrees"
    )
    if response:
        section, kind, fields, tolerance = "potential.response", "response", RESPONSE, "5e-2"
    else:
        section, kind, tolerance = "potential", "multipole", "3e-3"
        fields = {"centre": str(beside)} if made.path else {}
    lines = section_lines(section, kind, output, made.times, tolerance=tolerance, fields=fields)
    click.echo("\n" + "\n".join(lines))
