"""The command ``streamkit export``."""

from __future__ import annotations

from pathlib import Path

import click

from streamkit import fit, report
from streamkit.cli.options import FORCE_FILE, TRUST


@click.command()
@click.argument("directory", metavar="DIR", type=click.Path(path_type=Path))
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), metavar="FILE",
              help="File to write: FILE.nc, .csv, .ecsv or .txt.")  # fmt: skip
@TRUST
@FORCE_FILE
def export(directory: Path, output: Path, trust: bool, force: bool) -> None:
    """Write a run's samples, without burn-in, in the format of another program.

    The suffix of FILE selects the format:

    \b
    .nc          netCDF for ArviZ (arviz.from_netcdf), each walker a chain, with predictions and data
    .txt         GetDist (getdist.loadMCSamples), with .paramnames and .ranges in the same directory
    .csv, .ecsv  one row per sample; ECSV has units
    """  # noqa: D301  click reads the backspace: a paragraph that is not wrapped
    report.check_target(output, fit.EXPORTS, "--output", force)
    if output.suffix == ".txt":
        for suffix in (".paramnames", ".ranges"):
            report.check_target(output.with_suffix(suffix), (suffix,), "--output", force)
    results = fit.load_results(directory, trust=trust)
    for path in fit.write_samples(results, output):
        click.echo(f"samples: {path}")
    click.echo(results.note())
