"""The command `streamkit import-host`. Nothing heavy is imported before its use."""

from __future__ import annotations

from pathlib import Path

import click

from streamkit.cli import QUIET
from streamkit_hosts.options import FORCE, OUTPUT

POSITIVE = click.FloatRange(0, min_open=True)


@click.command("import-host")
@click.version_option(package_name="streamkit-hosts", message="streamkit-hosts %(version)s")
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--length", type=POSITIVE, metavar="KPC", help="Unit of length of the files, in kpc.")
@click.option("--mass", type=POSITIVE, metavar="MSUN", help="Unit of mass of the files, in Msun.")
@click.option("--time", type=POSITIVE, metavar="GYR",
              help="Unit of time of the files, in Gyr. Default: that of length and mass, with G = 1.")  # fmt: skip
@click.option("--today", type=float, metavar="T",
              help="Time of today, in the files' unit. Default: the last one of EXP, 0 of AGAMA.")  # fmt: skip
@click.option("--l-max", type=click.IntRange(0, 32), metavar="L",
              help="Largest degree of the spherical harmonics. Default: all.")  # fmt: skip
@click.option("--every", default=1, show_default=True, type=click.IntRange(1), metavar="N",
              help="Take every N-th time, counted from the last.")  # fmt: skip
@click.option("--between", nargs=2, type=POSITIVE, default=(5.0, 60.0), show_default=True, metavar="KPC KPC",
              help="Radii of the streams, at which the expansion must have converged.")  # fmt: skip
@click.option("--precision", default=3e-5, show_default=True, type=click.FloatRange(1e-7, 1e-2), metavar="X",
              help="Of the radial force between the radii of the table: a larger one needs fewer.")  # fmt: skip
@OUTPUT
@FORCE
@QUIET
def import_host(
    files: tuple[Path, ...], length: float | None, mass: float | None, time: float | None, today: float | None,
    l_max: int | None, every: int, between: tuple[float, float], precision: float, output: Path, force: bool,
    quiet: bool,
) -> None:  # fmt: skip
    """Make a host that another code has expanded the host of streams.

    FILES are a basis of EXP (YAML) and its coefficients (HDF5), or one INI file of AGAMA. Neither code is needed. FILE
    is the table of a `multipole` potential, in time if there are several times. Discs and bars of AGAMA (`CylSpline`)
    have tables of their own beside it, for `cylspline` potentials. The sections for a run file are printed.
    """
    from streamkit import StreamkitError
    from streamkit_hosts import agama, exp
    from streamkit_hosts.sections import described, written

    if between[0] >= between[1]:
        raise StreamkitError(f"--between: found {between[0]:g} and {between[1]:g}; expected a smaller and a larger one")
    found = ", ".join(file.name for file in files)
    hosts: list[agama.Host]
    if len(files) == 2 and files[0].suffix in (".yml", ".yaml"):
        source = exp.read(*files, exp.Units(length, mass, time), l_max=l_max, every=every, today=today)
        hosts = [agama.Host("multipole", source.times, source, centre=source.path)]
    elif len(files) == 1 and files[0].suffix == ".ini":
        hosts = agama.read(files[0], agama.Units.of(length, mass, time), l_max=l_max, every=every, today=today)
    else:
        raise StreamkitError(
            f"found {found}; expected a basis of EXP (.yml, .yaml) and its coefficients (HDF5), or one file of AGAMA "
            "(.ini)"
        )
    for part in written(hosts, between, output, precision=precision, force=force):
        for sentence in part.warnings:
            click.echo(f"warning: {sentence}", err=True)
        if not quiet:
            click.echo(described(part))
