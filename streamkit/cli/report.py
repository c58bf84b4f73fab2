"""The command ``streamkit report``."""

from __future__ import annotations

from pathlib import Path

import click

from streamkit import fit
from streamkit import report as reports
from streamkit.cli.compiling import announce_compilation
from streamkit.cli.options import COLUMN, JSON, LITERATURE, PDF, TRUST


@click.command()
@click.argument("directory", metavar="DIR", type=click.Path(path_type=Path))
@click.option("--truth", metavar="TRUE.toml", type=click.Path(path_type=Path),
              help="Compare with the true host of a mock: the [potential] of this run file.")  # fmt: skip
@LITERATURE
@PDF
@COLUMN
@TRUST
@JSON
@click.option("-q", "--quiet", is_flag=True, help="Print nothing.")
def report(
    directory: Path,
    truth: Path | None,
    literature: Path | None,
    pdf: bool,
    column: bool,
    trust: bool,
    as_json: bool,
    quiet: bool,
) -> None:
    """Write a run's tables, pictures and page again.

    The page, report.html, shows the results, the verdict on convergence, and the run file.

    --truth adds the recovery of a mock: the mass profile and rotation curve with the true ones, the relative
    difference, and recovered minus true in sigma by radius. The [potential] of TRUE.toml needs numbers, no priors;
    its other sections are not read.

    --literature adds published values: a table (ECSV, CSV, FITS, VOTable) with the columns quantity (M, v_c,
    q_Phi for the flattening of the potential, q_rho for that of the halo's density), radius (kpc), for q_Phi z (kpc),
    value, error_minus, error_plus (Msun or km/s) and reference. A copy in DIR serves later reports.
    """
    if not quiet:
        announce_compilation()
    results = fit.write_products(directory, truth, literature, pdf, trust, column=column)
    if as_json:
        click.echo(reports.as_json(fit.results_record(results)))
    elif not quiet:
        click.echo(fit.describe_results(results))
    if truth is not None and not (as_json or quiet):
        click.echo(f"\n{fit.describe_recovery(directory)}")
