"""The command ``streamkit report``."""

from __future__ import annotations

from pathlib import Path

import click

from streamkit import report as reports
from streamkit.cli.compiling import tell_of_compiling
from streamkit.cli.options import JSON, LITERATURE, PDF, TRUST
from streamkit.study import fit


@click.command()
@click.argument("directory", metavar="DIR", type=click.Path(path_type=Path))
@click.option("--truth", metavar="TRUE.toml", type=click.Path(path_type=Path),
              help="A run file whose [potential] is the true host of a mock: compare with it.")  # fmt: skip
@LITERATURE
@PDF
@TRUST
@JSON
@click.option("-q", "--quiet", is_flag=True, help="Print nothing.")
def report(
    directory: Path,
    truth: Path | None,
    literature: Path | None,
    pdf: bool,
    trust: bool,
    as_json: bool,
    quiet: bool,
) -> None:
    """Write a run's tables, pictures and page again.

    The page, report.html, says what was found, whether to believe it, and what was run.

    With --truth also the recovery of a mock: the mass profile and rotation curve over the true ones, with the relative
    difference, and recovered minus true in sigma by radius. The [potential] of TRUE.toml needs numbers, no priors;
    other sections are not looked at.

    With --literature also published values: a table (ECSV, CSV, FITS, VOTable) with the columns quantity (M, v_c,
    q_Phi for the flattening of the potential, q_rho for that of the halo's density), radius (kpc), for q_Phi z (kpc),
    value, error_minus, error_plus (Msun or km/s) and reference. It is kept in DIR for later reports.
    """
    if not quiet:
        tell_of_compiling()
    results = fit.write_products(directory, truth, literature, pdf, trust)
    if as_json:
        click.echo(reports.as_json(fit.results_record(results)))
    elif not quiet:
        click.echo(fit.describe_results(results))
    if truth is not None and not (as_json or quiet):
        click.echo(f"\n{fit.describe_recovery(directory)}")
