"""The command ``streamkit export``."""

from __future__ import annotations

from pathlib import Path

import click

from streamkit import report
from streamkit.cli.options import FORCE_FILE, TRUST
from streamkit.study import fit


@click.command()
@click.argument("directory", metavar="DIR", type=click.Path(path_type=Path))
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), metavar="FILE",
              help="Where to: FILE.nc, .csv, .ecsv or .txt.")  # fmt: skip
@TRUST
@FORCE_FILE
def export(directory: Path, output: Path, trust: bool, force: bool) -> None:
    """Write a run's samples for other programs.

    The suffix of FILE says the format. .nc: netCDF for ArviZ, each walker a chain, with the predictions and the data
    (arviz.from_netcdf reads it). .txt: GetDist's, with .paramnames and .ranges beside it (getdist.loadMCSamples of
    FILE without .txt). .csv and .ecsv: one row per sample, in ECSV with units. Burn-in is left out.
    """
    report.check_target(output, fit.EXPORTS, "--output", force)
    if output.suffix == ".txt":
        for suffix in (".paramnames", ".ranges"):
            report.check_target(output.with_suffix(suffix), (suffix,), "--output", force)
    results = fit.load_results(directory, trust=trust)
    for path in fit.write_samples(results, output):
        click.echo(f"samples: {path}")
    click.echo(results.note())
